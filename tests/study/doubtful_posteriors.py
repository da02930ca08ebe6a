"""Units whose Laplace approximation is in doubt, against chains: the rule of `imubayes batch --sample flagged`.

    python tests/study/doubtful_posteriors.py            200 units; writes benchmarks/results/doubtful_posteriors.md
    python tests/study/doubtful_posteriors.py 6          some, printed only

Units are polar tumbles with the stated noise, and with ten and a hundred times as much, which the priors then rule.
Each is fitted as in a batch, judged by its importance weights, and sampled in full.
"""

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "archive"))
from small_units import MODEL, change_readings, edit, make_units

from imubayes.campaign import load_campaign
from imubayes.inference.chains import Settings
from imubayes.inference.run_fit import joint_fit
from imubayes.model.model_file import read_model
from imubayes_archive.unit_fits.fit_unit import WeightShape, bound_to, joint_normal_vectors, weight_shape

REPORT = Path(__file__).parents[2] / "benchmarks" / "results" / "doubtful_posteriors.md"
UNITS, STATED, TIMES = 200, 4e-4, (0.0, 10.0, 100.0)


@dataclass(frozen=True)
class Compared:
    """A unit: added noise over the stated, its weights, and how far Laplace and chain are apart.

    `mean` is in standard deviations, `sd` a difference of logarithms; each the largest of all parameters.
    """

    noise: float
    weights: WeightShape
    mean: float
    sd: float


def compared(units: int) -> Iterator[Compared]:
    """Yield what each unit shows."""
    spec = read_model(MODEL)
    with tempfile.TemporaryDirectory() as folder:
        for place, unit in enumerate(make_units(Path(folder), units)):
            random, noise = np.random.default_rng(1000 + place), TIMES[place % len(TIMES)]
            for file in sorted((unit / "runs").glob("*.csv")):
                change_readings(file, lambda v, n=noise, r=random: v + r.normal(0, STATED * n, len(v)))
            # Noise that drowns the Earth rate makes every scale look alike.
            edit(unit / "campaign.toml", "format = 1", 'format = 1\naccepted = ["channel_unit"]')
            model = bound_to(spec, load_campaign(unit))
            laplace = joint_fit(model, None, laplace_draws=joint_normal_vectors(*model.problem.size))
            chain = joint_fit(model, Settings(seed=0))
            assert laplace.posterior is not None
            assert chain.posterior is not None
            ours, theirs = laplace.posterior.points, chain.posterior.points
            spread = theirs.std(axis=0)
            yield Compared(
                noise, weight_shape(laplace, 0),
                float(np.max(np.abs(ours.mean(axis=0) - theirs.mean(axis=0)) / spread)),
                float(np.max(np.abs(np.log(ours.std(axis=0) / spread)))),
            )  # fmt: skip


def lines_of(found: list[Compared]) -> list[str]:
    """Return the tables of the report."""
    rows = [
        "| noise, times the stated | units | flagged | means off by at most / sd | of those not flagged | "
        "sd off by at most | of those not flagged |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for noise in TIMES:
        own = [each for each in found if each.noise == noise]
        kept = [each for each in own if not each.weights.flagged]
        if kept:
            rows.append(
                f"| {1 + noise:g} | {len(own)} | {len(own) - len(kept)} | {max(e.mean for e in own):.3f} | "
                f"{max(e.mean for e in kept):.3f} | {max(e.sd for e in own):.1%} | {max(e.sd for e in kept):.1%} |"
            )
    apart = np.array([[each.mean, each.weights.off] for each in found])
    share = np.corrcoef(apart.T)[0, 1] if len(found) > 2 else np.nan
    return [
        *rows,
        "",
        f"How far the weights say that moments are off, and how far means are off: correlation {share:.2f}.",
    ]


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else UNITS
    text = "\n".join(lines_of(list(compared(count))))
    if count == UNITS:
        said = f"{UNITS} polar tumbles, each fitted as in a batch and sampled in full"
        head = f"# Units whose posterior is in doubt\n\n{said}:\n`tests/study/doubtful_posteriors.py`."
        REPORT.write_text(f"{head}\n\n{text}\n")
    print(text)

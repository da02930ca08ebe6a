"""Simulated replicates of every procedure by itself: do the joint fit's uncertainties hold what they promise?

    python tests/study/replicates.py                  all procedures, 50 replicates each; writes the table
    python tests/study/replicates.py servo_table 10   some, printed only
    python tests/study/replicates.py thermal 80 5001  80 replicates from a seed on

Campaigns come from `data/generators`, which shares no code with the package, with seats, tables, converters and gyros
that err as the priors of the model say: what the textbook takes as exact does not hold in them.
"""

import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np
from scipy.stats import norm

from imubayes.campaign import load_campaign
from imubayes.inference.chains import Settings
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model

jax.config.update("jax_enable_x64", True)

ROOT = Path(__file__).parents[2]
REPORT = ROOT / "benchmarks" / "results" / "procedures.md"
sys.path.insert(0, str(ROOT / "data" / "generators"))
REPLICATES = 50
# Procedure → the generator and model that show it, of which its own runs are taken.
CASES = {
    "rate_table": "trihedral_imu",
    "dividing_head": "trihedral_imu",
    "rotation_modulation": "rotation_modulation",
    "polar_tumble": "polar_tumble",
    "geographic_tumble": "geographic_tumble",
    "servo_table": "servo_table",
    "thermal_ramp, current_injection": "accel_channel",
    "reference_gyro": "reference_gyro",
    "multi_axis_table": "multi_axis_table",
    "centrifuge": "centrifuge",
    "free_tumble": "desk_imu",
}
# If few runs determine the scatter between runs its tail matters, and the posterior is sampled; elsewhere draws of the
# nested Laplace approximation serve.
SAMPLED = ("thermal_ramp, current_injection", "reference_gyro")


@dataclass(frozen=True)
class Extreme:
    """The parameter that a replicate missed by most, in some measure."""

    size: float
    parameter: str
    seed: int

    def __str__(self) -> str:
        return f"{self.size:.1f} (`{self.parameter}`, seed {self.seed})"


@dataclass(frozen=True)
class Scores:
    """(mean − truth)/sd and whether the 95 % interval holds the truth, for every parameter of every replicate.

    `failed` counts fits that did not converge.  `largest` is the largest |score|, of `largest_rank` the normal score of
    the share of draws below the truth: if the scatter between few runs is unknown the posterior is a mixture of
    narrow and wide distributions, whose standard deviation says little of its tails.
    """

    procedure: str
    z: np.ndarray
    inside: np.ndarray
    failed: int
    seconds: float
    largest: Extreme
    largest_rank: Extreme

    @property
    def rms(self) -> float:
        """Root mean square of the scores."""
        return float(np.sqrt(np.mean(self.z**2)))

    @property
    def coverage(self) -> float:
        """Share of 95 % intervals that hold the truth."""
        return float(np.mean(self.inside))


def scores(procedure: str, replicates: int = REPLICATES, first_seed: int = 1) -> Scores:
    """Return the scores of one procedure over replicates."""
    generator = __import__(CASES[procedure])
    name = CASES[procedure].replace("_", "-")
    spec = read_model(ROOT / "models" / f"{name}.toml")
    spec = replace(spec, effects=tuple(replace(one, optional=True) for one in spec.effects))
    found, where, failed, clock = [], [], 0, time.perf_counter()
    for seed in range(first_seed, first_seed + replicates):
        with tempfile.TemporaryDirectory() as folder:
            generator.generate(Path(folder) / name, seed)
            truth = tomllib.loads((Path(folder) / name / "truth.toml").read_text())
            campaign = load_campaign(Path(folder) / name)
        own = [run.name for run in campaign.runs if run.procedure in procedure.split(", ")]
        model = bind(spec, campaign.only(*own))
        fit = joint_fit(model, Settings(seed=seed) if procedure in SAMPLED else None)
        if not fit.converged:
            failed += 1
            continue
        assert fit.posterior is not None
        true = truth["parameters"] | truth["nuisance"]
        for place, parameter in enumerate(model.layout.parameters + model.hyper_layout.parameters):
            if parameter.name in true:
                draws, at = fit.posterior.points[:, place], parameter.z_at(true[parameter.name])
                assert at is not None
                low, high = np.quantile(draws, (0.025, 0.975))
                found.append(((draws.mean() - at) / draws.std(), low <= at <= high, _normal_score(draws, at)))
                where.append((parameter.name, seed))
    z, inside, ranks = np.array(found).T
    seconds = time.perf_counter() - clock
    return Scores(procedure, z, inside, failed, seconds, _extreme(z, where), _extreme(ranks, where))


def _normal_score(draws: np.ndarray, at: float) -> float:
    """Return the standard normal quantile of the share of draws below the truth, half a draw kept to each side."""
    return float(norm.ppf((np.sum(draws < at) + 0.5) / (len(draws) + 1)))


def _extreme(scores: np.ndarray, where: list[tuple[str, int]]) -> Extreme:
    place = int(np.argmax(np.abs(scores)))
    return Extreme(float(np.abs(scores[place])), *where[place])


def report(found: list[Scores]) -> str:
    """Return the table of all procedures."""
    lines = [
        "# Every procedure by itself, over simulated replicates",
        "",
        f"Made by `python tests/study/replicates.py`: {REPLICATES} replicates each, by generators that share no code "
        "with the package. Seats, tables, converters and clocks have errors drawn from the priors. Scores are "
        "(mean − truth)/sd of "
        "all parameters, from draws of the nested Laplace approximation, "
        f"of {' and of '.join(SAMPLED)} from the sampled posterior; required are rms 0.9 … 1.1 and coverage of 95 % "
        "intervals 0.92 … 0.98. A rank score is the standard normal quantile of the share of draws below the truth.",
        "",
        "| procedure | rms score | coverage | scores | not converged | largest score | largest rank score |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {s.procedure} | {s.rms:.3f} | {s.coverage:.4f} | {len(s.z)} | {s.failed} | {s.largest} | {s.largest_rank} |"
        for s in found
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    jax.config.update("jax_compilation_cache_dir", str(ROOT / ".cache" / "jax-study"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    chosen = [one for one in CASES if not sys.argv[1:] or any(word in one for word in sys.argv[1].split(","))]
    count = int(sys.argv[2]) if len(sys.argv) > 2 else REPLICATES
    first = int(sys.argv[3]) if len(sys.argv) > 3 else 1
    found = []
    for procedure in chosen:
        found.append(scores(procedure, count, first))
        print(
            f"{procedure}: rms {found[-1].rms:.3f}, coverage {found[-1].coverage:.4f}, "
            f"largest {found[-1].largest}, of ranks {found[-1].largest_rank}, {found[-1].seconds:.0f} s"
        )
    if len(chosen) == len(CASES) and len(sys.argv) == 1:
        REPORT.write_text(report(found))
        print(REPORT.relative_to(ROOT))
    else:
        print(report(found))


if __name__ == "__main__":
    main()

"""The sampler at its default settings against a chain of 50 times the length: are the tails of short chains whole?

    python tests/study/reference_chains.py                             all shipped campaigns; writes the table
    python tests/study/reference_chains.py accel-channel polar-tumble  some, printed only

Both chains have seeds of their own.  Compared are standard deviations and the ends of the 95 % intervals of all
parameters and noise scales in z, where priors are standard normal.  Asked is that all standard deviations agree to
5 % and all ends to 0.1 standard deviations.
"""

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

from imubayes.campaign import load_campaign
from imubayes.inference.ensemble_sampling import Settings, burn_in
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model

jax.config.update("jax_enable_x64", True)

ROOT = Path(__file__).parents[2]
REPORT = ROOT / "benchmarks" / "results" / "reference_chains.md"
TIMES = 50
SD_BAR, END_BAR = 0.05, 0.1
# Campaigns with their models, the cheapest first.
CAMPAIGNS = (
    "accel-channel",
    "polar-tumble",
    "reference-gyro",
    "rotation-modulation",
    "geographic-tumble",
    "desk-imu",
    "trihedral-imu",
    "redundant-imu",
    "servo-table",
    "full-qualification",
)


@dataclass(frozen=True)
class Comparison:
    """A chain at default settings against a long one.

    Attributes
    ----------
    campaign : name.
    converged : whether the short chain says it converged.
    draws, long_draws : of all ensembles.
    pareto_k : of the proposal's weights.
    sd, sd_name : standard deviation, short over long, of the parameter where it is farthest from 1.
    end, end_name : distance of the ends of the 95 % interval, in standard deviations, where it is largest.
    seconds : of the short chain's sampling.
    """

    campaign: str
    converged: bool
    draws: int
    long_draws: int
    pareto_k: float
    sd: float
    sd_name: str
    end: float
    end_name: str
    seconds: float

    @property
    def met(self) -> bool:
        """Whether all that is asked holds."""
        return self.converged and abs(self.sd - 1) <= SD_BAR and self.end <= END_BAR


def compare(campaign: str, seed: int = 0, times: int = TIMES) -> Comparison:
    """Return the comparison for one shipped campaign."""
    model = bind(read_model(ROOT / "models" / f"{campaign}.toml"), load_campaign(ROOT / "data" / campaign))
    short = joint_fit(model, Settings(seed=seed))
    steps = short.posterior.chains.points.shape[1]
    long = joint_fit(model, Settings(seed=seed + 1000, least_steps=times * steps, most_steps=times * steps))
    assert long.posterior.chains.points.shape[1] >= times * steps - burn_in(times * steps)
    names = model.layout.names + model.hyper_layout.names
    draws, reference = short.posterior.points, long.posterior.points
    ratio = draws.std(axis=0) / reference.std(axis=0)
    distance = np.abs(_ends(short) - _ends(long)).max(axis=0) / reference.std(axis=0)
    sd, end = int(np.argmax(np.abs(ratio - 1))), int(np.argmax(distance))
    return Comparison(
        campaign=campaign,
        converged=short.converged,
        draws=len(draws),
        long_draws=len(reference),
        pareto_k=short.posterior.chains.diagnosis.pareto_k,
        sd=float(ratio[sd]),
        sd_name=names[sd],
        end=float(distance[end]),
        end_name=names[end],
        seconds=short.seconds["sample"],
    )


def _ends(fit: Fit) -> np.ndarray:
    return np.quantile(fit.posterior.points, (0.025, 0.975), axis=0)


def report(found: list[Comparison]) -> str:
    """Return the table."""
    lines = [
        "# Default sampling against chains of 50 times the length",
        "",
        "Made by `python tests/study/reference_chains.py`. Asked: all standard deviations within "
        f"{SD_BAR:.0%}, all ends of 95 % intervals within {END_BAR} standard deviations, in z.",
        "",
        "| campaign | draws | reference | converged | Pareto k | sd ratio farthest from 1 | largest distance of an end "
        "| sampling | met |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {c.campaign} | {c.draws} | {c.long_draws} | {_word(c.converged)} | {c.pareto_k:.2f} "
        f"| {c.sd:.3f} (`{c.sd_name}`) | {c.end:.3f} (`{c.end_name}`) | {c.seconds:.1f} s | {_word(c.met)} |"
        for c in found
    ]
    return "\n".join(lines) + "\n"


def _word(met: bool) -> str:
    return "yes" if met else "no"


def main() -> None:
    """Compare the campaigns named on the command line, or all."""
    jax.config.update("jax_compilation_cache_dir", str(ROOT / ".cache" / "jax-study"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    chosen = [name for name in CAMPAIGNS if not sys.argv[1:] or name in sys.argv[1:]]
    found = []
    for name in chosen:
        clock = time.perf_counter()
        found.append(compare(name))
        print(f"{found[-1]} {time.perf_counter() - clock:.0f} s", flush=True)
    print(report(found))
    if not sys.argv[1:]:
        REPORT.write_text(report(found))


if __name__ == "__main__":
    main()

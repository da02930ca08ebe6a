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
from imubayes.inference import run_fit
from imubayes.inference.ensemble_sampling import _MOST_NUMBERS, Settings, burn_in
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import Model, bind
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
    assert short.posterior is not None
    chains = short.posterior.chains
    assert chains is not None
    draws = chains.points.reshape(-1, chains.points.shape[-1])
    reference = long_chain(model, seed + 1000, chains.points.shape, times)
    names = model.layout.names + model.hyper_layout.names
    ratio = draws.std(axis=0) / reference.std(axis=0)
    distance = np.abs(_ends(draws) - _ends(reference)).max(axis=0) / reference.std(axis=0)
    sd, end = int(np.argmax(np.abs(ratio - 1))), int(np.argmax(distance))
    return Comparison(
        campaign=campaign,
        converged=short.converged,
        draws=len(draws),
        long_draws=len(reference),
        pareto_k=chains.diagnosis.pareto_k or 0.0,
        sd=float(ratio[sd]),
        sd_name=names[sd],
        end=float(distance[end]),
        end_name=names[end],
        seconds=short.seconds["sample"],
    )


def long_chain(model: Model, seed: int, shape: tuple[int, ...], times: int) -> np.ndarray:
    """Return the draws of chains of `times` the length of one of a shape (ensembles, steps, walkers, D), (S, D).

    The sampler stores a chain up to a size; what is longer is several, with seeds of their own.
    """
    ensembles, steps, walkers, dimensions = shape
    most = _MOST_NUMBERS // (ensembles * walkers * dimensions) * 3 // 5
    pieces = -(-times * steps // most)
    each, found = -(-times * steps // pieces), []
    for piece in range(pieces):
        fit = joint_fit(model, Settings(seed=seed + piece, least_steps=each, most_steps=each))
        assert fit.posterior is not None
        assert fit.posterior.chains is not None
        points = fit.posterior.chains.points
        assert points.shape[1] >= each - burn_in(each)
        found.append(points.reshape(-1, dimensions).astype(np.float32))
        del fit, points
    return np.concatenate(found).astype(float)


def _ends(draws: np.ndarray) -> np.ndarray:
    return np.quantile(draws, (0.025, 0.975), axis=0)


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
    run_fit._MOST_DRAWS = sys.maxsize  # all steps of a chain, not those that a result keeps
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

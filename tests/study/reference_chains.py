"""The sampler at its default settings against a chain of 50 times the length: are the tails of short chains whole?

    python tests/study/reference_chains.py                             all shipped campaigns; writes the table
    python tests/study/reference_chains.py accel-channel polar-tumble  some, printed only
    python tests/study/reference_chains.py --short desk-imu            the chains at default settings alone

Both chains have seeds of their own.  Reference chains are kept piece by piece in .cache/reference-chains, by data and
model, so that the study goes on where it was stopped.  Compared are standard deviations and the ends of the 95 %
intervals of all parameters and noise scales in z, where priors are standard normal.  Asked is that all standard
deviations agree to 5 % and all ends to 0.1 standard deviations.
"""

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np

from imubayes.campaign import load_campaign
from imubayes.foundations.files import replacing
from imubayes.inference.chains import Settings, walkers_for
from imubayes.inference.convergence import END_BAR, INTERVAL, SD_BAR
from imubayes.inference.run_fit import data_hash, joint_fit, model_hash
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import read_model

jax.config.update("jax_enable_x64", True)

ROOT = Path(__file__).parents[2]
STORE = ROOT / ".cache" / "reference-chains"
REPORT = ROOT / "benchmarks" / "results" / "reference_chains.md"
TIMES = 50
# If heavy tails make the default chain itself long, a reference of this length has a fifth of its errors or less.
MOST_REFERENCE = 700_000
# Numbers of a piece of a reference chain, and draws of one seed at least.
PIECE, LEAST_PIECE = 4_000_000, 30_000
# Campaigns with their models, the cheapest first.
CAMPAIGNS = (
    "polar-tumble",
    "geographic-tumble",
    "reference-gyro",
    "accel-channel",
    "redundant-imu",
    "multi-axis-table",
    "centrifuge",
    "rotation-modulation",
    "servo-table",
    "trihedral-imu",
    "static-record",
    "desk-imu",
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
    seconds : CPU time of the short chain's sampling, compilation included.
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


@dataclass(frozen=True)
class Short:
    """A chain at default settings: whether it converged, draws (S, D) and draws taken, Pareto k, CPU seconds."""

    converged: bool
    message: str
    draws: np.ndarray
    taken: int
    pareto_k: float
    seconds: float


def bound(campaign: str) -> Model:
    """Return the shipped model bound to a shipped campaign."""
    return bind(read_model(ROOT / "models" / f"{campaign}.toml"), load_campaign(ROOT / "data" / campaign))


def short_chain(model: Model, seed: int) -> Short:
    """Sample at default settings."""
    clock = {}

    def tell(text: str) -> None:
        clock.setdefault(text.split(":")[0], time.process_time())

    fit = joint_fit(model, Settings(seed=seed), progress=tell)
    seconds = time.process_time() - clock["sampling"]
    assert fit.posterior is not None
    chains = fit.posterior.chains
    assert chains is not None
    return Short(
        fit.converged,
        fit.message,
        chains.points.reshape(-1, chains.points.shape[-1]),
        chains.log_density.size,
        chains.diagnosis.pareto_k or 0.0,
        seconds,
    )


def compare(campaign: str, seed: int = 0, times: int = TIMES) -> Comparison:
    """Return the comparison for one shipped campaign."""
    model = bound(campaign)
    short = short_chain(model, seed)
    print(
        f"{campaign}: {short.taken} draws, {short.seconds:.1f} s CPU, k {short.pareto_k:.2f} {short.message}",
        flush=True,
    )
    reference = long_chain(model, min(times * short.taken, MOST_REFERENCE))
    names = model.layout.names + model.hyper_layout.names
    sd = reference.std(axis=0)
    ratio = short.draws.std(axis=0) / sd
    distance = np.abs(_ends(short.draws) - _ends(reference)).max(axis=0) / sd
    worst, end = int(np.argmax(np.abs(ratio - 1))), int(np.argmax(distance))
    return Comparison(
        campaign=campaign,
        converged=short.converged,
        draws=short.taken,
        long_draws=len(reference),
        pareto_k=short.pareto_k,
        sd=float(ratio[worst]),
        sd_name=names[worst],
        end=float(distance[end]),
        end_name=names[end],
        seconds=short.seconds,
    )


def long_chain(model: Model, draws: int) -> np.ndarray:
    """Return at least so many draws of chains of their own, (S, D); what has been kept is read."""
    store = STORE / f"{data_hash(model)[:12]}-{model_hash(model)[:12]}"
    store.mkdir(parents=True, exist_ok=True)
    dimensions = len(model.layout) + len(model.hyper_layout)
    each = max(LEAST_PIECE, PIECE // dimensions)
    found, piece = [], 0
    while sum(map(len, found)) < draws:
        file = store / f"{piece}.npy"
        if not file.is_file():
            with replacing(file) as scratch, scratch.open("wb") as stream:
                np.save(stream, _piece(model, 1000 + piece, each).astype(np.float32))
        found.append(np.load(file))
        piece += 1
    return np.concatenate(found).astype(float)


def _piece(model: Model, seed: int, draws: int) -> np.ndarray:
    """Return a chain of one seed, (S, D), without its burn-in."""
    settings = Settings(seed=seed, most_kept=draws)
    walkers = settings.ensembles * walkers_for(len(model.layout) + len(model.hyper_layout), settings)
    steps = -(-draws // walkers)
    fit = joint_fit(model, replace(settings, least_steps=steps, most_steps=steps))
    assert fit.posterior is not None
    return fit.posterior.points


def _ends(draws: np.ndarray) -> np.ndarray:
    return np.quantile(draws, INTERVAL, axis=0)


def report(found: list[Comparison]) -> str:
    """Return the table."""
    lines = [
        "# Default sampling against chains of 50 times the length",
        "",
        "Made by `python tests/study/reference_chains.py`. Asked: all standard deviations within "
        f"{SD_BAR:.0%}, all ends of 95 % intervals within {END_BAR} standard deviations, in z. References are 50 times "
        f"as long, but not above {MOST_REFERENCE} draws.",
        "",
        "| campaign | draws | reference | converged | Pareto k | sd ratio farthest from 1 | largest distance of an end "
        "| sampling, CPU | met |",
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
    words = [word for word in sys.argv[1:] if not word.startswith("--")]
    chosen = [name for name in CAMPAIGNS if not words or name in words]
    if "--short" in sys.argv:
        for name in chosen:
            short = short_chain(bound(name), 0)
            print(
                f"{name}: {short.taken} draws, {short.seconds:.1f} s CPU, {short.converged} {short.message}", flush=True
            )
        return
    found = []
    for name in chosen:
        found.append(compare(name))
        print(found[-1], flush=True)
    print(report(found))
    if not words:
        REPORT.write_text(report(found))


if __name__ == "__main__":
    main()

"""Noise that is not what the model says: does a fit say so, and what do the intervals of those hold that do not?

    python tests/study/noise_not_as_modelled.py             40 replicates of each noise, from seed 1; prints the table
    python tests/study/noise_not_as_modelled.py 20 501      20 replicates from a seed on

`data/accel-channel` from its generator, which shares no code with the package, with noise of another law in place of
white, normal noise of the same standard deviation (of the same scale if that is infinite).
"""

import sys
import tempfile
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import jax
import numpy as np
from binomial_share import interval

from imubayes.adequacy.noise_tests import judged_noise
from imubayes.campaign import load_campaign
from imubayes.inference.chains import Settings
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model

jax.config.update("jax_enable_x64", True)

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "data" / "generators"))
REPLICATES = 40

Noise = Callable[[np.random.Generator, int], np.ndarray]
"""Draws so many rows of a run, in units of the standard deviation of white noise."""


def _autoregression(correlation: float) -> Noise:
    def drawn(random: np.random.Generator, rows: int) -> np.ndarray:
        noise = random.standard_normal(rows)
        for row in range(1, rows):
            noise[row] = correlation * noise[row - 1] + np.sqrt(1 - correlation**2) * noise[row]
        return noise

    return drawn


def _outliers(random: np.random.Generator, rows: int) -> np.ndarray:
    return random.standard_normal(rows) * np.where(random.uniform(size=rows) < 0.05, 10.0, 1.0)


def _walk(step: float) -> Noise:
    def drawn(random: np.random.Generator, rows: int) -> np.ndarray:
        wander = np.cumsum(step * random.standard_normal(rows))
        return random.standard_normal(rows) + wander - wander[0]

    return drawn


NOISES: dict[str, Noise] = {
    "white, normal": lambda random, rows: random.standard_normal(rows),
    "Student t, 3 degrees of freedom": lambda random, rows: random.standard_t(3, rows) / np.sqrt(3),
    "Student t, 2 degrees of freedom": lambda random, rows: random.standard_t(2, rows),
    "5 % outliers of ten times the size": _outliers,
    "AR(1), correlation 0.3": _autoregression(0.3),
    "AR(1), correlation 0.6": _autoregression(0.6),
    "random walk, 0.1 a row": _walk(0.1),
    "random walk, 0.3 a row": _walk(0.3),
}


@dataclass(frozen=True)
class Outcome:
    """One fit: whether its noise is said not to be as modelled, or suspected; which 95 % intervals hold the truth."""

    flagged: bool
    suspected: bool
    inside: tuple[bool, ...]


def drawn(folder: Path, seed: int, noise: Noise) -> dict[str, float]:
    """Write `accel-channel` with other noise into a folder; return the true values."""
    import accel_channel  # pyright: ignore[reportMissingImports]
    import plan as plans  # pyright: ignore[reportMissingImports]
    import simulate  # pyright: ignore[reportMissingImports]
    import truth  # pyright: ignore[reportMissingImports]

    def read_out(plan, values, seed):
        moments = plans.Moments(plan)
        exact, found = moments.means(moments.outputs(values)), []
        for index, (run, readings) in enumerate(zip(plan.runs, plans.read_out(plan, values, seed), strict=True)):
            mean = exact[moments.run_of_row == index] + readings.run_offset
            for column, channel in enumerate(plan.channels):
                sd = values[f"white_noise.sigma[{channel.name}]"] / np.sqrt([row.samples for row in run.rows])
                mean[:, column] += sd * noise(truth.stream(seed, f"other noise/{run.name}/{channel.name}"), len(sd))
            found.append(replace(readings, mean=mean))
        return found

    with mock.patch.object(simulate, "read_out", read_out):
        accel_channel.generate(folder, seed)
    stated = tomllib.loads((folder / "truth.toml").read_text())
    return stated["parameters"] | stated["nuisance"]


def outcome(seed: int, noise: Noise) -> Outcome:
    """Draw, fit and sample one campaign."""
    with tempfile.TemporaryDirectory() as place:
        true = drawn(Path(place) / "accel-channel", seed, noise)
        model = bind(read_model(ROOT / "models" / "accel-channel.toml"), load_campaign(Path(place) / "accel-channel"))
    fit = joint_fit(model, Settings(seed=seed))
    assert fit.posterior is not None
    inside = []
    for place, parameter in enumerate(model.layout.parameters):
        if parameter.name in true:
            at = parameter.z_at(true[parameter.name])
            low, high = np.quantile(fit.posterior.points[:, place], (0.025, 0.975))
            inside.append(bool(at is not None and low <= at <= high))
    noise = judged_noise(fit)
    return Outcome(bool(noise.violations), bool(noise.suspected), tuple(inside))


def _coverage(outcomes: list[Outcome]) -> str:
    inside = [each for one in outcomes for each in one.inside]
    if not inside:
        return "–"
    held, count = sum(inside), len(inside)
    low, high = interval(held, count)
    return f"{held / count:.3f} ({low:.3f} … {high:.3f}) of {count}"


def main() -> None:
    jax.config.update("jax_compilation_cache_dir", str(ROOT / ".cache" / "jax-study"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    count, first = (int(sys.argv[k]) if len(sys.argv) > k else one for k, one in ((1, REPLICATES), (2, 1)))
    titles = ("said to be not as modelled", "suspected", "coverage of all", "without alarm", "of the silent")
    print(f"| noise | fits | {' | '.join(titles)} |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name, noise in NOISES.items():
        found = [outcome(seed, noise) for seed in range(first, first + count)]
        quiet = [one for one in found if not one.flagged]
        silent = [one for one in quiet if not one.suspected]
        said = f"{len(found) - len(quiet)} | {len(quiet) - len(silent)}"
        coverages = " | ".join(_coverage(each) for each in (found, quiet, silent))
        print(f"| {name} | {count} | {said} | {coverages} |", flush=True)


if __name__ == "__main__":
    main()

"""Causes and noise that no part of the library knows, written on the rows of a plan in plain NumPy.

A cause moves the outputs by a shape of what the rows hold; a noise takes the place of white noise of the same size.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Random = np.random.Generator


@dataclass(frozen=True)
class Rows:
    """What the rows of a plan hold, (n,) each; `signal`, (n, K), is the input that each channel feels, −1 … 1.

    Attributes
    ----------
    rate, angle : of the table, deg/s and rad; the angle is NaN where it turns.
    time, hours : since the start of the run, s, and of the campaign, h.
    run : index of the run.
    """

    rate: np.ndarray
    angle: np.ndarray
    temperature: np.ndarray
    time: np.ndarray
    hours: np.ndarray
    run: np.ndarray
    signal: np.ndarray

    @property
    def starts(self) -> np.ndarray:
        """Whether a row is the first of its run."""
        return np.diff(self.run, prepend=-1) != 0

    @property
    def before(self) -> np.ndarray:
        """The input of the row before, 0 at the start of a run."""
        return np.where(self.starts[:, None], 0.0, np.roll(self.signal, 1, axis=0))


@dataclass(frozen=True)
class Cause:
    """A cause outside the catalogue: its shape in a channel, words that name it, and the run where it acts, if one."""

    shape: Callable[[int], np.ndarray]
    words: tuple[str, ...]
    run: int | None = None


INPUT, TIME, RATE = ("rate", "force", "input", "angle"), ("time", "step", "power_on"), ("rate",)


def _level(rows: Rows, random: Random) -> float:
    levels = np.unique(np.abs(rows.rate[np.abs(rows.rate) > 3]))
    return float(random.choice(levels)) if len(levels) else np.inf


def _resonance(rows: Rows, random: Random) -> Cause:
    centre = _level(rows, random)
    return Cause(lambda k: np.exp(-0.5 * ((np.abs(rows.rate) - centre) / (0.06 * centre)) ** 2), INPUT)


def _harmonic(rows: Rows, random: Random) -> Cause:
    phase = random.uniform(0, 2 * np.pi)
    return Cause(lambda k: np.nan_to_num(np.cos(5 * rows.angle + phase)), ("angle", "force"))


def _step_in_run(rows: Rows, random: Random) -> Cause:
    run = int(random.choice(np.unique(rows.run)))
    at = np.flatnonzero(rows.run == run)
    first = at[int(random.uniform(0.3, 0.7) * len(at))]
    return Cause(lambda k: ((rows.run == run) & (np.arange(len(rows.run)) >= first)).astype(float), (), run)


def _scale_of_run(rows: Rows, random: Random) -> Cause:
    run = int(random.choice(np.unique(rows.run)))
    return Cause(lambda k: rows.signal[:, k] * (rows.run == run), (), run)


def _scale_step(rows: Rows, random: Random) -> Cause:
    half = np.median(rows.hours)
    return Cause(lambda k: rows.signal[:, k] * (rows.hours > half), TIME)


def _dead_time(rows: Rows, random: Random) -> Cause:
    return Cause(lambda k: np.where(rows.starts, 0.0, rows.before[:, k] - rows.signal[:, k]), ("before",))


def _saturation(rows: Rows, random: Random) -> Cause:
    share = random.uniform(0.6, 0.85)
    return Cause(lambda k: np.sign(rows.signal[:, k]) * np.maximum(np.abs(rows.signal[:, k]) - share, 0), INPUT)


def _lock_in(rows: Rows, random: Random) -> Cause:
    share = random.uniform(0.1, 0.3)
    return Cause(lambda k: -rows.signal[:, k] * (np.abs(rows.signal[:, k]) < share), INPUT)


def _rate_by_cube(rows: Rows, random: Random) -> Cause:
    return Cause(lambda k: rows.signal[:, k] * (rows.temperature - 25.0) ** 3, ("temperature",))


def _tanh(rows: Rows, random: Random) -> Cause:
    share = random.uniform(0.05, 0.3)
    return Cause(lambda k: np.tanh(rows.signal[:, k] / share), INPUT)


def _root(rows: Rows, random: Random) -> Cause:
    return Cause(lambda k: np.sqrt(np.abs(rows.signal[:, k])), INPUT)


def _power(rows: Rows, random: Random) -> Cause:
    return Cause(lambda k: np.abs(rows.signal[:, k]) ** 1.5, INPUT)


def _settling(rows: Rows, random: Random) -> Cause:
    span = max(float(np.ptp(rows.time)), 1.0) * random.uniform(0.05, 0.2)
    return Cause(lambda k: np.exp(-rows.time / span), TIME)


def _periodic(rows: Rows, random: Random) -> Cause:
    period, phase = np.ptp(rows.hours) * random.uniform(0.25, 0.6), random.uniform(0, 2 * np.pi)
    return Cause(lambda k: np.sin(2 * np.pi * rows.hours / period + phase), TIME)


def _cross(rows: Rows, random: Random) -> Cause:
    count = rows.signal.shape[1]
    return Cause(lambda k: rows.signal[:, (k + 1) % count] * rows.signal[:, (k + 2) % count], INPUT)


def _direction(rows: Rows, random: Random) -> Cause:
    turned = np.where(rows.starts[:, None], 0.0, np.sign(rows.signal - rows.before))
    return Cause(lambda k: turned[:, k], (*INPUT, "before"))


def _warm_step(rows: Rows, random: Random) -> Cause:
    limit = np.quantile(rows.temperature, random.uniform(0.3, 0.7))
    return Cause(lambda k: (rows.temperature > limit).astype(float), ("temperature", *TIME))


def _angle_by_warmth(rows: Rows, random: Random) -> Cause:
    wave = np.nan_to_num(np.cos(3 * rows.angle)) * (rows.temperature - rows.temperature.mean())
    return Cause(lambda k: wave, ("angle", "temperature", "force"))


CAUSES: dict[str, Callable[[Rows, Random], Cause]] = {
    "resonance at a rate": _resonance, "harmonic 5 of the angle": _harmonic, "bias step in a run": _step_in_run,
    "scale of a run": _scale_of_run, "scale step half way": _scale_step, "dead time between rows": _dead_time,
    "saturation": _saturation, "lock-in": _lock_in, "input × temperature³": _rate_by_cube, "tanh of the input": _tanh,
    "root of |input|": _root, "|input|^1.5": _power, "settling in each run": _settling,
    "bias periodic in time": _periodic, "product of two channels": _cross, "direction of the input": _direction,
    "step of temperature": _warm_step, "harmonic 3 × temperature": _angle_by_warmth,
}  # fmt: skip


# noise of the rows of one run and channel, in units of the white noise of a row


def _correlated(random: Random, rows: int) -> np.ndarray:
    correlation, noise = random.uniform(0.5, 0.8), random.standard_normal(rows)
    for row in range(1, rows):
        noise[row] = correlation * noise[row - 1] + np.sqrt(1 - correlation**2) * noise[row]
    return noise


def _walk(random: Random, rows: int) -> np.ndarray:
    return random.standard_normal(rows) + np.cumsum(0.3 * random.standard_normal(rows))


def _drift(random: Random, rows: int) -> np.ndarray:
    share = np.linspace(0, 1, rows)
    waves = [np.cos(np.pi * order * share) / order for order in (1, 2, 3)]
    return random.standard_normal(rows) + 1.5 * random.standard_normal(3) @ np.array(waves)


def _tails(random: Random, rows: int) -> np.ndarray:
    return random.standard_t(3, rows)


def _outliers(random: Random, rows: int) -> np.ndarray:
    gross = (random.uniform(size=rows) < 0.02) * random.uniform(10, 40) * random.choice([-1, 1], rows)
    return random.standard_normal(rows) + gross


def _offsets(random: Random, rows: int) -> np.ndarray:
    return random.standard_normal(rows) + 2.5 * random.standard_normal()


def _white(random: Random, rows: int) -> np.ndarray:
    return random.standard_normal(rows)


NOISES: dict[str, Callable[[Random, int], np.ndarray]] = {
    "AR(1)": _correlated, "random walk": _walk, "slow drift": _drift, "Student t3": _tails, "gross outliers": _outliers,
    "offsets of runs": _offsets, "rounding": _white,
}  # fmt: skip
ROUNDED = 2.0
"""Step of outputs that are rounded, in units of the white noise of a row."""

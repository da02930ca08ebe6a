"""Deviations of the noise from its statement: structures of the rows of a channel, and offsets between its runs.

A structure is a covariance of the rows of one run up to a scale.  It whitens columns of rows that are divided by the
noise known beforehand, and determines the log determinant of that.  Offsets of runs lie on top of any structure: their
variance changes Gram matrices by a term of low rank, so that they cost nothing.

- As known; another scale.
- A state beside white noise (Kalman filter): AR(1) alone or with white noise, or a random walk.
- White noise that grows with the input, var ∝ 1 + k (input / largest)².
- Heavy tails: Student's t as a scale mixture, a normal law with a weight for each row and a lower bound of the log
  density.  The weights are found with the fit (West, JRSS B 46, 431, 1984).

Correlation in time that the model states is whitened first: any structure is one of its innovations.  Of it, of heavy
tails and of a scatter between runs that the model has, each size that the prior allows is noise as stated.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from typing import Literal

import numpy as np
from scipy import special

from imubayes.adequacy.known_noise import SISTERS_LOG_SD
from imubayes.criticism.evidence import linear_problem as linear

_BLOCK = 64
"""Rows that are filtered by one matrix.  Numerical: a compromise of loops and products."""
_RAISED = 2.0
"""Ratio of the scatter of a run to that of the others from which its count of samples is doubted (convention)."""
Family = Literal["known", "scale", "correlated", "wander", "rate", "tails", "runs", "counts"]


@dataclass(frozen=True)
class NoiseStructure:
    """A structure of the rows of a channel.

    Attributes
    ----------
    free : whether its scale is not that of the noise known beforehand.
    """

    family: Family
    free: bool = False

    @property
    def is_white(self) -> bool:
        """Whether rows stay as they are."""
        return True

    def whiten(self, rows: linear.ChannelRows, columns: np.ndarray) -> tuple[np.ndarray, float]:
        """Return columns (n, C) whitened, and the log determinant of the whitening."""
        return columns, 0.0


@dataclass(frozen=True)
class StateNoise(NoiseStructure):
    """White noise of variance `white` beside a state x_k = φ x_(k−1) + w of variance `drive`, starting at `start`."""

    phi: float = 0.0
    drive: float = 0.0
    white: float = 1.0
    start: float = 0.0

    @property
    def is_white(self) -> bool:
        return False

    def whiten(self, rows: linear.ChannelRows, columns: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the innovations of a Kalman filter over each run, all columns at once."""
        found, log_det = np.empty_like(columns), 0.0
        for length in {each for _, each in rows.series}:
            places = np.array([start for start, each in rows.series if each == length])[:, None] + np.arange(length)
            state, variance = np.zeros((len(places), 1, columns.shape[1])), self.start
            for first in range(0, length, _BLOCK):
                here = places[:, first : first + _BLOCK]
                block = _filter_block(self, here.shape[1], variance)
                joined = np.concatenate([columns[here], state], axis=1)
                found[here], state = block.innovations @ joined, block.state @ joined
                log_det, variance = log_det + len(places) * block.log_det, block.variance
        return found, log_det


@dataclass(frozen=True)
class _FilterBlock:
    """A Kalman filter over n rows as a linear map of these and of the state before, (n + 1,).

    Attributes
    ----------
    innovations, state : shapes (n, n + 1) and (1, n + 1): innovations over their standard deviations; the state after.
    log_det : of the whitening.
    variance : of the state after.
    """

    innovations: np.ndarray
    state: np.ndarray
    log_det: float
    variance: float


@lru_cache(maxsize=64)
def _filter_block(noise: StateNoise, length: int, variance: float) -> _FilterBlock:
    unit = np.eye(length + 1)
    found, state, log_det = np.empty((length, length + 1)), unit[-1], 0.0
    for k in range(length):
        total = variance + noise.white
        gain = variance / total
        apart = unit[k] - state
        found[k] = apart / math.sqrt(total)
        log_det -= 0.5 * math.log(total)
        state = noise.phi * (state + gain * apart)
        variance = noise.phi**2 * variance * (1 - gain) + noise.drive
    return _FilterBlock(found, state[None], log_det, variance)


def correlated(phi: float, share: float) -> StateNoise:
    """Return AR(1) noise that makes a share of the variance of a row."""
    return StateNoise("correlated", True, phi, share * (1 - phi**2), 1 - share, share)


def random_walk(variance: float) -> StateNoise:
    """Return a random walk from row to row beside white noise as known."""
    return StateNoise("wander", False, 1.0, variance, 1.0, variance)


@dataclass(frozen=True)
class InputNoise(NoiseStructure):
    """White noise that grows with the input; `excess`: variance at the largest, over that at zero, less 1."""

    excess: float = 0.0

    @property
    def is_white(self) -> bool:
        return False

    def whiten(self, rows: linear.ChannelRows, columns: np.ndarray) -> tuple[np.ndarray, float]:
        """Return columns divided by the noise of each row."""
        root = 1 / np.sqrt(1 + self.excess * rows.input**2)
        return columns * root[:, None], float(np.log(root).sum())


@dataclass(frozen=True)
class RunNoise(NoiseStructure):
    """White noise of one run `ratio` times as large as its stated count of samples says."""

    run: int = 0
    ratio: float = 1.0

    @property
    def is_white(self) -> bool:
        return False

    def whiten(self, rows: linear.ChannelRows, columns: np.ndarray) -> tuple[np.ndarray, float]:
        """Return columns with the rows of the run divided by the ratio."""
        if self.run not in rows.runs:
            return columns, 0.0
        start, length = rows.series[rows.runs.index(self.run)]
        found = columns.copy()
        found[start : start + length] /= self.ratio
        return found, -length * math.log(self.ratio)


@dataclass(frozen=True)
class HeavyTails(NoiseStructure):
    """Student's t with `degrees` of freedom; its weights are a matter of the fit."""

    degrees: float = 4.0


KNOWN = NoiseStructure("known")
SCALED = NoiseStructure("scale", True)
TAILED = HeavyTails("tails", True, 4.0)
_STRUCTURES: tuple[NoiseStructure, ...] = (
    KNOWN,
    SCALED,
    *(correlated(phi, 1.0) for phi in (0.3, 0.6, 0.85)),
    *(correlated(phi, share) for phi in (0.6, 0.9) for share in (0.15, 0.4)),
    *(random_walk(variance) for variance in (0.01, 0.05, 0.2, 0.6)),
    *(InputNoise("rate", False, excess) for excess in (1.0, 8.0, 60.0)),
    TAILED,
    HeavyTails("tails", True, 2.0),
)
_MEDIAN_STEP = 0.6745 * math.sqrt(2.0)  # of the difference of two rows of standard deviation 1
_SCATTERS = (0.3, 0.6, 1.2, 2.5, 5.0, 10.0)
"""Standard deviations of offsets of runs that a model does not have, in units of the noise of a row."""


@dataclass(frozen=True)
class NoiseOfUnit:
    """The noise of the channels of a unit.

    Attributes
    ----------
    rows : structure of its rows.
    scatter : standard deviation of offsets of runs, in units of the noise of a row.
    log_prior : logarithm of its prior probability.
    stated : whether it is what the model states.
    size : place of the size of the correlation in time that the model states; 0 of a model without.
    replaces : whether it stands in place of that correlation, which is at its smallest.
    """

    rows: NoiseStructure
    scatter: float
    log_prior: float
    stated: bool
    size: int = 0
    replaces: bool = False

    @property
    def family(self) -> Family:
        """What the noise is beyond what is stated."""
        return "runs" if self.rows.family == "known" and not self.stated else self.rows.family

    def scale_sd(self, rows: linear.ChannelRows) -> float:
        """Return the standard deviation of the logarithm of the scale of a channel."""
        return max(linear.UNKNOWN, rows.scale_sd) if self.rows.free else rows.scale_sd


@dataclass(frozen=True)
class NoiseUnit:
    """Channels that share a noise structure, and the noise that they may have.

    Attributes
    ----------
    factors : sizes of the correlation in time over that as fitted.
    """

    channels: tuple[int, ...]
    kind: str
    choices: tuple[NoiseOfUnit, ...]
    factors: tuple[float, ...] = ()

    @cached_property
    def stated(self) -> tuple[NoiseOfUnit, ...]:
        """The noise that the model states; several if it leaves a size open."""
        return tuple(each for each in self.choices if each.stated)

    def structures(self, at: NoiseOfUnit) -> list[NoiseOfUnit]:
        """Return all structures of rows, all else as it is."""
        here = [each for each in self.choices if each.scatter == at.scatter]
        return [each for each in here if each.size == at.size or each.replaces]

    def scatters(self, at: NoiseOfUnit) -> list[NoiseOfUnit]:
        """Return all scatters between runs, all else as it is, and those that a model lacks beside stated rows."""
        here = [each for each in self.choices if each.size == at.size]
        return [each for each in here if each.rows == at.rows or each.family == "runs"]

    def sizes(self, at: NoiseOfUnit) -> list[NoiseOfUnit]:
        """Return all sizes of the correlation in time, all else as it is."""
        return [each for each in self.choices if (each.rows, each.scatter) == (at.rows, at.scatter)]

    @cached_property
    def as_fitted(self) -> NoiseOfUnit:
        """The most probable noise before the data that is stated, its correlation in time as fitted."""
        size = min(range(len(self.factors)), key=lambda k: abs(math.log(self.factors[k])), default=0)
        return max((each for each in self.stated if each.size == size), key=lambda each: each.log_prior)


def noise_units(problem: linear.LinearProblem) -> tuple[NoiseUnit, ...]:
    """Return who shares noise: each channel by itself if the model leaves a size of its noise open, else a kind.

    The closing rotations of each run are by themselves.
    """
    kinds = {k: rows.kind for k, rows in enumerate(problem.rows) if len(rows.entry)}
    opened = any(rows.run_scatter or rows.tails or rows.correlations for rows in problem.rows)
    shared = {k: k if opened or kind == "closure" else kind for k, kind in kinds.items()}
    groups = [tuple(k for k in shared if shared[k] == owner) for owner in dict.fromkeys(shared.values())]
    raised = tuple(_raised(problem))
    return tuple(_unit(problem, each, raised) for each in groups)


def _raised(problem: linear.LinearProblem) -> Iterator[RunNoise]:
    """Yield the runs whose rows scatter more than those of the others, on all channels alike, with the ratio.

    The scatter is that of the residual of the fit from row to row, which a course within a run does not raise; its
    median is not raised by single rows.
    """
    typical: dict[int, list[float]] = {}
    squares: dict[int, list[np.ndarray]] = {}
    for rows in (each for each in problem.of_channels if each.runs):
        steps = [np.abs(np.diff(rows.columns[start : start + length, -1])) for start, length in rows.series]
        own = [float(np.median(each)) if len(each) > 2 else 0.0 for each in steps]
        usual = float(np.median(own)) if len(own) > 2 else 0.0
        for run, each, median in zip(rows.runs, steps, own, strict=True):
            if usual > 0:
                typical.setdefault(run, []).append(median / usual)
                squares.setdefault(run, []).append((each * _MEDIAN_STEP / usual) ** 2)
    for run, each in typical.items():
        if min(each) > _RAISED:
            yield RunNoise("counts", False, run, math.sqrt(float(np.concatenate(squares[run]).mean()) / 2))


def log_prior_of_sisters(
    problem: linear.LinearProblem, units: tuple[NoiseUnit, ...], noise: tuple[NoiseOfUnit, ...]
) -> float:
    """Return what the scatters between runs of equal sensors show of one another, beyond the prior of each.

    Scatters of a kind have a common size with the prior of the model, and lie about it with a standard deviation of the
    logarithm as equal sensors do, but for a share that have nothing in common.
    """
    found = 0.0
    for kind in dict.fromkeys(unit.kind for unit in units):
        sisters = [
            (unit.channels[0], each.scatter) for unit, each in zip(units, noise, strict=True) if unit.kind == kind
        ]
        grids = [problem.rows[k].run_scatter for k, _ in sisters]
        if len(sisters) < 2 or not all(grids):
            continue
        places = [
            int(np.argmin([abs(tau - own) for tau, _ in grid])) for (_, own), grid in zip(sisters, grids, strict=True)
        ]
        each = np.zeros(len(grids[0]))
        for place, grid in zip(places, grids, strict=True):
            prior, size = np.exp([p for _, p in grid]), np.log([max(tau, linear.NEGLIGIBLE) for tau, _ in grid])
            near = np.exp(-0.5 * ((size[:, None] - size) / SISTERS_LOG_SD) ** 2)
            about = linear.UNEXPECTED * prior[:, None] + (1 - linear.UNEXPECTED) * near / near.sum(axis=0)
            each += np.log(about[place]) - math.log(prior[place])
        found += float(np.logaddexp.reduce(each + [p for _, p in grids[0]]))
    return found


def _unit(problem: linear.LinearProblem, channels: tuple[int, ...], raised: Sequence[RunNoise]) -> NoiseUnit:
    own = problem.rows[channels[0]]
    others = _others(own, raised)
    # What the model leaves open is there beside any structure of the rows, as its prior says.
    scatters = own.run_scatter or ((0.0, 0.0),)
    sizes = tuple((k, each.log_prior) for k, each in enumerate(own.correlations)) or ((0, 0.0),)
    opened = [(tau, k, p + q) for tau, p in scatters for k, q in sizes]
    stated = _stated(own)
    scattered = _SCATTERS if len(own.series) > 1 and not own.run_scatter else ()
    believed = math.log(1 - linear.UNEXPECTED)
    open_and_stated = [(*one, *other) for one, other in product(opened, stated)]
    as_stated = [NoiseOfUnit(rows, tau, believed + p + q, True, k) for tau, k, p, rows, q in open_and_stated]
    beside = [
        NoiseOfUnit(rows, tau, p + q, False, k) for tau, (_, k, p, rows, q) in product(scattered, open_and_stated)
    ]
    whole = len(sizes) - 1 if any(each.whole for each in own.correlations) else None
    other = _other_noise(others, scatters, opened, whole, beside, len(scattered))
    return NoiseUnit(channels, own.kind, (*as_stated, *other), tuple(each.factor for each in own.correlations))


def _stated(rows: linear.ChannelRows) -> Sequence[tuple[NoiseStructure, float]]:
    """Return the structures of rows that a model states, with the logarithms of their probabilities."""
    return [(HeavyTails("known", False, degrees), p) for degrees, p in rows.tails] or [(KNOWN, 0.0)]


def _others(rows: linear.ChannelRows, raised: Sequence[RunNoise]) -> list[NoiseStructure]:
    """Return the structures other than stated.

    That of a gyro may grow with an input that varies.  Turns follow one another as the hand makes them, and their
    noise is known to a factor at best: of it heavy tails alone are other than stated.
    """
    if rows.kind == "closure":
        return [each for each in _STRUCTURES if each.family == "tails"]
    grows = rows.kind == "gyro" and rows.input_varies
    own = [each for each in raised if each.run in rows.runs]
    return [*(each for each in _STRUCTURES if each != KNOWN and (each.family != "rate" or grows)), *own]


def _other_noise(
    structures: Sequence[NoiseStructure],
    scatters: linear.Grid,
    opened: Sequence[tuple[float, int, float]],
    whole: int | None,
    beside: Sequence[NoiseOfUnit],
    scattered: int,
) -> Iterator[NoiseOfUnit]:
    """Yield noise other than stated: other structures, and scatters between runs that the model does not have.

    Parameters
    ----------
    scatters, opened : scatter, size and log prior of what the model leaves open.
    whole : smallest size of a correlation that is that of the whole noise, so that another stands in its place.
    beside : stated noise with scatters that the model does not have, of which there are `scattered`.
    """
    families = Counter(each.family for each in structures)
    each_family = math.log(linear.UNEXPECTED / (len(families) + bool(scattered)))
    for each in structures:
        share = each_family - math.log(families[each.family])
        if whole is not None and isinstance(each, StateNoise):
            yield from (NoiseOfUnit(each, tau, share + p, False, whole, True) for tau, p in scatters)
        else:
            yield from (NoiseOfUnit(each, tau, share + p, False, k) for tau, k, p in opened)
    for each in beside:
        yield replace(each, log_prior=each_family - math.log(scattered) + each.log_prior)


def tail_weights(squares: np.ndarray, degrees: float) -> np.ndarray:
    """Return the weight of each row, (n,), of expected squared residuals in units of its noise."""
    return (degrees + 1) / (degrees + squares)


def tail_bound(squares: np.ndarray, weight: np.ndarray, degrees: float) -> float:
    """Return what Student's t adds to the normal of weights w: a lower bound of its logarithm (variational)."""
    t = _log_density(squares, degrees)
    normal = -0.5 * math.log(2 * math.pi) + 0.5 * np.log(weight) - 0.5 * weight * squares
    return float(np.sum(t - normal + 0.5 * np.log(weight)))


def tail_log_density(residual: np.ndarray, degrees: float) -> float:
    """Return the logarithm of the density of residuals (n,) under Student's t of scale 1."""
    return float(_log_density(residual**2, degrees).sum())


def _log_density(squares: np.ndarray, degrees: float) -> np.ndarray:
    constant = special.gammaln((degrees + 1) / 2) - special.gammaln(degrees / 2) - 0.5 * math.log(degrees * math.pi)
    return constant - (degrees + 1) / 2 * np.log1p(squares / degrees)

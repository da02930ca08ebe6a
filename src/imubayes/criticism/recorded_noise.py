"""Fitted noise against recorded noise: whether rows scatter as the samples within them say they should.

Rows carry the standard deviation s of their n raw samples (`samples` and `<channel>_sd`), or the channel states the
noise of one sample.  The fit estimates the same quantity, σ, from the scatter *between* rows.  Whatever acts from row
to row and is missing in the model inflates σ but not s, so that (σ/s)² exceeds one; without it the ratio follows the F
distribution with the degrees of freedom of both estimates.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import jax.numpy as jnp
import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.noise_tests import to_entries
from imubayes.criticism.projection import Projection
from imubayes.model.problem import Problem
from imubayes.noise.base import SeriesNoise, SlowNoise
from imubayes.noise.components import WhiteNoise
from imubayes.tail_probabilities import f_survival, normal_survival

NoiseSource = Literal["samples", "channel"]


@dataclass(frozen=True)
class NoiseComparison:
    """White noise of one channel as fitted and as recorded.

    Attributes
    ----------
    fitted : standard deviation of one raw sample from the scatter of the rows, output units.
    recorded : the same from the samples within rows, or as the channel states it.
    source : whence the recorded value: the ``samples`` of the rows, or the entry of the ``channel``.
    ratio, ratio_sd : fitted over recorded with its standard uncertainty.
    p : p-value of a ratio of at most `thresholds.NOISE_AGREES`, over all channels compared (Bonferroni).
    correlated : whether the model has autocorrelated noise on this channel, which scatters rows but not samples.
    unit : output unit.
    freedom : degrees of freedom of the fitted noise; 0 of diagnoses of earlier versions.
    """

    channel: str
    fitted: float
    recorded: float
    source: NoiseSource
    ratio: float
    ratio_sd: float
    p: float
    correlated: bool
    unit: str
    freedom: float = 0.0

    @property
    def excessive(self) -> bool:
        """Whether rows scatter more than recorded, beyond chance, with nothing in the model that would explain it."""
        return not self.correlated and self.p < thresholds.EXCESS_NOISE_P

    @property
    def excess_chi2(self) -> float:
        """The χ² by which rows scatter more than recorded, at the noise that remains; 0 where that may be chance."""
        return self.freedom * (1 - (thresholds.NOISE_AGREES / self.ratio) ** 2) if self.excessive else 0.0

    @property
    def agrees(self) -> bool:
        """Whether fitted and recorded noise agree, but for chance or for less than is worth a word."""
        apart = abs(math.log(self.ratio))
        chance = thresholds.NOISE_TOLD_SD * self.ratio_sd / self.ratio if self.source == "samples" else 0.0
        return not self.excessive and apart < max(math.log(thresholds.NOISE_TOLD), chance)


@dataclass(frozen=True)
class RecordedNoise:
    """The rows of every channel against the recorded noise.

    Attributes
    ----------
    comparisons : one per channel that has a record of its noise, in the order of the channels.
    channel, run : shape (n,), names, of each row.
    scatter : shape (n,), whitened residual in standard deviations of the row's mean as recorded.
    """

    comparisons: tuple[NoiseComparison, ...]
    channel: np.ndarray
    run: np.ndarray
    scatter: np.ndarray

    @property
    def excessive(self) -> tuple[NoiseComparison, ...]:
        """The channels that scatter more than recorded, the least probable first."""
        return tuple(sorted((each for each in self.comparisons if each.excessive), key=lambda each: each.p))


@dataclass(frozen=True)
class _Record:
    """Recorded standard deviation of one sample, the variance of its logarithm, and its degrees of freedom."""

    sd: float
    freedom: float
    source: NoiseSource


def compare_with_record(projection: Projection) -> RecordedNoise:
    """Return fitted against recorded noise of every channel.

    Parameters
    ----------
    projection : without a further whitening, so that its rows are in units of the model's own noise.
    """
    model = projection.fitted.model
    entries, channels = model.entries, model.campaign.channels
    used = (np.asarray(model.problem.observations.weight) > 0) & ~entries.closing
    sigma, correlated = _white_noise(model.problem, projection.fitted.h)
    white = to_entries(projection, projection.residual[:, None])[:, 0]
    records = {place: record for place in range(len(channels)) if (record := _record(projection, place)) is not None}
    comparisons, scatter = [], np.full(len(entries), np.nan)
    for place, record in records.items():
        here = used & (entries.channel == place) & (sigma > 0)
        chi2, freedom = _within(projection, place)
        if not here.any() or freedom < thresholds.NOISE_FREEDOM_MIN or not record.sd > 0:
            continue
        own = float(np.median(sigma[here]))
        fitted = own * float(np.sqrt(chi2 / freedom))
        scatter[here] = white[here] * own / record.sd
        ratio = fitted / record.sd
        sd, p = _judged(ratio, freedom, record)
        comparisons.append(
            NoiseComparison(
                channels[place].name, fitted, record.sd, record.source, ratio, ratio * sd, p,
                bool(correlated[here].any()), channels[place].output_unit, freedom,
            )
        )  # fmt: skip
    count = len(comparisons)
    counted = tuple(replace(each, p=min(1.0, each.p * count)) for each in comparisons)
    shown = np.isfinite(scatter)
    names, runs = np.array([each.name for each in channels]), np.array([run.name for run in model.campaign.runs])
    return RecordedNoise(counted, names[entries.channel[shown]], runs[entries.run[shown]], scatter[shown])


def _judged(ratio: float, freedom: float, record: _Record) -> tuple[float, float]:
    """Return the relative standard uncertainty of a ratio, and the p-value of its excess."""
    excess = ratio / thresholds.NOISE_AGREES
    if record.source == "samples":
        sd = np.sqrt(0.5 / freedom + 0.5 / record.freedom)
        return float(sd), float(f_survival(excess**2, freedom, record.freedom))
    sd = np.hypot(thresholds.STATED_NOISE_LOG_SD, np.sqrt(0.5 / freedom))
    return float(sd), float(normal_survival(np.log(excess) / sd))


def _within(projection: Projection, channel: int) -> tuple[float, float]:
    """Return χ² and degrees of freedom of a channel within its runs."""
    strata = projection.strata
    own = np.flatnonzero((strata.channel == channel) & ~strata.between)
    squares = strata.sums(projection.residual**2)
    return float(squares[own].sum()), float(projection.freedom[own].sum())


def _white_noise(problem: Problem, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the white noise of one raw sample at each entry, 0 without, and whether its noise is autocorrelated."""
    observations = problem.observations
    values = problem.hyper_priors.values(jnp.asarray(h))
    variance = np.zeros(len(observations.value))
    correlated = np.zeros(len(observations.value), dtype=bool)
    for layer in problem.noise:
        if issubclass(layer.noise, WhiteNoise):
            variance += np.asarray(layer.entry_variances(values, observations.entry))
        elif issubclass(layer.noise, SeriesNoise):
            correlated |= (np.asarray(layer.acts) > 0)[np.asarray(observations.group)]
        elif issubclass(layer.noise, SlowNoise):
            correlated |= np.asarray(layer.acts) > 0
    return np.sqrt(variance * np.asarray(observations.entry.samples)), correlated


def _record(projection: Projection, channel: int) -> _Record | None:
    """Return what the campaign records of the noise of a channel; None where it records nothing."""
    model = projection.fitted.model
    steady, varying = [], []
    first = 0
    single = _single_nodes(projection)
    for run in model.campaign.runs:
        sd, samples = run.sample_sd[:, channel], run.samples
        known = np.isfinite(sd) & (samples > 1)
        here = single[first : first + run.rows]
        steady.append(np.stack([sd, samples])[:, known & here])
        varying.append(np.stack([sd, samples])[:, known & ~here])
        first += run.rows
    # A stimulus that varies within a row adds to the scatter of its samples: rows at a constant one go first.
    for parts in (steady, varying):
        sd, samples = np.concatenate(parts, axis=1)
        freedom = float(np.sum(samples - 1))
        if freedom > 0:
            return _Record(float(np.sqrt(np.sum((samples - 1) * sd**2) / freedom)), freedom, "samples")
    stated = model.campaign.channels[channel].noise
    return _Record(float(stated), np.inf, "channel") if stated else None


def _single_nodes(projection: Projection) -> np.ndarray:
    """Return which rows, counted over all runs, have one constant stimulus, bool."""
    nodes = projection.fitted.model.nodes
    sizes = np.concatenate([np.full(count, size) for count, size in nodes.turns])
    single = np.zeros(len(sizes), dtype=bool)
    single[nodes.row_of] = sizes == 1
    return single

"""Correlation of rows in time as the model states it: autocorrelation and slow noise, at a few sizes.

The size as fitted may have absorbed what is missing, so that smaller ones are hypotheses as well.  All members of a
channel change together: their ratios stay as fitted, and the common size has the prior that each gives it on that line.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.adequacy.known_noise import noise_scales
from imubayes.foundations.arrays import Array
from imubayes.foundations.tail_probabilities import normal_survival
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import Model
from imubayes.model.nodes_and_entries import Timeline
from imubayes.model.noise_covariance import Series, SlowSeries, whitener_of
from imubayes.model.problem import Problem
from imubayes.noise.components import RowSpan, SeriesNoise, SlowNoise
from imubayes.parameters.declarations import Parameter, prior_values

_FACTORS = tuple(2.0**k for k in range(1, -6, -1))
"""Sizes over that as fitted.  Derived: at a factor √2 off, the evidence of a hundred rows falls by some nats only."""


@dataclass(frozen=True, eq=False)
class RowCorrelation:
    """Correlation of the rows of a channel at one size.

    Attributes
    ----------
    factor : size over that as fitted.
    log_prior : logarithm of its probability.
    log_det : log determinant of the whitening.
    gain : shape (n,), change of a whitened row by the row itself.
    series : the whitening, over the rows of the channel.
    """

    factor: float
    log_prior: float
    log_det: float
    gain: np.ndarray
    series: Series | SlowSeries

    @property
    def whole(self) -> bool:
        """Whether the whole noise of a row is correlated, not a part beside white noise."""
        return isinstance(self.series, Series)

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Return columns (n, C) of rows over their independent noise, whitened."""
        return self.series.forward(columns)


Correlations = Mapping[int, tuple[RowCorrelation, ...]]
"""Channel → sizes of its correlation; channels without one are not there."""


def correlations_of(fitted: Fit, h: np.ndarray, entries: Mapping[int, np.ndarray], own: Array) -> Correlations:
    """Return the correlation of the rows of every channel.

    Parameters
    ----------
    h : shape (H,), noise scales as known; those of correlations are taken as fitted.
    entries : channel → (n,), entries of its rows.
    own : shape (E,), variance of the independent noise of each entry.
    """
    model = fitted.model
    correlates = [issubclass(member, SeriesNoise | SlowNoise) for _, member, _ in noise_scales(model)]
    h = np.where(correlates, fitted.h, h) if correlates else h
    sizes = {k: each for k in entries if (each := list(_sizes(model, k, h)))}
    found: dict[int, list[RowCorrelation]] = {k: [] for k in sizes}
    for factor in _FACTORS if sizes else ():
        moved, shares = _moved(h, sizes, factor)
        series = _series_at(model.problem, moved, own)
        assert series is not None
        for k, share in shares.items():
            found[k].append(_of_channel(series, factor, share, entries[k]))
    return {k: _normalised(each) for k, each in found.items()}


def _moved(
    h: np.ndarray, sizes: Mapping[int, Sequence[tuple[int, "_Size"]]], factor: float
) -> tuple[np.ndarray, dict[int, float]]:
    """Return noise scales with the correlations of every channel at a multiple, and the log share of each channel."""
    moved, shares = h.copy(), dict[int, float]()
    for k, members in sizes.items():
        places = [(place, each.at(factor)) for place, each in members]
        if all(z is not None for _, z in places):
            moved[[place for place, _ in places]] = [z for _, z in places]
            shares[k] = sum(each.log_share(factor) for _, each in members)
    return moved, shares


@dataclass(frozen=True)
class _Size:
    """The size of a member as fitted, in the unit of its parameter; a correlation cannot exceed that much."""

    parameter: Parameter
    fitted: float
    bounded: bool

    def at(self, factor: float) -> float | None:
        """Return z of a multiple; None if there is none."""
        return None if self.bounded and factor > 1 else self.parameter.z_at(self.fitted * factor)

    def log_share(self, factor: float) -> float:
        """Return the logarithm of the prior probability about a multiple."""
        low, high = (self.parameter.z_at(self.fitted * factor * by) for by in (math.sqrt(0.5), math.sqrt(2)))
        above = float(normal_survival(high)) if high is not None else 0.0
        below = float(normal_survival(low)) if low is not None else 1.0
        return math.log(max(below - above, 1e-300))


def _sizes(model: Model, channel: int, h: np.ndarray) -> Iterator[tuple[int, _Size]]:
    """Yield the sizes of the members that correlate the rows of a channel, with their places in h."""
    values = np.asarray(prior_values(model.problem.hyper_priors, h))
    kind = model.campaign.channels[channel].kind
    for k, (parameter, member, place) in enumerate(noise_scales(model)):
        bounded = issubclass(member, SeriesNoise)
        own = place == channel or (place is None and kind in member.kinds)
        if own and (bounded or (issubclass(member, SlowNoise) and parameter.unit == "output")):
            yield k, _Size(parameter, float(values[k]) / parameter.factor, bounded)


def _of_channel(series: Series | SlowSeries, factor: float, share: float, entry: np.ndarray) -> RowCorrelation:
    """Return the correlation of the rows of one channel alone."""
    log_variance = np.asarray(series.log_determinants())[entry]
    place = np.full(_count(series) + 1, len(entry))
    place[entry] = np.arange(len(entry))
    own = _of_rows(series, entry, place) if isinstance(series, Series) else _of_lanes(series, entry, place)
    return RowCorrelation(factor, share, -0.5 * float(log_variance.sum()), np.exp(-0.5 * log_variance), own)


def _count(series: Series | SlowSeries) -> int:
    return len(series.before) if isinstance(series, Series) else len(series.timeline.place)


def _of_rows(series: Series, entry: np.ndarray, place: np.ndarray) -> Series:
    before = place[np.asarray(series.before)[entry]]
    return Series(before, series.correlation[entry])


def _of_lanes(series: SlowSeries, entry: np.ndarray, place: np.ndarray) -> SlowSeries:
    lanes = place[np.asarray(series.timeline.lanes)]
    chosen = np.flatnonzero((lanes < len(entry)).any(axis=0))
    lanes = lanes[:, chosen]
    steps, columns = np.nonzero(lanes < len(entry))
    back = np.empty(len(entry), dtype=np.int32)
    back[lanes[steps, columns]] = steps * len(chosen) + columns
    row = series.timeline.row
    start, length, gap = (np.asarray(each)[entry] for each in (row.start, row.length, row.gap))
    timeline = Timeline(RowSpan(start, length, gap, row.times), lanes, back)
    fields = (series.mean, series.over_gap, series.over_row, series.gain, series.variance)
    return SlowSeries(timeline, *(each[:, chosen] for each in fields))


def _normalised(found: list[RowCorrelation]) -> tuple[RowCorrelation, ...]:
    whole = float(np.logaddexp.reduce([each.log_prior for each in found]))
    return tuple(
        RowCorrelation(each.factor, each.log_prior - whole, each.log_det, each.gain, each.series) for each in found
    )


def _series_at(problem: Problem, h: np.ndarray, own: np.ndarray) -> Series | SlowSeries | None:
    """Return the correlation in time of all entries."""
    return whitener_of(problem, h, own, np.zeros(problem.observations.members.shape[0])).series

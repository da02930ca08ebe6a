"""Drift that follows the recorded temperature, found and taken out before flicker noise and random walk are claimed.

The slope is that of generalised least squares on the lowest cosine coefficients, under the noise terms fitted to what
is left, in turns to the maximum of the likelihood.  Drift that is not needed beside random walk and flicker noise is no
drift with temperature: two slow records resemble each other by chance.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imubayes.noise_analysis.cosine_coefficients import cosine_statistics
from imubayes.noise_analysis.likelihood import NoiseLikelihood
from imubayes.noise_analysis.running_sum import RunningSum, from_parts
from imubayes.noise_analysis.term_evidence import BASIC, highest

_LEAST_EVIDENCE = 15.0  # −2 Δ log L; chance 1e-4 of χ²₁, as few coefficients tell the noise beside which it is tested
_MEANS = 4096  # of the temperature over the record
_TURNS = 12


@dataclass(frozen=True)
class TemperatureDrift:
    """Slope of the output with temperature, and its standard uncertainty, output units per K; −2 Δ log L without it."""

    slope: float
    sd: float
    evidence: float


def without_temperature(record: RunningSum, temperature: RunningSum) -> tuple[RunningSum, TemperatureDrift | None]:
    """Return a record without its drift with temperature, and the slope; None where there is none.

    Parameters
    ----------
    temperature : of the same span, K; gaps are interpolated.
    """
    time, mean = _means(temperature)
    if not np.ptp(mean) > 0:
        return record, None
    covariate = from_parts(_at_samples(record, time, mean), record.interval)
    with_ramp = cosine_statistics(covariate)
    here = [level.coefficient + with_ramp.slope * level.ramp for level in with_ramp.coarse]
    slope, sd = 0.0, math.nan
    first = best = -math.inf
    corrected = record
    for turn in range(_TURNS):
        likelihood = NoiseLikelihood(cosine_statistics(corrected))
        maximum = highest(likelihood, BASIC)
        best = maximum.log_likelihood
        first = best if not turn else first
        more, sd = likelihood.slope_along(maximum, here)
        if turn and abs(more) < 0.01 * sd:
            break
        slope += more
        corrected = from_parts(_less(record, slope, time, mean), record.interval, record.resolution)
    evidence = 2 * (best - first)
    if not evidence > _LEAST_EVIDENCE:
        return record, None
    return corrected, TemperatureDrift(slope, sd, evidence)


def _means(temperature: RunningSum) -> tuple[np.ndarray, np.ndarray]:
    """Return times, s from the start, and means of the temperature over parts of the record."""
    edges = np.unique(np.linspace(0, temperature.samples, min(_MEANS, temperature.samples) + 1).astype(int))
    total = np.array([float(temperature.read(int(edge), 1)[0]) for edge in edges])
    present = np.diff(edges) - np.diff(temperature.missing_before(edges))
    known = present > 0
    middle = (edges[1:] + edges[:-1]) / 2 * temperature.interval
    return middle[known], np.diff(total)[known] / present[known]


def _at_samples(record: RunningSum, time: np.ndarray, mean: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the temperature at the samples that are present."""
    for first, values in record.chunks():
        at = (first + np.arange(len(values)) + 0.5) * record.interval
        yield np.where(np.isfinite(values), np.interp(at, time, mean), np.nan)


def _less(record: RunningSum, slope: float, time: np.ndarray, mean: np.ndarray) -> Iterator[np.ndarray]:
    for (_, values), part in zip(record.chunks(), _at_samples(record, time, mean), strict=True):
        yield values + record.shift - slope * part

"""What a record holds beside noise: found by a test of its own each, and taken out or left out.

Repeated values, outliers, drift with temperature and spectral lines are taken out of the record; octaves of frequency
that the noise terms do not describe are left out of the fit.  A sudden change stays, and with it the slow terms are
not claimed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dct

from imubayes.noise_analysis.cosine_coefficients import cosine_statistics
from imubayes.noise_analysis.described_band import SLOW, Cause, DescribedBand, described_band, withheld_terms
from imubayes.noise_analysis.likelihood import Maximum, NoiseLikelihood
from imubayes.noise_analysis.noise_spectra import NoiseTerm
from imubayes.noise_analysis.repeated_values import Repetition, at_own_rate
from imubayes.noise_analysis.running_sum import RunningSum
from imubayes.noise_analysis.spectral_lines import SpectralLine, without_lines
from imubayes.noise_analysis.sudden_changes import OutlyingSamples, SuddenChange, sudden_change, without_outliers
from imubayes.noise_analysis.temperature_drift import TemperatureDrift, without_temperature
from imubayes.noise_analysis.term_selection import NoiseEstimate, TermEstimate
from imubayes.tail_probabilities import chi2_survival

_MOST_REST = 0.3  # of the uncertainty of white noise, by the tails of peaks
_PARTS = 32  # of a record, whose levels of noise are compared
_UNEQUAL = 1e-4  # chance of levels as far apart
_LEAST_ROUNDING = 1e-4  # part of the squared white noise
_NOT_RANDOM = 0.25  # part of rounding from which noise is below half a step, and its errors are not independent


@dataclass(frozen=True)
class Examination:
    """A record without what is no noise, and what that was.

    Attributes
    ----------
    own_rate : the record with one sample for each value of the sensor, otherwise as it was.
    cleaned : the record of noise.
    """

    own_rate: RunningSum
    cleaned: RunningSum
    repetition: Repetition | None
    outliers: OutlyingSamples | None
    temperature: TemperatureDrift | None
    lines: tuple[SpectralLine, ...]
    change: SuddenChange | None

    def band(self, shortest_tau: float) -> DescribedBand:
        """Return the band of frequency that the noise terms describe."""
        lines = [(line.low_hz, line.high_hz) for line in self.lines]
        return described_band(cosine_statistics(self.cleaned), shortest_tau, lines)

    def withheld(self, band: DescribedBand, estimate: NoiseEstimate, rounding_share: float) -> dict[NoiseTerm, Cause]:
        """Return the terms that the record does not allow to state, and why.

        Parameters
        ----------
        rounding_share : part of rounding in the variance of single samples.
        """
        pulses = estimate.of(NoiseTerm.QUANTISATION).determined
        if self.repetition is not None and not self.repetition.counted:
            return dict.fromkeys(NoiseTerm, Cause.REPETITION)
        if rounding_share > _NOT_RANDOM and not pulses:
            return dict.fromkeys(NoiseTerm, Cause.ROUNDING)
        rounding = 0.0 if pulses else self.cleaned.resolution**2 / 12 * self.cleaned.interval
        determined = [each.term for each in estimate.estimates if each.determined]
        found = withheld_terms(band, estimate.full, determined, rounding)
        if self.change is not None:
            found = dict.fromkeys(SLOW, Cause.CHANGE) | found
        return dict.fromkeys(self._under_tails(band, estimate), Cause.DISTURBANCE) | found

    def _under_tails(self, band: DescribedBand, estimate: NoiseEstimate) -> Sequence[NoiseTerm]:
        """Return the terms that the tails of peaks may reach: the slow ones, and all if white noise is in them.

        Octaves that are left out beside a broad peak are no filter and no other disturbance.
        """
        broad = any(line.broad for line in self.lines)
        white = estimate.of(NoiseTerm.WHITE)
        rest = sum(line.rest for line in self.lines) / (4 * float(band.likelihood.frequency.max()))
        reached = white.determined and rest > _MOST_REST * white.value * white.sd
        if reached or (broad and (band.cut(Cause.FILTER) or band.cut(Cause.DISTURBANCE))):
            return tuple(NoiseTerm)
        return SLOW if broad else ()


def examined(record: RunningSum, temperature: RunningSum | None = None) -> Examination:
    """Return a record without what is no noise.

    Parameters
    ----------
    temperature : recorded beside it, K.
    """
    own_rate, repetition = at_own_rate(record)
    cleaned, outliers = without_outliers(own_rate)
    drift = None
    if temperature is not None:
        cleaned, drift = without_temperature(cleaned, temperature)
    cleaned, lines = without_lines(cleaned)
    return Examination(own_rate, cleaned, repetition, outliers, drift, lines, sudden_change(cleaned))


def unequal_levels(record: RunningSum, likelihood: NoiseLikelihood, best: Maximum) -> float:
    """Return by how much the level of noise scatters between parts of a record, as a factor; 1 where as it should.

    Noise that is louder at times, or has heavy tails, scatters more than Gaussian noise of one level.
    """
    size = record.samples // _PARTS
    at = np.arange(1, size) / (2 * size * record.interval)
    order = np.argsort(likelihood.frequency)
    used = (at >= float(likelihood.frequency.min())) & (at <= float(likelihood.frequency.max()))
    if not used.any():
        return 1.0
    density = np.interp(at, likelihood.frequency[order], likelihood.density(best)[order])
    levels = []
    for part in range(_PARTS):
        values = np.nan_to_num(record.values(part * size, size))
        present = size - int(np.diff(record.missing_before(np.array([part * size, (part + 1) * size])))[0])
        if 2 * present > size:
            power = np.asarray(dct(values, type=2, norm="ortho"))[1:] ** 2 / density
            levels.append(float(power[used].mean()) * size / present)
    degrees, count = len(levels) - 1, int(used.sum())
    ratio = float(np.var(levels, ddof=1)) / float(np.mean(levels)) ** 2 * count / 2 if degrees > 1 else 1.0
    return float(np.sqrt(ratio)) if float(chi2_survival(degrees * ratio, degrees)) < _UNEQUAL else 1.0


def widened(found: TermEstimate, growth: float) -> TermEstimate:
    """Return an estimate with its uncertainty grown by a factor."""
    if not found.determined or growth == 1.0:
        return found
    low = found.value * (found.low / found.value) ** growth
    high = found.value * (found.high / found.value) ** growth
    return replace(found, low=low, high=high, sd=found.sd * growth)


def without_rounding(found: TermEstimate, estimate: NoiseEstimate, record: RunningSum) -> tuple[TermEstimate, bool]:
    """Return white noise less that of rounding to the steps of the log, and whether it is taken out.

    Steps of a counted angle make quantisation noise instead.  Where that is not excluded, the interval holds both.
    """
    rounding = record.resolution**2 / 12 * record.interval
    pulses = estimate.of(NoiseTerm.QUANTISATION)
    if not found.determined or pulses.determined or rounding < _LEAST_ROUNDING * found.value**2:
        return found, False
    less = np.sqrt(np.maximum(np.array([found.low, found.value, found.high]) ** 2 - rounding, 0.0))
    if not pulses.limit < record.resolution / np.sqrt(12) * record.interval:
        return replace(found, low=float(less[0])), False
    return replace(found, low=float(less[0]), value=float(less[1]), high=float(less[2])), True

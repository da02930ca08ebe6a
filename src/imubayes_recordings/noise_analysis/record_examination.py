"""Contents of a record beside noise: each is found by a test of its own, and subtracted or left out.

Repeated values, outliers, drift with temperature and spectral lines are taken out of the record; octaves of frequency
that the noise terms do not describe are left out of the fit.  A sudden change stays, and with it the slow terms are not
claimed.

Drift that follows the recorded temperature is found and taken out before flicker noise and random walk are claimed.
The slope is that of generalised least squares on the lowest cosine coefficients, under the noise terms fitted to what
is left, in turns to the maximum of the likelihood.  Drift that is not needed beside random walk and flicker noise is no
drift with temperature: two slow records resemble each other by chance.

Values are repeated if a sensor of a lower rate stands in a log of a higher one; it is taken at its own rate.  Held
values are distinguished from rounding by what follows a jump.  The increments of noise that is rounded to steps have a
unimodal distribution, whether or not they are correlated: after a jump of two steps or more no change at all is rarer
than a change by one step up or down.  Held values stay.  Noise within one step makes no such jumps; there only a hold
of a constant number of samples shows, by changes that all fall on the same place of its cycle.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dct

from imubayes.foundations.tail_probabilities import binomial_survival, chi2_survival
from imubayes_recordings.noise_analysis import running_sum as sums
from imubayes_recordings.noise_analysis.contamination import Contamination, without_contamination
from imubayes_recordings.noise_analysis.cosine_spectra import cosine_statistics
from imubayes_recordings.noise_analysis.described_band import SLOW, Cause, DescribedBand, described_band, withheld_terms
from imubayes_recordings.noise_analysis.likelihood import Maximum, NoiseLikelihood
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm
from imubayes_recordings.noise_analysis.spectral_lines import SpectralLine, without_lines
from imubayes_recordings.noise_analysis.term_estimates import BASIC, NoiseEstimate, TermEstimate, highest

_LEAST_EVIDENCE = 15.0  # −2 Δ log L; chance 1e-4 of χ²₁, as few coefficients determine the noise
_MEANS = 4096  # of the temperature over the record
_TURNS = 12


@dataclass(frozen=True)
class TemperatureDrift:
    """Slope of the output with temperature, and its standard uncertainty, output units per K; −2 Δ log L without it."""

    slope: float
    sd: float
    evidence: float


def without_temperature(
    record: sums.RunningSum, temperature: sums.RunningSum
) -> tuple[sums.RunningSum, TemperatureDrift | None]:
    """Return a record without its drift with temperature, and the slope; None if there is none.

    Parameters
    ----------
    temperature : of the same span, K; gaps are interpolated.
    """
    time, mean = _means(temperature)
    if not np.ptp(mean) > 0:
        return record, None
    covariate = sums.from_parts(_at_samples(record, time, mean), record.interval)
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
        corrected = sums.from_parts(_less(record, slope, time, mean), record.interval, record.resolution)
    evidence = 2 * (best - first)
    if not evidence > _LEAST_EVIDENCE:
        return record, None
    return corrected, TemperatureDrift(slope, sd, evidence)


def _means(temperature: sums.RunningSum) -> tuple[np.ndarray, np.ndarray]:
    """Return times, s from the start, and means of the temperature over parts of the record."""
    edges = np.unique(np.linspace(0, temperature.samples, min(_MEANS, temperature.samples) + 1).astype(int))
    total = np.array([float(temperature.read(int(edge), 1)[0]) for edge in edges])
    present = np.diff(edges) - np.diff(temperature.missing_before(edges))
    known = present > 0
    middle = (edges[1:] + edges[:-1]) / 2 * temperature.interval
    return middle[known], np.diff(total)[known] / present[known]


def _at_samples(record: sums.RunningSum, time: np.ndarray, mean: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the temperature at the samples that are present."""
    for first, values in record.chunks():
        at = (first + np.arange(len(values)) + 0.5) * record.interval
        yield np.where(np.isfinite(values), np.interp(at, time, mean), np.nan)


def _less(record: sums.RunningSum, slope: float, time: np.ndarray, mean: np.ndarray) -> Iterator[np.ndarray]:
    for (_, values), part in zip(record.chunks(), _at_samples(record, time, mean), strict=True):
        yield values + record.shift - slope * part


_ALPHA = 1e-6  # chance of calling a record held that is not
_FINEST = 0.01  # quantile of the changes taken for a step if the steps of the log differ
_LONGEST = 64  # samples of a hold of a constant number
_ON_CYCLE = 0.9  # of the changes, at least, on one place of the cycle
_REVERSED = 0.2  # of the changes within one step, at least, go back: those of a ramp do not
_HEAD = 1 << 19  # samples by which repetition is found
_COMMON = 1e-3  # share of equal neighbouring values from which a long run is taken for several values
_OFTEN = 0.1  # share of equal neighbouring values at which runs of an irregular length cannot be counted
_ONE_MORE = 1.5  # samples between long and short repetitions if two clocks beat
_SEVERAL = 1.5  # times the usual length: a long run


@dataclass(frozen=True)
class Repetition:
    """How values are repeated.

    Attributes
    ----------
    mean : samples of one value.
    shortest, longest : samples of the 5th and the 95th of 100 values.
    interval_s : between values.
    counted : whether each run of equal values is one value, or a known number of them; a coarse log with an irregular
        repetition does not decide.
    """

    mean: float
    shortest: int
    longest: int
    interval_s: float
    counted: bool = True


@dataclass(frozen=True)
class _Runs:
    """Runs of equal values: their value and length, and the sample at which each begins; missing ones are runs too."""

    value: np.ndarray
    length: np.ndarray
    start: np.ndarray


def at_own_rate(record: sums.RunningSum) -> tuple[sums.RunningSum, Repetition | None]:
    """Return a record with one sample for each value of the sensor, and how they were repeated; None if not."""
    if not record.resolution:
        return record, None
    head = _joined(_runs(record, _HEAD))
    if not _held_after_jumps(head, record.resolution) and not _held_on_a_cycle(head):
        return record, None
    runs = _bridged(_joined(_runs(record, record.samples)), record.resolution)
    present = np.isfinite(runs.value)
    count, mean, counted = _values_of_runs(runs.value[present], runs.length[present], record.resolution)
    if mean < 1 + _FINEST:
        return record, None
    number = np.maximum(1, np.rint(runs.length / mean)).astype(np.int64)
    number[present] = count
    interval = record.samples * record.interval / int(number.sum())
    shortest, longest = (round(float(np.quantile(runs.length[present] / count, q))) for q in (0.05, 0.95))
    repetition = Repetition(mean, shortest, longest, interval, counted)
    parts = np.array_split(np.arange(len(number)), max(1, len(number) // sums.CHUNK))
    values = (np.repeat(runs.value[part] + record.shift, number[part]) for part in parts)
    return sums.from_parts(values, interval, record.resolution), repetition


def _runs(record: sums.RunningSum, samples: int) -> Iterator[_Runs]:
    """Yield the runs of equal values, part by part; a run that goes over a seam is joined to the next part."""
    kept = np.zeros(0)
    for first, values in record.chunks():
        if first >= samples:
            return
        last = first + len(values) >= record.samples
        begin, joined = first - len(kept), np.concatenate([kept, values])
        missing = np.isnan(joined)
        changed = np.abs(np.diff(joined)) > record.resolution / 2
        edges = np.concatenate([[0], np.flatnonzero(changed | (missing[1:] != missing[:-1])) + 1])
        length = np.diff(np.concatenate([edges, [len(joined)]]))
        done = len(edges) if last or len(edges) == 1 else len(edges) - 1
        kept = joined[edges[done] :] if done < len(edges) else np.zeros(0)
        yield _Runs(joined[edges[:done]], length[:done], begin + edges[:done])


def _joined(parts: Iterable[_Runs]) -> _Runs:
    found = list(parts)
    value, length, start = (
        np.concatenate([getattr(part, name) for part in found]) for name in ("value", "length", "start")
    )
    return _Runs(value, length, start)


def _bridged(runs: _Runs, resolution: float) -> _Runs:
    """Return the runs with missing samples within a value, or at its end, as samples of that value."""
    value = runs.value.copy()
    usual = float(np.median(runs.length[np.isfinite(value)]))
    short = np.flatnonzero(np.isnan(value) & (runs.length < usual))
    short = short[short > 0]
    value[short] = value[short - 1]
    gone = np.isnan(value)
    new = (np.abs(np.diff(value)) > resolution / 2) | (gone[1:] != gone[:-1])
    first = np.concatenate([[0], np.flatnonzero(new) + 1])
    return _Runs(value[first], np.add.reduceat(runs.length, first), runs.start[first])


def _held_after_jumps(runs: _Runs, resolution: float) -> bool:
    """Whether no change follows a jump more often than a change by one step does."""
    value, length = runs.value, runs.length
    jump = np.diff(value)  # NaN beside missing samples
    inside = (value[1:] > np.nanmin(value) + resolution / 2) & (value[1:] < np.nanmax(value) - resolution / 2)
    after = np.flatnonzero((np.abs(jump) > 1.5 * resolution) & inside)  # not where a converter is at its end
    if not len(after):
        return False
    stays = int(np.sum(length[after + 1] > 1))
    following = np.abs(jump[np.minimum(after + 1, len(jump) - 1)][length[after + 1] == 1])
    following = following[np.isfinite(following)]
    step = max(resolution, float(np.quantile(following, _FINEST))) if len(following) else resolution
    return _more(stays, int(np.sum(following < 1.5 * step)))


def _held_on_a_cycle(runs: _Runs) -> bool:
    """Whether the changes fall on the same place of a cycle, and go to and fro as those of a ramp do not."""
    jump = np.diff(runs.value)
    at = runs.start[1:][np.isfinite(jump)]
    jump = jump[np.isfinite(jump)]
    if len(jump) < 2 * _LONGEST or np.mean(jump[1:] * jump[:-1] < 0) < _REVERSED:
        return False
    for cycle in range(2, _LONGEST + 1):
        most = int(np.bincount(at % cycle, minlength=cycle).max())
        chance = binomial_survival(most, len(at), 1 / cycle) * cycle * _LONGEST
        if most >= _ON_CYCLE * len(at) and chance < _ALPHA:
            return True
    return False


def _more(one: int, other: int) -> bool:
    """Whether one count is larger than another by more than chance explains."""
    return one > other and binomial_survival(one, one + other, 0.5) < _ALPHA


def _values_of_runs(value: np.ndarray, length: np.ndarray, resolution: float) -> tuple[np.ndarray, float, bool]:
    """Return how many values each run has, shape (runs,), the mean samples of one, and whether that is certain.

    One, unless the log is so coarse that neighbouring values are often equal by chance, as values one apart show, and
    long runs are no more frequent than that.
    """
    count = np.ones(len(length), dtype=np.int64)
    equal = float(np.mean(np.abs(value[2:] - value[:-2]) < resolution / 2)) if len(value) > 2 else 0.0
    mean = float(np.median(length))
    long = float(np.mean(length >= _SEVERAL * mean))
    if equal < _COMMON or long > _SEVERAL * equal + _COMMON:
        return count, float(length.mean()), equal < _FINEST
    for _ in range(10):
        count = np.maximum(1, np.rint(length / mean)).astype(np.int64)
        mean = float(length.sum() / count.sum())
    low, high = np.quantile(length / count, [0.05, 0.95])
    return count, mean, equal < _OFTEN or high - low < _ONE_MORE


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

    own_rate: sums.RunningSum
    cleaned: sums.RunningSum
    repetition: Repetition | None
    outliers: sums.OutlyingSamples | None
    contamination: Contamination | None
    temperature: TemperatureDrift | None
    lines: tuple[SpectralLine, ...]
    change: sums.SuddenChange | None

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


def examined(record: sums.RunningSum, temperature: sums.RunningSum | None = None, robust: bool = False) -> Examination:
    """Return a record without what is no noise.

    Parameters
    ----------
    temperature : recorded beside it, K.
    robust : whether stretches that are no rest are left out.
    """
    own_rate, repetition = at_own_rate(record)
    cleaned, outliers = sums.without_outliers(own_rate)
    drift = contamination = None
    if robust:
        cleaned, contamination = without_contamination(cleaned)
    if temperature is not None:
        cleaned, drift = without_temperature(cleaned, temperature)
    cleaned, lines = without_lines(cleaned)
    change = sums.sudden_change(cleaned)
    return Examination(own_rate, cleaned, repetition, outliers, contamination, drift, lines, change)


def unequal_levels(record: sums.RunningSum, likelihood: NoiseLikelihood, best: Maximum) -> float:
    """Return by how much the level of noise scatters between parts of a record, as a factor; 1 if as it should.

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


def without_rounding(
    found: TermEstimate, estimate: NoiseEstimate, record: sums.RunningSum
) -> tuple[TermEstimate, bool]:
    """Return white noise less that of rounding to the steps of the log, and whether it is taken out.

    Steps of a counted angle make quantisation noise instead.  If that is not excluded, the interval holds both.
    """
    rounding = record.resolution**2 / 12 * record.interval
    pulses = estimate.of(NoiseTerm.QUANTISATION)
    if not found.determined or pulses.determined or rounding < _LEAST_ROUNDING * found.value**2:
        return found, False
    less = np.sqrt(np.maximum(np.array([found.low, found.value, found.high]) ** 2 - rounding, 0.0))
    if not pulses.limit < record.resolution / np.sqrt(12) * record.interval:
        return replace(found, low=float(less[0])), False
    return replace(found, low=float(less[0]), value=float(less[1]), high=float(less[2])), True

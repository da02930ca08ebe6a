"""Lines of the spectrum: vibration, mains, sampling of another device; found, and taken out of the record.

The averaged periodogram (Welch, IEEE Trans. Audio Electroacoust. 15 (1967), 70) of Hann-windowed segments is χ² about
the local level of the spectrum, which is the running median: a line does not raise it.  Means over 1, 4, 16 … bins are
tested, as a line that wanders in frequency is a peak of some width, at one chance of a false line in all.
A line is taken out in windowed, overlapping segments, and with it the noise in its band: the fit has no bins there.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.foundations.numerics import true_stretches
from imubayes_recordings.noise_analysis.running_sum import CHUNK, RunningSum, from_parts

_ALPHA = 1e-3  # chance of a false line in a record
_SEGMENT = CHUNK // 2
_LEAST_CYCLES = 10  # of a line in a segment: a slower one is a drift
_FEW = 64  # bins up to which the local level is itself uncertain
_STRICTER = 1e-3  # factor of the chance there
_WINDOW = 1 / 32  # of the bins on either side for the running median, and no more than half of the frequency
_WIDTHS = (1, 4, 16, 64, 256)
_MARGIN = 4  # bins on either side of a line: the window leaks
_MOST = 0.3  # of the bins in lines: more are no lines
_PASSES = 3  # a strong line hides weaker ones beside it
_NEIGHBOURS = 1.94  # a mean over bins of a Hann window has fewer degrees of freedom: 1 + 2 (4/9 + 1/36)
_NULL = 0.1  # of the level on both sides
_RESOLVED = 3  # times the bins of a line of one frequency: a wider band is that of a peak with tails
_TAILS = 3  # times the band of a peak: at its ends a tail that falls with the square of the distance is a ninth
_BROAD = 0.1  # width over frequency; the tails of such a peak reach over octaves
_ENBW = 1.5  # equivalent noise bandwidth of the Hann window, bins


@dataclass(frozen=True)
class SpectralLine:
    """A line, or a narrow peak.

    Attributes
    ----------
    frequency_hz : of its centre.
    low_hz, high_hz : ends of the band that is taken out.
    amplitude, amplitude_sd : √2 times its rms, output units.
    rest : power of the tails beyond the band, output units squared, of a peak that falls with the square of the
        distance (a phase that wanders at random); 0 of a line.
    """

    frequency_hz: float
    low_hz: float
    high_hz: float
    amplitude: float
    amplitude_sd: float
    rest: float

    @property
    def broad(self) -> bool:
        """Whether it is a peak whose tails reach over octaves."""
        return self.high_hz - self.low_hz > _BROAD * self.frequency_hz


def without_lines(record: RunningSum) -> tuple[RunningSum, tuple[SpectralLine, ...]]:
    """Return a record without spectral lines, and the lines, the strongest first.

    Long records are searched twice, the second time in means over many samples for slow lines.
    """
    found: list[SpectralLine] = []
    thinning = [1, *([factor] if (factor := -(-record.samples // _SEGMENT)) > 1 else [])]
    for factor in thinning:
        for _ in range(_PASSES):
            lines = _lines(record, factor, found)
            if not lines:
                break
            record = from_parts(_cleaned(record, lines, factor), record.interval, record.resolution)
            found = _merged([*found, *lines])
    return record, tuple(sorted(found, key=lambda line: -line.amplitude))


def _merged(lines: list[SpectralLine]) -> list[SpectralLine]:
    """Return lines with those in or near the band of another as one."""
    joined: list[SpectralLine] = []
    for line in sorted(lines, key=lambda each: each.low_hz):
        if not joined or line.low_hz - joined[-1].high_hz > (joined[-1].high_hz - joined[-1].low_hz) / 2:
            joined.append(line)
            continue
        other = joined.pop()
        strong = max(line, other, key=lambda each: each.amplitude)
        joined.append(
            SpectralLine(
                strong.frequency_hz, other.low_hz, max(line.high_hz, other.high_hz),
                float(np.hypot(line.amplitude, other.amplitude)),
                float(np.hypot(line.amplitude_sd, other.amplitude_sd)),
                line.rest + other.rest,
            )
        )  # fmt: skip
    return joined


def _samples(record: RunningSum, factor: int) -> np.ndarray:
    """Return means over `factor` samples, missing ones as zero: the mean of what is there is near zero."""
    edge = np.concatenate([record.read(first, min(CHUNK, record.samples + 1 - first))[(-first) % factor :: factor]
                           for first in range(0, record.samples + 1, CHUNK)])  # fmt: skip
    return np.diff(edge) / factor


def _segments(record: RunningSum, factor: int) -> Iterator[np.ndarray]:
    """Yield half-overlapping segments."""
    if factor > 1:
        yield _samples(record, factor)
        return
    size = min(_SEGMENT, record.samples)
    for first in range(0, record.samples - size + 1, size // 2):
        yield np.nan_to_num(record.values(first, size))


def _lines(record: RunningSum, factor: int, removed: list[SpectralLine]) -> list[SpectralLine]:
    total, powers, size = np.zeros(0), [], 0
    for values in _segments(record, factor):
        size = len(values)
        time = np.arange(size) - (size - 1) / 2
        centred = values - values.mean()
        centred -= time * float(time @ centred) / float(time @ time)
        window = np.hanning(size + 1)[:-1]
        power = np.abs(np.fft.rfft(centred * window)) ** 2 / float(window @ window)
        total = power if not powers else total + power
        powers.append(float(np.median(power)))
    count = len(powers)
    mean = total[:-1] / count
    # Neighbouring windows overlap with a correlation of 1/6, and a louder segment counts for more than a quiet one.
    averages = sum(powers) ** 2 / max(sum(each**2 for each in powers), 1e-300) / (1 + (count - 1) / count / 18)
    step = 1 / (size * factor * record.interval)
    for line in removed:  # an empty band would lower the level beside it
        first, stop = max(1, int(line.low_hz / step) - _MARGIN), int(line.high_hz / step) + _MARGIN + 1
        beside = [part for part in (mean[max(1, 2 * first - stop) : first], mean[stop : 2 * stop - first]) if len(part)]
        if beside:
            low, high = (float(np.median(part)) for part in (beside[0], beside[-1]))
            mean[first:stop] = np.linspace(low, high, len(mean[first:stop]))
    level = _level(mean, 2 * averages)
    usable = np.flatnonzero(level > 0)
    if len(mean) <= 4 * _LEAST_CYCLES or len(usable) < len(mean) // 2:
        return []
    return [
        _line(mean, level, first, stop, step, size, averages)
        for first, stop in _regions(mean / level, averages, factor)
    ]


def _level(mean: np.ndarray, degrees: float) -> np.ndarray:
    """Return the running median as the mean of χ² of these degrees of freedom; wider windows at higher frequency."""
    bins, centres = len(mean), [1]
    while centres[-1] < bins:
        centres.append(centres[-1] + max(1, _half_window(centres[-1], bins) // 2))
    medians = []
    for centre in centres:
        half = _half_window(centre, bins)
        medians.append(float(np.median(mean[max(1, min(centre, bins - 1) - half) : centre + half + 1])))
    level = np.interp(np.arange(bins), centres, medians)
    # In a null of a filter the median of bins on its slopes is no level, and what is there does not matter.
    reach = 4 * _half_window(bins, bins)
    around = [scipy.ndimage.maximum_filter1d(level, reach, origin=side * (reach // 2 - 1)) for side in (-1, 1)]
    return np.maximum(level, _NULL * np.minimum(*around)) * degrees / float(scipy.stats.chi2.median(degrees))


def _half_window(place: int, bins: int) -> int:
    return int(np.clip(place // 2, _LEAST_CYCLES // 2, max(_LEAST_CYCLES, round(_WINDOW * bins))))


def _regions(ratio: np.ndarray, averages: float, factor: int) -> list[tuple[int, int]]:
    """Return first and one past the last bin of each stretch of bins that stands out."""
    ratio = ratio.copy()
    ratio[:_LEAST_CYCLES] = 1.0
    if factor > 1:
        ratio[len(ratio) // 2 :] = 1.0  # means over samples alias what the whole record shows
    chance = _ALPHA / (len(ratio) * len(_WIDTHS))
    marked = np.zeros(len(ratio), dtype=bool)
    for width in (each for each in _WIDTHS if each <= _half_window(len(ratio), len(ratio)) / 4):
        degrees = 2 * averages * width / (_NEIGHBOURS if width > 1 else 1.0)
        most, stricter = (float(scipy.stats.chi2.isf(p * chance, degrees)) / degrees for p in (1.0, _STRICTER))
        allowed = np.where(np.arange(len(ratio) - width + 1) < _FEW, stricter, most)
        while marked.mean() <= _MOST:
            total = np.concatenate([[0.0], np.cumsum(ratio)])
            excess = (total[width:] - total[:-width]) / width - allowed
            first = int(np.argmax(excess))
            if excess[first] <= 0:
                break
            here = slice(max(0, first - _MARGIN), first + width + _MARGIN)
            marked[here], ratio[here] = True, 1.0
    if not marked.any() or marked.mean() > _MOST:
        return []
    return [_with_tails(first, stop) for first, stop in true_stretches(marked).tolist()]


def _with_tails(first: int, stop: int) -> tuple[int, int]:
    """Return the bins of a line, or those of a peak and of its tails: there each bin is too close to the level."""
    width = stop - first
    reach = (_TAILS - 1) * width // 2 if width > _RESOLVED * (2 * _MARGIN + 1) else 0
    return max(1, first - reach), stop + reach


def _line(
    mean: np.ndarray, level: np.ndarray, first: int, stop: int, step: float, size: int, averages: float
) -> SpectralLine:
    at = slice(first, min(stop, len(mean)))
    excess, base = mean[at] - level[at], level[at]
    # A sine of amplitude A has the sum A² size/4 over its bins, the noise of a bin its variance.
    square = max(4 * float(excess.sum()) / size, 0.0)
    spread = 4 / size * float(np.sqrt(_NEIGHBOURS * np.sum(base**2) / averages))
    amplitude = float(np.sqrt(square))
    coherent = 4 * float(base.mean()) / size * _ENBW / averages
    sd = float(np.sqrt(coherent + (spread / (2 * amplitude)) ** 2)) if amplitude else float(np.sqrt(spread))
    weight = np.maximum(excess, 0.0) + 1e-300
    frequency = float(weight @ np.arange(at.start, at.stop)) / float(weight.sum())
    # Half of the power of a Lorentzian is within its full width at half maximum.
    total = np.maximum.accumulate(np.cumsum(excess))
    half = float(np.diff(np.searchsorted(total, np.array([0.25, 0.75]) * total[-1]))[0])
    width = stop - first
    rest = square * half / (np.pi * width) if width > _RESOLVED * (2 * _MARGIN + 1) else 0.0
    return SpectralLine(frequency * step, (first - 0.5) * step, (stop - 0.5) * step, amplitude, sd, float(rest))


def _cleaned(record: RunningSum, lines: list[SpectralLine], factor: int) -> Iterator[np.ndarray]:
    """Yield the samples without the bands of the lines, by overlapping segments with a sine window before and after."""
    size = 2 * (min(_SEGMENT * factor, record.samples + record.samples % 2) // 2)
    half = size // 2
    window = np.sin(np.pi * (np.arange(size) + 0.5) / size)
    frequency = np.fft.rfftfreq(size, record.interval)
    kept = np.zeros(len(frequency), dtype=bool)
    for line in lines:
        kept |= (frequency >= line.low_hz) & (frequency <= line.high_hz)
    before, overlap = np.full(half, np.nan), np.zeros(half)
    for first in range(0, record.samples + half, half):
        here = record.values(min(first, record.samples), max(0, min(half, record.samples - first)))
        after = np.concatenate([here, np.full(half - len(here), np.nan)])
        values = np.concatenate([before, after])
        band = np.fft.irfft(np.fft.rfft(np.nan_to_num(values) * window) * kept, size) * window
        if first:
            yield (before - overlap - band[:half])[: record.samples - first + half] + record.shift
        before, overlap = after, band[half:]

"""The band of frequency that the noise terms describe, and what of a record is not to be claimed beside it.

The fit of the terms is tested octave by octave.  If it fails, the band gives up octaves until the rest is described:
from above if a filter shapes the spectrum, from below if a drift or a transient does, in the middle if a
disturbance is too broad for a spectral line.  What the octaves that are left out would have shown is withheld: no
interval and no limit of a term rests on a spectrum that the terms do not describe.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.foundations.tail_probabilities import normal_survival
from imubayes_recordings.noise_analysis.cosine_spectra import CosineStatistics, removed_shares
from imubayes_recordings.noise_analysis.likelihood import Maximum, NoiseLikelihood
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm
from imubayes_recordings.noise_analysis.term_estimates import BASIC, highest, within_record

MISFIT = 0.003  # chance, over all octaves, at which the fit of one is called bad
LEAST_OCTAVES = 4
_MOST_OF_IT = 0.5  # part of white noise in the variance of an octave that determines its level
_LEAST, _TOLD = 2.33, 3.7  # attenuation in sd from which it is allowed for, and told: chances of 1 % and 1e-4
_STRONG = 0.2  # attenuation
_TURNS = 10
_FAST = 10.0  # times the shortest correlation time
_WIDEST_GAP = 3  # octaves of a disturbance in the middle
SLOW = (NoiseTerm.FLICKER, NoiseTerm.RANDOM_WALK, NoiseTerm.MARKOV, NoiseTerm.RAMP)


class Cause(StrEnum):
    """Why octaves are left out, or a term is withheld."""

    FILTER = "filter"
    DRIFT = "drift"
    DISTURBANCE = "disturbance"
    UNDESCRIBED = "undescribed"
    CHANGE = "change"
    REPETITION = "repetition"
    ROUNDING = "rounding"
    AMBIGUOUS = "ambiguous"
    CONVERGENCE = "convergence"


@dataclass(frozen=True)
class Gap:
    """Octaves that are left out: their ends, and why."""

    low_hz: float
    high_hz: float
    cause: Cause


@dataclass(frozen=True)
class Octave:
    """Fit of one octave of frequency: χ² of the coefficients against their number.

    Attributes
    ----------
    low_hz, high_hz : ends.
    chi2, count : sum of the squared standardised coefficients, and their number.
    score : χ² as a standard normal value (Wilson and Hilferty 1931).
    """

    low_hz: float
    high_hz: float
    chi2: float
    count: float
    score: float

    @property
    def p_value(self) -> float:
        """Two-sided, not corrected for the number of octaves."""
        return 2 * float(normal_survival(abs(self.score)))


@dataclass(frozen=True)
class RollOff:
    """Attenuation by a filter within the band.

    Attributes
    ----------
    attenuation, sd : of the power at the highest frequency in use, logarithm.
    frequency_hz : that frequency.
    growth : of the uncertainty of white noise by that of the attenuation.
    """

    attenuation: float
    sd: float
    frequency_hz: float
    growth: float

    @property
    def significant(self) -> bool:
        """Whether it is to be reported; a weaker one only widens the interval of white noise."""
        return self.attenuation > _TOLD * self.sd

    @property
    def strong(self) -> bool:
        """Whether it is significant, and so large that its form matters."""
        return self.significant and self.attenuation > _STRONG


@dataclass(frozen=True)
class DescribedBand:
    """The likelihood of the octaves that the terms describe, and those that they do not.

    Attributes
    ----------
    likelihood : of what is left.
    gaps : what is left out, beside spectral lines.
    roll_off : how a filter attenuates what is left; None if nothing indicates one.
    described : whether the terms describe what is left.
    """

    likelihood: NoiseLikelihood
    gaps: tuple[Gap, ...]
    roll_off: RollOff | None
    described: bool

    @property
    def filtered(self) -> bool:
        """Whether a filter shapes the spectrum."""
        return self.cut(Cause.FILTER) is not None or (self.roll_off is not None and self.roll_off.significant)

    @property
    def growth(self) -> float:
        """Factor by which a roll-off that was fitted beside widens the interval of white noise."""
        return 1.0 if self.roll_off is None else self.roll_off.growth

    def cut(self, cause: Cause) -> Gap | None:
        """Return the octaves left out for a cause."""
        return next((gap for gap in self.gaps if gap.cause is cause), None)


def octave_fits(likelihood: NoiseLikelihood, best: Maximum) -> list[Octave]:
    """Return the fit of each octave."""
    squares, found = likelihood.power / likelihood.variance(best), []
    for at in likelihood.octaves():
        total, count = float(squares[at].sum()), float(likelihood.count[at].sum())
        part = 2 / (9 * count)
        score = ((total / count) ** (1 / 3) - (1 - part)) / math.sqrt(part)
        low, high = (float(f) for f in (likelihood.frequency[at].min(), likelihood.frequency[at].max()))
        found.append(Octave(low, high, total, count, score))
    return found


def misfits(octaves: Sequence[Octave]) -> list[Octave]:
    """Return the octaves that the terms do not describe, at `MISFIT` over all of them."""
    most = float(scipy.stats.norm.isf(MISFIT / (2 * max(len(octaves), 1))))
    return [octave for octave in octaves if abs(octave.score) > most]


@dataclass(frozen=True)
class _Trial:
    """A fit to some octaves, by their exponents of two."""

    used: tuple[int, ...]
    likelihood: NoiseLikelihood
    octaves: tuple[Octave, ...]
    roll_off: RollOff | None

    @property
    def bad(self) -> list[int]:
        """Places in `used` of octaves that the terms do not describe."""
        wrong = misfits(self.octaves)
        return [place for place, octave in enumerate(self.octaves) if octave in wrong]

    @property
    def score(self) -> float:
        """What is left to describe."""
        return sum(max(0.0, octave.score**2 - 1) for octave in self.octaves)


def _tried(
    used: tuple[int, ...], likelihood: NoiseLikelihood, terms: tuple[NoiseTerm, ...], known: bool
) -> tuple[_Trial, Maximum]:
    """Return the fit of terms, behind a filter if the record indicates one or it is known, and its maximum."""
    best, attenuation, roll_off, filtered = highest(likelihood, terms), 0.0, None, likelihood
    for _ in range(_TURNS):
        step, sd, growth = filtered.attenuation_step(best)
        if roll_off is None and known:
            roll_off = RollOff(0.0, sd, float(likelihood.frequency.max()), growth)
        if (not attenuation and step < (0.0 if known else _LEAST) * sd) or abs(step) < 0.02 * sd:
            break
        attenuation = max(0.0, attenuation + float(np.clip(step, -1.0, 1.0)))
        filtered = likelihood.rolled_off(attenuation)
        best = filtered.maximise(terms, best.parameters)
        roll_off = RollOff(attenuation, sd, float(likelihood.frequency.max()), growth)
        if not attenuation:
            break
    return _Trial(used, filtered, tuple(octave_fits(filtered, best)), roll_off), best


class _Search:
    """Fits with octaves left out."""

    def __init__(self, statistics: CosineStatistics, shortest_tau: float, lines: Sequence[tuple[float, float]]):
        self._given = (statistics, shortest_tau, tuple(lines))
        self._removed = removed_shares(statistics, lines)
        everything = NoiseLikelihood(statistics, shortest_tau, lines, self._removed)
        self.filtered = False  # known of a band that reaches higher
        self.all = tuple(math.floor(math.log2(everything.frequency[at[0]])) for at in everything.octaves())

    def trial(self, used: Sequence[int]) -> _Trial:
        statistics, shortest_tau, lines = self._given
        gaps = [(2.0**octave, 2.0 ** (octave + 1)) for octave in self.all if octave not in used]
        likelihood = NoiseLikelihood(statistics, shortest_tau, [*lines, *gaps], self._removed)
        # A bin that reaches over the end of its octave may go with its neighbour.
        present = tuple(math.floor(math.log2(likelihood.frequency[at[0]])) for at in likelihood.octaves())
        plain, _ = _tried(present, likelihood, BASIC, self.filtered)
        if not plain.bad:
            return plain
        other, best = _tried(present, likelihood, (*BASIC, NoiseTerm.MARKOV), self.filtered)
        return other if within_record(likelihood, best) and other.score < plain.score else plain

    def smaller(self, trial: _Trial) -> _Trial:
        """Return the best of what is left with fewer octaves."""
        bad, used = trial.bad, trial.used
        if bad[0] > 0 and bad[-1] < len(used) - 1 and bad[-1] - bad[0] < _WIDEST_GAP:
            without = self.trial([*used[: bad[0]], *used[bad[-1] + 1 :]])
            if not without.bad:
                return without
        below = 1 + max((place for place in bad if place < len(used) // 2), default=0)
        return min((self.trial(used[:-1]), self.trial(used[below:])), key=lambda each: each.score)


def described_band(
    statistics: CosineStatistics, shortest_tau: float = 0.0, lines: Sequence[tuple[float, float]] = ()
) -> DescribedBand:
    """Return the band that the noise terms describe.

    Parameters
    ----------
    shortest_tau : leave out frequencies above 1/(2 `shortest_tau`), s.
    lines : bands of frequency of spectral lines, Hz.
    """
    search = _Search(statistics, shortest_tau, lines)
    whole = trial = search.trial(search.all)
    while trial.bad and len(trial.used) > LEAST_OCTAVES:
        trial = search.smaller(trial)
    # The slope of a filter may look like a random walk over more octaves than are flat below it.
    if trial.bad or len(trial.used) < LEAST_OCTAVES:
        trial = whole
        while trial.bad and len(trial.used) > LEAST_OCTAVES:
            trial = search.trial(trial.used[:-1])
    # Of a strong attenuation the form is not known well enough.
    while trial.roll_off and trial.roll_off.strong and len(trial.used) > LEAST_OCTAVES:
        search.filtered = True
        trial = search.trial(trial.used[:-1])
    described = bool(trial.used) and not trial.bad and len(trial.used) >= LEAST_OCTAVES
    return DescribedBand(trial.likelihood, tuple(_gaps(search.all, trial.used)), trial.roll_off, described)


def _gaps(everything: Sequence[int], used: Sequence[int]) -> list[Gap]:
    found: list[Gap] = []
    for octave in (each for each in everything if each not in used):
        low, high = 2.0**octave, 2.0 ** (octave + 1)
        cause = Cause.DISTURBANCE
        if not used or octave > used[-1]:
            cause = Cause.FILTER
        elif octave < used[0]:
            cause = Cause.DRIFT
        if found and found[-1].cause is cause and found[-1].high_hz == low:
            low = found.pop().low_hz
        found.append(Gap(low, high, cause))
    return found


def withheld_terms(
    band: DescribedBand, best: Maximum, determined: Sequence[NoiseTerm], rounding: float
) -> dict[NoiseTerm, Cause]:
    """Return the terms of which the octaves in use allow no statement, and why.

    Parameters
    ----------
    best : the maximum with all terms.
    determined : terms that the octaves in use determine.
    rounding : squared coefficient of white noise that rounding to the steps of the log makes.
    """
    if not best.converged:
        return dict.fromkeys(NoiseTerm, Cause.CONVERGENCE)
    if not band.described or misfits(octave_fits(band.likelihood, best)):
        return dict.fromkeys(NoiseTerm, Cause.UNDESCRIBED)
    # A filter and quantisation noise have the same form, so that of one beside the other nothing can be said.
    found = {NoiseTerm.QUANTISATION: Cause.FILTER} if band.filtered or band.roll_off else {}
    if band.cut(Cause.DRIFT):
        found |= dict.fromkeys(SLOW, Cause.DRIFT)
    if (gap := band.cut(Cause.DISTURBANCE)) and not _white_around(band.likelihood, best, gap):
        found |= dict.fromkeys((*SLOW, NoiseTerm.WHITE), Cause.DISTURBANCE)
    if _may_be_filter(band.likelihood, best, determined, rounding):
        found |= dict.fromkeys((NoiseTerm.WHITE, NoiseTerm.MARKOV), Cause.AMBIGUOUS)
    elif band.gaps and (NoiseTerm.WHITE not in determined or _white_share(band.likelihood, best)[-1] < _MOST_OF_IT):
        found.setdefault(NoiseTerm.WHITE, band.gaps[-1].cause)
    return found


def _may_be_filter(
    likelihood: NoiseLikelihood, best: Maximum, determined: Sequence[NoiseTerm], rounding: float
) -> bool:
    """Whether Gauss–Markov noise may be white noise behind a low-pass filter.

    Its white noise is then at low frequencies, and that at high ones is of rounding or of the readout.
    """
    if NoiseTerm.MARKOV not in determined:
        return False
    white, time = best.squared(NoiseTerm.WHITE), best.correlation_time
    below = 2 * best.squared(NoiseTerm.MARKOV) * time
    fast = time < _FAST * likelihood.shortest_time
    return NoiseTerm.WHITE not in determined or white < 2 * rounding or (fast and below > white)


def _white_around(likelihood: NoiseLikelihood, best: Maximum, gap: Gap) -> bool:
    """Whether white noise is most of the variance on both sides of a gap."""
    share = _white_share(likelihood, best)
    ends = [float(likelihood.frequency[at].max()) for at in likelihood.octaves()]
    below = max((place for place, end in enumerate(ends) if end < gap.high_hz), default=0)
    return min(share[below : below + 2]) > _MOST_OF_IT


def _white_share(likelihood: NoiseLikelihood, best: Maximum) -> list[float]:
    """Return the part of white noise in the variance of every octave."""
    white = best.squared(NoiseTerm.WHITE) * likelihood.shape(NoiseTerm.WHITE) / likelihood.variance(best)
    return [float(np.average(white[at], weights=likelihood.count[at])) for at in likelihood.octaves()]

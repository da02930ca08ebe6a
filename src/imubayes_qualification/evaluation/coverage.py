"""The statement of a quantity: estimate y, standard uncertainty u, coverage interval, expanded uncertainty U = k u.

The draws of a posterior give its quantiles with a Monte Carlo error, which U should not have if the posterior is
known.  If both ends of the interval of the draws agree, within their errors, with those of a normal posterior, or of
Student's t with the degrees of freedom ν of the scatter that its budget knows, the interval is y ± k u.

No degrees of freedom belong to u.  In the GUM, s is an estimate from few readings, and t_p(ν) in U = t_p(ν) s accounts
for that (G.3).  The standard deviation of a posterior accounts for it already: that of Student's t with ν degrees of
freedom and the scale s is u = s √(ν/(ν − 2)), so that the same U is k u with k = t_p(ν) √((ν − 2)/ν) (JCGM 101, 6.4.9).
A program that multiplies u by t_p(ν) counts it twice: with ν = 11 it makes U ten per cent larger.  Such programs are
given the ν′ for which t_p(ν′) = k.

The length of a vector, as the angle between true and nominal axis, is not normal near zero: the mean of its draws is
about u if the vector is zero.  Its estimate is the length of the mean vector, its interval the shortest (JCGM 101,
5.3.4), and its components are stated beside it.  If the mean vector is shorter than all of that interval, it is from
zero to the length that is not exceeded with the probability.

A bias in the next run has an offset that is normal with the scatter τ between runs, and τ is uncertain: the posterior
is no normal one, and its k is its own.  Over draws of bias c and τ its distribution function is F(y) = E[Φ((y − c)/τ)],
which scatters less than draws of the offset, and u² = Var(c) + E[τ²].
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import special

from imubayes.foundations.tail_probabilities import normal_survival
from imubayes.results.marginal import Marginal, MonteCarloErrors

IntervalShape = Literal["symmetric", "equal-tailed", "shortest"]
COVERAGE_PROBABILITY = 0.95
_ONE_SIDED = (1 + COVERAGE_PROBABILITY) / 2
NORMAL_FACTOR = float(special.ndtri(_ONE_SIDED))
"""k of 95 % for a normal posterior, 1.96."""
# Relative difference of two coverage factors that are one.
_SAME = 1e-9
# Monte Carlo errors by which an end of the interval may differ from that of the distribution with a known k; degrees of
# freedom below which the standard deviation of t is no measure of its width.
_AGREES, _LEAST_DEGREES = 3.0, 4.0
# Share of u that the scatter of each draw has at least: less would make steps of the distribution function.
_LEAST_SCATTER, _MOST_STEPS, _CLOSE = 0.02, 60, 1e-6
# Share of U by which the ends of an interval y ± U may differ from those of equal tails: it changes the coverage by
# less than a ten-thousandth.
_OFF_CENTRE = 0.02


@dataclass(frozen=True)
class Coverage:
    """What is stated of a quantity.

    Attributes
    ----------
    estimate, standard : y and u.
    low, high : ends of the 95 % coverage interval.
    shape : kind of interval.
    errors : Monte Carlo errors of these numbers.
    known : k if the interval is y ± k u with a k that is known; None for the ends of draws.
    """

    estimate: float
    standard: float
    low: float
    high: float
    shape: IntervalShape
    errors: MonteCarloErrors
    known: float | None = None

    @property
    def expanded(self) -> float:
        """U: half the length of the interval."""
        return (self.high - self.low) / 2 if self.known is None else self.known * self.standard

    @property
    def factor(self) -> float:
        """K = U/u; 0 for a quantity that does not vary."""
        if self.known is not None:
            return self.known
        return self.expanded / self.standard if self.standard > 0 else 0.0


@dataclass(frozen=True)
class KnownUncertainty:
    """A standard uncertainty that is known better than from draws: u, its Monte Carlo error, and k.

    `factor` is that of the interval if the draws have its shape; None if they have another one.  `mean_error` is
    the Monte Carlo error of the estimate if that is not u over the root of the draws.
    """

    standard: float
    error: float
    factor: float | None = NORMAL_FACTOR
    mean_error: float | None = None


def coverage_factor(degrees: float) -> float | None:
    """Return k of 95 % for a posterior of Student's t with ν degrees of freedom and known standard deviation.

    None if there are so few that the standard deviation is no measure of the width.
    """
    if math.isinf(degrees):
        return NORMAL_FACTOR
    if degrees <= _LEAST_DEGREES:
        return None
    return float(special.stdtrit(degrees, _ONE_SIDED)) * math.sqrt((degrees - 2) / degrees)


def equivalent_degrees(factor: float) -> float:
    """Return ν′ for which Student's t has the factor k of 95 %, t_p(ν′) = k; infinite for that of a normal posterior.

    It is for programs that form U = t_p(ν′) u, and says nothing of how well u is known.
    """
    return math.inf if factor <= NORMAL_FACTOR * (1 + _SAME) else float(special.stdtridf(_ONE_SIDED, factor))


def effective_degrees(contributions: np.ndarray, degrees: np.ndarray, variance: float | None = None) -> float:
    """Return ν of a sum of variances by Welch–Satterthwaite (GUM G.4.1); infinite if all are.

    `variance` is that of the sum if some of the parts, with infinite ν, are correlated.
    """
    whole = float(np.sum(contributions)) if variance is None else variance
    sum_of_squares = float(np.sum(contributions**2 / degrees))
    return whole**2 / sum_of_squares if sum_of_squares > 0 else math.inf


def coverage_of(marginal: Marginal, known: KnownUncertainty | None = None) -> Coverage:
    """Return what is stated of a quantity with these draws.

    Parameters
    ----------
    marginal : of the quantity.
    known : its uncertainty if a budget gives it; that of the draws if None.
    """
    errors, (low, high) = marginal.errors, marginal.interval
    known = known or KnownUncertainty(marginal.sd, errors.sd)
    if known.factor is not None and marginal.sd > 0:
        mean, k = marginal.mean, known.factor
        # The shape is that of the draws alone: their standard deviation has an error of its own.
        of_draws = abs(mean - k * marginal.sd - low), abs(mean + k * marginal.sd - high)
        if of_draws[0] <= _AGREES * errors.low and of_draws[1] <= _AGREES * errors.high:
            of_mean = errors.mean if known.mean_error is None else known.mean_error
            half, of_end = k * known.standard, math.hypot(of_mean, k * known.error)
            own = MonteCarloErrors(of_mean, known.error, of_end, of_end)
            return Coverage(mean, known.standard, mean - half, mean + half, "symmetric", own, k)
    return Coverage(marginal.mean, known.standard, low, high, "equal-tailed", errors)


def coverage_with_scatter(centre: Marginal, scatter: np.ndarray, added: float = 0.0) -> Coverage:
    """Return what is stated of a quantity with an offset of its own on top, whose standard deviation is uncertain.

    Parameters
    ----------
    centre : of the quantity without the offset.
    scatter : shape (S,), standard deviation of the offset for each draw.
    added : standard deviation, known exactly, of what is in the draws and moves no estimate by chance.
    """
    draws, effective = centre.draws, centre.effective
    squares = (draws - centre.mean) ** 2 + scatter**2
    standard = math.sqrt(float(np.mean(squares)))
    of_mean = math.sqrt(max(centre.sd**2 - added**2, 0.0) / effective)
    of_sd = float(np.std(squares)) / math.sqrt(effective) / (2 * standard)
    reach = np.maximum(scatter, _LEAST_SCATTER * standard)
    (low, of_low), (high, of_high) = (
        _quantile_of_mixture(draws, reach, probability, effective) for probability in (1 - _ONE_SIDED, _ONE_SIDED)
    )
    errors = MonteCarloErrors(of_mean, of_sd, of_low, of_high)
    off_centre = abs(low + high - 2 * centre.mean)
    if off_centre > max(_AGREES * math.hypot(of_low, of_high), _OFF_CENTRE * (high - low)):
        return Coverage(centre.mean, standard, low, high, "equal-tailed", errors)
    half = (high - low) / 2
    return Coverage(centre.mean, standard, centre.mean - half, centre.mean + half, "symmetric", errors, half / standard)


def _quantile_of_mixture(
    centre: np.ndarray, scatter: np.ndarray, probability: float, effective: float
) -> tuple[float, float]:
    """Return the quantile of a mixture of normal distributions, (S,), and its Monte Carlo error."""
    ends = centre + special.ndtri(probability) * scatter
    low, high = float(ends.min()), float(ends.max())
    # Between the quantiles of its members, by Newton steps inside a bracket that closes.
    at = float(np.mean(centre)) + special.ndtri(probability) * math.sqrt(np.var(centre) + np.mean(scatter**2))
    error = 0.0
    for _ in range(_MOST_STEPS):
        below = normal_survival((centre - at) / scatter)
        density = float(np.mean(np.exp(-0.5 * ((at - centre) / scatter) ** 2) / scatter)) / math.sqrt(2 * math.pi)
        excess = float(np.mean(below)) - probability
        low, high = (low, at) if excess > 0 else (at, high)
        error = float(np.std(below)) / math.sqrt(effective) / max(density, 1e-300)
        after = at - excess / max(density, 1e-300)
        after = after if low < after < high else (low + high) / 2
        if abs(after - at) <= _CLOSE * (high - low + error):
            return after, error
        at = after
    return at, error


def coverage_of_length(marginal: Marginal, length: float, known: KnownUncertainty | None = None) -> Coverage:
    """Return what is stated of the length of a vector, whose mean has this length."""
    ordered = np.sort(marginal.draws)
    low, high = shortest_interval(ordered)
    if length < low:  # the vector may be zero, and its draws never are: what is known is how long it is at most
        low, high = 0.0, float(np.quantile(ordered, COVERAGE_PROBABILITY))
    standard = marginal.sd if known is None else known.standard
    return Coverage(length, standard, low, high, "shortest", marginal.errors)


def shortest_interval(ordered: np.ndarray, probability: float = COVERAGE_PROBABILITY) -> tuple[float, float]:
    """Return the shortest interval that holds a share of draws in increasing order, (S,) (JCGM 101, 7.7.4)."""
    inside = min(max(round(probability * len(ordered)), 1), len(ordered) - 1)
    widths = ordered[inside:] - ordered[:-inside]
    first = int(np.argmin(widths))
    return float(ordered[first]), float(ordered[first + inside])

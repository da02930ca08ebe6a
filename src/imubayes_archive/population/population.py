"""The population of a parameter: mean and spread over units, each unit's estimate given the others, and draw errors.

The *spread* is half the width of the interval that holds the central 68.3 % of the population: its standard deviation
under the normal law, and a number of the same meaning under the t law, which replaces it if the units have heavier
tails.  Units are treated as independent: an error that all of them share, such as that of one table, is in the mean.

A population must not be inferred from posteriors as they are: each of them contains the prior of the model, n units
would count it n times, and badly measured units would pull the spread towards the prior's.  The prior is therefore
divided out.  With a normal posterior N(m, s²) under a normal prior N(μ₀, σ₀²) the quotient is the integrated likelihood
of the unit, normal as well:

    1/v = 1/s² − 1/σ₀²,    y = v (m/s² − μ₀/σ₀²).

All other parameters of the unit are integrated over with the priors that the model gives them.

Posteriors estimated from draws lose a part of what is known of the population.  A mean and a variance estimated from S
draws have mean squared errors s²/S and 2s⁴/S.  Such an error ε(Λ) of the log likelihood of the population's parameters
Λ turns its posterior p into p e^ε, up to a factor.  To second order the Kullback–Leibler divergence between the two is
half the variance of ε over the posterior.  Its expectation over the draws is, in nats,

    ½ Σᵢ Σ_k var_k,i · Var_Λ[∂ₖ ln Lᵢ(Λ)]  +  ½ Var_Λ[½ Σᵢ Σ_k var_k,i · (∂ₖ ln Lᵢ(Λ))²],

where k runs over mean and variance of a unit.  The first term is lost precision.  The second is lost accuracy: the
logarithm of an estimate is too small by half its variance.  J. Heinzel and S. Vitale (2025, arXiv:2509.07221) define
the sum as the information error and recommend at most 0.2 bits.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import stats

from imubayes.foundations.tail_probabilities import normal_survival
from imubayes_archive.population.population_laws import GridPosterior, mixing, mixture, normal_law, student_law

LEAST_FROM_DATA = 0.05
"""Share of the information on a parameter that must come from a unit's data for the unit to count (convention).

Below it the quotient of posterior and prior is mostly the error of the normal approximation.  Units are left out by
their uncertainty alone, never by their value, so that the selection does not bias the population.
"""


@dataclass(frozen=True)
class UnitPosteriors:
    """The posterior of one parameter in n units, on a scale on which the prior is normal.

    Attributes
    ----------
    mean, sd : shape (n,), posterior mean and standard deviation.
    prior_mean, prior_sd : shape (n,), of the prior; an infinite standard deviation is a flat prior.
    draws : shape (n,), effective number of draws that mean and sd were estimated from; infinite if they are exact.
    stated : mean and standard deviation of the prior of the model, if these posteriors have other priors.
    """

    mean: np.ndarray
    sd: np.ndarray
    prior_mean: np.ndarray
    prior_sd: np.ndarray
    draws: np.ndarray
    stated: tuple[float, float] | None = None

    @property
    def stated_sd(self) -> float:
        """Standard deviation of the prior of the model; infinite for a flat one."""
        return self.stated[1] if self.stated is not None else float(np.median(self.prior_sd))

    def of(self, chosen: np.ndarray) -> "UnitPosteriors":
        """Return the posteriors of some units."""
        return UnitPosteriors(
            self.mean[chosen], self.sd[chosen], self.prior_mean[chosen], self.prior_sd[chosen], self.draws[chosen],
            self.stated,
        )  # fmt: skip

    def shifted(self, by: np.ndarray) -> "UnitPosteriors":
        """Return the posteriors of the parameter less what is known of each unit, (n,)."""
        return replace(self, mean=self.mean - by, prior_mean=self.prior_mean - by)

    @cached_property
    def from_data(self) -> np.ndarray:
        """1 − posterior variance / prior variance, shape (n,)."""
        return 1 - (self.sd / self.prior_sd) ** 2

    @cached_property
    def informative(self) -> np.ndarray:
        """Whether a unit carries information on the parameter, shape (n,) bool.

        The posterior must be narrower than the prior by more than `LEAST_FROM_DATA`, and by more than the standard
        error of a variance estimated from so many draws.
        """
        least = np.maximum(LEAST_FROM_DATA, np.sqrt(2 / self.draws))
        usable = np.isfinite(self.mean) & np.isfinite(self.sd) & (self.sd > 0)
        return usable & (self.from_data > least)

    @cached_property
    def likelihood(self) -> tuple[np.ndarray, np.ndarray]:
        """Estimate and variance of each unit with the prior divided out, (n,) each; 0 and ∞ without information."""
        with np.errstate(divide="ignore", invalid="ignore"):
            precision = np.where(self.informative, 1 / self.sd**2 - 1 / self.prior_sd**2, 0.0)
            variance = 1 / precision
            estimate = variance * (self.mean / self.sd**2 - self.prior_mean / self.prior_sd**2)
        return np.where(self.informative, estimate, 0.0), np.where(self.informative, variance, np.inf)


MOST_BITS = 0.2
"""Information error above which an estimate of a population is refused (Heinzel and Vitale, 2025)."""


def information_error(posterior: GridPosterior, units: UnitPosteriors) -> float:
    """Return the information error of the posterior of a population, in bits.

    Parameters
    ----------
    posterior : of centre and scale.
    units : all of them; those without information are left out.
    """
    used = units.informative & np.isfinite(units.draws)
    if not used.any():
        return 0.0
    weight = posterior.weight
    precision, bias = 0.0, np.zeros(len(weight))
    for place in np.flatnonzero(used):
        by_mean, by_variance = _sensitivities(posterior, units, int(place))
        variance, draws = units.sd[place] ** 2, units.draws[place]
        for slope, error in ((by_mean, variance / draws), (by_variance, 2 * variance**2 / draws)):
            precision += 0.5 * error * _variance(weight, slope)
            bias += 0.5 * error * (slope - weight @ slope) ** 2
    nats = precision + 0.5 * _variance(weight, bias)
    return float(nats / np.log(2))


def _variance(weight: np.ndarray, values: np.ndarray) -> float:
    return float(weight @ (values - weight @ values) ** 2)


def _sensitivities(posterior: GridPosterior, units: UnitPosteriors, place: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of a unit's log likelihood by its posterior mean and variance, (G,) each.

    Under the normal law the centre of each grid point is integrated over: its mean stands for it, and the variance of
    the centre adds to that of the unit.
    """
    estimate, variance = (each[place] for each in units.likelihood)
    by_estimate, by_variance = _slopes(posterior, float(estimate), float(variance))
    square = units.sd[place] ** 2
    grows = (variance / square) ** 2
    moves = variance * (estimate - units.mean[place]) / square**2
    return by_estimate * variance / square, by_variance * grows + by_estimate * moves


def _slopes(posterior: GridPosterior, estimate: float, variance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of the log density of a unit by its estimate and by its variance, (G,) each."""
    distance = estimate - posterior.centre
    squares = distance**2 + posterior.centre_variance
    if np.isinf(posterior.freedom):
        total = variance + posterior.scale**2
        return -distance / total, 0.5 * (squares / total - 1) / total
    node, log_weight = mixing(posterior.freedom)
    total = variance + posterior.scale[:, None] ** 2 / node
    share = log_weight - 0.5 * np.log(total) - 0.5 * squares[:, None] / total
    share = np.exp(share - share.max(axis=1, keepdims=True))
    share /= share.sum(axis=1, keepdims=True)
    slope = -distance * np.sum(share / total, axis=1)
    return slope, 0.5 * np.sum(share * (squares[:, None] / total - 1) / total, axis=1)


LEAST_UNITS = 5
"""Fewest informative units: with fewer the spread has no variance under its flat prior (derived, Gelman 2006)."""
STUDENT_FREEDOM = (2.0, 4.0, 8.0)
"""Degrees of freedom of the t laws compared with the normal law (convention)."""
TAIL_ALARM = 0.1
"""The t laws are tried if the most distant unit has a p-value below this, all units counted (effort)."""
RATE = 0.05
"""False discovery rate of outlying units, drifting parameters and changed estimates (convention)."""
MASS = 0.95
_CORE = float(normal_survival(-1.0))


@dataclass(frozen=True)
class Population:
    """Mean and spread of a parameter over units.

    Attributes
    ----------
    units, informative : number of units, and of those that carry information.
    reason : why there is no estimate; empty if there is one.  The numbers below are NaN without one.
    freedom : degrees of freedom of the t law; infinite for the normal law.
    mean, mean_sd, mean_interval : of the population mean, the interval with 95 % probability.
    spread, spread_sd, spread_interval : of the spread, the interval the shortest.
    predictive_sd : of the next unit, as a normal approximation; mean and spread uncertain.
    information_error : bits lost to the Monte Carlo error of the units' posteriors.
    posterior : of centre and scale.
    """

    units: int
    informative: int
    reason: str = ""
    freedom: float = np.inf
    mean: float = np.nan
    mean_sd: float = np.nan
    mean_interval: tuple[float, float] = (np.nan, np.nan)
    spread: float = np.nan
    spread_sd: float = np.nan
    spread_interval: tuple[float, float] = (np.nan, np.nan)
    predictive_sd: float = np.nan
    information_error: float = 0.0
    posterior: GridPosterior | None = field(default=None, repr=False)

    def with_mean(self, mean: float, sd: float) -> "Population":
        """Return the population with a mean and its standard deviation from elsewhere, as a normal distribution."""
        half = float(stats.norm.ppf((1 + MASS) / 2)) * sd
        predictive = float(np.sqrt(self.predictive_sd**2 - self.mean_sd**2 + sd**2))
        interval = mean - half, mean + half
        return replace(self, mean=mean, mean_sd=sd, mean_interval=interval, predictive_sd=predictive)


@dataclass(frozen=True)
class ShrunkUnits:
    """What is known of each unit from its own data and from the population, and how unusual it is.

    Attributes
    ----------
    mean, sd : shape (n,), posterior mean and standard deviation of each unit, the population as prior.
    distance : shape (n,), of the unit's own estimate from the population mean, in standard deviations; NaN without
        information.
    p : shape (n,), two-sided p-value of that distance, the unit itself not counted to the population; 1 without
        information.
    outlying : shape (n,), bool, at a false discovery rate of 5 % (Benjamini–Yekutieli).
    others : mean and standard deviation of each unit given the other units alone, shape (n,) each; None if they
        follow from those given all units and the likelihood of the unit.
    """

    mean: np.ndarray
    sd: np.ndarray
    distance: np.ndarray
    p: np.ndarray
    outlying: np.ndarray
    others: tuple[np.ndarray, np.ndarray] | None = None


def population(units: UnitPosteriors) -> Population:
    """Return the population that units come from, or why it cannot be given."""
    count, used = len(units.mean), units.informative
    informative = int(used.sum())
    if informative < LEAST_UNITS:
        return Population(count, informative, f"fewer than {LEAST_UNITS} units determine the parameter")
    posterior = _law(*(each[used] for each in units.likelihood))
    bits = information_error(posterior, units)
    if bits > MOST_BITS:
        reason = f"the information error is {bits:.2g} bits, above {MOST_BITS:g}: the units need more draws"
        return Population(count, informative, reason, posterior.freedom, information_error=bits)
    return population_of(posterior, count, informative, bits)


def population_of(posterior: GridPosterior, count: int, informative: int, bits: float = 0.0) -> Population:
    """Return the population of `count` units with a posterior of centre and scale."""
    factor = core_width(posterior.freedom)
    mean, mean_sd = posterior.of_centre()
    spread, spread_sd = posterior.of_scale(factor)
    variance = posterior.weight @ (posterior.centre_variance + (posterior.centre - mean) ** 2)
    variance += factor**2 * posterior.weight @ posterior.scale**2
    tail = (1 - MASS) / 2
    return Population(
        units=count,
        informative=informative,
        freedom=posterior.freedom,
        mean=mean,
        mean_sd=mean_sd,
        mean_interval=(posterior.centre_quantile(tail), posterior.centre_quantile(1 - tail)),
        spread=spread,
        spread_sd=spread_sd,
        spread_interval=posterior.scale_interval(MASS, factor),
        predictive_sd=float(np.sqrt(variance)),
        information_error=bits,
        posterior=posterior,
    )


def core_width(freedom: float) -> float:
    """Return half the width of the central 68.3 % of a t distribution, in units of its scale."""
    return 1.0 if np.isinf(freedom) else float(stats.t.ppf(_CORE, freedom))


def _law(estimate: np.ndarray, variance: np.ndarray) -> GridPosterior:
    """Return the posterior under the law with the largest evidence; the t laws only if a unit is far out."""
    normal = normal_law(estimate, variance)
    middle = float(np.median(estimate))
    core = max((float(np.median(np.abs(estimate - middle))) / 0.6745) ** 2 - float(np.median(variance)), 0.0)
    farthest = float(np.max(np.abs(estimate - middle) / np.sqrt(variance + core)))
    if 2 * normal_survival(farthest) * len(estimate) > TAIL_ALARM:
        return normal
    laws = [normal, *(student_law(estimate, variance, freedom) for freedom in STUDENT_FREEDOM)]
    return max(laws, key=lambda each: each.log_evidence)


def shrunk(units: UnitPosteriors, found: Population) -> ShrunkUnits:
    """Return the units with the population as prior; raises ValueError if there is no population."""
    if found.posterior is None:
        raise ValueError(found.reason)
    estimate, variance = units.likelihood
    moments = _normal_moments if np.isinf(found.freedom) else _student_moments
    return compared(units, found, *moments(found.posterior, estimate, variance))


def compared(units: UnitPosteriors, found: Population, mean: np.ndarray, sd: np.ndarray) -> ShrunkUnits:
    """Return units of given mean and sd with their distances from the population."""
    distance, p = _distances(found, *units.likelihood, units.informative)
    return ShrunkUnits(mean, sd, distance, p, discoveries(p, RATE))


def _normal_moments(
    posterior: GridPosterior, estimate: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of each unit under the normal law, (n,) each."""
    first, second = np.zeros(len(estimate)), np.zeros(len(estimate))
    parts = (posterior.weight, posterior.centre, posterior.centre_variance, posterior.scale**2)
    for weight, centre, uncertainty, spread in zip(*parts, strict=True):
        share = spread / (spread + variance)
        mean = centre + share * (estimate - centre)
        first += weight * mean
        second += weight * (mean**2 + spread * (1 - share) + (1 - share) ** 2 * uncertainty)
    return first, np.sqrt(np.maximum(second - first**2, 0.0))


def _student_moments(
    posterior: GridPosterior, estimate: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of each unit under the t law, (n,) each."""
    node, _ = mixing(posterior.freedom)
    first, second = np.zeros(len(estimate)), np.zeros(len(estimate))
    known = np.isfinite(variance)
    finite = np.where(known, variance, 1.0)
    for weight, centre, scale in zip(posterior.weight, posterior.centre, posterior.scale, strict=True):
        among = mixture((estimate - centre) ** 2, finite, scale, posterior.freedom) + 1e-300
        among /= np.sum(among, axis=1, keepdims=True)
        # The t law may have no variance: a unit without information has the core's.
        spread = scale**2 / node
        share = np.where(known[:, None], spread / (spread + finite[:, None]), 0.0)
        mean = centre + share * (estimate - centre)[:, None]
        left = np.where(known[:, None], spread * (1 - share), (core_width(posterior.freedom) * scale) ** 2)
        first += weight * np.sum(among * mean, axis=1)
        second += weight * np.sum(among * (mean**2 + left), axis=1)
    return first, np.sqrt(np.maximum(second - first**2, 0.0))


def _distances(
    found: Population, estimate: np.ndarray, variance: np.ndarray, used: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance of each unit from the population mean, in standard deviations, and its p-value, (n,) each.

    Under the normal law each unit is left out of the population in turn.  The t law is hardly moved by a single unit;
    its core is what a unit is compared with.
    """
    sd = np.sqrt(variance + found.mean_sd**2 + found.spread**2)
    distance = np.where(used, (estimate - found.mean) / sd, np.nan)
    p = np.ones(len(estimate))
    posterior = found.posterior
    if posterior is None or np.isfinite(found.freedom):
        p[used] = 2 * normal_survival(np.abs(distance[used]))
        return distance, p
    for place in np.flatnonzero(used):
        total = variance[place] + posterior.scale**2
        centre_variance = 1 / (1 / posterior.centre_variance - 1 / total)
        centre = centre_variance * (posterior.centre / posterior.centre_variance - estimate[place] / total)
        apart, width = np.abs(estimate[place] - centre), centre_variance + total
        log_weight = np.log(posterior.weight + 1e-300) + 0.5 * (apart**2 / width + np.log(width))
        weight = np.exp(log_weight - log_weight.max())
        p[place] = 2 * (weight / weight.sum()) @ normal_survival(apart / np.sqrt(width))
    return distance, p


def discoveries(p: np.ndarray, rate: float) -> np.ndarray:
    """Return which of n hypotheses are rejected at a false discovery rate, (n,) bool.

    By the procedure of Benjamini and Yekutieli (Annals of Statistics 29, 2001), which holds under any dependence, such
    as that of units which share the estimate of their population.
    """
    if not len(p):
        return np.zeros(0, dtype=bool)
    return stats.false_discovery_control(p, method="by") <= rate

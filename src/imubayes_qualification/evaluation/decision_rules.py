"""Decision rules: from estimate, uncertainty and conformance probability to pass, conditional pass or fail; risks.

Binary rules compare the estimate with an acceptance interval, the tolerance interval less a guard band w on each side:
w = 0 is simple acceptance.  The non-binary rule of ILAC-G8:09/2019 (4.2.3) has w = U and gives a conditional result
within U of a limit.  The rules of JCGM 106 look at p_c, which needs no normal distribution: against a bound of its own,
or as specific consumer's risk 1 − p_c against a target.  A target for the *global* risk sets the guard band from the
distribution of all units that are tested.

JCGM 106 defines p_c as the posterior probability that the quantity is within its tolerance interval.  It is found by
two methods that have to agree: the draws give it as a fraction with a Monte Carlo error; quadrature over the fitted
marginal gives it again.  If the two differ by more than the errors allow, the number is withheld: the reader gets
the reason instead.

Global risks are shares of all units tested: those wrongly accepted and those wrongly rejected (JCGM 106, 9.5).  A unit
drawn from the production has the value η ~ normal(μ, s), its measurement gives y ~ normal(η, u), and it is accepted
if y is in the acceptance interval of the rule as it is applied: a conditional pass is delivered, and a bound on p_c
is an interval of y.  The consumer's risk is the probability that a unit is accepted and does not conform, the
producer's that it is rejected and conforms.  Each is found twice: by quadrature over η, with the probability of
acceptance in closed form, and by simulated units.

Tolerances of the qualification statistics are constants, each with its value, meaning, origin, and what moves when it
is changed.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.foundations.numerics import gauss_legendre
from imubayes.foundations.tail_probabilities import normal_survival
from imubayes.results.marginal import Marginal
from imubayes_qualification.evaluation.fitted_marginal import fitted_to

RISK_ERRORS = 3.0
"""Monte Carlo errors by which a risk from draws may differ from that of quadrature.

Origin: 3 standard deviations, exceeded by chance once in 370 comparisons.  A larger value lets a wrong risk pass.
"""

RISK_SHAPE = 0.005
"""Difference between the two methods that is allowed beyond the Monte Carlo error.

Origin: a four-parameter marginal misses the tail of a posterior with mixed widths by some thousandths of probability
(tests/qualification/test_conformance.py: gamma, folded and t₅ marginals stay below 0.004).  No decision rule in use
turns on less.  A smaller value withholds risks of marginals that are merely not sinh-arcsinh.
"""

COVERAGE = 0.95
"""Probability of the coverage interval, and default of the conformance probability that a decision asks for."""

GUARD_FACTOR = 1.65
"""Width of the one-sided 95 % guard band in standard uncertainties (JCGM 106, 8.3.2; ILAC-G8:09/2019)."""

LEAST_EFFECTIVE = 400.0
"""Effective draws below which no conformance probability is stated.

Origin: at p = 0.95 the Monte Carlo error of 400 draws is 0.011, a fifth of the risk.
"""

LEAST_SHARE = 1e-3
"""Share of the variance below which a contribution is summed with others in one line of a budget.

Origin: it changes a standard uncertainty by half a thousandth, below its second digit.
"""

ADDS_UP = 0.02
"""Share of the posterior variance by which the contributions of a budget may miss it before that is said.

Origin: the budget is required to add up to the posterior variance within 2 %.
"""

USEFUL_RUN = 0.99
"""Share of a standard uncertainty that a further run may leave at most, to be proposed in a budget.

Origin: a change by a hundredth is the least that two significant digits show.  The report states by how much each run
narrows a quantity; a larger value proposes runs that narrow nothing visibly.
"""

SPLIT_DRAWS = 40
"""Draws of the noise scales over which the contributions of the data are divided among the runs.

Origin: the shares of runs scatter less than their sum, and degrees of freedom from 40 draws are known to 25 %.  Each
costs a product of the whitened Jacobian.
"""


Withheld = Literal["disagreement", "too_few_draws"]


@dataclass(frozen=True)
class ToleranceInterval:
    """Limits of a quantity; an infinite one is none."""

    lower: float = -math.inf
    upper: float = math.inf

    def contains(self, values: np.ndarray) -> np.ndarray:
        """Return whether each value is within the limits, shape as given, bool."""
        return (values >= self.lower) & (values <= self.upper)

    def guarded(self, width: float) -> "ToleranceInterval":
        """Return the acceptance interval with a guard band of this width inside each limit (JCGM 106, 8.3)."""
        return ToleranceInterval(self.lower + width, self.upper - width)


@dataclass(frozen=True)
class ProbabilityByTwoMethods:
    """A probability from draws and from quadrature.

    Attributes
    ----------
    from_draws, from_quadrature : of the two methods.
    monte_carlo_error : Monte Carlo standard error of the first.
    allowed : largest difference between the two.
    withheld : why no value is stated; None if one is.
    """

    from_draws: float
    from_quadrature: float
    monte_carlo_error: float
    allowed: float
    withheld: Withheld | None

    @property
    def value(self) -> float | None:
        """The probability; None if it is withheld."""
        return None if self.withheld is not None else self.from_draws


def compared(
    from_draws: float, from_quadrature: float, error: float, effective: float = math.inf
) -> ProbabilityByTwoMethods:
    """Return a probability found by two methods, withheld if they disagree or if draws are too few."""
    allowed = RISK_ERRORS * error + RISK_SHAPE
    withheld: Withheld | None = None
    if not abs(from_draws - from_quadrature) <= allowed:
        withheld = "disagreement"
    elif effective < LEAST_EFFECTIVE:
        withheld = "too_few_draws"
    return ProbabilityByTwoMethods(from_draws, from_quadrature, error, allowed, withheld)


def fraction_error(fraction: float, effective: float) -> float:
    """Return the Monte Carlo standard error of a fraction of so many independent draws.

    With one success and one failure added, so that a fraction of 0 or 1 has an error too.
    """
    smoothed = (fraction * effective + 1) / (effective + 2)
    return math.sqrt(smoothed * (1 - smoothed) / (effective + 2))


def conformance_probability(marginal: Marginal, tolerance: ToleranceInterval) -> ProbabilityByTwoMethods:
    """Return p_c: the posterior probability that a quantity is within its tolerance interval (JCGM 106, 7.1)."""
    inside = float(np.mean(tolerance.contains(marginal.draws)))
    error = fraction_error(inside, marginal.effective)
    if not marginal.sd > 0:
        return compared(inside, inside, 0.0, marginal.effective)
    smooth = fitted_to(np.sort(marginal.draws)).probability(tolerance.lower, tolerance.upper)
    return compared(inside, smooth, error, marginal.effective)


RuleName = Literal[
    "simple_acceptance", "guard_band", "ilac_g8_non_binary", "conformance_probability", "specific_risk", "global_risk"
]
Outcome = Literal["pass", "conditional_pass", "conditional_fail", "fail", "withheld"]
ACCEPTED: tuple[Outcome, ...] = ("pass", "conditional_pass")
"""Outcomes with which a unit is delivered."""
REJECTED: tuple[Outcome, ...] = ("conditional_fail", "fail")
"""Outcomes with which it is not; `withheld` is no decision."""
NoDecision = Literal["probability", "not_determined", "taken_as_exact", "obstacle"]
"""Why there is none: a probability that the rule needs is withheld; the data do not determine the quantity; what the
model takes as exact of the equipment could plausibly put it beyond the limit; something stands against the whole unit.
"""


@dataclass(frozen=True)
class MeasuredValue:
    """What a rule looks at.

    Attributes
    ----------
    value : posterior mean.
    standard, expanded : standard uncertainty u, and U, half the length of the 95 % coverage interval.
    conformance : p_c by two methods.
    """

    value: float
    standard: float
    expanded: float
    conformance: ProbabilityByTwoMethods


@dataclass(frozen=True)
class DecisionRule:
    """A decision rule.

    Attributes
    ----------
    name : of the rule.
    guard_factor : width of the guard band in standard uncertainties; None for w = U.
    guard_width : width of the guard band in the unit of the quantity; None if a factor gives it.
    probability : least p_c, or largest risk.
    """

    name: RuleName
    guard_factor: float | None = None
    guard_width: float | None = None
    probability: float | None = None

    def guard(self, estimate: MeasuredValue) -> float:
        """Return the width w of the guard band, in the unit of the quantity."""
        if self.name == "simple_acceptance":
            return 0.0
        if self.guard_width is not None:
            return self.guard_width
        if self.name == "guard_band" and self.guard_factor is not None:
            return self.guard_factor * estimate.standard
        return estimate.expanded


@dataclass(frozen=True)
class Decision:
    """Outcome of a rule, with the guard band that it used, None for rules on p_c; and why it is withheld, if it is."""

    outcome: Outcome
    guard_band: float | None
    withheld: NoDecision | None = None


def decide(rule: DecisionRule, estimate: MeasuredValue, tolerance: ToleranceInterval) -> Decision:
    """Return the outcome of a rule for one quantity; `withheld` if it needs a probability that is withheld."""
    least = least_conformance(rule)
    if least is not None:
        outcome = _by_probability(least, estimate.conformance.value)
        return Decision(outcome, None, "probability" if outcome == "withheld" else None)
    guard = rule.guard(estimate)
    if rule.name == "ilac_g8_non_binary":
        return Decision(_non_binary(estimate.value, tolerance, guard), guard)
    return Decision("pass" if _within(estimate.value, tolerance.guarded(guard)) else "fail", guard)


def specific_risks(conformance: float | None, outcome: Outcome) -> tuple[float | None, float | None]:
    """Return the specific risks (JCGM 106, 3.3.13–14): consumer's of an accepted unit, producer's of a rejected one.

    Each is None if it does not apply, and both if p_c is withheld.
    """
    if conformance is None:
        return None, None
    return (1 - conformance if outcome in ACCEPTED else None), (conformance if outcome in REJECTED else None)


def _by_probability(least: float, conformance: float | None) -> Outcome:
    if conformance is None:
        return "withheld"
    return "pass" if conformance >= least else "fail"


def _non_binary(value: float, tolerance: ToleranceInterval, guard: float) -> Outcome:
    if _within(value, tolerance.guarded(guard)):
        return "pass"
    if _within(value, tolerance):
        return "conditional_pass"
    return "conditional_fail" if _within(value, tolerance.guarded(-guard)) else "fail"


def _within(value: float, interval: ToleranceInterval) -> bool:
    return interval.lower <= value <= interval.upper


def acceptance_interval(
    rule: DecisionRule, standard: float, tolerance: ToleranceInterval, decision: Decision
) -> ToleranceInterval | None:
    """Return the estimates with which units are delivered, conditional passes among them; None if none is.

    Parameters
    ----------
    rule, decision : as applied to a unit.
    standard : standard uncertainty u, that of all units measured in this way.
    tolerance : limits of the quantity.
    """
    if rule.name == "ilac_g8_non_binary":
        return tolerance
    least = least_conformance(rule)
    width = decision.guard_band if least is None else _guard_of_probability(least, standard, tolerance)
    accepted = None if width is None else tolerance.guarded(width)
    return None if accepted is None or accepted.lower > accepted.upper else accepted


def least_conformance(rule: DecisionRule) -> float | None:
    """Return the p_c with which a rule on it accepts; None for other rules."""
    if rule.probability is None or rule.name not in ("conformance_probability", "specific_risk"):
        return None
    return rule.probability if rule.name == "conformance_probability" else 1 - rule.probability


def _guard_of_probability(least: float, standard: float, tolerance: ToleranceInterval) -> float | None:
    """Return w such that p_c of a normal posterior is the least one at a distance w inside a limit; None for none."""
    if not standard > 0:
        return 0.0

    def lacking(width: float) -> float:
        inside, across = width / standard, (tolerance.upper - tolerance.lower - width) / standard
        outside = normal_survival(np.array([inside, across]))
        return least - (1 - float(outside.sum()))

    middle = min((tolerance.upper - tolerance.lower) / 2, _WIDEST * standard)
    if lacking(middle) > 0:
        return None
    return float(np.asarray(scipy.optimize.brentq(lacking, -_WIDEST * standard, middle, xtol=1e-9 * standard)))


_NODES, _FAR, _CLIMB, _UNITS = 100, 9.0, 8.0, 400_000
# Widest guard band that is tried: in standard uncertainties, if no unit beyond a limit is accepted, and as a share
# of half the tolerance, which leaves nothing to accept.
_WIDEST, _MOST = 8.0, 0.999


@dataclass(frozen=True)
class Production:
    """Distribution of the true values of the units tested, normal(mean, sd), in the unit of the quantity."""

    mean: float
    sd: float


@dataclass(frozen=True)
class GlobalRisks:
    """Consumer's and producer's risk of a rule, each by two methods."""

    consumer: ProbabilityByTwoMethods
    producer: ProbabilityByTwoMethods


def global_risks(
    production: Production,
    standard: float,
    tolerance: ToleranceInterval,
    accepted: ToleranceInterval | None,
    seed: int = 0,
) -> GlobalRisks:
    """Return the global risks of a rule.

    Parameters
    ----------
    production : of the units tested.
    standard : standard uncertainty u of a measurement.
    tolerance : limits of the quantity.
    accepted : estimates with which units are delivered (`acceptance_interval`); None if none is.
    seed : of the simulated units.
    """
    accepted = accepted or ToleranceInterval(math.inf, math.inf)
    random = np.random.default_rng(seed)
    true = random.normal(production.mean, production.sd, _UNITS)
    taken = accepted.contains(true + random.normal(0.0, standard, _UNITS))
    conform = tolerance.contains(true)
    consumer, producer = _by_quadrature(production, standard, tolerance, accepted)
    return GlobalRisks(
        _compared(float(np.mean(taken & ~conform)), consumer), _compared(float(np.mean(~taken & conform)), producer)
    )


def _compared(simulated: float, integrated: float) -> ProbabilityByTwoMethods:
    return compared(simulated, integrated, fraction_error(simulated, _UNITS))


def _by_quadrature(
    production: Production, standard: float, tolerance: ToleranceInterval, accepted: ToleranceInterval
) -> tuple[float, float]:
    """Return consumer's and producer's risk by Gauss–Legendre quadrature over the true values, piece by piece."""

    def joint(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        density = np.exp(-0.5 * ((values - production.mean) / production.sd) ** 2)
        density = density / (production.sd * math.sqrt(2 * math.pi))
        with np.errstate(divide="ignore"):  # without an uncertainty the probability of acceptance is a step
            upper, lower = (normal_survival((values - limit) / standard) for limit in (accepted.upper, accepted.lower))
        acceptance = np.maximum(upper - lower, 0.0)
        return density * acceptance, density * (1 - acceptance)

    # The probability of acceptance climbs within some u of each end of the acceptance interval.
    climbs = [end + side * _CLIMB * standard for end in (accepted.lower, accepted.upper) for side in (-1, 0, 1)]

    def integral(low: float, high: float, which: int) -> float:
        reach = _FAR * production.sd
        low, high = max(low, production.mean - reach), min(high, production.mean + reach)
        ends = [low, *sorted(climb for climb in climbs if low < climb < high), high]
        nodes, weights = gauss_legendre(_NODES)
        pieces = [(first, (last - first) / 2) for first, last in pairwise(ends) if last > first]
        return sum(float(half * np.sum(weights * joint(first + half * (nodes + 1))[which])) for first, half in pieces)

    outside = integral(-math.inf, tolerance.lower, 0) + integral(tolerance.upper, math.inf, 0)
    return outside, integral(tolerance.lower, tolerance.upper, 1)


def guard_for_risk(
    production: Production, standard: float, tolerance: ToleranceInterval, target: float
) -> float | None:
    """Return the narrowest guard band whose global consumer's risk is at most the target; None if none is.

    A negative guard band, which accepts beyond the limits, is not considered.
    """
    if not standard > 0:
        return 0.0

    def excess(factor: float) -> float:
        return _by_quadrature(production, standard, tolerance, tolerance.guarded(factor * standard))[0] - target

    widest = min(_WIDEST, _MOST * (tolerance.upper - tolerance.lower) / 2 / standard)
    if excess(0.0) <= 0:
        return 0.0
    if excess(widest) > 0:
        return None
    return standard * float(np.asarray(scipy.optimize.brentq(excess, 0.0, widest, xtol=1e-6)))


def applied(
    rule: DecisionRule, estimate: MeasuredValue, tolerance: ToleranceInterval, production: Production | None
) -> Decision:
    """Return the outcome of any rule; a target for the global risk sets its guard band by the production."""
    if rule.name != "global_risk":
        return decide(rule, estimate, tolerance)
    assert production is not None, "a global risk is that of a production"
    assert rule.probability is not None, "a rule on a risk has its target"
    guard = guard_for_risk(production, estimate.standard, tolerance, rule.probability)
    if guard is None:
        return Decision("fail", None)
    return decide(DecisionRule("guard_band", guard_width=guard), estimate, tolerance)

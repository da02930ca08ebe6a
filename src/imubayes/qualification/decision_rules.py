"""Decision rules: from an estimate, its uncertainty and its conformance probability to pass, conditional pass or fail.

Binary rules compare the estimate with an acceptance interval, the tolerance interval less a guard band w on each side:
w = 0 is simple acceptance.  The non-binary rule of ILAC-G8:09/2019 (4.2.3) has w = U and gives a conditional result
within U of a limit.  The rules of JCGM 106 look at p_c, which needs no normal distribution: against a bound of its own,
or as specific consumer's risk 1 − p_c against a target.  A target for the *global* risk sets the guard band from the
distribution of all units that are tested (`imubayes.qualification.global_risk`).
"""

from dataclasses import dataclass
from typing import Literal

from imubayes.qualification.conformance import ProbabilityByTwoMethods, ToleranceInterval

RuleName = Literal[
    "simple_acceptance", "guard_band", "ilac_g8_non_binary", "conformance_probability", "specific_risk", "global_risk"
]
Outcome = Literal["pass", "conditional_pass", "conditional_fail", "fail", "withheld"]
ACCEPTED: tuple[Outcome, ...] = ("pass", "conditional_pass")
"""Outcomes with which a unit is delivered."""
REJECTED: tuple[Outcome, ...] = ("conditional_fail", "fail")
"""Outcomes with which it is not; `withheld` is no decision."""
NoDecision = Literal["probability", "not_determined"]
"""Why there is none: a probability that the rule needs is withheld, or the data do not determine the quantity."""


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
    guard_width : width of the guard band in the unit of the quantity; None where a factor gives it.
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
    """Return the outcome of a rule for one quantity; `withheld` where it needs a probability that is withheld."""
    if rule.name in ("conformance_probability", "specific_risk"):
        outcome = _by_probability(rule, estimate.conformance.value)
        return Decision(outcome, None, "probability" if outcome == "withheld" else None)
    guard = rule.guard(estimate)
    if rule.name == "ilac_g8_non_binary":
        return Decision(_non_binary(estimate.value, tolerance, guard), guard)
    return Decision("pass" if _within(estimate.value, tolerance.guarded(guard)) else "fail", guard)


def _by_probability(rule: DecisionRule, conformance: float | None) -> Outcome:
    assert rule.probability is not None, "a rule on probabilities has one"
    if conformance is None:
        return "withheld"
    least = rule.probability if rule.name == "conformance_probability" else 1 - rule.probability
    return "pass" if conformance >= least else "fail"


def _non_binary(value: float, tolerance: ToleranceInterval, guard: float) -> Outcome:
    if _within(value, tolerance.guarded(guard)):
        return "pass"
    if _within(value, tolerance):
        return "conditional_pass"
    return "conditional_fail" if _within(value, tolerance.guarded(-guard)) else "fail"


def _within(value: float, interval: ToleranceInterval) -> bool:
    return interval.lower <= value <= interval.upper

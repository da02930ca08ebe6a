"""The specification file: limits of quantities, the conditions under which they hold, and the decision rule.

It is TOML like the other files::

    format = 1
    name = "qualification"

    [rule]
    name = "guard_band"          # simple_acceptance, guard_band, ilac_g8_non_binary, conformance_probability, …
    factor = 1.65                # w = 1.65 u; without factor and width w = U

    [[limit]]
    quantity = "gyro_bias.bias"  # a family: one limit for each of its members; or one member, "gyro_bias.bias[gx]"
    lower = -20
    upper = 20
    unit = "deg/h"
    temperature_degC = [-10, 55]

    [[limit]]
    quantity = "scale_factor[gx]"
    nominal = 1000               # limits in ppm or % are then deviations from it
    lower = -500
    upper = 500
    unit = "ppm"
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from imubayes.campaign.toml_documents import Ledger, read_document
from imubayes.foundations.errors import Issue
from imubayes_qualification.certificate.certificate import Certificate, Text
from imubayes_qualification.evaluation.decision_rules import COVERAGE, GUARD_FACTOR, DecisionRule, RuleName

Probability = Annotated[float, Field(gt=0, lt=1)]
Positive = Annotated[float, Field(gt=0)]


class _SpecificationEntry(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class RuleEntry(_SpecificationEntry):
    """A decision rule."""

    name: RuleName = Field(description="of the rule")
    factor: Positive | None = Field(default=None, description="guard band in standard uncertainties")
    width: Positive | None = Field(default=None, description="guard band in the unit of the limit")
    probability: Probability | None = Field(
        default=None, description="least conformance probability, or the target of a risk"
    )


class ProductionEntry(_SpecificationEntry):
    """Distribution of the true values of all units tested, in the unit of the limit; a global risk refers to it."""

    mean: float = Field(description="of the units produced")
    sd: Positive = Field(description="standard deviation among the units produced")


class LimitEntry(_SpecificationEntry):
    """Limits of a quantity, or of each member of a family."""

    quantity: str = Field(
        min_length=1, description="name in the summary of a fit; without the labels in brackets, all of the family"
    )
    lower: float | None = Field(default=None, description="limit; none if absent")
    upper: float | None = Field(default=None, description="limit; none if absent")
    unit: str = Field(description="of the limits")
    nominal: float | None = Field(
        default=None, description="in the unit of the quantity; limits in ppm or % are deviations from it"
    )
    temperature_degC: Annotated[list[float], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="range over which the limits hold"
    )
    rule: RuleEntry | None = Field(default=None, description="decision rule, in place of that of the file")
    production: ProductionEntry | None = Field(default=None, description="distribution of the units tested")


class SpecificationFile(_SpecificationEntry):
    """A specification: limits of quantities and the rule by which conformity is decided."""

    format: Literal[1] = Field(description="of this file")
    name: Text = Field(description="of the specification")
    rule: RuleEntry = Field(
        default=RuleEntry(name="guard_band", factor=GUARD_FACTOR), description="by which conformity is decided"
    )
    limit: Annotated[list[LimitEntry], Field(min_length=1)] = Field(description="one for each quantity or family")
    certificate: Certificate | None = Field(default=None, description="what a certificate states of the calibration")


def read_specification(file: str | Path) -> tuple[SpecificationFile, Ledger]:
    """Read a specification, and check what can be checked without a result.

    Returns
    -------
    the file, and the ledger that knows the line of every key, for checks against a result.

    Raises
    ------
    InputError
        with everything that is wrong with the file.
    """
    document = read_document(Path(file), SpecificationFile)
    document.ledger.stop_if_any()
    found = document.entry
    assert found is not None, "an invalid document has issues"
    document.ledger.issues += issues_of_rule(found.rule, document.ledger.where("rule"))
    _check_common_width(found, document.ledger)
    for place, limit in enumerate(found.limit):
        _check_limit(limit, place, found.rule, document.ledger)
    document.ledger.stop_if_any()
    return found, document.ledger


def _check_common_width(found: SpecificationFile, ledger: Ledger) -> None:
    """Refuse one width of a guard band for limits in several units: 5 ppm is a width, and so is 5 mg."""
    units = dict.fromkeys(limit.unit for limit in found.limit if limit.rule is None)
    if found.rule.width is not None and len(units) > 1:
        ledger.add(
            f"the guard band has one width, {found.rule.width:g}, for limits in {', '.join(units)}",
            ("rule", "width"),
            "a width for limits in one unit, or a factor",
            'state the width beside each limit, as rule = { name = "guard_band", width = … }, or use a factor',
        )


def _check_limit(limit: LimitEntry, place: int, common: RuleEntry, ledger: Ledger) -> None:
    where = ("limit", place)
    if limit.lower is None and limit.upper is None:
        ledger.add(f"the limit of '{limit.quantity}' has no limits", where, "lower, upper or both", "add one")
    elif limit.lower is not None and limit.upper is not None and not limit.lower < limit.upper:
        ledger.add(
            f"the limits of '{limit.quantity}' are crossed: lower = {limit.lower:g}, upper = {limit.upper:g}",
            (*where, "lower"),
            "lower < upper",
            "exchange or correct the limits",
        )
    span = limit.temperature_degC
    if span is not None and not span[0] < span[1]:
        ledger.add(
            f"the temperature range of '{limit.quantity}' is crossed: {span[0]:g} … {span[1]:g} degC",
            (*where, "temperature_degC"),
            "[lowest, highest]",
            "exchange or correct the temperatures",
        )
    if limit.rule is not None:
        ledger.issues += issues_of_rule(limit.rule, ledger.where(*where, "rule"))
    if (limit.rule or common).name == "global_risk" and limit.production is None:
        ledger.add(
            f"the rule of '{limit.quantity}' is a global risk, which depends on the distribution of the production",
            where,
            "production = { mean = …, sd = … } in the unit of the limit",
            "add 'production', or choose a rule that needs none",
        )


def issues_of_rule(rule: RuleEntry, where: str) -> list[Issue]:
    """Return what is wrong with a rule: what it does not use must not be set."""
    issues = []
    if rule.factor is not None and rule.width is not None:
        issues.append(Issue("a guard band has a factor or a width", where, "factor or width", "leave one out"))
    if (rule.factor is not None or rule.width is not None) and rule.name != "guard_band":
        what = f"the rule {rule.name} has no guard band to set"
        issues.append(Issue(what, where, 'name = "guard_band"', "leave it out"))
    takes = ("conformance_probability", "specific_risk", "global_risk")
    if rule.probability is not None and rule.name not in takes:
        what = f"the rule {rule.name} has no probability to set"
        issues.append(Issue(what, where, ", ".join(takes), "leave it out"))
    return issues


def rule_of(entry: RuleEntry, factor: float = 1.0) -> DecisionRule:
    """Return the rule that an entry states.

    Parameters
    ----------
    entry : as in the file.
    factor : the unit of the limit in the unit of the quantity.
    """
    default = COVERAGE if entry.name == "conformance_probability" else 1 - COVERAGE
    width = None if entry.width is None else entry.width * factor
    return DecisionRule(entry.name, entry.factor, width, entry.probability or default)

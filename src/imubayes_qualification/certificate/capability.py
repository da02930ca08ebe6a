"""The calibration and measurement capability (CMC) of a laboratory: no expanded uncertainty is stated smaller.

ILAC-P14:09/2020, 5.4.  If U by the budget is smaller, the draws of the quantity are widened about their mean until
U is the CMC, so that every table, decision, probability and covariance agrees with what is stated.  What the CMC is
larger by is a line of the budget.  A quantity that a result has twice, as the scale factor beside its error, has one
capability: that of one is that of the other, in its unit.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes import Registry
from imubayes.campaign.toml_documents import Ledger
from imubayes.foundations.quantity_names import (
    AXIS_ANGLE,
    DELTA_K,
    MOUNTING_ANGLE,
    SCALE_FACTOR,
    QuantityName,
    family_of,
)
from imubayes.parameters.declarations import declared_parameters
from imubayes_qualification.budgets.budget_parts import BudgetLine, QuantityBudget
from imubayes_qualification.budgets.report_budgets import UnitWithBudgets
from imubayes_qualification.budgets.standard_quantities import STANDARD_QUANTITIES
from imubayes_qualification.budgets.unit_under_test import TestedUnit, is_measured
from imubayes_qualification.certificate.certificate import CapabilityEntry, CapabilityFloor
from imubayes_qualification.certificate.conformity import members_of, resolved_limits
from imubayes_qualification.certificate.specification import LimitEntry, SpecificationFile
from imubayes_qualification.evaluation.coverage import KnownUncertainty

_PATH = ("certificate", "cmc")
# Share of a standard deviation by which a quantity may differ from another one of its label, in another unit: scale
# factors are no linear functions of their errors.
_SAME = 5e-4


@dataclass(frozen=True)
class AppliedCapability:
    """The quantities whose U is the capability, and those with one that the result does not have."""

    floors: tuple[CapabilityFloor, ...] = ()
    unused: tuple[str, ...] = ()


def with_capability(
    found: UnitWithBudgets, entries: Sequence[CapabilityEntry], ledger: Ledger
) -> tuple[UnitWithBudgets, AppliedCapability]:
    """Return a unit and its budgets with no U below the capability, and what of it was applied.

    A laboratory has one list of capabilities for all that it calibrates: quantities that other results have are unused.

    Raises
    ------
    InputError
        for a quantity that no result has, one that is the length of a vector, and a unit of another kind.
    """
    if not entries:
        return found, AppliedCapability()
    known = calibrated_families()
    unused = [
        place
        for place, each in enumerate(entries)
        if family_of(each.quantity) in known and not members_of(each.quantity, found.unit.quantities.entries)
    ]
    limits = [LimitEntry(quantity=each.quantity, upper=each.expanded, unit=each.unit) for each in entries]
    unit, listed = found.unit, SpecificationFile(format=1, name="cmc", limit=limits)
    floors: dict[str, float] = {}
    for limit in resolved_limits(listed, ledger, unit, _PATH, unused):
        name = limit.quantity.name
        floors[name] = max(limit.tolerance.upper, floors.get(name, 0.0))
    if lengths := floors.keys() & unit.lengths.keys():
        ledger.add(
            f"'{min(lengths)}' is the length of a vector, for which a smallest uncertainty cannot be stated", _PATH,
            "its components", "name the components, such as gyro_misalignment.toward_o",
        )  # fmt: skip
        ledger.stop_if_any()
    floors = _of_the_same(unit, floors)
    draws, known, raised = dict(unit.quantities.draws), dict(unit.known), []
    for name, floor in floors.items():
        quantity, stated = unit.quantities.entries[name], unit.coverage(name)
        if is_measured(quantity, draws[name]) and stated.expanded < floor:
            factor, middle, before = floor / stated.expanded, unit.quantities.marginal(name).mean, known.get(name)
            draws[name] = middle + factor * (draws[name] - middle)
            if before is not None:
                known[name] = KnownUncertainty(factor * before.standard, factor * before.error, before.factor)
            raised.append(CapabilityFloor(name=name, unit=quantity.unit, expanded=floor, own=stated.expanded))
    quantities = replace(unit.quantities, draws=draws)
    factors = {each.name: each.expanded / each.own for each in raised}
    budgets = tuple(_raised(each, factors.get(each.name, 1.0)) for each in found.budgets.quantities)
    made = found.budgets.model_copy(update={"quantities": budgets})
    widened = replace(unit, quantities=quantities, known=known, floors=floors)
    applied = AppliedCapability(tuple(raised), tuple(entries[place].quantity for place in unused))
    return replace(found, unit=widened, budgets=made), applied


def calibrated_families() -> frozenset[str]:
    """Return the families of the quantities that some result has: of effects, derived ones, and of the standards."""
    effects = Registry().effects.values()
    own = {f"{effect.name}.{name}" for effect in effects for name in declared_parameters(effect)}
    return frozenset(own | {SCALE_FACTOR, MOUNTING_ANGLE, AXIS_ANGLE, DELTA_K} | {q.key for q in STANDARD_QUANTITIES})


def _of_the_same(unit: TestedUnit, floors: Mapping[str, float]) -> dict[str, float]:
    """Return floors with those of the quantities that are the same in another unit, or with another zero or sign."""
    found, draws = dict(floors), unit.quantities.draws
    for name, floor in floors.items():
        labels, own = QuantityName.of(name).labels, draws[name] - draws[name].mean()
        for other in (each for each in draws if QuantityName.of(each).labels == labels and each not in unit.lengths):
            values = draws[other] - draws[other].mean()
            slope = float(values @ own) / (float(own @ own) or 1.0)
            if other != name and np.std(values - slope * own) < _SAME * np.std(values):
                found[other] = max(abs(slope) * floor, found.get(other, 0.0))
    return found


def _raised(budget: QuantityBudget, factor: float) -> QuantityBudget:
    """Return a budget with what makes its U larger by a factor; nothing that was measured would narrow it."""
    if factor == 1:
        return budget
    u, share = budget.standard_uncertainty, factor**-2
    own = u * factor * math.sqrt(1 - share)
    lines = [line.model_copy(update={"share": line.share * share}) for line in budget.lines]
    added = BudgetLine(kind="cmc", input="", type="B", contribution=own, share=1 - share)
    return budget.model_copy(
        update={
            "standard_uncertainty": factor * u,
            "monte_carlo_error": factor * budget.monte_carlo_error,
            "lines": (added, *lines),
            "contributed": math.hypot(budget.contributed, own),
            "remainder": budget.remainder * share,
            "expanded_uncertainty": factor * budget.expanded_uncertainty,
            "halved": (),
            "next_run": None,
        }
    )

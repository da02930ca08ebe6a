"""From the budgets of a result to the records of the report; they are kept in its folder, as they take seconds."""

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from imubayes.foundations.errors import InputError
from imubayes.foundations.quantity_names import name_of
from imubayes.foundations.records import Record, finite
from imubayes.inference.candidate_runs import RunDesign
from imubayes.inference.experiment_design import expected_deviations
from imubayes.parameters.declarations import Parameter
from imubayes.results.folder_files import BUDGETS, add_to, added
from imubayes.results.posterior_quantities import posterior_quantities
from imubayes.results.result import Result
from imubayes.results.standard_uncertainties import slopes
from imubayes.results.stored_tables import complete
from imubayes.results.summary import is_constant
from imubayes.results.temperature_range import thermal_quantities
from imubayes_qualification.budgets import budget_parts
from imubayes_qualification.budgets import uncertainty_budget as budget
from imubayes_qualification.budgets.standard_quantities import STANDARD_QUANTITIES, draws_of_standard
from imubayes_qualification.budgets.taken_as_exact import ExactInput, TakenAsExact, exact_equipment
from imubayes_qualification.budgets.unit_under_test import TestedUnit, unit_under_test
from imubayes_qualification.evaluation.coverage import KnownUncertainty, coverage_factor, effective_degrees
from imubayes_qualification.evaluation.decision_rules import LEAST_SHARE, USEFUL_RUN

# Changed if budgets of the same result come out otherwise, so that those that are kept are made anew.
_METHOD = 15
_MOST_HALVED = 3
# Decimals of a correlation: two scale factors that share the error of gravity differ from 1 in the fifth.
_DECIMALS = 8
_NORMAL = "normal"


class KeptBudgets(Record):
    """Budgets in a result folder, with what the model takes as exact, and the method that they were computed by."""

    method: int
    exact: TakenAsExact
    budgets: budget_parts.UncertaintyBudgets


@dataclass(frozen=True)
class UnitWithBudgets:
    """A unit as its report states it: draws with all that is included, budgets, and what the model takes as exact."""

    unit: TestedUnit
    budgets: budget_parts.UncertaintyBudgets
    exact: TakenAsExact


def unit_with_budgets(result: Result) -> UnitWithBudgets:
    """Return the unit of a result that converged, with the budgets of all its quantities.

    Those that the result folder keeps are taken if they are of this result; others are kept there.
    """
    kept = None if result.folder is None else _kept(result.folder)
    if kept is not None and kept.method == _METHOD:
        unit = unit_under_test(result, kept.exact)
    else:
        kept, unit = _computed(result)
        if result.folder is not None:
            with suppress(OSError, InputError):  # of a result that cannot be written to they are computed every time
                add_to(result.folder, BUDGETS, kept.model_dump_json() + "\n", result.identity)
    known = {each.name: _known(unit, each) for each in kept.budgets.quantities}
    return UnitWithBudgets(replace(unit, known=known), kept.budgets, kept.exact)


def _known(unit: TestedUnit, found: budget_parts.QuantityBudget) -> KnownUncertainty:
    """Return what a budget knows of an uncertainty; what is taken as exact moves no estimate by chance."""
    of_mean = math.sqrt(max(_own_variance(found), 0.0) / unit.quantities.effective[found.name])
    factor = found.coverage_factor if found.interval == "symmetric" else None
    return KnownUncertainty(found.standard_uncertainty, found.monte_carlo_error, factor, of_mean)


def keep_budgets(result: Result) -> None:
    """Compute the budgets of a fit made in this process and keep them in its folder, if there is one.

    The programs that a report needs are compiled and linearised then; a later process would trace the model anew.
    """
    if result.converged and result.folder is not None:
        unit_with_budgets(result)


def _own_variance(found: budget_parts.QuantityBudget) -> float:
    """Return the variance of a quantity without what the model takes as exact."""
    return found.standard_uncertainty**2 - sum(line.contribution**2 for line in found.lines if line.kind == "exact")


def _kept(folder: Path) -> KeptBudgets | None:
    """Return the budgets that a folder keeps of its fit; None if there are none as they were written."""
    try:
        file = added(folder, BUDGETS)
        return KeptBudgets.model_validate_json(file.read_bytes()) if file is not None else None
    except (InputError, OSError, ValueError):
        return None


def _computed(result: Result) -> tuple[KeptBudgets, TestedUnit]:
    """Return the budgets of a result, and its unit with draws that contain what is taken as exact."""
    plain = unit_under_test(result)
    draws = plain.quantities.draws
    # The component along a nominal axis has no gradient there; the budgets of the misalignments say it all.
    entries = posterior_quantities(result).entries.values()
    names = [line.name for line in entries if not line.repeats_misalignments and not is_constant(draws[line.name])]
    arrays = budget.budget_of(result, names, functions_of_quantities(result, plain))
    gradients = {name: each.gradient for name, each in zip(arrays.names, arrays.components, strict=True)}
    exact = exact_equipment(result.fit).found(gradients, thermal_quantities(gradients))
    unit = unit_under_test(result, exact)
    correlation = budget.correlation_of(complete({name: unit.quantities.draws[name] for name in arrays.names}))
    widths = tuple(finite(parameter.prior_sd) for parameter in arrays.priors)
    parts = _Parts(result, unit, arrays, widths, exact.included)
    runs = list(_next_runs(parts))
    quantities = tuple(_budget(parts, place, runs[place]) for place in range(len(arrays.names)))
    rows = tuple(
        tuple(round(float(value), _DECIMALS) + 0.0 for value in row[: place + 1])
        for place, row in enumerate(correlation)
    )
    matrix = budget_parts.CorrelationMatrix(names=arrays.names, rows=rows)
    budgets = budget_parts.UncertaintyBudgets(quantities=quantities, correlation=matrix)
    return KeptBudgets(method=_METHOD, exact=exact, budgets=budgets), unit


def functions_of_quantities(result: Result, unit: TestedUnit) -> dict[str, budget.FunctionOfQuantities]:
    """Return determined combinations, and quantities of the standards that are functions of those of the result."""
    draws = unit.quantities.draws
    combinations = {
        found.name: budget.FunctionOfQuantities(
            draws[found.name], found.quantities, slopes=slopes(found, [draws[name] for name in found.quantities])
        )
        for found in result.summary.combinations
        if found.name in draws
    }
    return combinations | {
        name_of(quantity.key, found.label): budget.FunctionOfQuantities(found.draws, found.members, found.length)
        for quantity in STANDARD_QUANTITIES
        for found in draws_of_standard(quantity, unit)
        if name_of(quantity.key, found.label) in draws
    }


@dataclass(frozen=True)
class _Parts:
    """What budgets are made of.

    Attributes
    ----------
    widths : of the priors in their units, None if infinite.
    exact : what is included of the parameters that the model takes as exact.
    """

    result: Result
    unit: TestedUnit
    arrays: budget.BudgetArrays
    widths: tuple[float | None, ...]
    exact: tuple[ExactInput, ...]

    def variance_of_exact(self, name: str) -> float:
        """Return the variance of a quantity by what is included of these."""
        return sum(each.shift(name) ** 2 for each in self.exact)


def _budget(parts: _Parts, place: int, next_run: budget_parts.NarrowingRun | None) -> budget_parts.QuantityBudget:
    arrays, name = parts.arrays, parts.arrays.names[place]
    by_exact = parts.variance_of_exact(name)
    posterior = float(arrays.posterior[place]) + by_exact
    lines = _lines(parts, place, posterior)
    u = float(np.sqrt(posterior))
    error = float(arrays.posterior_error[place]) / (2 * u)
    type_a = arrays.averaged.type_a[place]
    rest = posterior - float(type_a.sum())
    degrees = effective_degrees(np.append(type_a, max(rest, 0.0)), np.append(arrays.degrees[place], np.inf))
    known = {name: KnownUncertainty(u, error, coverage_factor(degrees))}
    stated = replace(parts.unit, known=known).coverage(name)
    return budget_parts.QuantityBudget(
        name=name,
        unit=parts.unit.quantities.entries[name].unit,
        standard_uncertainty=u,
        monte_carlo_error=error,
        lines=tuple(lines),
        contributed=float(np.sqrt(arrays.contributions[place] + by_exact)),
        scaled=float(arrays.widened[place]) ** 2,
        remainder=float(arrays.remainder[place]) / posterior,
        components=name in arrays.at_zero,
        interval=stated.shape,
        coverage_factor=stated.factor,
        expanded_uncertainty=stated.expanded,
        halved=_halved(parts, place),
        next_run=next_run,
    )


def _lines(parts: _Parts, place: int, posterior: float) -> list[budget_parts.BudgetLine]:
    """Return the contributions to a posterior variance, the largest first, and last those too small for a line."""
    contributions = [*_contributions(parts, place), *_by_exact(parts, parts.arrays.names[place])]
    least = LEAST_SHARE * posterior
    shown = sorted((each for each in contributions if each.variance >= least), key=lambda each: -each.variance)
    small = [each for each in contributions if 0 < each.variance < least]
    if small:
        first = small[0].type
        together = sum(each.variance for each in small)
        same = all(each.type == first for each in small)
        shown.append(_Contribution(together, first if same else None, sum(each.inputs for each in small)))
    return [
        budget_parts.BudgetLine(
            type=each.type,
            inputs=each.inputs,
            contribution=float(np.sqrt(each.variance)),
            share=each.variance / posterior,
            **each.named,
        )
        for each in shown
    ]


@dataclass(frozen=True)
class _Contribution:
    """A contribution to a posterior variance: what its line says of it is in `named`."""

    variance: float
    type: Literal["A", "B"] | None
    inputs: int = 1
    named: Mapping[str, Any] = field(default_factory=lambda: {"kind": "small", "input": ""})


def _contributions(parts: _Parts, place: int) -> Iterator[_Contribution]:
    arrays, runs = parts.arrays, parts.result.fit.model.campaign.runs
    averaged = arrays.averaged
    type_a, degrees, type_b = (each[place].tolist() for each in (averaged.type_a, arrays.degrees, averaged.type_b))
    for run, variance, known in zip(runs, type_a, degrees, strict=True):
        named = {"kind": "run", "input": run.name, "group": run.procedure, "distribution": _NORMAL}
        yield _Contribution(variance, "A", named=named | {"relative_uncertainty": _relative(known)})
    for effect, members in budget.nuisance_groups(parts.result.fit.model.layout).items():
        named = {
            "kind": "priors",
            "input": effect,
            "source": budget.SOURCES.get(effect, "unit"),
            "distribution": _NORMAL,
        }
        yield _Contribution(float(averaged.type_b[place, members].sum()), "B", int(members.sum()), named)
    slopes = averaged.sensitivity[place].tolist()
    for parameter, width, variance, slope in zip(arrays.priors, parts.widths, type_b, slopes, strict=True):
        if not parameter.nuisance:
            yield _Contribution(variance, "B", named=_of_prior(parameter, width, variance, slope))
    yield _Contribution(float(arrays.noise_scales[place]), "A", named={"kind": "noise_scales", "input": ""})
    yield _Contribution(float(arrays.second_order[place]), None, named={"kind": "second_order", "input": ""})


def _relative(degrees: float) -> float | None:
    """Return the relative standard uncertainty of a standard uncertainty with ν degrees of freedom (GUM E.4.3)."""
    return float((2 * degrees) ** -0.5) if math.isfinite(degrees) else None


def _by_exact(parts: _Parts, name: str) -> Iterator[_Contribution]:
    """Yield what is included of the parameters that the model takes as exact."""
    for each in parts.exact:
        shift = each.shift(name)
        if shift:
            named = {
                "kind": "exact", "input": each.parameter, "source": each.source, "distribution": _NORMAL,
                "unit": each.unit, "input_uncertainty": each.left, "sensitivity": -shift / each.left,
            }  # fmt: skip
            yield _Contribution(shift**2, "B", named=named)


def _of_prior(parameter: Parameter, width: float | None, variance: float, slope: float) -> dict[str, Any]:
    """Return what the line of a prior says."""
    return {
        "kind": "prior", "input": parameter.name, "source": budget.SOURCES.get(parameter.effect, "unit"),
        "distribution": budget.distribution(parameter.prior), "unit": parameter.unit, "input_uncertainty": width,
        "sensitivity": float(np.sign(slope)) * float(np.sqrt(variance)) / width if width else None,
    }  # fmt: skip


def _halved(parts: _Parts, place: int) -> tuple[budget_parts.HalvedInput, ...]:
    """Return what halving one contribution would leave, for the most useful ones.

    Deviations are those at the mode, scaled to the posterior one.
    """
    arrays, improved = parts.arrays, parts.arrays.improved
    if not improved.at_mode[place] > 0:
        return ()
    scale = float(np.sqrt(arrays.posterior[place]) / improved.at_mode[place])
    quantity = arrays.names[place]
    by_exact, own = parts.variance_of_exact(quantity), float(arrays.posterior[place])
    found: list[_Halved] = [
        (float(np.hypot(scale * after, np.sqrt(by_exact))), kind, name, source)
        for after, kind, name, source in _better_inputs(arrays, place)
    ]
    for each in parts.exact:
        shift = each.shift(quantity)
        if shift:
            found.append((float(np.sqrt(own + by_exact - 0.75 * shift**2)), "exact", each.parameter, each.source))
    return tuple(
        budget_parts.HalvedInput(kind=kind, input=name, source=source, standard_uncertainty=after)
        for after, kind, name, source in sorted(found, key=lambda each: each[0])[:_MOST_HALVED]
    )


_Halved = tuple[float, Literal["run", "prior", "priors", "exact"], str, budget_parts.Source | None]


def _better_inputs(arrays: budget.BudgetArrays, place: int) -> Iterator[_Halved]:
    """Yield the standard deviation with each input halved, and what the input is."""
    improved = arrays.improved
    for run, after in zip(arrays.runs, improved.halved_noise[place].tolist(), strict=True):
        yield after, "run", run, None
    for parameter, after in zip(arrays.priors, improved.halved_prior[place].tolist(), strict=True):
        if not parameter.nuisance:
            yield after, "prior", parameter.name, budget.SOURCES.get(parameter.effect, "unit")
    for effect, after in zip(improved.groups, improved.halved_groups[place].tolist(), strict=True):
        yield after, "priors", effect, budget.SOURCES.get(effect, "unit")


def _next_runs(parts: _Parts) -> Iterator[budget_parts.NarrowingRun | None]:
    """Return, for each quantity, the run that would narrow it most; None if no run would."""
    result, arrays = parts.result, parts.arrays
    count, runs = len(arrays.names), result.fit.model.campaign.runs
    before = np.maximum(arrays.improved.at_mode, np.finfo(float).tiny)
    # Share of the standard deviation that each run leaves, predicted from the mode: (C, Q).
    left = (arrays.improved.repeated / before[:, None]).T
    designs: list[RunDesign] = []
    if arrays.components:
        expected = expected_deviations(result.fit, arrays.components)
        designs = expected.designs
        left = np.concatenate([left, expected.after / np.maximum(expected.before, np.finfo(float).tiny)])
    for place in range(count):
        best, by_exact = int(left[:, place].argmin()), parts.variance_of_exact(arrays.names[place])
        own = float(arrays.posterior[place])
        after = float(np.sqrt(own * left[best, place] ** 2 + by_exact))
        useful = left[best, place] > 0 and after < USEFUL_RUN * float(np.sqrt(own + by_exact))
        run = designs[best - len(runs)] if best >= len(runs) else None
        repeats = runs[best].name if best < len(runs) else None
        narrowing = budget_parts.NarrowingRun(run=run, repeats=repeats, standard_uncertainty=after)
        yield narrowing if useful else None

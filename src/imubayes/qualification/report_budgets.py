"""From the budgets of a result to the records of the report; they are kept in its folder, as they take seconds."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from imubayes.foundations.errors import InputError
from imubayes.foundations.records import Record, finite
from imubayes.inference.candidate_runs import RunDesign
from imubayes.inference.experiment_design import expected_deviations
from imubayes.parameters.declarations import Parameter
from imubayes.qualification import budget_parts
from imubayes.qualification import uncertainty_budget as budget
from imubayes.qualification.decision_rules import LEAST_SHARE, USEFUL_RUN
from imubayes.qualification.posterior_quantities import posterior_quantities, slopes
from imubayes.qualification.standard_quantities import STANDARD_QUANTITIES, draws_of_standard
from imubayes.qualification.tested_unit import TestedUnit, tested_unit
from imubayes.results.folder_files import BUDGETS, add_to, added
from imubayes.results.result import Result
from imubayes.results.summary import is_constant

# Changed where budgets of the same result come out otherwise, so that those that are kept are made anew.
_METHOD = 7
_MOST_HALVED = 3
# Decimals of a correlation.
_DECIMALS = 4
_NORMAL = "normal"


class KeptBudgets(Record):
    """Budgets in a result folder, with the method that they were computed by."""

    method: int
    budgets: budget_parts.UncertaintyBudgets


def budgets_of(result: Result, unit: TestedUnit | None) -> budget_parts.UncertaintyBudgets | None:
    """Return the budgets of all quantities of a result; None where the fit did not converge.

    Those that the result folder keeps are taken where they are of this result; others are kept there.
    """
    if unit is None or result.folder is None:
        return None
    kept = _kept(result.folder)
    if kept is not None and kept.method == _METHOD:
        return kept.budgets
    budgets = _computed(result, unit)
    text = KeptBudgets(method=_METHOD, budgets=budgets).model_dump_json() + "\n"
    with suppress(OSError, InputError):  # a result that cannot be written to has its budgets computed every time
        add_to(result.folder, BUDGETS, text, result.identity)
    return budgets


def keep_budgets(result: Result) -> None:
    """Compute the budgets of a fit made in this process and keep them in its folder, where there is one.

    What a report needs of the model is compiled and linearised then; a later process would trace the model anew.
    """
    if result.converged and result.folder is not None:
        budgets_of(result, tested_unit(result))


def _kept(folder: Path) -> KeptBudgets | None:
    """Return the budgets that a folder keeps of its fit; None where there are none as they were written."""
    try:
        file = added(folder, BUDGETS)
        return KeptBudgets.model_validate_json(file.read_bytes()) if file is not None else None
    except (InputError, OSError, ValueError):
        return None


def _computed(result: Result, unit: TestedUnit) -> budget_parts.UncertaintyBudgets:
    draws = unit.quantities.draws
    # The component along a nominal axis has no gradient there; the budgets of the misalignments say it all.
    entries = posterior_quantities(result).entries.values()
    names = [line.name for line in entries if not line.repeats_misalignments and not is_constant(draws[line.name])]
    arrays = budget.budget_of(result, names, functions_of_quantities(result, unit))
    widths = tuple(finite(parameter.prior_sd) for parameter in arrays.priors)
    parts = _Parts(result, unit, arrays, widths)
    runs = _next_runs(result, arrays)
    quantities = tuple(_budget(parts, place, runs[place]) for place in range(len(arrays.names)))
    rows = tuple(
        tuple(round(float(value), _DECIMALS) + 0.0 for value in row[: place + 1])
        for place, row in enumerate(arrays.correlation)
    )
    return budget_parts.UncertaintyBudgets(
        quantities=quantities, correlation=budget_parts.CorrelationMatrix(names=arrays.names, rows=rows)
    )


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
        f"{quantity.key}[{found.label}]": budget.FunctionOfQuantities(found.draws, found.members, found.length)
        for quantity in STANDARD_QUANTITIES
        for found in draws_of_standard(quantity, unit)
        if f"{quantity.key}[{found.label}]" in draws
    }


@dataclass(frozen=True)
class _Parts:
    """What budgets are made of; `widths` are those of the priors in their units, None where infinite."""

    result: Result
    unit: TestedUnit
    arrays: budget.BudgetArrays
    widths: tuple[float | None, ...]


def _budget(parts: _Parts, place: int, next_run: budget_parts.NarrowingRun | None) -> budget_parts.QuantityBudget:
    arrays, name = parts.arrays, parts.arrays.names[place]
    posterior = float(arrays.posterior[place])
    lines = _lines(parts, place)
    u = float(np.sqrt(posterior))
    low, high = parts.unit.quantities.marginal(name).interval
    type_a = arrays.averaged.type_a[place]
    rest = posterior - float(type_a.sum())
    degrees = budget_parts.effective_degrees(
        np.append(type_a, max(rest, 0.0)), np.append(arrays.degrees[place], np.inf)
    )
    return budget_parts.QuantityBudget(
        name=name,
        unit=parts.unit.quantities.entries[name].unit,
        standard_uncertainty=u,
        monte_carlo_error=float(arrays.posterior_error[place]) / (2 * u),
        lines=tuple(lines),
        contributed=float(np.sqrt(arrays.contributions[place])),
        scaled=float(arrays.widened[place]) ** 2,
        remainder=float(arrays.remainder[place]) / posterior,
        components=name in arrays.at_zero,
        degrees_of_freedom=finite(degrees),
        coverage_factor=(high - low) / 2 / u,
        expanded_uncertainty=(high - low) / 2,
        halved=_halved(parts, place),
        next_run=next_run,
    )


def _lines(parts: _Parts, place: int) -> list[budget_parts.BudgetLine]:
    """Return the contributions to a quantity, the largest first, and last those too small for a line of their own."""
    posterior, contributions = float(parts.arrays.posterior[place]), list(_contributions(parts, place))
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
        yield _Contribution(variance, "A", named=named | {"degrees_of_freedom": finite(known)})
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
    best = sorted(_better_inputs(arrays, place), key=lambda each: each[0])[:_MOST_HALVED]
    return tuple(
        budget_parts.HalvedInput(kind=kind, input=name, source=source, standard_uncertainty=scale * after)
        for after, kind, name, source in best
    )


def _better_inputs(
    arrays: budget.BudgetArrays, place: int
) -> Iterator[tuple[float, Literal["run", "prior", "priors"], str, budget_parts.Source | None]]:
    """Yield the standard deviation with each input halved, and what the input is."""
    improved = arrays.improved
    for run, after in zip(arrays.runs, improved.halved_noise[place].tolist(), strict=True):
        yield after, "run", run, None
    for parameter, after in zip(arrays.priors, improved.halved_prior[place].tolist(), strict=True):
        if not parameter.nuisance:
            yield after, "prior", parameter.name, budget.SOURCES.get(parameter.effect, "unit")
    for effect, after in zip(improved.groups, improved.halved_groups[place].tolist(), strict=True):
        yield after, "priors", effect, budget.SOURCES.get(effect, "unit")


def _next_runs(result: Result, arrays: budget.BudgetArrays) -> list[budget_parts.NarrowingRun | None]:
    """Return, for each quantity, the run that would narrow it most; None where no run would."""
    count, runs = len(arrays.names), result.fit.model.campaign.runs
    before = np.maximum(arrays.improved.at_mode, np.finfo(float).tiny)
    # Share of the standard deviation that each run leaves, predicted from the mode: (C, Q).
    left = (arrays.improved.repeated / before[:, None]).T
    designs: list[RunDesign] = []
    if arrays.components:
        expected = expected_deviations(result.fit, arrays.components)
        designs = expected.designs
        left = np.concatenate([left, expected.after / np.maximum(expected.before, np.finfo(float).tiny)])
    found: list[budget_parts.NarrowingRun | None] = []
    for place in range(count):
        best, u = int(left[:, place].argmin()), float(np.sqrt(arrays.posterior[place]))
        useful = 0 < left[best, place] < USEFUL_RUN
        run = designs[best - len(runs)] if best >= len(runs) else None
        repeats = runs[best].name if best < len(runs) else None
        narrowing = budget_parts.NarrowingRun(
            run=run, repeats=repeats, standard_uncertainty=u * float(left[best, place])
        )
        found.append(narrowing if useful else None)
    return found

"""From the budgets of a result to the records of the report; they are kept in its folder, as they take seconds."""

import hashlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from imubayes.atomic_files import write_text
from imubayes.inference.candidate_runs import RunDesign
from imubayes.inference.experiment_design import narrowed
from imubayes.json_record import Record, finite
from imubayes.qualification.assess import standards_input
from imubayes.qualification.budget_algebra import effective_degrees
from imubayes.qualification.budget_record import (
    BudgetLine,
    CorrelationMatrix,
    HalvedInput,
    NarrowingRun,
    QuantityBudget,
    UncertaintyBudgets,
)
from imubayes.qualification.conformity import TestedUnit
from imubayes.qualification.posterior_quantities import posterior_quantities
from imubayes.qualification.standard_quantities import STANDARD_QUANTITIES, draws_of_standard
from imubayes.qualification.tolerances import LEAST_SHARE, USEFUL_RUN
from imubayes.qualification.uncertainty_budget import (
    SOURCES,
    BudgetArrays,
    FunctionOfQuantities,
    budget_of,
    distribution,
    nuisance_groups,
)
from imubayes.results.estimates import is_constant
from imubayes.results.record_names import FIT, POSTERIOR
from imubayes.results.result import Result

BUDGETS = "budgets.json"
# Changed where budgets of the same result come out otherwise, so that those that are kept are made anew.
_METHOD = 3
_MOST_HALVED = 3
# Decimals of a correlation.
_DECIMALS = 4
_NORMAL = "normal"


class KeptBudgets(Record):
    """Budgets in a result folder, with the method and a hash of the files that they were computed from."""

    method: int
    sha256: str
    budgets: UncertaintyBudgets


def budgets_of(result: Result, unit: TestedUnit | None) -> UncertaintyBudgets | None:
    """Return the budgets of all quantities of a result; None where the fit did not converge.

    Those that the result folder keeps are taken where they are of this result; others are kept there.
    """
    if unit is None or result.folder is None:
        return None
    file, sha256 = result.folder / BUDGETS, _hash(result.folder)
    kept = _kept(file)
    if kept is not None and (kept.method, kept.sha256) == (_METHOD, sha256):
        return kept.budgets
    budgets = _computed(result, unit)
    with suppress(OSError):  # a result that cannot be written to has its budgets computed every time
        write_text(file, KeptBudgets(method=_METHOD, sha256=sha256, budgets=budgets).model_dump_json() + "\n")
    return budgets


def _hash(folder: Path) -> str:
    found = hashlib.sha256()
    for name in (FIT, POSTERIOR):
        found.update((folder / name).read_bytes())
    return found.hexdigest()


def _kept(file: Path) -> KeptBudgets | None:
    try:
        return KeptBudgets.model_validate_json(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _computed(result: Result, unit: TestedUnit) -> UncertaintyBudgets:
    draws = unit.quantities.draws
    names = [name for name in posterior_quantities(result).entries if not is_constant(draws[name])]
    arrays = budget_of(result, names, functions_of_quantities(result, unit))
    parts = _Parts(result, unit, arrays)
    runs = _next_runs(result, arrays)
    quantities = tuple(_budget(parts, place, runs[place]) for place in range(len(arrays.names)))
    rows = tuple(
        tuple(round(float(value), _DECIMALS) + 0.0 for value in row[: place + 1])
        for place, row in enumerate(arrays.correlation)
    )
    return UncertaintyBudgets(quantities=quantities, correlation=CorrelationMatrix(names=arrays.names, rows=rows))


def functions_of_quantities(result: Result, unit: TestedUnit) -> dict[str, FunctionOfQuantities]:
    """Return the quantities of the standards that are functions of those of the result."""
    under_test = standards_input(result, unit)
    return {
        f"{quantity.key}[{found.label}]": FunctionOfQuantities(found.draws, found.members, found.length)
        for quantity in STANDARD_QUANTITIES
        for found in draws_of_standard(quantity, under_test)
        if f"{quantity.key}[{found.label}]" in unit.quantities.draws
    }


@dataclass(frozen=True)
class _Parts:
    """What budgets are made of."""

    result: Result
    unit: TestedUnit
    arrays: BudgetArrays


def _budget(parts: _Parts, place: int, next_run: NarrowingRun | None) -> QuantityBudget:
    arrays, name = parts.arrays, parts.arrays.names[place]
    posterior = float(arrays.posterior[place])
    lines = _lines(parts, place)
    u = float(np.sqrt(posterior))
    low, high = parts.unit.quantities.marginal(name).interval
    type_a = arrays.averaged.type_a[place]
    rest = posterior - float(type_a.sum())
    degrees = effective_degrees(np.append(type_a, max(rest, 0.0)), np.append(arrays.degrees[place], np.inf))
    return QuantityBudget(
        name=name,
        unit=parts.unit.quantities.entries[name].unit,
        standard_uncertainty=u,
        monte_carlo_error=float(arrays.posterior_error[place]) / (2 * u),
        lines=tuple(lines),
        contributed=float(np.sqrt(arrays.contributions[place])),
        remainder=float(arrays.remainder[place]) / posterior,
        components=name in arrays.at_zero,
        degrees_of_freedom=finite(degrees),
        coverage_factor=(high - low) / 2 / u,
        expanded_uncertainty=(high - low) / 2,
        halved=_halved(parts, place),
        next_run=next_run,
    )


def _lines(parts: _Parts, place: int) -> list[BudgetLine]:
    """Return the contributions to a quantity, the largest first, and last those too small for a line of their own."""
    lines = sorted(_all_lines(parts, place), key=lambda line: -line.share)
    large = [line for line in lines if line.share >= LEAST_SHARE]
    small = [line for line in lines if 0 < line.share < LEAST_SHARE]
    if small:
        share = sum(line.share for line in small)
        together = float(np.sqrt(sum(line.contribution**2 for line in small)))
        types: list[Literal["A", "B"] | None] = list({line.type: None for line in small})
        large.append(
            BudgetLine(
                kind="small", input="", type=types[0] if len(types) == 1 else None, contribution=together,
                share=share, inputs=sum(line.inputs for line in small),
            )
        )  # fmt: skip
    return large


def _all_lines(parts: _Parts, place: int) -> Iterator[BudgetLine]:
    arrays, posterior = parts.arrays, float(parts.arrays.posterior[place])

    def line(variance: float, **rest) -> BudgetLine:
        return BudgetLine(contribution=float(np.sqrt(variance)), share=float(variance) / posterior, **rest)

    runs = parts.result.fit.model.campaign.runs
    for run, variance, degrees in zip(runs, arrays.averaged.type_a[place], arrays.degrees[place], strict=True):
        yield line(
            variance, kind="run", input=run.name, group=run.procedure, type="A", distribution=_NORMAL,
            degrees_of_freedom=finite(float(degrees)),
        )  # fmt: skip
    groups = nuisance_groups(parts.result.fit.model.layout)
    for effect, members in groups.items():
        variance = float(arrays.averaged.type_b[place, members].sum())
        yield line(
            variance, kind="priors", input=effect, type="B", source=SOURCES.get(effect, "unit"),
            inputs=int(members.sum()), distribution=_NORMAL,
        )  # fmt: skip
    for column, parameter in enumerate(arrays.priors):
        if parameter.nuisance:
            continue
        variance, width = float(arrays.averaged.type_b[place, column]), finite(parameter.prior_sd)
        sign = float(np.sign(arrays.averaged.sensitivity[place, column]))
        yield line(
            variance, kind="prior", input=parameter.name, type="B", source=SOURCES.get(parameter.effect, "unit"),
            distribution=distribution(parameter.prior), unit=parameter.unit, input_uncertainty=width,
            sensitivity=sign * float(np.sqrt(variance)) / width if width else None,
        )  # fmt: skip
    yield line(float(arrays.noise_scales[place]), kind="noise_scales", input="", type="A")
    yield line(float(arrays.second_order[place]), kind="second_order", input="", type=None)


def _halved(parts: _Parts, place: int) -> tuple[HalvedInput, ...]:
    """Return what halving one contribution would leave, for the most useful ones.

    Deviations are those at the mode, scaled to the posterior one.
    """
    arrays = parts.arrays
    if not arrays.improved.at_mode[place] > 0:
        return ()
    scale = float(np.sqrt(arrays.posterior[place]) / arrays.improved.at_mode[place])
    found = [
        HalvedInput(kind="run", input=run, source=None, standard_uncertainty=scale * float(after))
        for run, after in zip(arrays.runs, arrays.improved.halved_noise[place], strict=True)
    ]
    found += [
        HalvedInput(
            kind="prior", input=parameter.name, source=SOURCES.get(parameter.effect, "unit"),
            standard_uncertainty=scale * float(after),
        )
        for parameter, after in zip(arrays.priors, arrays.improved.halved_prior[place], strict=True)
        if not parameter.nuisance
    ]  # fmt: skip
    found += [
        HalvedInput(
            kind="priors", input=effect, source=SOURCES.get(effect, "unit"), standard_uncertainty=scale * float(after)
        )
        for effect, after in zip(arrays.improved.groups, arrays.improved.halved_groups[place], strict=True)
    ]
    return tuple(sorted(found, key=lambda each: each.standard_uncertainty)[:_MOST_HALVED])


def _next_runs(result: Result, arrays: BudgetArrays) -> list[NarrowingRun | None]:
    """Return, for each quantity, the run that would narrow it most; None where no run would."""
    count, runs = len(arrays.names), result.fit.model.campaign.runs
    before = np.maximum(arrays.improved.at_mode, np.finfo(float).tiny)
    # Share of the standard deviation that each run leaves, predicted from the mode: (C, Q).
    left = (arrays.improved.repeated / before[:, None]).T
    designs: list[RunDesign] = []
    if len(arrays.gradient):
        designs, start, after = narrowed(result.fit, arrays.gradient)
        squares = np.stack([np.bincount(arrays.owner, row**2, count) for row in (start, *after)])
        left = np.concatenate([left, np.sqrt(squares[1:] / np.maximum(squares[0], np.finfo(float).tiny))])
    found: list[NarrowingRun | None] = []
    for place in range(count):
        best, u = int(left[:, place].argmin()), float(np.sqrt(arrays.posterior[place]))
        useful = 0 < left[best, place] < USEFUL_RUN
        run = designs[best - len(runs)] if best >= len(runs) else None
        repeats = runs[best].name if best < len(runs) else None
        narrowing = NarrowingRun(run=run, repeats=repeats, standard_uncertainty=u * float(left[best, place]))
        found.append(narrowing if useful else None)
    return found

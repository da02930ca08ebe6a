"""Properties of site and equipment that the model takes as exact: those in every U, and those that U omits."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from imubayes.display.fit_quality_tables import members_text
from imubayes.display.layout import Cell, Sheet, cells
from imubayes.display.numbers_and_labels import pretty, ratio_text, significant
from imubayes.foundations.quantity_names import QuantityName
from imubayes.foundations.wording import counted
from imubayes_qualification.budgets.taken_as_exact import OMITTED, ExactInput
from imubayes_qualification.certificate.report_record import QualificationReport, ReportedEstimate, StandardEstimate
from imubayes_qualification.display.report.document import without_empty_columns

# Included inputs are distinguished from this ratio of uncertainties on.
_MATTERS = 1.1
# Share of the omitted variance, by each effect alone, from which on an effect is named as its cause.
_CAUSE = 0.1
# Share of u by which a cause of the plausible size moves a quantity, from which on it is listed with what it does.
_LISTED = 0.1

Kind = Literal["standard", "angle", "combination", "converter", "result"]
_KINDS: dict[Kind, str] = {
    "standard": "", "angle": "true mounting angles", "combination": "combinations", "converter": "converters",
    "result": "others of the result table",
}  # fmt: skip


@dataclass(frozen=True)
class Omission:
    """A quantity whose stated uncertainty omits contributions of what the model takes as exact.

    Attributes
    ----------
    kind, symbol, label : table that has it, symbol of the standards, and its name there.
    ratio : uncertainty with the omitted contributions over the stated one.
    uncertainty, unit : the stated standard uncertainty.
    causes : inputs that contribute, effect by effect, the largest first.
    """

    kind: Kind
    symbol: str
    label: str
    ratio: float
    uncertainty: float
    unit: str
    causes: tuple[ExactInput, ...]


CONVERTER = "converter_"
"""Beginning of the names of converter effects, whose estimates have a table of their own."""
BESIDE = "U omits"
"""Head of the column with the factor by which what U omits would multiply it."""


def included_table(report: QualificationReport) -> Sheet | None:
    """Return what is taken as exact and is in every U, with what it does; None if nothing of it matters."""
    budgets = {} if report.budgets is None else {each.name: each for each in report.budgets.quantities}
    symbols = {each.members[0]: each.symbol for each in report.standards if len(each.members) == 1}
    symbols |= {each.name: each.symbol for each in report.standards}
    shown = {name: budget.standard_uncertainty for name, budget in budgets.items() if name in symbols}
    rows = []
    for ratio, each, name in _worst_included(report.exact.included, shown):
        u = budgets[name].standard_uncertainty
        rows.append(
            cells(
                _named(each),
                f"{significant(each.size, 2)} {pretty(each.unit)}",
                "stated" if each.stated else "assumed",
                Cell(str(QuantityName(symbols[name], QuantityName.of(name).labels)), formula=True),
                f"{significant(u / ratio, 2)} → {significant(u, 2)}",
                pretty(budgets[name].unit),
            )
        )
    if not rows:
        return None
    head = ("taken as exact", "standard uncertainty", "", "moves most", "u without → with", "unit")
    note = "Uncertainties that the campaign states, and that of normal gravity, are in every U of this document."
    return Sheet("Site and equipment that the model takes as exact, in U", head, rows, (0, 1, 2, 3, 5), note=note)


def _worst_included(
    inputs: Sequence[ExactInput], uncertainties: Mapping[str, float]
) -> list[tuple[float, ExactInput, str]]:
    """Return for each effect its worst parameter: ratio of uncertainties, parameter, and the quantity that it moves."""
    worst: dict[str, tuple[float, ExactInput, str]] = {}
    for each in inputs:
        for shift in (shift for shift in each.shifts if shift.name in uncertainties):
            alone = uncertainties[shift.name] ** 2 - shift.value**2
            ratio = (1 + shift.value**2 / alone) ** 0.5 if alone > 0 else 1.0
            if ratio > (worst[each.effect][0] if each.effect in worst else _MATTERS):
                worst[each.effect] = ratio, each, shift.name
    return sorted(worst.values(), key=lambda found: -found[0])


def omissions(report: QualificationReport) -> list[Omission]:
    """Return the stated quantities whose U omits what would widen it by a twentieth and more, each once."""
    found, seen = [], set[str]()
    for names, omission in _omitted(report):
        if not seen.intersection(names):
            found.append(omission)
        seen.update(names)
    return found


def omitted_beside(report: QualificationReport) -> dict[str, str]:
    """Return, for the name of every estimate whose U omits something, the factor by which that would multiply it."""
    return {name: omitted_factor(found.ratio) for names, found in _omitted(report) for name in names}


def omitted_factor(ratio: float) -> str:
    """Return the factor by which what U omits would multiply it, as text; empty if that is not worth saying."""
    return f"× {ratio_text(ratio)}" if ratio > OMITTED else ""


def _omitted(report: QualificationReport) -> Iterator[tuple[tuple[str, ...], Omission]]:
    """Yield what U omits of each stated quantity, with the names that this has."""
    budgets = {} if report.budgets is None else {each.name: each for each in report.budgets.quantities}
    omitted = {each.name for each in report.exact.unstated}
    for kind, symbol, label, line, names in _stated(report):
        name = next((each for each in names if each in omitted), None)
        u = line.standard_uncertainty
        if name is None or not u or line.withheld is not None:
            continue
        own = budgets[name].standard_uncertainty if name in budgets else u
        ratio = report.exact.omitted_ratio(name, own)
        if ratio > OMITTED:
            causes = _causes(report.exact.inputs, name)
            yield names, Omission(kind, symbol, label, ratio, u, line.unit, causes)


def _stated(report: QualificationReport) -> Iterator[tuple[Kind, str, str, ReportedEstimate, tuple[str, ...]]]:
    """Yield what the document states: table, symbol, label, estimate, and the names that it may have."""
    for each in report.standards:
        members = each.members if len(each.members) == 1 else ()
        yield "standard", each.symbol, each.label, each, (each.name, *members)
    for angle in report.mounting_angles:
        yield "angle", "", f"{angle.channel},{angle.mounting}", angle, (angle.name,)
    for combination in report.combinations:
        yield "combination", "", members_text(combination), combination, (combination.name,)
    for each in report.thermal_linearity:
        yield "converter", "", f"Δk[{each.channel},{each.run}]", each, (each.name,)
    for line in report.results:
        yield "converter" if line.name.startswith(CONVERTER) else "result", "", line.name, line, (line.name,)


def _causes(inputs: Sequence[ExactInput], name: str) -> tuple[ExactInput, ...]:
    """Return an input of each effect that causes what U omits of a quantity, the largest effect first."""
    effects: dict[str, tuple[float, ExactInput]] = {}
    for each in (each for each in inputs if not each.included and each.shift(name)):
        before = effects[each.effect][0] if each.effect in effects else 0.0
        effects[each.effect] = before + each.shift(name) ** 2, each
    whole = sum(variance for variance, _ in effects.values())
    ordered = sorted(effects.values(), key=lambda found: -found[0])
    return tuple(each for variance, each in ordered if variance >= _CAUSE * whole)


def omitted_table(found: Sequence[Omission]) -> Sheet | None:
    """Return what U omits, a row for each quantity or table with its worst; None if it omits nothing."""
    groups: dict[tuple[Kind, str, str], list[Omission]] = {}
    for each in found:
        groups.setdefault((each.kind, each.symbol, each.unit), []).append(each)
    rows = []
    for (kind, symbol, unit), own in groups.items():
        worst = max(own, key=lambda each: each.ratio)
        causes = dict.fromkeys(_input_text(cause) for each in own for cause in each.causes)
        rows.append(
            cells(
                Cell(symbol, formula=True) if symbol else _KINDS[kind],
                _factors(own) if kind == "standard" else _range(own),
                f"{significant(worst.uncertainty, 2)} → {significant(worst.uncertainty * worst.ratio, 2)}",
                pretty(unit),
                ", ".join(causes),
            )
        )
    if not rows:
        return None
    head = ("quantity", "U would be multiplied by", "worst: u → u with them", "unit", "omitted")
    note = (
        "Known contributions from site and equipment that the model takes as exact, and that no u or U of this "
        "document contains. They are listed if all together widen U by a twentieth or more. The campaign states no "
        "size, so that a plausible standard uncertainty is used. State it in the campaign (0 if exact), or add the "
        "effect to the model. Wobble and encoder harmonics of a table can only be added as effects. A factor contains "
        "only that part of each error that the data do not determine. Annex A lists the changes per unit of the whole "
        "error. Factors apply to values at T_ref. The factor of a limit over a range of temperatures is given with the "
        "limit. A limit passes only if all of these together could not move the value beyond it."
    )
    return Sheet("Contributions that U omits", head, rows, (0, 1, 3, 4), note=note)


def sensitivity_table(report: QualificationReport) -> Sheet | None:
    """Return what an error of one unit of each cause that U omits does to the quantities; None if there is none.

    Of a cause with several parameters, as the thermometer in each run, what independent errors of all do, and what one
    that all have in common does; of the channels of a quantity the one that is moved most in units of its u.
    """
    causes: dict[str, list[ExactInput]] = {}
    for each in report.exact.inputs:
        if not each.included:
            causes.setdefault(each.effect, []).append(each)
    rows = []
    for own in causes.values():
        for symbol, lines in _by_symbol(report).items():
            line = max(lines, key=lambda each: _share(own, each))
            if _share(own, line) < _LISTED:
                continue
            independent, common = _moved(own, line)
            several = len(own) > 1
            rows.append(
                cells(
                    _named(own[0]) + (f", {len(own)} parameters" if several else ""),
                    f"1 {pretty(own[0].unit)}",
                    Cell(symbol, formula=True),
                    line.label,
                    significant(independent),
                    significant(common) if several else "",
                    significant(_u(line), 2),
                    pretty(line.unit),
                )
            )
    if not rows:
        return None
    head = ("taken as exact", "error", "quantity", "channel", "change", "the same error in all", "u", "unit")
    note = (
        "Change of the estimate at T_ref that an error of this size causes while the model takes it as exact. For a "
        "cause with several parameters it is the root sum of squares of their changes. Other sizes act in proportion. "
        "If the data bound such an error, it adds less to u than this change times the plausible size: the factors of "
        "the first page contain the remaining part. "
        "Quantities that the plausible size changes by less than a tenth of u are left out. For each quantity the "
        "channel with the largest change is given."
    )
    title = "Change of the results per unit of each contribution that U omits"
    return without_empty_columns(Sheet(title, head, rows, (0, 1, 2, 3, 7), note=note))


def _by_symbol(report: QualificationReport) -> dict[str, list[StandardEstimate]]:
    """Return the measured quantities of the standards by their symbol."""
    found: dict[str, list[StandardEstimate]] = {}
    for each in report.standards:
        if each.measured and each.withheld is None and each.standard_uncertainty:
            found.setdefault(each.symbol, []).append(each)
    return found


def _u(line: StandardEstimate) -> float:
    return line.standard_uncertainty or 1.0


def _names(line: StandardEstimate) -> tuple[str, ...]:
    return (line.name, *(line.members if len(line.members) == 1 else ()))


def _share(causes: Sequence[ExactInput], line: StandardEstimate) -> float:
    """Return what errors of the plausible sizes do to a quantity, in units of its u."""
    shifts = [next(filter(None, map(each.shift, _names(line))), 0.0) for each in causes]
    return math.sqrt(sum(shift**2 for shift in shifts)) / _u(line)


def _moved(causes: Sequence[ExactInput], line: StandardEstimate) -> tuple[float, float]:
    """Return what independent errors of one unit do to a quantity, and what one that all have does."""
    changes = [next(filter(None, map(each.sensitivity, _names(line))), 0.0) for each in causes]
    return math.sqrt(sum(change**2 for change in changes)), sum(changes)


def omitted_note(found: Sequence[Omission], kind: Kind) -> str:
    """Return what U omits in one table, as a sentence for its note; empty if it omits nothing."""
    causes = dict.fromkeys(_named(cause) for each in found if each.kind == kind for cause in each.causes)
    if not any(each.kind == kind for each in found):
        return ""
    named = f" ({', '.join(causes)})" if causes else ""
    return f" {BESIDE}: factor by which known contributions{named} would multiply u and U of this line (first page)."


def _factors(found: Sequence[Omission]) -> str:
    return "; ".join(f"{each.label} × {ratio_text(each.ratio)}" for each in found)


def _range(found: Sequence[Omission]) -> str:
    ratios = sorted(each.ratio for each in found)
    ends = dict.fromkeys(ratio_text(each) for each in (ratios[0], ratios[-1]))
    return f"× {' … '.join(ends)} ({counted(len(found), 'factor')} in that table)"


def _named(each: ExactInput) -> str:
    return each.effect.replace("_", " ")


def _input_text(each: ExactInput) -> str:
    return f"{_named(each)} ({significant(each.size, 2)} {pretty(each.unit)})"

"""Section on uncertainty budgets: what contributes to each uncertainty, and what would narrow it first."""

from collections.abc import Collection, Iterator, Sequence

from imubayes.display.fit_quality_tables import run_design_text
from imubayes.display.layout import Cell, Sheet, cells
from imubayes.display.numbers_and_labels import NO_NUMBER, listed, pretty, significant
from imubayes.foundations.wording import counted
from imubayes_qualification.budgets import budget_parts as parts
from imubayes_qualification.certificate.report_record import QualificationReport, ReportedEstimate
from imubayes_qualification.display.report import words
from imubayes_qualification.display.report.document import Block, Heading, Items, Paragraph, without_empty_columns
from imubayes_qualification.display.report.quantity_drawings import bar_drawings, correlation_drawing
from imubayes_qualification.evaluation.decision_rules import ADDS_UP

_SOURCES: dict[parts.Source, str] = {
    "fixture": "fixture", "table": "table", "site": "site", "reference": "reference", "unit": "unit under test",
}  # fmt: skip
# Lines of a table: those with at least this share, and so many at most; the others are summed.
_SHOWN_SHARE, _MOST_LINES = 0.01, 7
# Correlations in the table of the strongest.
_STRONG, _MOST_STRONG = 0.5, 30
_MOST_DRAWN = 36
NO_DEGREES = (
    "U = k u is half the length of the 95 % coverage interval of the posterior (JCGM 101). u is the standard deviation "
    "of the posterior. It already includes the uncertainty of a scatter that is estimated from few rows, so that it "
    "has no degrees of freedom, and no factor of Student’s t may be applied to it again."
)
"""Why no ν stands beside u."""
_METHOD = (
    "Posterior variance = Σ (cᵢ u(xᵢ))² of independent inputs: the noise of the runs (type A) and each prior (type B), "
    "which states the prior knowledge of fixture, table, site, reference and unit before the test."
)
_NOTES = (
    "Type A contributions are evaluated from all rows of the runs of a procedure, so that they have no single input. "
    "Known to: their own relative standard uncertainty, as the scatter of these runs is known from few rows (GUM "
    "E.4.3). The record has the contribution of each run.",
    "Noise scales: the scatter itself is estimated, and if it is uncertain the estimate moves with it; this is the "
    "variance of the conditional mean. Second order: the part that is quadratic in the inputs (GUM 5.1.2, note).",
    "Remainder: posterior variance less all contributions, hence higher orders and Monte Carlo error.",
    f"{NO_DEGREES} If the posterior is not symmetric, its interval is given with the results.",
)
_TABLE_NOTE = (
    "u(x): standard uncertainty of the input; c: sensitivity, in the unit of the quantity over that of the input; "
    "|c| u(x): standard uncertainty that it contributes; share: of the posterior variance."
)
_FIRST_NOTE = (
    "Halve first: u becomes smallest if this contribution is halved, by a better certificate or less noise. Next run: "
    "the run that narrows the quantity most, among repetitions and other runs that the equipment allows. A dash means "
    "that none narrows it by 1 %. Both are linear predictions."
)


def budget_section(report: QualificationReport) -> Iterator[Block]:
    """Return the uncertainty budgets of limits, mounting angles, quantities and combinations of the standards."""
    budgets = report.budgets
    if budgets is None:
        return
    shown, stated = reported_budgets(report, budgets), {line.name: line for line in report.estimates}
    withheld = {name for name, line in stated.items() if line.withheld is not None}
    yield Heading("Uncertainty budgets")
    yield Paragraph(_METHOD)
    yield Items(_NOTES)
    yield Paragraph(_sum_text(budgets) + _scaled_text(budgets))
    if not shown:
        return
    yield bar_drawings(shown)
    yield from _improvements(shown, withheld)
    for place, each in enumerate(shown):
        yield _budget_table(each, place == 0, stated[each.name])
    yield Heading("Correlations", 3)
    drawn = [each.name for each in shown][:_MOST_DRAWN]
    yield correlation_drawing(budgets.correlation, drawn)
    yield from _strongest(budgets.correlation, {each.name for each in shown})


def reported_budgets(report: QualificationReport, budgets: parts.UncertaintyBudgets) -> list[parts.QuantityBudget]:
    """Return the budgets that the document shows, limits first; the record has those of all quantities."""
    known = {each.name: each for each in budgets.quantities}
    limits = report.conformity.limits if report.conformity is not None else ()
    names = [limit.name for limit in limits] + [angle.name for angle in report.mounting_angles]
    names += [each.name if each.name in known else each.members[0] for each in report.standards]
    names += [each.name for each in report.combinations if each.standard]
    names += [each.name for each in report.thermal_linearity]
    return [known[name] for name in dict.fromkeys(names) if name in known]


def _scaled_text(budgets: parts.UncertaintyBudgets) -> str:
    """Return which budgets are scaled to their draws, as a sentence; empty if none is."""
    named = [f"{each.name} (× {each.scaled:.3f})" for each in budgets.quantities if each.scaled != 1]
    if not named:
        return ""
    return (
        f" Contributions to {listed(named)} are those of the linear approximation times the factor, as "
        "the posterior draws have another width."
    )


def _sum_text(budgets: parts.UncertaintyBudgets) -> str:
    off = [each for each in budgets.quantities if abs(each.remainder) > ADDS_UP]
    largest = max((abs(each.remainder) for each in budgets.quantities), default=0.0)
    if not off:
        return (
            f"The contributions to {counted(len(budgets.quantities), 'quantity')} add up to the posterior variances "
            f"within {100 * ADDS_UP:g} %; the largest remainder is {100 * largest:.1f} %."
        )
    named = listed([f"{each.name} ({100 * each.remainder:+.0f} %)" for each in off])
    return (
        f"The contributions add up to the posterior variance within {100 * ADDS_UP:g} %, except for {named}: "
        "these are not linear in their inputs over the width of the posterior."
    )


def input_text(line: parts.BudgetLine | parts.HalvedInput) -> str:
    """Return what contributes, as a phrase."""
    match line.kind:
        case "run" if isinstance(line, parts.BudgetLine) and not line.input:
            return f"noise of {line.inputs} runs, {str(line.group).replace('_', ' ')}"
        case "run":
            return f"noise of {line.input}"
        case "priors":
            count = f" ({line.inputs} inputs)" if isinstance(line, parts.BudgetLine) else ""
            return line.input.replace("_", " ") + count
        case "prior" | "exact":
            return line.input
        case "noise_scales":
            return "noise scales"
        case "cmc":
            return "up to the CMC of the laboratory"
        case "second_order":
            return "second order"
        case "small":
            return f"{line.inputs} smaller" if isinstance(line, parts.BudgetLine) else ""


def _improvements(shown: Sequence[parts.QuantityBudget], withheld: Collection[str]) -> Iterator[Block]:
    """Return what to improve first, and the runs that it names by letters."""
    runs = list(dict.fromkeys(run_text(each.next_run) for each in shown if each.next_run is not None))
    letters = {text: _letter(place) for place, text in enumerate(runs)}
    rows = [
        cells(
            each.name,
            "withheld" if each.name in withheld else significant(each.standard_uncertainty, 2),
            pretty(each.unit),
            input_text(each.halved[0]) if each.halved else NO_NUMBER,
            _fall(each, each.halved[0].standard_uncertainty) if each.halved else NO_NUMBER,
            letters[run_text(each.next_run)] if each.next_run is not None else NO_NUMBER,
            _fall(each, each.next_run.standard_uncertainty) if each.next_run is not None else NO_NUMBER,
        )
        for each in shown
    ]
    head = ("quantity", "u", "unit", "halve first", "u falls by", "next run", "u falls by")
    yield Sheet("Improve first", head, rows, (0, 2, 3, 5), note=_FIRST_NOTE)
    if letters:
        yield Paragraph("Next runs:")
        yield Items([f"{letter}: {text}." for text, letter in letters.items()])


def run_text(run: parts.NarrowingRun) -> str:
    """Return a further run as a phrase."""
    return f"{run.repeats} once more" if run.run is None else run_design_text(run.run)


def _fall(budget: parts.QuantityBudget, after: float) -> str:
    return f"{100 * (1 - after / budget.standard_uncertainty):.0f} %"


def _letter(place: int) -> str:
    return "ABCDEFGHIJKLMNOPQRSTUVWXYZ"[place] if place < 26 else f"R{place + 1}"


def _budget_table(budget: parts.QuantityBudget, first: bool, stated: ReportedEstimate) -> Sheet:
    """Return the table of a budget; its caption has u, k and U as `stated` has them."""
    lines = sorted(_grouped(budget.lines), key=lambda line: -line.share)
    large = [line for line in lines if line.kind != "small" and line.share >= _SHOWN_SHARE][:_MOST_LINES]
    rest = [line for line in lines if line not in large]
    rows = [_line(line) for line in large]
    if rest:
        share = sum(line.share for line in rest)
        contribution = sum(line.contribution**2 for line in rest) ** 0.5
        count = sum(line.inputs for line in rest)
        rows.append(_cells(f"{count} smaller", contribution=contribution, share=share))
    rows.append(_cells("remainder", share=budget.remainder))
    known = words.uncertainties_text(stated) if stated.withheld is None else "u, k and U withheld: too few draws"
    caption = f"{budget.name}: {known}"
    head = ("contribution", "type", "source", "distribution", "u(x)", "unit", "c", "|c| u(x)", "share", "known to")
    note = (
        "Near zero, inputs contribute through the components of the direction, and the shares refer to these."
        if budget.components
        else ""
    )
    return without_empty_columns(
        Sheet(caption, head, rows, (0, 1, 2, 3, 5), note=" ".join([_TABLE_NOTE if first else "", note]).strip())
    )


def _grouped(lines: Sequence[parts.BudgetLine]) -> list[parts.BudgetLine]:
    """Return the contributions with runs of one procedure taken together."""
    found = [line for line in lines if line.kind != "run"]
    for group in dict.fromkeys(line.group for line in lines if line.kind == "run"):
        own = [line for line in lines if line.kind == "run" and line.group == group]
        if len(own) == 1:
            found += own
            continue
        share, variance = sum(line.share for line in own), sum(line.contribution**2 for line in own)
        spread = sum((line.contribution**2 * (line.relative_uncertainty or 0.0)) ** 2 for line in own)
        found.append(
            own[0].model_copy(
                update={
                    "input": "", "inputs": len(own), "share": share, "contribution": variance**0.5,
                    "relative_uncertainty": spread**0.5 / variance if spread else None,
                }
            )
        )  # fmt: skip
    return found


def _line(line: parts.BudgetLine) -> tuple[Cell, ...]:
    return _cells(
        input_text(line),
        line.type or "",
        _SOURCES[line.source] if line.source is not None else "",
        line.distribution or "",
        "" if line.input_uncertainty is None else significant(line.input_uncertainty, 2),
        "" if line.unit is None else pretty(line.unit),
        "" if line.sensitivity is None else significant(line.sensitivity, 2),
        contribution=line.contribution,
        share=line.share,
        known="" if line.relative_uncertainty is None else f"{significant(100 * line.relative_uncertainty, 2)} %",
    )


def _cells(
    name: str, *middle: str, contribution: float | None = None, share: float = 0.0, known: str = ""
) -> tuple[Cell, ...]:
    filled = [*middle, *[""] * (6 - len(middle))]
    last = "" if contribution is None else significant(contribution, 2)
    return tuple(Cell(text) for text in (name, *filled, last, _share(share), known))


def _share(share: float) -> str:
    return f"{100 * share + 0.0:.1f} %".replace("-0.0", "0.0")


def _strongest(matrix: parts.CorrelationMatrix, shown: set[str]) -> Iterator[Block]:
    pairs = [
        (abs(value), value, first, matrix.names[column])
        for first, row in zip(matrix.names, matrix.rows, strict=True)
        for column, value in enumerate(row[:-1])
        if abs(value) >= _STRONG and first in shown and matrix.names[column] in shown
    ]
    pairs.sort(key=lambda pair: -pair[0])
    if not pairs:
        yield Paragraph(f"No two of these quantities have a correlation beyond ± {_STRONG:g}.")
        return
    rows = [cells(second, first, f"{value:+.3f}") for _, value, first, second in pairs]
    note = (
        f"Correlations beyond ± {_STRONG:g} of the posterior draws"
        + (f", the strongest {_MOST_STRONG} of {len(rows)}" if len(rows) > _MOST_STRONG else "")
        + ". Uncertainties of strongly correlated quantities must not be added as if they were independent. The whole "
        "matrix is in the JSON record."
    )
    yield Sheet("Strongest correlations", ("quantity", "and", "r"), rows[:_MOST_STRONG], (0, 1), note=note)

"""Sections with estimates: quantities of the standards, mounting angles, converters, and the full result table."""

from collections.abc import Iterator, Mapping, Sequence

from imubayes.display.fit_quality_tables import members_text, symbol_text
from imubayes.display.layout import Cell, Sheet, cells
from imubayes.display.numbers_and_labels import NO_NUMBER, percent, pretty, rounded, significant, value_and_sd
from imubayes.foundations.campaign_data import channel_of_component
from imubayes.foundations.quantity_names import QuantityName, name_of
from imubayes.inference.identifiability import ProcedureShare
from imubayes_qualification.certificate import report_record as record
from imubayes_qualification.display.report import words
from imubayes_qualification.display.report.document import Block, Heading, Items, Paragraph, without_empty_columns
from imubayes_qualification.display.report.exact_tables import BESIDE, CONVERTER

_UNMEASURED = "Not measured: known from priors, or fixed by the model"
_TOGETHER = "Determined combinations"
_STANDARD_NOTE = (
    "y ± U: estimate with expanded uncertainty U = k u of 95 % coverage; estimate [95 % interval] if the posterior "
    "is not symmetric. u: standard uncertainty. Term: its place in the model equation. "
)
_REASONS = {
    "not_in_model": "not in the model",
    "undetectable": "these runs cannot show it",
    "not_defined": "no run or no channel to define it by",
    "not_measured": "the data do not determine it",
}


Beside = Mapping[str, str]
"""Name of an estimate → the factor on its U by what this omits."""


def standards_section(
    report: record.QualificationReport, omitted: str = "", beside: Beside | None = None
) -> Iterator[Block]:
    """Return the quantities of the standards, one table per standard, and those that were not estimated.

    `omitted` says which contributions their U omits, `beside` what these would do to each.
    """
    yield Heading("Quantities of the standards")
    if report.standards:
        yield Paragraph(
            "Each quantity is computed for every draw of the joint posterior, so that its uncertainty contains all "
            "others. Biases and scale factors are the means over the runs at T_ref = "
            f"{words.reference_temperature(report)}. A limit over a range of temperatures is another measurand under "
            "the same symbol: the value at the worst temperature of the range, with hysteresis, lag and the scatter "
            "between runs. I, O, S (gyros) and I, O, P (accelerometers) are the input, output and third axis of each "
            "channel; f and a are specific force, Ω is rate."
        )
    found = list(dict.fromkeys(each.standard for each in report.standards))
    for standard in found:
        note = _STANDARD_NOTE + words.digits_text(report.standards) + omitted if standard == found[-1] else ""
        own = [each for each in report.standards if each.standard == standard]
        yield _standard_table(standard, own, note, beside or {})
    together = _determined_together(report)
    if together:
        yield Paragraph(f"Much better determined together than by themselves: {together}; see {_TOGETHER}.")
    if not report.convergence.converged:
        yield Paragraph("None is stated: the fit did not converge.")
    if report.not_estimated:
        yield _not_estimated(report.not_estimated)


def _determined_together(report: record.QualificationReport) -> str:
    """Return the quantities of the standards that are members of standard combinations; empty for none."""
    members = {name for found in report.combinations if found.standard for name in found.quantities}
    named = [each for each in report.standards if members & set(each.members)]
    return words.enumerated([name_of(each.symbol, each.label) for each in named]) if named else ""


def _standard_table(standard: str, own: Sequence[record.StandardEstimate], note: str, beside: Beside) -> Sheet:
    rows, before = [], ""
    for each in own:
        new = each.key != before
        before = each.key
        u = NO_NUMBER if each.withheld else words.stated(each)[1]
        rows.append(
            cells(
                Cell(each.symbol if new else "", formula=True),
                Cell(each.quantity if new else "", "" if new else "dim"),
                each.label,
                words.value_text(each),
                beside.get(each.name, ""),
                words.factor_text(each),
                u,
                pretty(each.unit),
                Cell(each.term if new else "", formula=True),
            )
        )
    head = ("symbol", "quantity", "channel", "y ± U", BESIDE, "k", "u", "unit", "term")
    return without_empty_columns(Sheet(standard, head, rows, (0, 1, 2, 4, 7, 8), note=note), BESIDE)


def _not_estimated(lines: Sequence[record.NotEstimated]) -> Sheet:
    rows = []
    for each in lines:
        screened = "; ".join(
            f"{QuantityName.of(c.name).label}: "
            f"{words.beside(*value_and_sd(c.value, c.standard_uncertainty))} {pretty(c.unit)}"
            for c in each.screened[:1]
        )
        reason = _REASONS[each.reason] + (f" (needs {', '.join(each.needs)})" if each.needs else "")
        if each.reason == "not_measured":
            share = "fixed by the model" if each.from_data is None else f"{percent(each.from_data)} from data"
            reason += f" ({share})"
        rows.append(
            cells(
                Cell(each.symbol, formula=True), each.quantity, ", ".join(each.labels) or "all", each.standard,
                reason, ", ".join(each.effects), screened or "–"
            )
        )  # fmt: skip
    head = ("symbol", "quantity", "channel", "standard", "why", "effect", "one-step estimate of the diagnosis")
    return Sheet(
        "Not measured",
        head,
        rows,
        (0, 1, 2, 3, 4, 5, 6),
        note="“Not measured” does not mean zero. If less than half of the information on a quantity came from the "
        "data, it depends on its prior. The one-step estimate is that of the linearised fit with the "
        "effect added; an effect that is probably missing is reported as such.",
    )


def mounting_section(
    angles: Sequence[record.MountingAngle], omitted: str = "", beside: Beside | None = None
) -> Iterator[Block]:
    """Return the true mounting angles and what determined them.

    `omitted` says what their uncertainties omit, `beside` what that would do to each.
    """
    if not angles:
        return
    rows = []
    for each in angles:
        value = words.value_text(each)
        shift = "–" if each.deviation is None else _deviation(each)
        rows.append(
            cells(
                each.mounting, each.channel, _like(each.nominal, value.partition(" ")[0]), value,
                (beside or {}).get(each.name, ""), words.factor_text(each), shift,
                percent(each.from_data) + ("" if each.measured else ", not measured"),
                _determined_by(each.evidence, each.standard_uncertainty, 3600.0, "arcsec")
            )
        )  # fmt: skip
    head = ("mounting", "channel", "nominal / deg", "true y ± U / deg", BESIDE, "k", "deviation / arcsec",
            "from data", "determined by")  # fmt: skip
    note = (
        "True angle between sensitive axis and axis of rotation; y ± U as for the quantities of the standards. From "
        "data: 1 − posterior variance / prior variance. If an axis is nominally along the axis of rotation, its angle "
        "is the length of its tilt, whose deviation is never negative. "
        "Determined by: the procedure that alone would leave the smallest uncertainty, with that uncertainty, and how "
        "many times smaller it is with all runs together; a dash means that the angle is not linear enough in the "
        f"parameters for a share by procedure. {words.digits_text(angles)}{omitted}"
    )
    runs = [
        f"{mounting}: {words.enumerated(next(each.runs for each in angles if each.mounting == mounting))}"
        for mounting in dict.fromkeys(each.mounting for each in angles)
    ]
    yield Heading("True mounting angles")
    yield without_empty_columns(Sheet("Angles to the axis of rotation", head, rows, (0, 1, 4, 8), note=note), BESIDE)
    yield Paragraph("Runs in each mounting:")
    yield Items(runs)


def _like(value: float, written: str) -> str:
    """Return a value with the decimals of a number as it is written; four if there is none."""
    number, _, decimals = written.partition(".")
    return f"{value:.{len(decimals) if decimals.isdigit() else 4 * (not number.isdigit())}f}"


def _deviation(angle: record.MountingAngle) -> str:
    u = None if angle.standard_uncertainty is None else angle.standard_uncertainty * 3600
    return "–" if angle.deviation is None else rounded((angle.deviation * 3600,), u)[0]


def _determined_by(
    evidence: Sequence[ProcedureShare], standard_uncertainty: float | None, factor: float, unit: str
) -> str:
    """Return the procedure that alone leaves the smallest uncertainty, which is shown times `factor` in `unit`."""
    if not evidence:
        return NO_NUMBER
    best = min(evidence, key=lambda each: each.alone)
    alone = f"{best.procedure.replace('_', ' ')}, {significant(best.alone * factor, 2)} {pretty(unit)}"
    gain = best.alone / standard_uncertainty if standard_uncertainty else 1.0
    return f"{alone}; all runs {significant(gain, 2)} × better" if gain > 1.05 else alone


def combination_section(
    combinations: Sequence[record.ReportedCombination], omitted: str = "", beside: Beside | None = None
) -> Iterator[Block]:
    """Return what the data determine together alone.

    `omitted` says what the uncertainties omit, `beside` what that would do to each.
    """
    if not combinations:
        return
    rows = []
    for each in sorted(combinations, key=lambda each: not each.standard):
        estimate, u, _, _ = words.stated(each)
        rows.append(
            cells(
                Cell(_with_minus(symbol_text(each)), formula=True), members_text(each), estimate, u,
                (beside or {}).get(each.name, ""), words.interval_text(each), pretty(each.unit),
                percent(each.from_data),
                _determined_together_by(each)
            )
        )  # fmt: skip
    head = ("symbol", "combination", "estimate", "u", BESIDE, "95 % interval", "unit", "from data", "determined by")
    note = (
        "The runs determine these combinations much better than their leading members, whose own estimates rest on "
        "their priors or are strongly correlated; use the combination, not the sum of the single estimates with "
        "their uncertainties. Each member counts in its own unit. Symbols are those of the standard of the test; a "
        "combination without one was found from the information in the data. Determined by: as for mounting angles. "
        f"{words.digits_text(combinations)}{omitted}"
    )
    table = without_empty_columns(Sheet("Combinations that the runs determine", head, rows, (0, 1, 4, 6, 8), note=note))
    yield Heading(_TOGETHER)
    yield table


def _with_minus(symbol: str) -> str:
    """Return a symbol with minus signs in its sum, D_II−D_SS; its label keeps its hyphens."""
    name = QuantityName.of(symbol)
    return str(QuantityName(name.family.replace("-", "−"), name.labels))


def _determined_together_by(found: record.ReportedCombination) -> str:
    if len(found.procedures) == 1:
        return found.procedures[0].replace("_", " ")
    return _determined_by(found.evidence, found.standard_uncertainty, 1.0, found.unit)


def converter_section(
    lines: Sequence[record.ThermalLinearity],
    results: Sequence[record.ResultLine],
    omitted: str = "",
    beside: Beside | None = None,
) -> Iterator[Block]:
    """Return the drift of the converters, and Δk per input with P(Δk ≤ threshold).

    `omitted` says what the uncertainties omit, `beside` what that would do to each.
    """
    drift = [line for line in results if line.name.startswith(CONVERTER)]
    if lines or drift:
        yield Heading("Converters")
    if drift:
        note = f"Temperature sensitivity of gain and offset, and the other converter effects of the model.{omitted}"
        rows = [_result_row(line, (beside or {}).get(line.name, "")) for line in drift]
        yield without_empty_columns(Sheet("Drift of the converters", _RESULT_HEAD, rows, (0, 3, 5), note=note), BESIDE)
    if lines:
        yield _delta_k_table(lines, omitted, beside or {})


def _delta_k_table(lines: Sequence[record.ThermalLinearity], omitted: str, beside: Beside) -> Sheet:
    rows = []
    for each in lines:
        estimate, u, _, _ = words.stated(each)
        rows.append(
            cells(
                each.channel, each.run, estimate, u, beside.get(each.name, ""), words.interval_text(each),
                f"{each.threshold:g}", words.probability_text(each.within)
            )
        )  # fmt: skip
    head = ("channel", "run", "Δk / %", "u / %", BESIDE, "95 % interval / %", "threshold / %", "P(Δk ≤ threshold)")
    note = (
        "Δk: relative difference between the thermal slope of an input and that of the input nearest 1 g. If "
        "Δk is probably below the threshold, the temperature line measured at 1 g applies to all inputs; if it is "
        f"above, each input needs its own line. {words.digits_text(lines)}{omitted}"
    )
    table = Sheet("Thermal linearity: Δk of each input", head, rows, (0, 1, 4), note=note)
    return without_empty_columns(table, BESIDE)


def result_section(
    report: record.QualificationReport, omitted: str = "", beside: Beside | None = None
) -> Iterator[Block]:
    """Return the full result table; `omitted` says which contributions its u omits, `beside` what they would do."""
    axes = [line for line in report.results if channel_of_component(line.name) is not None]
    note = (
        "u: standard uncertainty, the standard deviation of the joint posterior (GUM, type A and B combined). From "
        "data: 1 − posterior variance / prior variance on the scale on which the prior is normal; a quantity below "
        f"50 % was not measured. {words.digits_text(report.results)}{omitted}"
    )
    yield Heading("Result table")
    tables: dict[str, list[record.ResultLine]] = {}
    for line in report.results:
        if line not in axes:
            measured = "Derived quantities" if line.kind == "derived" else "Parameters"
            tables.setdefault(measured if line.measured else _UNMEASURED, []).append(line)
    for caption in ("Derived quantities", "Parameters", _UNMEASURED):
        if lines := tables.get(caption):
            rows = [_result_row(line, (beside or {}).get(line.name, "")) for line in lines]
            yield without_empty_columns(Sheet(caption, _RESULT_HEAD, rows, (0, 3, 5), note=note), BESIDE)
            note = ""
    if axes:
        yield axis_table(axes)


def supplied_section(section: record.ReportSection) -> Iterator[Block]:
    """Return a section that the author of the report added, marked as such."""
    yield Heading(section.title)
    yield Paragraph("Stated by the author of this report; imubayes computed none of it.", "dim")
    yield from map(Paragraph, section.paragraphs)
    if section.rows:
        left = tuple(range(len(section.head)))
        yield Sheet(section.title, section.head, [cells(*row) for row in section.rows], left)


def axis_table(lines: Sequence[record.ResultLine]) -> Sheet:
    """Return the input axes as vectors, a row for each channel."""
    axes: dict[str, list[Cell]] = {}
    for line in lines:
        estimate, u, _, _ = words.stated(line)
        channel = channel_of_component(line.name)
        assert channel is not None, line.name
        axes.setdefault(channel, []).append(Cell(words.beside(estimate, u)))
    rows = [cells(channel, *own) for channel, own in axes.items()]
    note = "Components of the unit vectors in body axes; their budgets are those of the misalignments."
    return Sheet("Input axes (input_axis)", ("channel", "x", "y", "z"), rows, (0,), note=note)


_RESULT_HEAD = ("quantity", "estimate", "u", BESIDE, "95 % interval", "unit", "from data")


def _result_row(line: record.ReportedEstimate, beside: str = "") -> tuple[Cell, ...]:
    estimate, u, _, _ = words.stated(line)
    mood = "" if line.measured else "weak"
    share = "fixed by the model" if line.exact else percent(line.from_data)
    share += "" if line.measured or line.exact else ", not measured"
    return cells(
        line.name, Cell(estimate, mood), Cell(u, mood), beside, Cell(words.interval_text(line), mood),
        pretty(line.unit), Cell(share, mood)
    )  # fmt: skip

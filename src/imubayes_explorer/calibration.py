"""The calibration of a model as the page lists it: every estimate as the tables of the command have it, and its shift.

Digits, units and shares of the data are those of `parameter_sheet` and `derived_sheet`.  Beside a model that was made
from another one stands the estimate before, and the shift in the smaller of the two standard uncertainties.
"""

from imubayes.display.layout import Sheet
from imubayes.display.quantity_tables import derived_sheet, parameter_sheet
from imubayes.foundations.quantity_names import QuantityName
from imubayes.foundations.records import Record
from imubayes.results.change_records import estimate_changes
from imubayes.results.summary import Summary

_WEAK = "weak"


class EstimateLine(Record):
    """An estimate in words.

    Attributes
    ----------
    kind : the table that it is of.
    parts : of its name.
    weak : whether it is that of the prior.
    before, before_sd : of the model that this one was made from; empty if that has none.
    in_sd : the shift since, in standard uncertainties; None if there is none.
    """

    kind: str
    name: str
    parts: tuple[str, str]
    unit: str
    estimate: str
    sd: str
    from_data: str
    weak: bool
    before: str = ""
    before_sd: str = ""
    in_sd: float | None = None


class CalibrationFacts(Record):
    """The estimates of a model; `before` is the title of the one that it was made from, empty without one."""

    lines: tuple[EstimateLine, ...]
    before: str
    note: str


def calibration_facts(summary: Summary, before: Summary | None = None, title: str = "") -> CalibrationFacts:
    """Return the estimates of a result; `before` is the one that it was made from, and `title` says which that is."""
    was = {} if before is None else {line.name: line for sheet in _sheets(before) for line in _lines(sheet)}
    shifts = {} if before is None else {each.name: each.in_sd for each in estimate_changes(before, summary)}
    lines = tuple(
        line.model_copy(update={
            "before": was[line.name].estimate, "before_sd": was[line.name].sd, "in_sd": shifts.get(line.name),
        }) if line.name in was else line
        for sheet in _sheets(summary)
        for line in _lines(sheet)
    )  # fmt: skip
    return CalibrationFacts(lines=lines, before=title if before is not None else "", note=_sheets(summary)[0].note)


def _sheets(summary: Summary) -> tuple[Sheet, Sheet]:
    return parameter_sheet(summary), derived_sheet(summary)


def _lines(sheet: Sheet) -> list[EstimateLine]:
    places = {word: place for place, word in enumerate(sheet.head)}
    columns = [places[word] for word in ("name", "unit", "estimate", "sd", "from data")]
    found = []
    for row in sheet.rows:
        name, unit, estimate, sd, share = (row[place].text for place in columns)
        found.append(EstimateLine(
            kind=sheet.title, name=name, parts=QuantityName.of(name).parts, unit=unit, estimate=estimate, sd=sd,
            from_data=share, weak=row[places["from data"]].mood == _WEAK,
        ))  # fmt: skip
    return found

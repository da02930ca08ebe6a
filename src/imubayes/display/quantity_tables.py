"""Tables of parameters and derived quantities, and the calibration sheet of a unit.

A quantity has a line with estimate, standard uncertainty, interval and share from the data.

The calibration sheet shows a unit at a glance: channels as columns, what was fitted of each as rows, and the input
axes.  A terminal of 80 columns has no room for three channels with their uncertainties after `±`: the form in
parentheses of GUM 7.2.2, 13.26(26), keeps them side by side.  A longer table continues in a further block.
"""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from imubayes.display import numbers_and_labels as numbers
from imubayes.display.fit_cautions import alarm_of
from imubayes.display.fit_quality_tables import NOT_DETERMINED, more
from imubayes.display.layout import Cell, Sheet, cells
from imubayes.foundations.campaign_data import channel_of_component
from imubayes.foundations.quantity_names import AXIS_ANGLE, QuantityName, family_of
from imubayes.foundations.units import BIAS_CONVENTION
from imubayes.foundations.wording import counted
from imubayes.results.summary import ParameterSummary, Quantity, Summary, channel_units, in_output_units

R_HAT, EFFECTIVE_SIZE = 1.01, 400.0
_TEMPERATURES = (
    "thermometer_error.", "converter_thermometer_error.", "thermometer_calibration.",
    "converter_thermometer_calibration.",
)  # fmt: skip
_MEANING = "sd: standard uncertainty. from data: 1 − (sd/prior sd)² on the scale on which the prior is normal. "


def parameter_sheet(summary: Summary, most: int | None = None, nuisance: bool = False) -> Sheet:
    """Return the parameters, those of single poses only if `nuisance`; at most `most`, the questionable first."""
    return _quantities(summary, in_output_units(summary).parameters, "Parameters", most, nuisance)


def scale_and_angle_sheet(summary: Summary) -> Sheet:
    """Return the derived quantities but for angles between axes and the vectors of the input axes."""
    own = [
        entry for entry in summary.derived if not entry.repeats_misalignments and family_of(entry.name) != AXIS_ANGLE
    ]
    return _quantities(summary, own, "Derived quantities", None, nuisance=False).changed(dividers=frozenset())


def equipment_sheet(summary: Summary, shown: Collection[str]) -> Sheet:
    """Return what is neither of a channel alone nor of a seat: axes of tables, a station, a reference.

    Parameters
    ----------
    shown : names that other tables show; the mounting angles determine the seats.
    """
    own = [
        entry
        for entry in in_output_units(summary).parameters
        if entry.name not in shown and not entry.name.startswith("mounting_error.")
    ]
    sheet = _quantities(summary, own, "Tables, station and reference", None, nuisance=False)
    # The same note stands below the derived quantities.
    return sheet.changed(note="", dense=True, dividers=frozenset())


def derived_sheet(summary: Summary, most: int | None = None) -> Sheet:
    """Return the derived quantities in the form of the parameters."""
    return _quantities(summary, summary.derived, "Derived quantities", most, nuisance=False)


def _quantities(
    summary: Summary, everything: Sequence[Quantity], title: str, most: int | None, nuisance: bool
) -> Sheet:
    entries = [entry for entry in everything if nuisance or not is_nuisance(entry)]
    sampling = any(map(_unsettled, entries))
    chosen = _chosen(entries, most)
    families = [QuantityName.of(entry.name).effect for entry in chosen]
    dividers = frozenset(place for place in range(1, len(chosen)) if families[place] != families[place - 1])
    note = (_note(entries, len(everything) - len(entries)) + more(len(entries) - len(chosen))).strip()
    head = ("name", "estimate", "sd", summary.interval, "unit", "from data", *(("R-hat", "ESS") if sampling else ()))
    rows = [(*_estimate(entry), *(_sampling_cells(entry) if sampling else ())) for entry in chosen]
    sheet = Sheet(title, head, rows, (0, 4), alarm_of(summary), note, dividers)
    return sheet.with_narrow(("name", "estimate ± sd", "from data"), [_short(entry) for entry in chosen], (0, 1))


def is_nuisance(entry: Quantity) -> bool:
    """Return whether a quantity is of no interest in itself, such as the attitude of a pose.

    The temperature of a run and the error of a thermometer are of interest if the data determine them better than the
    campaign states them.
    """
    if not isinstance(entry, ParameterSummary) or not entry.nuisance:
        return False
    return is_undetermined(entry) or not entry.name.startswith(_TEMPERATURES)


def _note(entries: Sequence[Quantity], left_out: int) -> str:
    note = _MEANING + sampling_note(entries)
    undetermined = sum(map(is_undetermined, entries))
    if undetermined:
        note += (
            f"{undetermined} of {len(entries)} not determined (less than {numbers.percent(NOT_DETERMINED)} from the "
            "data): their estimates are those of the prior. "
        )
    if left_out:
        note += f"{counted(left_out, 'nuisance parameter')} (of single runs and poses) left out. "
    return note


def _after(unit: str) -> str:
    """Return a unit as it stands behind a number: nothing for a number of dimension one."""
    return "" if unit == "1" else numbers.pretty(unit)


def _short(entry: Quantity) -> tuple[Cell, ...]:
    mean, sd = numbers.value_and_sd(entry.mean, entry.sd)
    mood = "weak" if is_undetermined(entry) else ""
    return cells(entry.name, Cell(f"{mean} ± {sd} {_after(entry.unit)}".strip(), mood), _from_data(entry))


def _from_data(entry: Quantity) -> Cell:
    if entry.from_data is None and (entry.prior_sd == 0 or numbers.is_exact(entry.mean, entry.prior_sd)):
        return Cell("fixed by the model", "dim")
    share = numbers.percent(entry.from_data)
    return Cell(f"{share}, not determined", "weak") if is_undetermined(entry) else Cell(share)


def _estimate(entry: Quantity) -> tuple[Cell, ...]:
    if numbers.is_exact(entry.mean, entry.sd):
        mean, sd = numbers.value_and_sd(entry.mean, entry.sd)
        return cells(entry.name, mean, sd, "", numbers.pretty(entry.unit), _from_data(entry))
    mean, sd, low, high = numbers.rounded((entry.mean, entry.sd, entry.q025, entry.q975), entry.sd)
    mood = "weak" if is_undetermined(entry) else ""
    stated = (Cell(mean, mood), Cell(sd, mood), Cell(f"{low} … {high}", mood))
    return cells(entry.name, *stated, numbers.pretty(entry.unit), _from_data(entry))


def _sampling_cells(entry: Quantity) -> tuple[Cell, Cell]:
    r_hat, size = _r_hat(entry), _effective_size(entry)
    return (
        Cell("–" if r_hat is None else f"{r_hat:.3f}", "bad" if r_hat is not None and r_hat > R_HAT else "dim"),
        Cell("–" if size is None else f"{size:.0f}", "bad" if size is not None and size < EFFECTIVE_SIZE else "dim"),
    )


def is_undetermined(entry: Quantity) -> bool:
    """Return whether the data contributed less than a tenth of the information on a quantity."""
    return entry.from_data is not None and entry.from_data < NOT_DETERMINED


def _r_hat(entry: Quantity) -> float | None:
    return entry.r_hat if isinstance(entry, ParameterSummary) else None


def _effective_size(entry: Quantity) -> float | None:
    sizes = (entry.ess_bulk, entry.ess_tail) if isinstance(entry, ParameterSummary) else ()
    return min((size for size in sizes if size is not None), default=None)


def _unsettled(entry: Quantity) -> bool:
    return any(cell.mood == "bad" for cell in _sampling_cells(entry))


def sampling_note(entries: Sequence[Quantity]) -> str:
    """Return the worst R̂ and effective size, which replace the columns if all is well."""
    r_hats = [r_hat for r_hat in map(_r_hat, entries) if r_hat is not None]
    sizes = [size for size in map(_effective_size, entries) if size is not None]
    if not r_hats or not sizes:
        return ""
    return f"Sampling: R-hat at most {max(r_hats):.3f}, effective sizes at least {min(sizes):.0f}. "


def _chosen(entries: Sequence[Quantity], most: int | None) -> Sequence[Quantity]:
    """Return at most so many quantities in their order, those that need attention before the others."""
    if most is None or len(entries) <= most:
        return entries
    questionable = [_unsettled(entry) or is_undetermined(entry) for entry in entries]
    ranked = sorted(range(len(entries)), key=lambda place: not questionable[place])
    return [entries[place] for place in sorted(ranked[: max(most, 0)])]


MARK = "*"
"""Beside an estimate that is that of the prior."""
_SHORT_FORM = ": estimate(sd in units of the last digits)"
_GAP = 2
_ANGLES = ("deg", "rad", "mrad", "urad", "arcmin", "arcsec")
_OF_ONE = re.compile(r"(?P<name>.+)\[(?P<channel>[^,\]]+)\]")


@dataclass(frozen=True)
class CalibrationSheet:
    """A table with a column for each channel, in as many blocks as its medium needs.

    Attributes
    ----------
    title : of the first block.
    channels : the columns.
    rows : name and unit of each row, and its quantity by channel.
    note : below the last block.
    """

    title: str
    channels: Sequence[str]
    rows: Sequence[tuple[str, str, dict[str, Quantity]]]
    note: str = ""

    def blocks(self, width: int | None = None) -> list[Sheet]:
        """Return the table in the fewest blocks that fit into a width, with `±` if that takes no more of them."""
        plain, short = (self._divided(is_short, width) for is_short in (False, True))
        return plain if len(plain) <= len(short) else short

    def _divided(self, is_short: bool, width: int | None) -> list[Sheet]:
        count = len(self.channels)
        for most in range(count, 0, -1):
            # As many columns in each block as there can be, and about the same number.
            size = -(-count // -(-count // most))
            parts = [self.channels[start : start + size] for start in range(0, count, size)]
            sheets = [self._block(part, is_short, first=not place) for place, part in enumerate(parts)]
            sheets[-1] = replace(sheets[-1], note=self.note)
            if width is None or most == 1 or all(_width(sheet) <= width for sheet in sheets):
                return sheets
        return []

    def _block(self, channels: Sequence[str], is_short: bool, first: bool) -> Sheet:
        rows = [
            cells(name, *(estimate_cell(own.get(channel), is_short) for channel in channels), numbers.pretty(unit))
            for name, unit, own in self.rows
            if any(channel in own for channel in channels)
        ]
        title = self.title + _SHORT_FORM * is_short if first else ""
        return Sheet(title, ("", *channels, "unit"), rows, (0, len(channels) + 1), dense=True)


def _width(sheet: Sheet) -> int:
    columns = zip(sheet.head, *([cell.text for cell in row] for row in sheet.rows), strict=True)
    return sum(max(map(len, column)) for column in columns) + _GAP * (len(sheet.head) - 1)


def estimate_cell(entry: Quantity | None, is_short: bool) -> Cell:
    """Return an estimate with its standard uncertainty, marked if it is that of the prior."""
    if entry is None:
        return Cell("")
    if entry.mean is None or entry.sd is None:
        return Cell(numbers.NO_NUMBER, "dim")
    estimate, sd = numbers.value_and_sd(entry.mean, entry.sd)
    exact = numbers.is_exact(entry.mean, entry.sd)
    text = estimate if exact else numbers.concise(entry.mean, entry.sd) if is_short else f"{estimate} ± {sd}"
    return Cell(f"{text}{MARK}", "dim") if is_undetermined(entry) else Cell(text)


def calibration_sheets(summary: Summary) -> list[CalibrationSheet]:
    """Return what was fitted of each channel alone, a table for gyros and one for accelerometers."""
    kinds: dict[str, list[str]] = {}
    for channel, (_, unit) in channel_units(summary).items():
        kind = "Gyros" if unit.partition("/")[0] in _ANGLES else "Accelerometers"
        kinds.setdefault(kind, []).append(channel)
    sheets = [CalibrationSheet(kind, kinds[kind], _rows(summary, kinds[kind])) for kind in sorted(kinds, reverse=True)]
    sheets = [sheet for sheet in sheets if sheet.rows]
    if any("_bias." in name for sheet in sheets for name, *_ in sheet.rows):
        sheets[-1] = replace(sheets[-1], note=BIAS_CONVENTION)
    return sheets


def _rows(summary: Summary, channels: Sequence[str]) -> list[tuple[str, str, dict[str, Quantity]]]:
    found: dict[tuple[str, str], dict[str, Quantity]] = {}
    for entry in in_output_units(summary).parameters:
        match = _OF_ONE.fullmatch(entry.name)
        if match and match["channel"] in channels:
            found.setdefault((match["name"], entry.unit), {})[match["channel"]] = entry
    return [(name, unit, own) for (name, unit), own in found.items()]


def axis_sheet(summary: Summary) -> Sheet:
    """Return the input axes as vectors, a row for each channel."""
    axes: dict[str, list[Quantity]] = {}
    for entry in summary.derived:
        channel = channel_of_component(entry.name)
        if channel is not None:
            axes.setdefault(channel, []).append(entry)
    wide, narrow = (
        [cells(channel, *(estimate_cell(entry, is_short) for entry in own)) for channel, own in axes.items()]
        for is_short in (False, True)
    )
    title, head = "Input axes in body axes: input_axis[channel,component]", ("", "x", "y", "z")
    return Sheet(title, head, wide, dense=True).with_narrow(head, narrow)

"""The calibration of a unit at a glance: channels as columns, what was fitted of each as rows, and the input axes.

A terminal of 80 columns has no room for three channels with their uncertainties after `±`: the form in parentheses of
GUM 7.2.2, 13.26(26), keeps them side by side.  What needs more room goes on in a further block.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from imubayes.display.labels import pretty
from imubayes.display.quantity_tables import is_undetermined
from imubayes.display.rounding import NO_NUMBER, concise, is_exact, value_and_sd
from imubayes.display.table_layout import Cell, Sheet
from imubayes.parameters.input_axis_names import channel_of_component
from imubayes.results.output_units import channel_units, in_output_units
from imubayes.results.summary import Quantity, Summary
from imubayes.units import BIAS_CONVENTION

MARK = "*"
"""Beside an estimate that is that of the prior."""
_MEANING = ": estimate(sd in units of the last digits)"
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
        """Return the table in the fewest blocks that fit into a width, with `±` where that takes no more of them."""
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
            (Cell(name), *(estimate_cell(own.get(channel), is_short) for channel in channels), Cell(pretty(unit)))
            for name, unit, own in self.rows
            if any(channel in own for channel in channels)
        ]
        title = self.title + _MEANING * is_short if first else ""
        return Sheet(title, ("", *channels, "unit"), rows, (0, len(channels) + 1), dense=True)


def _width(sheet: Sheet) -> int:
    columns = zip(sheet.head, *([cell.text for cell in row] for row in sheet.rows), strict=True)
    return sum(max(map(len, column)) for column in columns) + _GAP * (len(sheet.head) - 1)


def estimate_cell(entry: Quantity | None, is_short: bool) -> Cell:
    """Return an estimate with its standard uncertainty, marked where it is that of the prior."""
    if entry is None:
        return Cell("")
    if entry.mean is None or entry.sd is None:
        return Cell(NO_NUMBER, "dim")
    estimate, sd = value_and_sd(entry.mean, entry.sd)
    exact = is_exact(entry.mean, entry.sd)
    text = estimate if exact else concise(entry.mean, entry.sd) if is_short else f"{estimate} ± {sd}"
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
        [(Cell(channel), *(estimate_cell(entry, is_short) for entry in own)) for channel, own in axes.items()]
        for is_short in (False, True)
    )
    title, head = "Input axes in body axes: input_axis[channel,component]", ("", "x", "y", "z")
    short = Sheet(title, head, narrow, dense=True)
    return Sheet(title, head, wide, dense=True, narrow=short)

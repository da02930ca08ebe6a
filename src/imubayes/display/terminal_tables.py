"""Tables of a result for the terminal; what they say is in `imubayes.display.fit_tables`."""

from collections.abc import Iterable, Mapping
from typing import Any

from rich import box
from rich.console import Console, ConsoleOptions
from rich.table import Table
from rich.text import Text

from imubayes.display.fit_tables import (
    Sheet,
    Summary,
    alarm_of,
    contribution_sheet,
    fit_sheet,
    next_run_sheet,
    run_sheet,
    weak_sheet,
)
from imubayes.display.quantity_tables import derived_sheet, parameter_sheet

_LEAST_NAME = 16
_STYLES = {"bad": "bold red", "weak": "yellow", "dim": "dim"}


def parameter_table(summary: Summary, most: int | None = None) -> Table:
    """Return the parameters: estimate, standard uncertainty, interval, share from the data.

    Parameters
    ----------
    summary : the content of `summary.json`.
    most : rows to show; those in need of attention are kept first.
    """
    return terminal(parameter_sheet(summary, most))


def derived_table(summary: Summary, most: int | None = None) -> Table:
    """Return the derived quantities, in the form of the parameters."""
    return terminal(derived_sheet(summary, most))


def run_table(summary: Summary, most: int | None = None) -> Table:
    """Return n, χ²/n and rms residual of every run and channel; the ones that do not fit are red."""
    return terminal(run_sheet(summary, most))


def fit_table(summary: Summary) -> Table:
    """Return χ²/n with a line per run and a column per channel."""
    return terminal(fit_sheet(summary))


def weak_table(summary: Summary) -> Table:
    """Return the combinations of parameters that the runs left to the prior."""
    return terminal(weak_sheet(summary))


def next_run_table(summary: Summary) -> Table:
    """Return the runs that would determine a chosen quantity best."""
    return terminal(next_run_sheet(summary))


def contribution_table(summary: Summary) -> Table:
    """Return what each procedure tells of the mounting angles and scale factors."""
    return terminal(contribution_sheet(summary))


class SheetTable(Table):
    """A table that shows itself in fewer columns where the whole has no room.

    A name, which is searched for and typed, is folded only where there is not enough room with words wrapped.

    Attributes
    ----------
    narrow : the same in fewer columns.
    kept : width of the columns that stay whole as long as others can give way: names and numbers.
    """

    narrow: "SheetTable | None" = None
    kept: Mapping[int, int] = {}

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterable[Any]:
        ample = options.update(max_width=10_000)
        if self.narrow is not None and self.__rich_measure__(console, ample).maximum > options.max_width:
            return self.narrow.__rich_console__(console, options)
        folded = {place: (self.columns[place].no_wrap, self.columns[place].min_width) for place in self.kept}
        self._set({place: (True, width) for place, width in self.kept.items()})
        if self.__rich_measure__(console, ample).minimum > options.max_width:
            self._set(folded)
        return super().__rich_console__(console, options)

    def _set(self, columns: dict[int, tuple[bool, int | None]]) -> None:
        for place, (no_wrap, least) in columns.items():
            self.columns[place].no_wrap, self.columns[place].min_width = no_wrap, least


def terminal(sheet: Sheet) -> SheetTable:
    """Return a sheet as a table for the terminal."""
    table = _table(sheet)
    if sheet.narrow is not None:
        table.narrow = _table(sheet.narrow)
    return table


def _table(sheet: Sheet) -> SheetTable:
    title = Text()
    if sheet.alarm:
        title.append(sheet.alarm + "\n", style="bold red")
    title.append(sheet.title, style="bold")
    table = SheetTable(
        title=title,
        title_justify="left",
        caption=Text(sheet.note, style="dim") if sheet.note else None,
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        header_style="bold",
        pad_edge=False,
        min_width=len(sheet.title) + 2,
    )
    for place, name in enumerate(sheet.head):
        texts = [row[place].text for row in sheet.rows]
        widest = max((len(text) for text in texts), default=0)
        # Where the terminal is narrow, names are folded and what has spaces is wrapped, but no number is cut.
        table.add_column(
            Text(name),
            justify="left" if place in sheet.left else "right",
            overflow="fold",
            no_wrap=not any(" " in text for text in texts) and place > 0,
            min_width=min(widest, _LEAST_NAME) if place == 0 else None,
        )
        if place == 0 or any("±" in text for text in texts):
            table.kept = {**table.kept, place: max(widest, len(name))}
    for place, row in enumerate(sheet.rows):
        if place in sheet.dividers:
            table.add_section()
        table.add_row(*(Text(cell.text, style=_STYLES.get(cell.mood, "")) for cell in row))
    return table


__all__ = [
    "alarm_of",
    "contribution_table",
    "derived_table",
    "fit_table",
    "next_run_table",
    "parameter_table",
    "run_table",
    "terminal",
    "weak_table",
]

"""A table independent of the medium: one renderer for the terminal, one for HTML."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from rich import box
from rich.console import Console, ConsoleOptions
from rich.table import Table
from rich.text import Text

from imubayes.display.templates import render

_LEAST_NAME = 16
_MOST_WORD = 24
_STYLES = {"bad": "bold red", "weak": "yellow", "dim": "dim", "": ""}


@dataclass(frozen=True)
class Cell:
    """Text with its emphasis: none, `bad`, `weak` or `dim`."""

    text: str
    mood: str = ""


@dataclass(frozen=True)
class Sheet:
    """A table independent of the medium.

    Attributes
    ----------
    title, head, rows : content.
    left : left-aligned columns; the others are right-aligned.
    alarm : warning above the table, in red.
    note : explanation below the table.
    dividers : rows before which a new group begins.
    narrow : the same content in fewer columns, for narrow terminals.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    left: Sequence[int] = (0,)
    alarm: str = ""
    note: str = ""
    dividers: frozenset[int] = field(default_factory=frozenset)
    narrow: "Sheet | None" = None


def without_alarm(sheet: Sheet) -> Sheet:
    """Return a sheet without its warning, which another sheet above has said."""
    return replace(sheet, alarm="", narrow=None if sheet.narrow is None else without_alarm(sheet.narrow))


def of_columns(sheet: Sheet, places: Sequence[int]) -> Sheet:
    """Return a sheet with some of its columns alone."""
    return replace(
        sheet,
        head=[sheet.head[place] for place in places],
        rows=[[row[place] for place in places] for row in sheet.rows],
        left=[new for new, old in enumerate(places) if old in sheet.left],
        narrow=None,
    )


def sheet_html(sheet: Sheet, folded: bool = False) -> str:
    """Return a sheet as an HTML table, collapsed where `folded`."""
    return render("sheet_only", sheet=sheet, folded=folded)


def terminal(sheet: Sheet) -> "SheetTable":
    """Return a sheet as a rich table."""
    return SheetTable(sheet, None if sheet.narrow is None else SheetTable(sheet.narrow))


class SheetTable(Table):
    """A rich table that falls back to fewer columns where the terminal is too narrow.

    Names and numbers stay on one line as long as other columns can be wrapped instead; no number is ever truncated.
    """

    def __init__(self, sheet: Sheet, narrow: "SheetTable | None" = None):
        alarm = f"{sheet.alarm}\n" if sheet.alarm else ""
        super().__init__(
            title=Text.assemble((alarm, "bold red"), (sheet.title, "bold")),
            title_justify="left",
            caption=Text(sheet.note, style="dim") if sheet.note else None,
            caption_justify="left",
            box=box.SIMPLE_HEAD,
            header_style="bold",
            pad_edge=False,
            min_width=len(sheet.title) + 2,
        )
        self._narrow = narrow
        self._unbroken: dict[int, int] = {}
        for place, name in enumerate(sheet.head):
            self._add_column(place, name, [row[place].text for row in sheet.rows], place in sheet.left)
        for place, row in enumerate(sheet.rows):
            if place in sheet.dividers:
                self.add_section()
            self.add_row(*(Text(cell.text, style=_STYLES[cell.mood]) for cell in row))

    def _add_column(self, place: int, name: str, texts: Sequence[str], left: bool) -> None:
        widest = max(map(len, texts), default=0)
        # A column of single words keeps them whole; its heading may wrap.
        single = place > 0 and not any(" " in text for text in texts)
        whole = max(widest, *map(len, name.split()), 0) if single else None
        if left and place > 0 and not single:
            # Lists of names wrap between the names: names cut in two are not told apart.
            whole = min(max((len(word) for text in texts for word in text.split()), default=0), _MOST_WORD)
        self.add_column(
            Text(name),
            justify="left" if left else "right",
            overflow="fold",
            min_width=min(widest, _LEAST_NAME) if place == 0 else whole,
        )
        if place == 0 or any("±" in text for text in texts):
            self._unbroken[place] = max(widest, len(name))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterable[Any]:
        ample = options.update(max_width=10_000)
        if self._narrow is not None and self.__rich_measure__(console, ample).maximum > options.max_width:
            return self._narrow.__rich_console__(console, options)
        wrapped = {place: (self.columns[place].no_wrap, self.columns[place].min_width) for place in self._unbroken}
        self._set({place: (True, width) for place, width in self._unbroken.items()})
        if self.__rich_measure__(console, ample).minimum > options.max_width:
            self._set(wrapped)
        return super().__rich_console__(console, options)

    def _set(self, columns: Mapping[int, tuple[bool, int | None]]) -> None:
        for place, (no_wrap, least) in columns.items():
            self.columns[place].no_wrap, self.columns[place].min_width = no_wrap, least

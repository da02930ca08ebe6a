"""Tables and reports independent of the medium, with renderers for the terminal, plain text and HTML templates.

A table has one renderer for the terminal and one for HTML.  A report is free of its medium: sentences, tables, closing
lines; it is shown on a terminal, as text and as HTML.  Everything put into the HTML templates of the package is
escaped.
"""

import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from html import escape
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from rich import box
from rich.console import Console, ConsoleOptions
from rich.table import Table
from rich.text import Text

_KERNEL = "imubayes.display"


@cache
def _environment(package: str) -> Environment:
    places = [PackageLoader(name) for name in dict.fromkeys((package, _KERNEL))]
    return Environment(
        loader=ChoiceLoader(places), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )


def render(name: str, package: str = _KERNEL, **context: object) -> str:
    """Return the HTML of `templates/NAME.html.j2` of a package.

    A table is drawn by the macro `sheet_table(sheet, folded=false, alarm=true)` of `sheet.html.j2`.
    """
    return _environment(package).get_template(f"{name}.html.j2").render(context)


_LEAST_NAME = 16
_MOST_WORD = 24
_BETWEEN_NUMBERS = ("±", "→")
_STYLES = {"bad": "bold red", "weak": "yellow", "dim": "dim", "": ""}


@dataclass(frozen=True)
class Cell:
    """Text with its emphasis: none, `good`, `bad`, `weak` or `dim`; in a formula `_` begins a subscript, ``K_oo``.

    The sign of a negative number is the one of the keyboard, so that programs read a number that was copied.
    """

    text: str
    mood: str = ""
    formula: bool = False


def cells(*texts: str | Cell) -> tuple[Cell, ...]:
    """Return a row of a table; texts stand in it without emphasis."""
    return tuple(text if isinstance(text, Cell) else Cell(text) for text in texts)


@runtime_checkable
class Tabular(Protocol):
    """What comes in one or several tables, depending on the room there is."""

    def blocks(self, width: int | None = None) -> Sequence["Sheet"]:
        """Return the tables for a medium of so many columns; none if there is nothing to show."""
        ...


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
    dense : without margins on the terminal.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    left: Sequence[int] = (0,)
    alarm: str = ""
    note: str = ""
    dividers: frozenset[int] = field(default_factory=frozenset)
    narrow: "Sheet | None" = None
    dense: bool = False
    type: ClassVar[Literal["table"]] = "table"

    def blocks(self, width: int | None = None) -> Sequence["Sheet"]:
        """Return the table, whatever the width, unless it has no rows."""
        return [self] if self.rows else []

    def with_narrow(self, head: Sequence[str], rows: Sequence[Sequence[Cell]], left: Sequence[int] = (0,)) -> "Sheet":
        """Return the table with its content in other columns for narrow terminals."""
        return replace(self, narrow=replace(self, head=head, rows=rows, left=left))

    def with_few(self, *places: int) -> "Sheet":
        """Return the table with some of its columns alone for narrow terminals."""
        return replace(self, narrow=of_columns(self, places))

    def changed(self, **changes: Any) -> "Sheet":
        """Return the table with other attributes, on narrow terminals as well."""
        return replace(self, narrow=None if self.narrow is None else self.narrow.changed(**changes), **changes)

    def few(self, most: int) -> "Sheet":
        """Return at most so many of its first rows, with a note of how many there are."""
        left = len(self.rows) - most
        return self.first(most, f"{left} more with --verbose. {self.note}".strip()) if left > 0 else self

    def first(self, most: int, note: str) -> "Sheet":
        """Return at most so many of its first rows, with another note."""
        narrow = None if self.narrow is None else self.narrow.first(most, note)
        return replace(self, rows=self.rows[:most], note=note, narrow=narrow)


def of_columns(sheet: Sheet, places: Sequence[int]) -> Sheet:
    """Return a sheet with some of its columns alone."""
    return replace(
        sheet,
        head=[sheet.head[place] for place in places],
        rows=[tuple(row[place] for place in places) for row in sheet.rows],
        left=tuple(new for new, old in enumerate(places) if old in sheet.left),
        narrow=None,
    )


def sheet_html(sheet: Sheet, folded: bool = False) -> str:
    """Return a sheet as an HTML table, collapsed if `folded`."""
    return render("sheet_only", sheet=sheet, folded=folded)


def terminal(sheet: Sheet) -> "SheetTable":
    """Return a sheet as a rich table."""
    return SheetTable(sheet, None if sheet.narrow is None else SheetTable(sheet.narrow))


class SheetTable(Table):
    """A rich table that falls back to fewer columns if the terminal is too narrow.

    Names and numbers stay on one line as long as other columns can be wrapped instead; no number is ever truncated.
    """

    def __init__(self, sheet: Sheet, narrow: "SheetTable | None" = None):
        alarm = f"{sheet.alarm}\n" if sheet.alarm else ""
        super().__init__(
            title=Text.assemble((alarm, "bold red"), (sheet.title, "bold")) if alarm or sheet.title else None,
            title_justify="left",
            caption=Text(sheet.note, style="dim") if sheet.note else None,
            caption_justify="left",
            box=box.SIMPLE_HEAD,
            header_style="bold",
            pad_edge=False,
            padding=(0, 1, 0, 0) if sheet.dense else (0, 1),
            show_edge=not sheet.dense,
        )
        self._title_width = len(sheet.title) + 2
        self._narrow = narrow
        self._widths = [
            _Width.of(place, name, [row[place].text for row in sheet.rows]) for place, name in enumerate(sheet.head)
        ]
        for place, name in enumerate(sheet.head):
            self.add_column(Text(name), justify="left" if place in sheet.left else "right", overflow="fold")
        for place, row in enumerate(sheet.rows):
            if place in sheet.dividers:
                self.add_section()
            self.add_row(*(Text(cell.text, style=_STYLES[cell.mood]) for cell in row))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterable[Any]:
        for column, width in zip(self.columns, self._widths, strict=True):
            column.width = width.natural
        self.min_width = None
        ample = self.__rich_measure__(console, options.update(max_width=10_000)).maximum
        if ample > options.max_width:
            if self._narrow is not None:
                return self._narrow.__rich_console__(console, options)
            # Rich itself shrinks columns below the width of their words, and crops what then does not fit.
            between = ample - sum(width.natural for width in self._widths)
            for column, width in zip(self.columns, _fitted(self._widths, options.max_width - between), strict=True):
                column.width = width
        self.min_width = self._title_width
        return super().__rich_console__(console, options)


@dataclass(frozen=True)
class _Width:
    """Width of a column with room, with whole names and values, with values beside uncertainties, with whole words."""

    natural: int
    whole: int
    values: int
    words: int

    @classmethod
    def of(cls, place: int, head: str, texts: Sequence[str]) -> "_Width":
        widest = max(map(len, texts), default=0)
        natural = max(widest, len(head))
        longest = max((len(word) for text in (head, *texts) for word in text.split()), default=0)
        if place > 0 and not any(" " in text for text in texts):
            return cls(natural, longest, longest, longest)  # single words; the heading may wrap
        # Names cut in two are not distinguished, and numbers stay beside their uncertainty.
        numbers = any(sign in text for text in texts for sign in _BETWEEN_NUMBERS)
        prose = any(word.isalpha() and len(word) > 1 for text in texts for word in text.split())
        whole = longest if prose and not numbers else widest
        words = min(longest, _MOST_WORD) if place else min(widest, _LEAST_NAME)
        values = max(words, _widest_value(texts) if place else longest)
        return cls(natural, max(whole, longest), values, words)


def _widest_value(texts: Sequence[str]) -> int:
    """Return the length of the longest number with its uncertainty, without its unit."""
    joined = (part for text in texts for part in text.replace(" ± ", "_±_").split())
    return max((len(part) for part in joined if "±" in part), default=0)


def _fitted(columns: Sequence[_Width], room: int) -> list[int]:
    """Return the widths of columns in so much room: text is wrapped before units, units before names, values last."""
    widths = [column.natural for column in columns]
    whole, values, words = ([getattr(column, each) for column in columns] for each in ("whole", "values", "words"))
    for least in (whole, values, words, [1] * len(columns)):
        while sum(widths) > room:
            spare = [width if width > floor else 0 for width, floor in zip(widths, least, strict=True)]
            if not any(spare):
                break
            widths[spare.index(max(spare))] -= 1
    return widths


@dataclass(frozen=True)
class Report:
    """Lines said first, tables of evidence (those without rows are left out), lines said last; a warning above all."""

    lines: Sequence[str]
    sheets: Sequence[Tabular] = ()
    closing: Sequence[str] = ()
    alarm: str = ""


def print_report(report: Report, console: Console | None = None) -> None:
    """Print a report on a terminal."""
    console = console or Console()
    if report.alarm:
        console.print(report.alarm, style="bold red", highlight=False, markup=False, soft_wrap=True)
    _print_lines(console, report.lines)
    for sheet in report.sheets:
        for block in sheet.blocks(console.width):
            console.print(terminal(block))
            if block.dense:
                console.print()
    _print_lines(console, report.closing)


def report_text(report: Report, width: int = 120) -> str:
    """Return a report as plain text.

    In a notebook rich would show the tables by itself and leave the text empty.
    """
    buffer = io.StringIO()
    print_report(report, Console(file=buffer, width=width, color_system=None, force_jupyter=False))
    return buffer.getvalue().rstrip("\n")


def report_html(report: Report) -> str:
    """Return a report as HTML for a notebook."""
    tables = "".join(sheet_html(block) for sheet in report.sheets for block in sheet.blocks())
    alarm = f'<p style="color:#d33;font-weight:600">{escape(report.alarm)}</p>' if report.alarm else ""
    return alarm + _paragraphs(report.lines) + tables + _paragraphs(report.closing)


def _paragraphs(lines: Sequence[str]) -> str:
    return "".join(f"<p>{escape(line)}</p>" for line in lines)


def _print_lines(console: Console, lines: Sequence[str]) -> None:
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)

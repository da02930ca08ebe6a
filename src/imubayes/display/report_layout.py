"""A report free of its medium: sentences, tables, closing lines; shown on a terminal, as text and as HTML."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from rich.console import Console

from imubayes.display.table_layout import Tabular, sheet_html, terminal


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

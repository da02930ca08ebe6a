"""What is printed on a terminal: the verdict first, then the tables, then what was not determined."""

import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from imubayes.display.classical_comparison import beside_sheet, decision_sheet, textbook_sheet, undetermined_sheet
from imubayes.display.terminal_tables import (
    contribution_table,
    derived_table,
    next_run_table,
    parameter_table,
    run_table,
    terminal,
    weak_table,
)


def print_summary(summary: dict[str, Any], verbose: bool = False) -> None:
    """Print a summary; the parameters of single poses only where `verbose`."""
    _show(summary, Console(), verbose)


def summary_text(summary: dict[str, Any], width: int = 120) -> str:
    """Return a summary as plain text."""
    buffer = io.StringIO()
    _show(summary, Console(file=buffer, width=width, color_system=None), verbose=False)
    return buffer.getvalue()


def _show(summary: dict[str, Any], console: Console, verbose: bool) -> None:
    shown = summary | {
        "parameters": [line for line in summary["parameters"] if verbose or not line["nuisance"]],
        "runs": summary["runs"] if verbose else [],
    }
    console.print(parameter_table(shown))
    console.print(derived_table(shown))
    if verbose:
        console.print(run_table(shown))
    if summary["weak_directions"]:
        console.print(weak_table(summary))
    if summary["next_runs"]:
        console.print(next_run_table(summary))
    if summary.get("contributions"):
        console.print(contribution_table(summary))
    seconds = summary["seconds"]
    chi2 = "–" if summary["chi2"] is None else f"{summary['chi2']:.1f}"
    console.print(
        f"chi2 {chi2} for {summary['dof']:.0f} degrees of freedom; "
        f"fit {seconds['fit']:.1f} s, sampling {seconds['sample']:.1f} s; "
        f"intervals are {summary['interval']}; uncertainty is the {summary['uncertainty']}",
        highlight=False,
    )


def print_comparison(runs: Table, textbook: Mapping[str, Any] | None, pictures: Iterable[Path]) -> None:
    """Print the table per run and channel, the textbook beside the joint fit, and where the pictures are."""
    console = Console()
    console.print(runs)
    if textbook is not None:
        beside = beside_sheet(textbook)
        if beside.rows:
            console.print(terminal(beside))
    for path in pictures:
        console.print(str(path), highlight=False, soft_wrap=True)


def print_textbook(facts: Mapping[str, Any]) -> None:
    """Print textbook estimates, and what they leave open."""
    console = Console()
    for sheet in (textbook_sheet(facts), decision_sheet(facts), undetermined_sheet(facts)):
        if sheet.rows:
            console.print(terminal(sheet))
    if not facts["estimates"]:
        console.print("The textbook has no evaluation for these runs.", highlight=False)

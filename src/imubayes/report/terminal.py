"""What is printed on a terminal: the verdict first, then the tables, then what was not determined."""

import io
from typing import Any

from rich.console import Console

from imubayes.report.comparison import Comparison
from imubayes.report.tables import (
    derived_table,
    next_run_table,
    parameter_table,
    run_table,
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
    seconds = summary["seconds"]
    console.print(
        f"chi2 {summary['chi2']:.1f} for {summary['dof']:.0f} degrees of freedom; "
        f"fit {seconds['fit']:.1f} s, sampling {seconds['sample']:.1f} s; "
        f"intervals are {summary['interval']}; uncertainty is the {summary['uncertainty']}",
        highlight=False,
    )


def print_comparison(comparison: Comparison) -> None:
    """Print the table per run and channel, and where the pictures are."""
    console = Console()
    console.print(comparison.runs)
    for path in comparison.pictures:
        console.print(str(path), highlight=False, soft_wrap=True)

"""What `imubayes batch` says: how far it is, what is in the results folder, and which units have no estimates."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import polars as pl

from imubayes.batch.run_batch import BatchProgress
from imubayes.display.archive_report import counted
from imubayes.display.report_layout import Report
from imubayes.display.table_layout import Cell, Sheet

_SHOWN = 20


def progress_text(state: BatchProgress) -> str:
    """Return how far a batch is, in one line."""
    left = state.seconds_left
    parts = [f"{state.before + state.done} of {state.units} units"]
    if state.done:
        parts.append(f"{state.rate:.3g} units/s")
    if state.failed:
        parts.append(f"{state.failed} without estimates")
    if left is not None and left >= 1:
        parts.append(f"{_duration(left)} left")
    return ", ".join(parts)


def _duration(seconds: float) -> str:
    hours, minutes = int(seconds // 3600), int(seconds % 3600 // 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {int(seconds % 60)} s" if minutes else f"{int(seconds)} s"


def batch_report(state: BatchProgress, units: pl.DataFrame, out: Path) -> Report:
    """Return what a batch did, and the units without estimates.

    Parameters
    ----------
    units : the table of units of the model.
    """
    said = f"{counted(state.done, 'unit')} fitted in {_duration(state.seconds)}, {state.before} done before"
    failed = units.filter(pl.col("status") != "fitted")
    rows = [
        [Cell(str(row[name])) for name in ("unit", "status", "reason", "file")]
        for row in failed.head(_SHOWN).iter_rows(named=True)
    ]
    # A reason and a path beside each other leave neither enough room on 80 columns.
    title = "Units without estimates"
    slim = [[unit, _below(*further)] for unit, *further in rows]
    apart = frozenset(range(1, len(slim)))
    narrow = Sheet(title, ("unit", "status, reason, file"), slim, left=(0, 1), dividers=apart)
    sheet = Sheet(title, ("unit", "status", "reason", "file"), rows, left=(0, 1, 2, 3), narrow=narrow)
    closing = [f"result in {out}: {units.height - failed.height} fitted, {failed.height} without estimates"]
    if failed.height > _SHOWN:
        closing.insert(0, f"{failed.height - _SHOWN} more are in units.parquet")
    return Report([said], [sheet], closing)


def _below(*cells: Cell) -> Cell:
    """Return cells as one, a line each."""
    return Cell("\n".join(cell.text for cell in cells))


def batch_json(state: BatchProgress, units: pl.DataFrame, model: str) -> dict[str, Any]:
    """Return what a batch did, for `--json`."""
    failed = units.filter(pl.col("status") != "fitted").select("unit", "campaign", "digest", "status", "reason", "file")
    return {
        "format": 1, "model": model, "units": units.height, "fitted": units.height - failed.height,
        "done_now": state.done, "done_before": state.before, "seconds": state.seconds, "failed": _rows(failed),
    }  # fmt: skip


def _rows(frame: pl.DataFrame) -> Sequence[dict[str, Any]]:
    return frame.to_dicts()

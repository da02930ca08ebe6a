"""Summary and residuals of a result folder, read without its fit."""

from pathlib import Path

import polars as pl

from imubayes.errors import InputError, Issue
from imubayes.results.manifest import checked
from imubayes.results.record_files import AGAIN, damaged, read_record
from imubayes.results.record_names import POSTERIOR, RESIDUALS, SUMMARY
from imubayes.results.residual_table import COLUMNS, Residuals
from imubayes.results.summary import Summary


def read_summary_and_residuals(folder: Path) -> tuple[Summary, Residuals]:
    """Read what every result folder has.

    Raises
    ------
    InputError
        if it is missing, incomplete, altered or damaged; every issue is in it.
    """
    manifest, issues = checked(folder), []
    try:
        summary = read_record(folder / SUMMARY, Summary)
    except InputError as error:
        summary, issues = None, [*error.issues]
    residuals = _read_residuals(folder / RESIDUALS, issues)
    if summary is not None and summary.sampled and not manifest.holds(POSTERIOR):
        where = str(folder / POSTERIOR)
        issues.append(Issue("the posterior is missing", where, f"{POSTERIOR}, as written by the fit", AGAIN))
    if issues or summary is None or residuals is None:
        raise InputError(issues)
    return summary, residuals


def _read_residuals(file: Path, issues: list[Issue]) -> Residuals | None:
    try:
        frame = pl.read_parquet(file)
    except (OSError, pl.exceptions.PolarsError) as error:
        issues.append(damaged(file, error))
        return None
    absent = [name for name in COLUMNS if name not in frame.columns]
    if absent:
        issues.append(
            Issue(f"the residuals lack the columns {', '.join(absent)}", str(file), ", ".join(COLUMNS), AGAIN)
        )
        return None
    if frame.is_empty():
        issues.append(Issue("the residuals have no rows", str(file), "one row per run, row and channel", AGAIN))
        return None
    return Residuals(frame)

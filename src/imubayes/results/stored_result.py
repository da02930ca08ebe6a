"""Reading a result folder back, and saying what is wrong with one that cannot be read."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from imubayes.errors import InputError, Issue, closest_first

FORMAT = 1
CHECKPOINT, SUMMARY = "checkpoint.h5", "summary.json"
_FILES = (SUMMARY, "residuals.parquet")
_KEYS = ("campaign", "model", "converged", "parameters", "derived", "runs", "chi2", "dof")
_LISTS = {
    "parameters": ("name", "unit", "mean", "sd", "q025", "q975", "from_data"),
    "derived": ("name", "unit", "mean", "sd", "q025", "q975", "from_data"),
    "runs": ("name", "channel", "n", "chi2", "rms", "unit"),
}
_COLUMNS = (
    "run", "procedure", "row", "channel", "kind", "observed", "predicted", "sd", "model_sd", "residual",
    "output_unit", "input_residual", "input_sd", "input_unit", "whitened",
)  # fmt: skip
_AGAIN = "run `imubayes fit` again with this folder as --out"


@dataclass(frozen=True)
class StoredResult:
    """A result folder as read: the summary, the residuals, and where the posterior is (None without sampling)."""

    folder: Path
    summary: dict[str, Any]
    residuals: pl.DataFrame
    posterior: Path | None


def read_stored(folder: str | Path) -> StoredResult:
    """Read a result folder.

    Raises
    ------
    InputError
        if it is missing, incomplete or damaged; every problem is in it.
    """
    folder = Path(folder)
    missing = _missing(folder)
    if missing:
        raise InputError(missing)
    issues: list[Issue] = []
    summary = _summary(folder / "summary.json", issues)
    residuals = _residuals(folder / "residuals.parquet", issues)
    posterior = folder / "posterior.nc"
    if summary is not None and summary.get("sampled", True) and not posterior.is_file():
        issues.append(
            Issue("the posterior is not there", str(posterior), "posterior.nc, as written by the fit", _AGAIN)
        )
    if issues or summary is None or residuals is None:
        raise InputError(issues)
    return StoredResult(folder, summary, residuals, posterior if posterior.is_file() else None)


def way_back(folder: Path) -> str:
    """Return what to do where a folder holds no result."""
    if _only_begun(folder):
        return "its sampling was interrupted: run the same `imubayes fit` again with --resume"
    return "correct the path, or run the fit again"


def _only_begun(folder: Path) -> bool:
    return (folder / CHECKPOINT).is_file() and not (folder / SUMMARY).is_file()


def damaged(file: Path, reason: object) -> Issue:
    """Return the problem of a file that is there but cannot be read."""
    detail = " ".join(str(reason).split())[:200]
    return Issue(f"{file.name} cannot be read: {detail}", str(file), "a whole file, as the fit wrote it", _AGAIN)


def _missing(folder: Path) -> list[Issue]:
    allowed = "a result folder with " + ", ".join(_FILES)
    if not folder.exists():
        beside = folder.parent if folder.parent.is_dir() else Path()
        near = sorted(path.parent.name for path in beside.glob("*/summary.json"))
        listed = f"{allowed}; beside it: {closest_first(folder.name, near)}" if near else allowed
        return [Issue("there is no such result folder", str(folder), listed, "name the folder given to --out")]
    if not folder.is_dir():
        return [Issue("this is a file, not a result folder", str(folder), allowed, "name the folder it lies in")]
    if _only_begun(folder):
        return [Issue("there is no result yet", str(folder / SUMMARY), allowed, way_back(folder))]
    return [
        Issue(f"the result folder has no {name}", str(folder / name), allowed, _AGAIN)
        for name in _FILES
        if not (folder / name).is_file()
    ]


def _summary(file: Path, issues: list[Issue]) -> dict[str, Any] | None:
    try:
        summary = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        issues.append(damaged(file, error))
        return None
    if not isinstance(summary, dict) or summary.get("format") != FORMAT:
        found = summary.get("format") if isinstance(summary, dict) else type(summary).__name__
        issues.append(Issue(f"format is {found!r}", f"{file}, key format", f"format = {FORMAT}", _AGAIN))
        return None
    absent = [key for key in _KEYS if key not in summary]
    for key, wanted in _LISTS.items():
        entries = summary.get(key)
        if key in summary and not (isinstance(entries, list) and all(isinstance(one, dict) for one in entries)):
            absent.append(f"{key} (a list of objects)")
        elif entries:
            absent += [f"{key}[{i}].{name}" for i, one in enumerate(entries) for name in wanted if name not in one][:3]
    if absent:
        issues.append(Issue(f"the summary lacks {', '.join(absent)}", str(file), ", ".join(_KEYS), _AGAIN))
        return None
    return summary


def _residuals(file: Path, issues: list[Issue]) -> pl.DataFrame | None:
    try:
        frame = pl.read_parquet(file)
    except (OSError, pl.exceptions.PolarsError) as error:
        issues.append(damaged(file, error))
        return None
    absent = [name for name in _COLUMNS if name not in frame.columns]
    if absent:
        issues.append(
            Issue(f"the residuals lack the columns {', '.join(absent)}", str(file), ", ".join(_COLUMNS), _AGAIN)
        )
        return None
    if frame.is_empty():
        issues.append(Issue("the residuals have no rows", str(file), "one row per run, row and channel", _AGAIN))
        return None
    return frame

"""Names of the files of a result folder, and what is missing in one."""

from pathlib import Path

from imubayes.errors import Issue, closest_first
from imubayes.results.record_files import AGAIN

SUMMARY = "summary.json"
FIT = "fit.json"
MODEL = "model.toml"
RESIDUALS = "residuals.parquet"
POSTERIOR = "posterior.nc"
CHECKPOINT = "checkpoint.h5"
MANIFEST = "manifest.json"
HISTORY = "history.json"
CHANGE, ADDED_VARIABLE = "change.json", "added_variable.parquet"
DIAGNOSIS, BUDGETS = "diagnosis.json", "budgets.json"
PAGE = "compare.html"
BY_OTHER_COMMANDS = {DIAGNOSIS: "diagnose", BUDGETS: "report"}
"""File that is made of a finished fit → the command that makes it."""
_NEEDED = (SUMMARY, RESIDUALS)


def missing(folder: Path) -> list[Issue]:
    """Return what keeps a folder from being a result, before any of its files is read."""
    allowed = "a result folder with " + ", ".join(_NEEDED)
    if not folder.exists():
        parent = folder.parent if folder.parent.is_dir() else Path()
        near = sorted(path.parent.name for path in parent.glob(f"*/{SUMMARY}"))
        listed = f"{allowed}; in the same place: {closest_first(folder.name, near)}" if near else allowed
        return [Issue("there is no such result folder", str(folder), listed, "name the folder given to --out")]
    if not folder.is_dir():
        return [Issue("this is a file, not a result folder", str(folder), allowed, "name the folder it lies in")]
    if _only_begun(folder):
        return [Issue("there is no result yet", str(folder / SUMMARY), allowed, way_back(folder))]
    absent = [name for name in _NEEDED if not (folder / name).is_file()]
    return [Issue(f"the result folder has no {name}", str(folder / name), allowed, AGAIN) for name in absent]


def way_back(folder: Path) -> str:
    """Return what to do where a folder holds no result."""
    if _only_begun(folder):
        return "its sampling was interrupted: run the same `imubayes fit` again with --resume"
    return "correct the path, or run the fit again"


def _only_begun(folder: Path) -> bool:
    return (folder / CHECKPOINT).is_file() and not (folder / SUMMARY).is_file()

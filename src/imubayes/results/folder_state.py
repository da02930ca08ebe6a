"""What a result folder holds: names of its files, whether it can take a result, and what is wrong with one."""

import json
from pathlib import Path

from pydantic import ValidationError

from imubayes.errors import InputError, Issue, closest_first
from imubayes.inference.checkpoint import steps_in
from imubayes.json_record import Record

SUMMARY, FIT, MODEL = "summary.json", "fit.json", "model.toml"
RESIDUALS, POSTERIOR, CHECKPOINT = "residuals.parquet", "posterior.nc", "checkpoint.h5"
AGAIN = "run `imubayes fit` again with this folder as --out"
_NEEDED = (SUMMARY, RESIDUALS)
# Faults of a damaged record that are listed.
_MOST_FAULTS = 3


def claim(folder: Path, resume: bool = False, replace: bool = False) -> None:
    """Make sure that a folder can take a result, before anything is computed.

    Raises
    ------
    InputError
        where it holds files but no result, a sampling that was interrupted and is not to be resumed, or a sampled
        result that is not to be replaced.
    """
    if folder.is_dir():
        held = [file.name for file in folder.iterdir() if not file.name.startswith(".")]
        if held and not any((folder / name).is_file() for name in (FIT, CHECKPOINT)):
            raise InputError(
                Issue(
                    f"the folder holds '{min(held)}' and no result",
                    str(folder),
                    "a folder that does not exist yet, an empty one, or one with a result, which is replaced",
                    "choose another --out",
                )
            )
        if not resume and _interrupted(folder):
            raise InputError(
                Issue(
                    "the folder holds a sampling that was interrupted",
                    str(folder / CHECKPOINT),
                    "the same fit with --resume, which continues it",
                    f"add --resume; to begin anew choose another --out, or remove {folder / CHECKPOINT}",
                )
            )
        if not (resume or replace) and (folder / POSTERIOR).is_file() and _sampled(folder):
            raise InputError(
                Issue(
                    "the folder holds a sampled result",
                    str(folder),
                    "a folder that does not exist yet, an empty one, or a result that was not sampled",
                    f"choose another --out, or add --replace (in Python replace=True) to lose {folder / POSTERIOR}",
                )
            )
    if not resume:
        folder.mkdir(parents=True, exist_ok=True)


def claim_new(folder: Path, parent: Path | None) -> Path:
    """Return a folder for the model after `parent`; raises InputError where it holds a result."""
    if (folder / FIT).exists() or (parent is not None and folder.resolve() == parent.resolve()):
        raise InputError(
            Issue(
                "the folder holds a result already",
                str(folder),
                "a folder that does not exist yet: each model tried keeps its own",
                "choose another --out, or remove the folder",
            )
        )
    claim(folder, resume=True)
    return folder


def _sampled(folder: Path) -> bool:
    """Tell whether the result of a folder was sampled; one that cannot be read is taken for sampled."""
    try:
        return json.loads((folder / SUMMARY).read_bytes()).get("sampled") is not False
    except (OSError, ValueError, AttributeError):
        return True


def _interrupted(folder: Path) -> bool:
    """Tell whether a folder holds a sampling of which there is no result."""
    checkpoint, summary = folder / CHECKPOINT, folder / SUMMARY
    if not steps_in(checkpoint):
        return False
    return not summary.is_file() or summary.stat().st_mtime_ns < checkpoint.stat().st_mtime_ns


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


def damaged(file: Path, reason: object, key: str = "") -> Issue:
    """Return the issue of a file that is there but cannot be read."""
    detail = " ".join(str(reason).split())[:200]
    where = f"{file}, key {key}" if key else str(file)
    return Issue(f"{file.name} cannot be read: {detail}", where, "a whole file, as the fit wrote it", AGAIN)


def read_record[Kept: Record](file: Path, record: type[Kept], absent: Issue | None = None) -> Kept:
    """Read a JSON file of a result folder as its typed record.

    Raises
    ------
    InputError
        with its first faults where it cannot be read; `absent` where there is no such file.
    """
    if absent is not None and not file.is_file():
        raise InputError(absent)
    try:
        return record.model_validate_json(file.read_bytes())
    except OSError as error:
        raise InputError(damaged(file, error)) from error
    except ValidationError as error:
        faults = error.errors()[:_MOST_FAULTS]
        issues = [damaged(file, fault["msg"], ".".join(map(str, fault["loc"]))) for fault in faults]
        raise InputError(issues) from error

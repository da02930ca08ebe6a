"""Files of a result folder as typed records, and what is said of one that cannot be read."""

from pathlib import Path

from pydantic import ValidationError

from imubayes.errors import InputError, Issue
from imubayes.json_record import Record

AGAIN = "run `imubayes fit` again with this folder as --out and --replace"


# Faults of a damaged record that are listed.
_MOST_FAULTS = 3


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

"""Atomic writing of a campaign folder: to a temporary folder, renamed at the end."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import tomlkit

from imubayes.atomic_files import new_folder
from imubayes.campaign.campaign_reader import CAMPAIGN_FILE, inspect_campaign
from imubayes.errors import InputError, input_error


def write_campaign(
    out: Path,
    document: Mapping[str, Any],
    tables: Mapping[str, Mapping[str, np.ndarray]],
    check: bool = True,
    came_from: Callable[[str], str] = lambda where: where,
) -> None:
    """Write `campaign.toml` and run tables into a new folder.

    Parameters
    ----------
    out : the folder; must not exist, or be empty.
    document : content of `campaign.toml`.
    tables : path of a run table within the folder → its columns.
    check : read the campaign back before it is moved into place.
    came_from : place in the campaign → the place in its source, for errors.

    Raises
    ------
    InputError
        if the folder is not empty, or the campaign would not load.
    """
    refuse_occupied(out)
    with new_folder(out) as draft:
        for name, columns in tables.items():
            (draft / name).parent.mkdir(parents=True, exist_ok=True)
            _write_csv(draft / name, columns)
        (draft / CAMPAIGN_FILE).write_text(tomlkit.dumps(document), encoding="utf-8")
        issues = inspect_campaign(draft).issues if check else ()
        if issues:
            raise InputError(
                replace(issue, where=came_from(issue.where.replace(str(draft), str(out)))) for issue in issues
            )


def refuse_occupied(out: Path) -> None:
    """Raise an `InputError` if the folder is not empty, or is a file."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise input_error(
            f"'{out}' exists and is not an empty folder",
            str(out),
            "a folder that does not exist yet, or an empty one",
            "choose another name, or remove the folder first",
        )


def _write_csv(file: Path, columns: Mapping[str, np.ndarray]) -> None:
    with file.open("wb") as stream:
        stream.write((",".join(columns) + "\n").encode())
        pacsv.write_csv(pa.table(dict(columns)), stream, pacsv.WriteOptions(include_header=False))

"""Write a campaign folder: `campaign.toml` and the tables of its runs."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import tomlkit

from imubayes.campaign.campaign_reader import CAMPAIGN_FILE, inspect_campaign
from imubayes.campaign.run_tables import BATCH_ROWS
from imubayes.foundations.errors import InputError, Issue
from imubayes.foundations.files import new_folder, refuse_occupied


def write_campaign(
    out: Path,
    document: Mapping[str, Any],
    tables: Mapping[str, Mapping[str, np.ndarray]],
    check: bool = True,
    came_from: Callable[[str], str] = lambda where: where,
    beside: Mapping[str, str] | None = None,
    to_correct: bool = False,
) -> None:
    """Write `campaign.toml` and run tables into a new folder.

    Parameters
    ----------
    out : the folder; must not exist, or be empty.
    document : content of `campaign.toml`.
    tables : path of a run table within the folder → its columns.
    check : read the campaign back before it is moved into place.
    came_from : place in the campaign → the place in its source, for errors.
    beside : name of a further text file → its content.
    to_correct : whether a campaign that would not load is written all the same, with its faults at its head.

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
        for name, text in {CAMPAIGN_FILE: tomlkit.dumps(document), **(beside or {})}.items():
            (draft / name).write_text(text, encoding="utf-8")
        found = inspect_campaign(draft).issues if check else ()
        issues = [replace(issue, where=issue.where.replace(str(draft), str(out))) for issue in found]
        if issues and not to_correct:
            raise InputError(replace(issue, where=came_from(issue.where)) for issue in issues)
        if issues:
            issues = _marked(draft / CAMPAIGN_FILE, issues)
    if issues:
        raise InputError(issues, written=str(out))


_MARK = "# This campaign is not accepted yet.  Correct the points below, then run `imubayes check`:"


def _marked(file: Path, issues: Sequence[Issue]) -> list[Issue]:
    """Write faults at the head of a campaign file, as comments; return them with the lines that they are at then."""
    more = 2 + sum(len(str(issue).splitlines()) for issue in issues)

    def moved(line: re.Match) -> str:
        return f"{CAMPAIGN_FILE}:{int(line[1]) + more}"

    placed = [replace(each, where=re.sub(rf"{re.escape(CAMPAIGN_FILE)}:(\d+)", moved, each.where)) for each in issues]
    faults = [f"# {line}" for issue in placed for line in str(issue).splitlines()]
    file.write_text("\n".join([_MARK, *faults, "", file.read_text(encoding="utf-8")]), encoding="utf-8")
    return placed


def _write_csv(file: Path, columns: Mapping[str, np.ndarray]) -> None:
    rows = len(next(iter(columns.values())))
    with file.open("wb") as stream:
        stream.write((",".join(columns) + "\n").encode())
        for first in range(0, rows, BATCH_ROWS):
            part = {name: np.ascontiguousarray(values[first : first + BATCH_ROWS]) for name, values in columns.items()}
            # A value that is not there is an empty cell.
            arrays = {name: pa.array(values, from_pandas=True) for name, values in part.items()}
            pacsv.write_csv(pa.table(arrays), stream, pacsv.WriteOptions(include_header=False))

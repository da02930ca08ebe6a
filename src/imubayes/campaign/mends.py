"""Mends of a campaign that need no fact: spellings of keys, words and columns, and the order of rows in time.

A key or a word is mended if it is one that is allowed but for capitals, blanks, hyphens and underscores; a column of
a run table likewise; rows are put in order of time.  Everything else needs somebody who knows, and is left to `check`.
"""

import shutil
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import tomlkit

from imubayes.campaign.campaign_reader import CAMPAIGN_FILE
from imubayes.campaign.file_schemas import CampaignFile
from imubayes.foundations.covariates import COVARIATES, recorded_columns
from imubayes.foundations.errors import input_error
from imubayes.foundations.files import new_folder, refuse_occupied
from imubayes.foundations.wording import counted

_TIME = COVARIATES["time"].column


def mend_campaign(folder: Path, copy: Path) -> tuple[str, ...]:
    """Write a copy of a campaign folder with all mends that need no fact, and return them in words.

    Raises
    ------
    InputError
        if the copy would not be a new folder, or the campaign file is no TOML.
    """
    refuse_occupied(copy)
    file = folder / CAMPAIGN_FILE
    try:
        document: Any = tomlkit.parse(file.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError) as error:
        what = f"the file cannot be read: {error}"
        raise input_error(what, str(file), "a TOML file", "correct it first") from None
    schema = CampaignFile.model_json_schema()
    mends = list(_of_document(document, schema, schema["$defs"], CAMPAIGN_FILE))
    with new_folder(copy) as draft:
        shutil.copytree(folder, draft, dirs_exist_ok=True)
        (draft / CAMPAIGN_FILE).write_text(tomlkit.dumps(document), encoding="utf-8")
        channels = [str(entry.get("name", "")) for entry in document.get("channel", ())]
        for run in document.get("run", ()):
            table = draft / str(run.get("file", ""))
            inside = table.resolve().is_relative_to(draft.resolve())
            if inside and table.is_file() and table.suffix.lower() == ".csv":
                mends += _of_table(table, channels, str(run["file"]))
    return tuple(mends)


def _plain(word: str) -> str:
    return "".join(sign for sign in word.casefold() if sign not in " -_")


def _allowed(word: str, words: Sequence[str]) -> str | None:
    """Return the only allowed word that a word is but for its spelling; None if it is one, or no one is."""
    near = [each for each in dict.fromkeys(words) if _plain(each) == _plain(word)]
    return near[0] if len(near) == 1 and near[0] != word else None


def _of_document(
    part: MutableMapping[str, Any], schema: Mapping[str, Any], known: Mapping[str, Any], where: str
) -> Iterator[str]:
    """Mend the keys and words of a table, and of those within it."""
    schema = _resolved(schema, known)
    properties: Mapping[str, Any] = schema.get("properties", {})
    for key in list(part):
        name = key
        if key not in properties and (right := _allowed(key, list(properties))) and right not in part:
            part[right] = part.pop(key)
            yield f"{where}: key '{key}' → '{right}'"
            name = right
        value, own = part[name], _resolved(properties.get(name, {}), known)
        if isinstance(value, MutableMapping):
            yield from _of_document(value, own, known, f"{where}, {name}")
        elif isinstance(value, list):
            for place, each in enumerate(value, 1):
                if isinstance(each, MutableMapping):
                    yield from _of_document(each, own.get("items", {}), known, f"{where}, {name}[{place}]")
        elif isinstance(value, str) and (right := _allowed(value, [str(word) for word in own.get("enum", ())])):
            part[name] = right
            yield f"{where}: {name} = '{value}' → '{right}'"


def _resolved(schema: Mapping[str, Any], known: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a schema without references, and of an optional value that of the value."""
    while True:
        if "$ref" in schema:
            schema = known[schema["$ref"].rpartition("/")[2]]
        elif choices := [each for each in schema.get("anyOf", ()) if each.get("type") != "null"]:
            schema = choices[0]
        else:
            return schema


def _of_table(table: Path, channels: Sequence[str], where: str) -> Iterator[str]:
    """Mend the header and the order of rows of a run table."""
    with table.open(encoding="utf-8-sig") as stream:
        header, *lines = stream.read().splitlines() or [""]
    names = header.split(",")
    words = [_TIME, "samples", *recorded_columns(), *channels, *(f"{name}_sd" for name in channels)]
    right = [_allowed(name, [word for word in words if word not in names]) or name for name in names]
    mends = [f"{where}: column '{old}' → '{new}'" for old, new in zip(names, right, strict=True) if old != new]
    if _TIME in right:
        lines, late = _in_order(lines, right.index(_TIME))
        mends += [f"{where}: {counted(late, 'step')} back in time, rows put in order of {_TIME}"] if late else []
    if mends:
        table.write_text("\n".join([",".join(right), *lines]) + "\n", encoding="utf-8")
    yield from mends


def _in_order(lines: Sequence[str], place: int) -> tuple[list[str], int]:
    """Return rows in order of the time at a place, and how many stood before an earlier one."""
    rows = [line for line in lines if line.strip()]
    cells = [line.split(",")[place : place + 1] for line in rows]
    time = pl.Series(["".join(cell) for cell in cells]).cast(pl.Float64, strict=False).to_numpy()
    late = int((np.diff(time) < 0).sum())
    if not late or not np.isfinite(time).all():
        return list(lines), 0
    return [rows[number] for number in np.argsort(time, kind="stable")], late

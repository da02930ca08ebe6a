"""`mapping.toml`: how a recording was read, written beside the campaign and read again for others of its kind.

A fact stated by an option or by the recording is written as a key.  A guess is written as a comment with its
evidence: it is guessed anew for each recording, until someone takes the comment sign away.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from imubayes.foundations.errors import input_error
from imubayes_recordings.convert.column_choice import ChosenTable
from imubayes_recordings.convert.options import ConvertOptions

MAPPING_FILE = "mapping.toml"
# Of one recording and not of its kind.
_OF_ONE = ("name", "serial", "temperature_degC", "initial_rest_s")


def mapping_text(tables: Sequence[ChosenTable], options: ConvertOptions, guesses: Mapping[str, str]) -> str:
    """Return the text of the mapping of a conversion."""
    document = tomlkit.document()
    document.add(tomlkit.comment("How the recording was read. For another one of its kind:"))
    document.add(tomlkit.comment("imubayes convert FILE --mapping mapping.toml --out FOLDER"))
    document.add(
        tomlkit.comment("A key behind a comment sign is a guess, with its evidence; without the sign it holds.")
    )
    document.add("format", tomlkit.item(1))
    kinds = {"a": "acc=", "g": "gyro=", "": ""}
    topics = [kinds[table.topic.kind] + table.topic.name for table in tables if table.topic.name]
    if topics:
        document.add("topic", tomlkit.item(list(dict.fromkeys(topics))))
    for option in fields(ConvertOptions):
        value = getattr(options, option.name)
        if option.name in (*_OF_ONE, "topic", "columns") or value in ("", None, ()) or value == option.default:
            continue
        item = tomlkit.item(list(value) if isinstance(value, list | tuple) else value)
        if option.name in guesses:
            document.add(tomlkit.comment(f"{option.name} = {item.as_string()}  # {guesses[option.name]}"))
        else:
            document.add(option.name, item)
    if len(tables) == 1:
        _add_columns(document, tables[0], guesses.get("columns", ""))
    return tomlkit.dumps(document)


def _add_columns(document: tomlkit.TOMLDocument, table: ChosenTable, guess: str) -> None:
    """Add column of the campaign = column of the recording, by name or number."""
    lines: dict[str, str | int] = {}
    for target, column in table.columns.items():
        name = table.topic.columns[column.position].name or column.position + 1
        if target in ("date", "clock", "counter") or column.added is not None:
            continue  # found by their names again
        lines[target] = f"-{name}" if column.sign < 0 else name
    if guess:
        document.add(tomlkit.nl())
        document.add(tomlkit.comment(f"[columns]  # {guess}"))
        for target, source in lines.items():
            document.add(tomlkit.comment(f"{target} = {tomlkit.item(source).as_string()}"))
        return
    columns = tomlkit.table()
    for target, source in lines.items():
        columns.add(target, source)
    document.add("columns", columns)


def read_mapping(file: Path) -> dict[str, Any]:
    """Return the options that a mapping states.

    Raises
    ------
    InputError
        if the file cannot be read; its keys are checked with the options.
    """
    try:
        content = tomlkit.parse(file.read_text(encoding="utf-8")).unwrap()
    except (OSError, UnicodeDecodeError, TOMLKitError) as error:
        what = f"the mapping cannot be read: {error}"
        raise input_error(what, str(file), "a mapping.toml of an earlier conversion", "correct it") from None
    if content.pop("format", 1) != 1:
        raise input_error("the mapping has another format", f"{file}, key format", "1", "convert again without it")
    return content

"""The valid entries of a campaign file, so that one invalid entry does not hide the errors of the others."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError

from imubayes.campaign.file_schemas import ChannelEntry, MountingEntry, RunEntry, SiteEntry, TableEntry


@dataclass(frozen=True)
class Draft:
    """Entries that conform to the schema, by their index in the file.

    Attributes
    ----------
    site : None if missing or invalid.
    channels, tables, mountings, runs : index in the file → entry.
    names : section → all names in it, including those of invalid entries.
    """

    site: SiteEntry | None
    channels: Mapping[int, ChannelEntry]
    tables: Mapping[int, TableEntry]
    mountings: Mapping[int, MountingEntry]
    runs: Mapping[int, RunEntry]
    names: Mapping[str, list[str]]


def draft_of(content: Mapping[str, Any]) -> Draft:
    """Return the valid entries in the content of a campaign file."""
    sections = ("channel", "table", "mounting", "run")
    return Draft(
        _validated(content.get("site"), SiteEntry),
        _entries(content, "channel", ChannelEntry),
        _entries(content, "table", TableEntry),
        _entries(content, "mounting", MountingEntry),
        _entries(content, "run", RunEntry),
        {section: _names(content, section) for section in sections},
    )


def _elements(content: Mapping[str, Any], section: str) -> list[Any]:
    value = content.get(section, [])
    return value if isinstance(value, list) else []


def _entries[Entry: BaseModel](content: Mapping[str, Any], section: str, kind: type[Entry]) -> dict[int, Entry]:
    entries = {index: _validated(value, kind) for index, value in enumerate(_elements(content, section))}
    return {index: entry for index, entry in entries.items() if entry is not None}


def _validated[Entry: BaseModel](value: Any, kind: type[Entry]) -> Entry | None:
    try:
        return kind.model_validate(value)
    except ValidationError:
        return None


def _names(content: Mapping[str, Any], section: str) -> list[str]:
    values = [value.get("name") for value in _elements(content, section) if isinstance(value, dict)]
    return [name for name in values if isinstance(name, str)]

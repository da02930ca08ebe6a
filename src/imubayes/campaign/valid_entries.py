"""The sound parts of a campaign file, so that one faulty entry does not hide the faults of the others."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError

from imubayes.campaign.file_schemas import ChannelEntry, MountingEntry, RunEntry, SiteEntry, TableEntry


@dataclass(frozen=True)
class Draft:
    """Entries that passed the schema, by their place in the file.

    Attributes
    ----------
    site : None where it is missing or faulty.
    channels, tables, mountings, runs : index in the file → entry.
    names : section → all names in it, those of faulty entries too.
    """

    site: SiteEntry | None
    channels: Mapping[int, ChannelEntry]
    tables: Mapping[int, TableEntry]
    mountings: Mapping[int, MountingEntry]
    runs: Mapping[int, RunEntry]
    names: Mapping[str, list[str]]


def draft_of(content: Mapping[str, Any]) -> Draft:
    """Return what is sound in the content of a campaign file."""
    sections = ("channel", "table", "mounting", "run")
    return Draft(
        _sound(content.get("site"), SiteEntry),
        _all_sound(content, "channel", ChannelEntry),
        _all_sound(content, "table", TableEntry),
        _all_sound(content, "mounting", MountingEntry),
        _all_sound(content, "run", RunEntry),
        {section: _names(content, section) for section in sections},
    )


def _elements(content: Mapping[str, Any], section: str) -> list[Any]:
    value = content.get(section, [])
    return value if isinstance(value, list) else []


def _all_sound[Entry: BaseModel](content: Mapping[str, Any], section: str, kind: type[Entry]) -> dict[int, Entry]:
    entries = {index: _sound(value, kind) for index, value in enumerate(_elements(content, section))}
    return {index: entry for index, entry in entries.items() if entry is not None}


def _sound[Entry: BaseModel](value: Any, kind: type[Entry]) -> Entry | None:
    try:
        return kind.model_validate(value)
    except ValidationError:
        return None


def _names(content: Mapping[str, Any], section: str) -> list[str]:
    values = [value.get("name") for value in _elements(content, section) if isinstance(value, dict)]
    return [name for name in values if isinstance(name, str)]

"""From a TOML file to a validated record, with every problem in it named at its line.

Reading never stops at the first fault: what the parser, the schema and the later checks find is collected
in a `Ledger`, which knows the places of the keys, and raised together.
"""

import re
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from imubayes.campaign.file_schemas import FORMS, PATTERNS, SECTIONS
from imubayes.campaign.toml_lines import Path as KeyPath
from imubayes.campaign.toml_lines import key_lines, line_of
from imubayes.errors import InputError, Issue, closest_first

_PLACE = re.compile(r"\s*\(at (?:line (\d+), column \d+|end of document)\)")


@dataclass
class Ledger:
    """The problems found so far in one document, and where its keys stand."""

    file: Path
    lines: dict[KeyPath, int] = field(default_factory=dict)
    issues: list[Issue] = field(default_factory=list)

    def where(self, *path: str | int) -> str:
        """Return file, line and key of a path."""
        line = line_of(path, self.lines)
        place = f"{self.file}:{line}" if line else str(self.file)
        return f"{place}, {spell(path)}" if path else place

    def add(self, what: str, path: KeyPath, allowed: str, remedy: str) -> None:
        """Note one problem at a key."""
        self.issues.append(Issue(what, self.where(*path), allowed, remedy))

    def stop_if_any(self) -> None:
        """Raise what was collected."""
        if self.issues:
            raise InputError(self.issues)


def spell(path: KeyPath) -> str:
    """Write a key path as ``channel[2].scale`` (elements counted from 0)."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text


@dataclass(frozen=True)
class Document[Record: BaseModel]:
    """One TOML file as read: its content, the validated record where it is sound, and what was found."""

    content: dict[str, Any]
    entry: Record | None
    ledger: Ledger


def read_document[Record: BaseModel](file: Path, record: type[Record]) -> Document[Record]:
    """Read and validate one TOML file; faults of structure go to the ledger.

    Raises
    ------
    InputError
        where the file cannot be read or is not TOML.
    """
    text = _text(file)
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(_syntax_problem(file, str(error))) from None
    ledger = Ledger(file, key_lines(text))
    try:
        entry = record.model_validate(content)
    except ValidationError as error:
        for fault in error.errors(include_url=False):
            _note_fault(ledger, record, content, fault)
        return Document(content, None, ledger)
    return Document(content, entry, ledger)


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        near = sorted(path.name for path in file.parent.glob("*.toml")) if file.parent.is_dir() else []
        raise InputError(
            Issue(
                f"there is no file '{file.name}'",
                str(file),
                closest_first(file.name, near) or "a TOML file",
                "give the path of an existing file",
            )
        ) from None
    except UnicodeDecodeError as error:
        raise InputError(
            Issue(
                f"the file is not UTF-8 text (byte {error.start})",
                str(file),
                "UTF-8",
                "save it as UTF-8 text",
            )
        ) from None
    except OSError as error:
        raise InputError(
            Issue(f"the file cannot be read: {error.strerror}", str(file), "", "make the file readable")
        ) from None


def _syntax_problem(file: Path, message: str) -> Issue:
    place = _PLACE.search(message)
    line = f":{place[1]}" if place and place[1] else ""
    return Issue(
        f"the file is not valid TOML: {_PLACE.sub('', message)}",
        f"{file}{line}",
        'key = value, with text in "quotes" and tables as [name] or [[name]]',
        "mend the syntax at this line",
    )


def _note_fault(ledger: Ledger, record: type[BaseModel], content: dict[str, Any], fault: Any) -> None:
    path = _within(content, tuple(part for part in fault["loc"] if part != "[key]"))
    kind, context = fault["type"], fault.get("ctx", {})
    key = str(path[-1]) if path else ""
    owner = _owner(record, path)
    fields = list(owner.model_fields) if owner else []
    if kind == "extra_forbidden":
        ledger.add(f"unknown key '{key}'", path, closest_first(key, fields), "correct the key or remove it")
    elif kind == "missing":
        what = f"{_label(content, path[:-1])} has no '{key}'"
        ledger.add(what, path, f"{key} = {_example(owner, key)}", f"add '{key}'")
    elif kind == "literal_error":
        options = [option.strip("'") for option in re.split(r", | or ", context["expected"])]
        ledger.add(
            f"{key} = {fault['input']!r} is not known",
            path,
            closest_first(str(fault["input"]), options),
            "use one of the allowed values",
        )
    elif kind == "value_error":
        ledger.add(str(context["error"]), path, ", ".join(fields), "mend this entry")
    elif kind == "string_pattern_mismatch":
        allowed = PATTERNS[context["pattern"]]
        ledger.add(f"{spell(path)}: {fault['input']!r} is no name", path, allowed, "correct the name")
    else:
        named = [part for part in path[1:] if isinstance(part, str)] or [str(part) for part in path[:1]]
        allowed = next((FORMS[part] for part in reversed(named) if part in FORMS), "") or _range(owner, key)
        # A value that may be one of two types is reported once for each.
        if not any(one.where == ledger.where(*path) for one in ledger.issues):
            ledger.add(f"{spell(path) or 'the file'}: {_sentence(fault)}", path, allowed, "correct the value")


def _within(content: Any, path: KeyPath) -> KeyPath:
    """Return a path as far as the keys of the file go: of a value that may be one of two types, each is a step more."""
    part: Any
    for depth, part in enumerate(path):
        if not isinstance(content, dict | list):
            return path[:depth]
        try:
            content = content[part]
        except (KeyError, IndexError, TypeError):
            return path[: depth + 1]
    return path


def _sentence(fault: Any) -> str:
    given = fault["input"]
    shown = f" (it is {given!r})" if isinstance(given, str | int | float | bool) else ""
    return fault["msg"][0].lower() + fault["msg"][1:] + shown


def _owner(record: type[BaseModel], path: KeyPath) -> type[BaseModel] | None:
    if len(path) <= 1:
        return record
    return SECTIONS[record].get(str(path[0]))


def _label(content: dict[str, Any], path: KeyPath) -> str:
    value: Any = content
    for part in path:
        value = value[part]
    name = value.get("name") if isinstance(value, dict) else None
    return f"{spell(path)} '{name}'" if path and name else (spell(path) or "the file")


def _example(owner: type[BaseModel] | None, key: str) -> str:
    if owner is None or key not in owner.model_fields:
        return "…"
    examples = {
        "format": "1",
        "kind": '"gyro" or "accelerometer"',
        "per": '"deg/s"',
        "input_axis": "[1, 0, 0]",
    }
    shape = str(owner.model_fields[key].annotation)
    return examples.get(key, "a number" if "float" in shape else "text in quotes" if "str" in shape else "…")


def _range(owner: type[BaseModel] | None, key: str) -> str:
    if owner is None or key not in owner.model_fields:
        return "see the data dictionary"
    words = {"ge": "at least {}", "gt": "more than {}", "le": "at most {}", "lt": "less than {}"}
    schema = owner.model_json_schema()["properties"][key]
    names = {"minimum": "ge", "exclusiveMinimum": "gt", "maximum": "le", "exclusiveMaximum": "lt"}
    variants = [schema, *schema.get("anyOf", [])]
    bounds = [words[names[k]].format(f"{v:g}") for variant in variants for k, v in variant.items() if k in names]
    kinds = [variant["type"] for variant in variants if variant.get("type", "null") != "null"]
    return " ".join([*kinds[:1], ", ".join(bounds)]).strip() or "see the data dictionary"

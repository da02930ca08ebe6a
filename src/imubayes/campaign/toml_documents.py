"""TOML files as validated records, with every issue reported at its line.

Reading does not stop at the first fault: the issues found by the parser, the schema and later checks are collected in a
`Ledger`, which knows the line of every key, and raised together.  The standard parser does not give the lines of keys,
so a scanner finds them.  It reads headers and keys only; it follows brackets and quotes just far enough not to take the
inside of a multi-line value for a key.
"""

import difflib
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel, ValidationError

from imubayes.campaign.file_schemas import FORMS, PATTERNS
from imubayes.foundations.errors import InputError, Issue, closest_first, input_error
from imubayes.foundations.files import not_utf8

KeyPath = tuple[str | int, ...]
_MISSPELT = 0.8  # least similarity of a key to the one that is meant: one letter of six

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*(\]\]?)\s*(#.*)?$")
_KEY = re.compile(r"""^\s*((?:"[^"]*"|'[^']*'|[A-Za-z0-9_\-]+)(?:\s*\.\s*(?:"[^"]*"|'[^']*'|[A-Za-z0-9_\-]+))*)\s*=""")
_PART = re.compile(r"""\s*("[^"]*"|'[^']*'|[^.\s]+)\s*\.?""")
_QUOTED_OR_COMMENT = re.compile(r'"(?:\\.|[^"\\])*"|\'[^\']*\'|#.*$')


def key_lines(text: str) -> dict[KeyPath, int]:
    """Return the line (from 1) of every table header and key, by key path such as ``("channel", 2, "scale")``."""
    lines: dict[KeyPath, int] = {}
    counts: dict[KeyPath, int] = {}
    table: KeyPath = ()
    depth, fence = 0, ""
    for number, line in enumerate(text.splitlines(), start=1):
        if fence:
            fence = "" if fence in line else fence
            continue
        if depth == 0 and (header := _HEADER.match(line)) and len(header[1]) == len(header[3]):
            table = _resolve(_parts(header[2]), counts, new_element=header[1] == "[[")
            lines.setdefault(table, number)
            continue
        value = line
        if depth == 0 and (key := _KEY.match(line)):
            lines.setdefault((*table, *_parts(key[1])), number)
            value = line[key.end() :]
        depth, fence = _follow(value, depth)
    return lines


def line_of(path: KeyPath, lines: dict[KeyPath, int]) -> int | None:
    """Return the line of a key path, else of its first child, else of its nearest parent; None if there is none."""
    while path:
        inside = [line for key, line in lines.items() if key[: len(path)] == path]
        if inside:
            return lines.get(path, min(inside))
        path = path[:-1]
    return None


def _parts(dotted: str) -> list[str]:
    return [match[1].strip("\"'") for match in _PART.finditer(dotted)]


def _resolve(names: list[str], counts: dict[KeyPath, int], new_element: bool) -> KeyPath:
    path: KeyPath = ()
    for position, name in enumerate(names):
        path = (*path, name)
        if position == len(names) - 1 and new_element:
            counts[path] = counts.get(path, -1) + 1
        if path in counts:
            path = (*path, counts[path])
    return path


def _follow(value: str, depth: int) -> tuple[int, str]:
    for fence in ('"""', "'''"):
        if value.count(fence) % 2:
            return depth, fence
    bare = _QUOTED_OR_COMMENT.sub("", value)
    return max(0, depth + bare.count("[") + bare.count("{") - bare.count("]") - bare.count("}")), ""


_PLACE = re.compile(r"\s*\(at (?:line (\d+), column \d+|end of document)\)")


@dataclass
class Ledger:
    """The issues found so far in one document, and the line of each key."""

    file: Path
    lines: dict[KeyPath, int] = field(default_factory=dict)
    issues: list[Issue] = field(default_factory=list)

    def where(self, *path: str | int) -> str:
        """Return file, line and key of a key path, for an error message."""
        line = line_of(path, self.lines)
        place = f"{self.file}:{line}" if line else str(self.file)
        return f"{place}, {spell(path)}" if path else place

    def add(self, what: str, path: KeyPath, allowed: str, remedy: str) -> None:
        """Add an issue at a key."""
        self.issues.append(Issue(what, self.where(*path), allowed, remedy))

    def stop_if_any(self) -> None:
        """Raise the issues collected so far, if any, as one `InputError`."""
        if self.issues:
            raise InputError(self.issues)


def spell(path: KeyPath) -> str:
    """Return a key path as text, ``channel[2].scale`` (elements counted from 0)."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text


@dataclass(frozen=True)
class Document[Record: BaseModel]:
    """A TOML file as read: its content, the record (None if invalid) and the issues found."""

    content: dict[str, Any]
    entry: Record | None
    ledger: Ledger


def read_document[Record: BaseModel](file: Path, record: type[Record]) -> Document[Record]:
    """Read a TOML file and validate it against a record; structural faults go to the ledger.

    Raises
    ------
    InputError
        if the file cannot be read or is not TOML.
    """
    text = _text(file)
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _syntax_error(file, str(error)) from None
    return validated(content, record, Ledger(file, key_lines(text)))


def validated[Record: BaseModel](content: dict[str, Any], record: type[Record], ledger: Ledger) -> Document[Record]:
    """Return what a file, or a mapping with the keys of one, says; structural faults go to the ledger."""
    content = _as_meant(content, record, ledger)
    try:
        entry = record.model_validate(content)
    except ValidationError as error:
        for fault in error.errors(include_url=False):
            _add_fault(ledger, record, content, fault)
        return Document(content, None, ledger)
    return Document(content, entry, ledger)


def _as_meant(content: dict[str, Any], record: type[BaseModel], ledger: Ledger) -> dict[str, Any]:
    """Return the content with each misspelt section under the name that it is meant to have, and report it.

    What the section holds is then read, and no fault follows from its absence.
    """
    found = dict(content)
    for key in [key for key in content if key not in record.model_fields]:
        near = difflib.get_close_matches(key, record.model_fields, n=1, cutoff=_MISSPELT)
        if near and near[0] not in found:
            ledger.add(f"unknown key '{key}'", (key,), near[0], f"write '{near[0]}' in place of '{key}'")
            found[near[0]] = found.pop(key)
    return found


def plain_content(value: Any) -> Any:
    """Return content with arrays and tuples as lists, and numbers of NumPy as those of Python, as a file has them."""
    if isinstance(value, Mapping):
        return {str(key): plain_content(member) for key, member in value.items() if member is not None}
    if isinstance(value, list | tuple):
        return [plain_content(member) for member in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return str(value) if isinstance(value, Path) else value


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        near = sorted(path.name for path in file.parent.glob("*.toml")) if file.parent.is_dir() else []
        allowed = closest_first(file.name, near) or "a TOML file"
        remedy = "give the path of an existing file"
        raise input_error(f"there is no file '{file.name}'", str(file), allowed, remedy) from None
    except UnicodeDecodeError:
        raise InputError(not_utf8(file)) from None
    except OSError as error:
        raise input_error(f"the file cannot be read: {error.strerror}", str(file), "", "make it readable") from None


def _syntax_error(file: Path, message: str) -> InputError:
    place = _PLACE.search(message)
    line = f":{place[1]}" if place and place[1] else ", at its end" if place else ""
    return input_error(
        f"the file is not valid TOML: {_PLACE.sub('', message)}",
        f"{file}{line}",
        'key = value, with text in "quotes" and tables as [name] or [[name]]',
        "complete what is open there, such as a bracket or quotation marks"
        if place and not place[1]
        else "correct the syntax of this line",
    )


def _add_fault(ledger: Ledger, record: type[BaseModel], content: dict[str, Any], fault: Any) -> None:
    path = _existing_part(content, tuple(part for part in fault["loc"] if part != "[key]"))
    # A value that may have one of two types is reported once for each.
    if any(issue.where == ledger.where(*path) for issue in ledger.issues):
        return
    owner = _section_record(record, path)
    message = _message(fault, path, _label(content, path[:-1]), owner)
    if message is not None:
        what, allowed, remedy = message
        ledger.add(what, path, allowed, remedy)
    else:
        ledger.add(_wrong_value(fault, path), path, _form(path) or _range(owner, path), "correct the value")


def _message(fault: Any, path: KeyPath, label: str, owner: type[BaseModel] | None) -> tuple[str, str, str] | None:
    """Return what is wrong, what is allowed and the remedy; None for a value of wrong type or out of range."""
    key, given, context = str(path[-1]) if path else "", fault["input"], fault.get("ctx", {})
    fields = list(owner.model_fields) if owner else []
    match fault["type"]:
        case "extra_forbidden":
            return f"unknown key '{key}'", closest_first(key, fields), "correct the key or remove it"
        case "missing":
            return f"{label} has no '{key}'", f"{key} = {_example(owner, key)}", f"add '{key}'"
        case "literal_error":
            options = [option.strip("'") for option in re.split(r", | or ", context["expected"])]
            return (
                f"{key} = {given!r} is not known",
                closest_first(str(given), options),
                "use one of the allowed values",
            )
        case "value_error":
            form = FORMS.get(key, "") if isinstance(given, str) else ""
            if isinstance(given, str) and key in fields:
                form = form or f"{key} = {_example(owner, key)}"
            return str(context["error"]), form or ", ".join(fields), "correct this entry"
        case "string_pattern_mismatch":
            return f"{spell(path)}: {given!r} is not allowed here", PATTERNS[context["pattern"]], "correct it"
    return None


def _wrong_value(fault: Any, path: KeyPath) -> str:
    given = f" (it is {fault['input']!r})" if isinstance(fault["input"], str | int | float | bool) else ""
    # The library calls a value "Input", which is the stimulus of a sensor here.
    said = fault["msg"].replace("Input", "the value", 1)
    return f"{spell(path) or 'the file'}: {said[0].lower()}{said[1:]}{given}"


def _form(path: KeyPath) -> str:
    """Return the expected form of the value in words, from its innermost key."""
    keys = [part for part in path[1:] if isinstance(part, str)] or [str(part) for part in path[:1]]
    return next((FORMS[key] for key in reversed(keys) if key in FORMS), "")


def _existing_part(content: Any, path: KeyPath) -> KeyPath:
    """Return a path up to the last key that the file has; pydantic appends the variant of a union to it."""
    part: Any
    for depth, part in enumerate(path):
        if not isinstance(content, dict | list):
            return path[:depth]
        try:
            content = content[part]
        except (KeyError, IndexError, TypeError):
            return path[: depth + 1]
    return path


def _section_record(record: type[BaseModel], path: KeyPath) -> type[BaseModel] | None:
    """Return the schema of the table that a path lies in, as the annotation of its section in `record` says."""
    if len(path) <= 1:
        return record
    annotation = record.model_fields[str(path[0])].annotation
    candidates = (annotation, *get_args(annotation))
    return next((kind for kind in candidates if isinstance(kind, type) and issubclass(kind, BaseModel)), None)


def _label(content: dict[str, Any], path: KeyPath) -> str:
    value: Any = content
    for part in path:
        value = value[part]
    name = value.get("name") if isinstance(value, dict) else None
    return f"{spell(path)} '{name}'" if path and name else (spell(path) or "the file")


def _example(record: type[BaseModel] | None, key: str) -> str:
    if record is None or key not in record.model_fields:
        return "…"
    examples = {"format": "1", "kind": '"gyro" or "accelerometer"', "per": '"deg/s"', "input_axis": "[1, 0, 0]"}
    shape = str(record.model_fields[key].annotation)
    return examples.get(key, "a number" if "float" in shape else "text in quotes" if "str" in shape else "…")


_BOUNDS = {
    "minimum": "at least {:g}",
    "exclusiveMinimum": "more than {:g}",
    "maximum": "at most {:g}",
    "exclusiveMaximum": "less than {:g}",
}


def _range(record: type[BaseModel] | None, path: KeyPath) -> str:
    key = str(path[-1]) if path else ""
    if record is None or key not in record.model_fields:
        return "see the data dictionary"
    schema = record.model_json_schema()["properties"][key]
    variants = [schema, *schema.get("anyOf", [])]
    bounds = [_BOUNDS[word].format(value) for variant in variants for word, value in variant.items() if word in _BOUNDS]
    kinds = [variant["type"] for variant in variants if variant.get("type", "null") != "null"]
    return " ".join([*kinds[:1], ", ".join(bounds)]).strip() or "see the data dictionary"

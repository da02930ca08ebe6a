"""Line numbers of the keys of a TOML file, which the standard parser does not give.

The scanner reads headers and keys only; it follows brackets and quotes just far enough not to take the inside of a
multi-line value for a key.
"""

import re

Path = tuple[str | int, ...]

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*(\]\]?)\s*(#.*)?$")
_KEY = re.compile(r"""^\s*((?:"[^"]*"|'[^']*'|[A-Za-z0-9_\-]+)(?:\s*\.\s*(?:"[^"]*"|'[^']*'|[A-Za-z0-9_\-]+))*)\s*=""")
_PART = re.compile(r"""\s*("[^"]*"|'[^']*'|[^.\s]+)\s*\.?""")
_QUOTED_OR_COMMENT = re.compile(r'"(?:\\.|[^"\\])*"|\'[^\']*\'|#.*$')


def key_lines(text: str) -> dict[Path, int]:
    """Return the line (from 1) of every table header and key, by key path such as ``("channel", 2, "scale")``."""
    lines: dict[Path, int] = {}
    counts: dict[Path, int] = {}
    table: Path = ()
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


def line_of(path: Path, lines: dict[Path, int]) -> int | None:
    """Return the line of a key path, else of its first child, else of its nearest parent; None if there is none."""
    while path:
        inside = [line for key, line in lines.items() if key[: len(path)] == path]
        if inside:
            return lines.get(path, min(inside))
        path = path[:-1]
    return None


def _parts(dotted: str) -> list[str]:
    return [match[1].strip("\"'") for match in _PART.finditer(dotted)]


def _resolve(names: list[str], counts: dict[Path, int], new_element: bool) -> Path:
    path: Path = ()
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

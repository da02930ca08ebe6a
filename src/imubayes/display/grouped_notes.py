"""Notes and warnings that many runs share, each said once: the runs are counted and numbers become ranges."""

import re
from collections.abc import Sequence

from imubayes.display.labels import listed

_CHANGING = re.compile(r"'[^']*'|\"[^\"]*\"|(?<![\w.])\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?!\w)")
_MOST_NAMES = 4


def grouped(notes: Sequence[tuple[str, str]]) -> list[str]:
    """Return each note once, in the order of first appearance, with the runs it is about.

    Notes that differ in numbers and quoted names only are one note: its numbers are given as a range, its names as a
    list.

    Parameters
    ----------
    notes : pairs of the name of a run, empty for the campaign, and a text.
    """
    groups: dict[tuple[bool, str], list[tuple[str, str]]] = {}
    for run, text in notes:
        groups.setdefault((bool(run), _CHANGING.sub("\0", text)), []).append((run, text))
    return [_said(members) for members in groups.values()]


def _said(members: Sequence[tuple[str, str]]) -> str:
    """Return notes of one form as one line."""
    runs = list(dict.fromkeys(run for run, _ in members if run))
    columns = list(zip(*(_CHANGING.findall(text) for _, text in members), strict=True))
    merged = iter([_merged(list(dict.fromkeys(column))) for column in columns])
    text = _CHANGING.sub(lambda _: next(merged), members[0][1])
    if not runs:
        return text
    who = f"{len(runs)} runs ({listed(runs, _MOST_NAMES)})" if len(runs) > 1 else runs[0]
    return f"{who}: {text}"


def _merged(parts: Sequence[str]) -> str:
    """Return numbers as a range, and quoted names as a list."""
    if len(parts) == 1:
        return parts[0]
    if parts[0][0] in "'\"":
        return listed(parts, _MOST_NAMES)
    ordered = sorted(parts, key=float)
    return f"{ordered[0]} … {ordered[-1]}"

"""The line that `check` asks for, made in the files of a campaign, as its reader would make it."""

import ast
import re
from collections.abc import Callable

import numpy as np
from campaign_files import Files
from record_mistakes import Cells, changed

Made = Callable[[Files, re.Match[str]], None]


def _runs(files: Files, where: str) -> list[dict]:
    """The runs that are named by name, file, table, or as all of them."""
    named = [run for run in files.runs if f"'{run['name']}'" in where or str(run["file"]) in where]
    tables = [run for run in files.runs if f"table '{run.get('table')}'" in where]
    return named or tables or files.runs


def _each(where: str, column: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Files], None]:
    def make(files: Files) -> None:
        for run in _runs(files, where):
            if files.has(run, column):
                changed(files, run, column, change)

    return make


def _columns(quoted: str) -> list[str]:
    return re.findall(r"'([^']+)'", quoted)


def _every(files: Files, where: str, quoted: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    for column in _columns(quoted):
        _each(where, column, change)(files)


def _entry(files: Files, section: str, name: str) -> dict:
    return next(each for each in files.document[section] if each["name"] == name)


def _keys(files: Files, found: re.Match[str]) -> None:
    """Write keys of members: `key = value for 'name'`, or for a run, a table or a mounting by name."""
    for key, value, section, name in re.findall(
        r"(\w+) = (\[.*?\](?= for)|\S+?),? for (?:(run|table|mounting) )?'([^']+)'", found[0]
    ):
        member = _entry(files, section or "channel", name)
        member[key] = value.strip('"') if value.startswith('"') else ast.literal_eval(value)
    files.save()


def _row(files: Files, found: re.Match[str]) -> None:
    value, column, row, run = found.groups()

    def edit(columns: Cells) -> None:
        columns[column][int(row) - 1] = value

    files.edit(next(each for each in files.runs if each["name"] == run), edit)


def _added_to_row(files: Files, found: re.Match[str]) -> None:
    value, column, row, run = found.groups()

    def edit(columns: Cells) -> None:
        columns[column][int(row) - 1] = f"{float(columns[column][int(row) - 1]) + float(value):.9g}"

    files.edit(next(each for each in files.runs if each["name"] == run), edit)


def _reversed_in_row(files: Files, found: re.Match[str]) -> None:
    column, row, run = found.groups()

    def edit(columns: Cells) -> None:
        columns[column][int(row) - 1] = f"{-float(columns[column][int(row) - 1]):.9g}"

    files.edit(next(each for each in files.runs if each["name"] == run), edit)


def _exchanged(files: Files, found: re.Match[str]) -> None:
    column, *names = found.groups()
    runs = [next(each for each in files.runs if each["name"] == name) for name in names]
    held: list[np.ndarray] = []
    for run in runs:
        changed(files, run, column, lambda values: held.append(values) or values)
    for run, values in zip(runs, reversed(held), strict=True):
        changed(files, run, column, lambda _, values=values: values)


def _renamed(files: Files, found: re.Match[str]) -> None:
    holds = dict(re.findall(r"'([^']+)' holds '([^']+)'", found[0]))
    for run in files.runs:
        files.edit(run, lambda columns: columns.update({right: columns[name] for name, right in holds.items()}))


_LINES: tuple[tuple[str, Made], ...] = (
    (r"write (-?[\d.]+) in column '(\w+)', row (\d+) of run '([^']+)'", _row),
    (r"add ([+-][\d.]+) to column '(\w+)', row (\d+) of run '([^']+)'", _added_to_row),
    (r"reverse the sign of column '(\w+)', row (\d+) of run '([^']+)'", _reversed_in_row),
    (r"exchange column '(\w+)' of run '([^']+)' and of run '([^']+)'", _exchanged),
    (
        r"add ([+-][\d.]+) to column '(\w+)' (.*)",
        lambda files, m: _each(m[3], m[2], lambda x: x + float(m[1]))(files),
    ),
    (
        r"multiply (?:column )?'(\w+)' (of .*)by ([-\d.e]+)()",
        lambda files, m: _each(m[2], m[1], lambda x: x * float(m[3]))(files),
    ),
    (
        r"multiply '(\w+)' by ([-\d.e+]+) (in .*)",
        lambda files, m: _each(m[3], m[1], lambda x: x * float(m[2]))(files),
    ),
    (
        r"divide the columns ((?:'\w+',? )+)by ([-\d.e+]+) (in .*)",
        lambda files, m: _every(files, m[3], m[1], lambda x: x / float(m[2])),
    ),
    (
        r"reverse the sign of (?:columns? |the columns )?((?:'\w+'(?:,| and)? ?)+)((?:in|of) .*)",
        lambda files, m: _every(files, m[2], m[1], np.negative),
    ),
    (r"reverse the order of '(\w+)' in (.*)", lambda files, m: _each(m[2], m[1], lambda x: x[::-1])(files)),
    (
        r"replace T by \(T - 32\) / 1.8 in column '(\w+)' (.*)",
        lambda files, m: _each(m[2], m[1], lambda x: (x - 32) / 1.8)(files),
    ),
    (r"replace y by ([\d.]+) - y in column '(\w+)' (.*)", lambda f, m: _each(m[3], m[2], lambda y: float(m[1]) - y)(f)),
    (r"rename the columns: .*", _renamed),
    (r"write \w+ = .*", _keys),
)


def apply_remedy(files: Files, remedy: str) -> bool:
    """Make the first line of a remedy in the files; return whether it is one that is known."""
    line = re.split(r"; accepted| \(or: | if the record|, or leave|, or correct", remedy)[0]
    for pattern, make in _LINES:
        if found := re.search(pattern, line):
            make(files, found)
            return True
    return False

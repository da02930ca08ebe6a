"""Lines of several kinds in one text: a word, or a number, in each line says what it holds.

`ACCE;12.1;0.1;0.2;9.8`, `$TIM,12.1,$ACC,+0010,+0020,+1000` and `12.1,gyro,0.1,0.2,0.3` are such lines.  The word stands
in one column of all lines; each word becomes a topic with the other cells.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from imubayes_recordings.convert.column_names import role_of
from imubayes_recordings.convert.formats.cell_values import CellKind, is_number, kind_of

_MOST_TAGS, _LEAST_CELLS = 12, 3
FEW = 6  # lines that show what is usual
_ONE_SENSOR = 7  # cells of a line at most: a number, two times, three readings and their accuracy
_LEAST_CHANGES = 5  # from one number to another, among the first lines


@dataclass(frozen=True)
class TaggedLine:
    """What the cells of a line beside its tag are.

    Attributes
    ----------
    kinds : of the cells.
    names : of the cells; empty if no line lists them.
    labels : places of the cells that hold the same word in every line.
    """

    kinds: tuple[CellKind, ...]
    names: tuple[str, ...] = ()
    labels: frozenset[int] = frozenset()


@dataclass(frozen=True)
class LineTags:
    """The tags of the lines of a text.

    Attributes
    ----------
    column : place of the tag in a line, from 0.
    lines : tag → what its lines hold.
    """

    column: int
    lines: Mapping[str, TaggedLine]

    def tag_of(self, cells: Sequence[str]) -> str:
        """Return the tag of a line; empty if it has none."""
        return plain_tag(cells[self.column]) if len(cells) > self.column else ""

    def beside(self, cells: Sequence[str]) -> list[str]:
        """Return the cells of a line without its tag."""
        return [*cells[: self.column], *cells[self.column + 1 :]]


def plain_tag(cell: str) -> str:
    """Return a tag without the sign of a sentence before it."""
    return cell.strip().lstrip("$")


def find_tags(
    sample: Sequence[Sequence[str]], names: Sequence[str], named: bool, above: Sequence[Sequence[str]]
) -> LineTags | None:
    """Return the tags of lines, or None.

    One word alone, in every line, is a tag if it names a sensor and there are no names for all columns.  Names that
    begin with a tag are those of its lines.

    Parameters
    ----------
    sample : cells of the first lines of data.
    names : in the line above them.
    named : whether these are names for all columns.
    above : cells of all lines above the data.
    """
    lines, sample = len(sample), [row for row in sample if len(row) >= _LEAST_CELLS]
    if 2 * len(sample) <= lines or (named and _has_both(names)):
        return None
    for_one = bool(names) and _last_word(names[0]) in {plain_tag(row[0]) for row in sample}
    column = _tag_column(sample, named and not for_one)
    if column is None:
        return None
    tags = dict.fromkeys(plain_tag(row[column]) for row in sample)
    common = () if for_one or not named else names
    return LineTags(column, {tag: _line(tag, sample, column, common, _listed(above)) for tag in tags})


def _listed(above: Sequence[Sequence[str]]) -> dict[str, tuple[str, ...]]:
    """Return tag → names of the cells behind it, of the lines above the data that begin with one."""
    return {_last_word(cells[0]): tuple(cells[1:]) for cells in above if cells}


def _has_both(names: Sequence[str]) -> bool:
    """Return whether names for all columns are those of accelerometers and of gyros: each line holds both."""
    return {"ax", "gx"} <= {role.target for name in names if (role := role_of(name))}


def _line(
    tag: str, rows: Sequence[Sequence[str]], column: int, names: Sequence[str], listed: Mapping[str, tuple[str, ...]]
) -> TaggedLine:
    own = [[*row[:column], *row[column + 1 :]] for row in rows if plain_tag(row[column]) == tag]
    width = min(map(len, own))
    kinds = tuple(kind_of([row[place] for row in own]) for place in range(width))
    common = (*names[:column], *names[column + 1 :])
    fitting = common if len(common) == width else listed.get(tag, ())
    labels = frozenset(
        place for place, kind in enumerate(kinds) if kind is CellKind.TEXT and len({row[place] for row in own}) == 1
    )
    return TaggedLine(kinds, tuple(fitting) if len(fitting) == width else (), labels)


def _tag_column(rows: Sequence[Sequence[str]], named: bool) -> int | None:
    """Return the column whose words, or numbers, say what each line holds; None if there is none."""
    for place in range(min(map(len, rows))):
        words = [plain_tag(row[place]) for row in rows]
        if all(map(_is_word, words)) and _are_tags(words, place == 0 and not named):
            return place
    narrow = min(map(len, rows)) <= _ONE_SENSOR
    return 0 if narrow and not named and _are_numbers([row[0] for row in rows], [row[1] for row in rows]) else None


def _are_tags(words: Sequence[str], first: bool) -> bool:
    """Return whether the words of a column say what the lines hold; `first` is of the first without names for all."""
    distinct = set(words)
    sensors = any(map(_names_a_sensor, distinct))
    if len(distinct) > 1:
        return len(distinct) <= _MOST_TAGS and (sensors or first)
    return first and sensors and len(words) >= FEW


def _are_numbers(first: Sequence[str], second: Sequence[str]) -> bool:
    """Return whether few whole numbers change from line to line, beside a time that never goes back."""
    if not all(cell.isdigit() for cell in first) or not all(map(is_number, second)):
        return False
    times = [float(cell) for cell in second]
    changes = sum(own != other for own, other in pairwise(first))
    forward = all(own <= other for own, other in pairwise(times))
    return 1 < len(set(first)) <= _MOST_TAGS and changes >= _LEAST_CHANGES and forward


def _names_a_sensor(word: str) -> bool:
    role = role_of(f"{word}[0]")
    return role is not None and role.target in ("ax", "gx")


def _is_word(cell: str) -> bool:
    return cell[:1].isalpha() and not is_number(cell)


def _last_word(cell: str) -> str:
    """Return the tag before a list of names: `MAGN` of `Magnetometer data: 'MAGN;time;x;y;z'`."""
    words = re.split(r"[\s'\"]+", cell.strip(" \t'\""))
    return plain_tag(words[-1])

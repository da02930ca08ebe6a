"""Text tables of any layout, read block by block; a few damaged lines are left out and counted."""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from imubayes.foundations.errors import input_error
from imubayes.foundations.wording import counted
from imubayes_recordings.convert.formats.cell_values import VALUE, CellKind
from imubayes_recordings.convert.formats.line_tags import TaggedLine
from imubayes_recordings.convert.formats.text_layout import (
    COMMENT_SIGN,
    find_layout,
    open_text,
    without_padding,
)
from imubayes_recordings.convert.recording import BLOCK_ROWS, SourceColumn, SourceRecording, Topic

_MOST_DAMAGED = 1e-4  # share of the lines; a torn last line is left out besides
_LINES_FOR_ONE = 1000  # of which one may be damaged


class TextRecording(SourceRecording):
    """A text table; if the first word of each line says what it holds, each word is a topic."""

    def __init__(self, file: Path, delimiter: str | None = None) -> None:
        self.file, self.layout = file, find_layout(file, delimiter)
        self._damaged: list[tuple[int, str]] = []
        self._padded: list[int] = []
        self._lines = self._last = 0

    def topics(self) -> tuple[Topic, ...]:
        """Return the table, or one topic for each first word."""
        layout = self.layout
        if layout.tags:
            return tuple(
                Topic(tag, _columns(line), f"{self.file}:{layout.first}", numbered=tag.isdigit())
                for tag, line in layout.tags.lines.items()
            )
        fits = len(layout.names) == len(layout.kinds)
        units = layout.units if len(layout.units) == len(layout.kinds) else [""] * len(layout.kinds)
        columns = tuple(
            SourceColumn(
                layout.names[place] if fits else "", _unit(kind) or units[place], place in layout.label_columns
            )
            for place, kind in enumerate(layout.kinds)
        )
        where = f"{self.file}:{layout.heading or layout.first}"
        if layout.names and not fits:
            names, fields = len(layout.names), len(layout.kinds)
            note = f"the header has {counted(names, 'name')}, the rows have {counted(fields, 'field')}"
        else:
            note = f"names in line {layout.heading}" if fits else "no names"
            note += f", numbers from line {layout.first}"
        rate = layout.rate
        note += f", {rate.hz:g} Hz stated in line {rate.line}" if rate else ""
        misfit = bool(layout.names) and not fits
        return (Topic("", columns, where, note, rate.hz if rate else None, misfit),)

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows; a damaged line is a row of NaN, and more than a few are refused."""
        layout, self._damaged, self._padded, self._lines = self.layout, [], [], 0
        kinds = self._kinds(topic)
        self._refuse_text(topic, kinds, positions)
        plain = (
            not layout.tags
            and not layout.labels
            and not layout.decimal_comma
            and all(kinds[k] is CellKind.NUMBER for k in positions)
        )
        with open_text(self.file, layout.encoding) as stream:
            lines = islice(enumerate(stream, 1), layout.first - 1, None)
            while chunk := list(islice(lines, BLOCK_ROWS)):
                text = self._without_padding(chunk)
                rows = [(n, line) for n, line in text if not line.isspace() and not self._no_data(line)]
                self._lines, self._last = self._lines + len(rows), rows[-1][0] if rows else self._last
                block = self._whole(rows, positions) if plain else None
                yield self._by_line(rows, topic, kinds, positions) if block is None else block
        self._judge(len(kinds))

    def parsed(self, lines: Sequence[str], topic: Topic, positions: Sequence[int]) -> np.ndarray:
        """Return rows of some lines, (n, positions): of a recording that is still written, line by line."""
        return self._by_line(list(enumerate(lines)), topic, self._kinds(topic), positions)

    def _kinds(self, topic: Topic) -> tuple[CellKind, ...]:
        return self.layout.tags.lines[topic.name].kinds if self.layout.tags else self.layout.kinds

    def _without_padding(self, lines: list[tuple[int, str]]) -> list[tuple[int, str]]:
        """Return numbered lines without NUL bytes at their ends, and without lines that hold nothing else."""
        padded = [number for number, line in lines if "\0" in line]
        self._padded += padded
        return [(n, text) for n, line in lines if (text := without_padding(line))] if padded else lines

    def notes(self) -> tuple[str, ...]:
        """Return how many lines were left out, and which; and which held NUL bytes."""
        return (*self._of_padding(), *self._of_damage())

    def _of_padding(self) -> tuple[str, ...]:
        if not self._padded:
            return ()
        places = ", ".join(map(str, self._padded[:5])) + (", …" if len(self._padded) > 5 else "")
        what = f"NUL bytes are left out (line {places}): the logger wrote nothing there, and samples may be missing"
        return (f"{self.file.name}: {what}",)

    def _of_damage(self) -> tuple[str, ...]:
        if not self._damaged:
            return ()
        places = ", ".join(str(number) for number, _ in self._damaged[:5]) + (", …" if len(self._damaged) > 5 else "")
        what = "1 damaged line is" if len(self._damaged) == 1 else f"{len(self._damaged)} damaged lines are"
        return (f"{self.file.name}: {what} left out of {self._lines} (line {places}): {self._damaged[0][1]}",)

    def _refuse_text(self, topic: Topic, kinds: Sequence[CellKind], positions: Sequence[int]) -> None:
        for place in positions:
            if kinds[place] is CellKind.TEXT:
                name = topic.columns[place].name or str(place + 1)
                raise input_error(
                    f"column '{name}' holds text that is not a number, date or time of day",
                    f"{self.file}:{self.layout.first}",
                    "numbers, h:m:s, or a date and time in ISO 8601",
                    "write it so; or leave the column out: a time may be replaced by --sample-rate-hz",
                )

    def _no_data(self, line: str) -> bool:
        """Return whether a line is a comment, or the heading once more, as of a logger that was started again."""
        if line.strip() == self.layout.head:
            return True
        sign = COMMENT_SIGN.match(line)
        return sign is not None and sign[1] != self.layout.delimiter

    def _whole(self, rows: Sequence[tuple[int, str]], positions: Sequence[int]) -> np.ndarray | None:
        """Return many lines of plain numbers at once; None if any needs a closer look."""
        width, mark = len(self.layout.kinds), self.layout.delimiter
        lines = [line for _, line in rows]
        if any((line.count(mark) + 1 if mark else len(line.split())) < width or '"' in line for line in lines):
            return None
        try:
            return np.loadtxt(lines, delimiter=mark, usecols=positions, ndmin=2, comments=None)
        except ValueError:
            return None

    def _by_line(
        self, rows: Sequence[tuple[int, str]], topic: Topic, kinds: Sequence[CellKind], positions: Sequence[int]
    ) -> np.ndarray:
        layout, tags = self.layout, self.layout.tags
        read = [(place, VALUE[kinds[place]]) for place in positions]
        values = []
        for number, line in rows:
            cells = layout.cells(line)
            if tags and tags.tag_of(cells) != topic.name:
                continue
            cells = tags.beside(cells) if tags else cells
            try:
                if len(cells) < len(kinds):
                    raise ValueError(f"{len(cells)} fields of {len(kinds)}")
                values.append([value(cells[place]) for place, value in read])
            except ValueError as error:
                self._damaged.append((number, str(error)))
                values.append([np.nan] * len(positions))
        return np.array(values, dtype=float).reshape(-1, len(positions))

    def _judge(self, width: int) -> None:
        torn = bool(self._damaged) and self._damaged[-1][0] == self._last
        most = int(np.ceil(self._lines * _MOST_DAMAGED)) if self._lines >= _LINES_FOR_ONE else 0
        if len(self._damaged) - torn > most:
            number, why = self._damaged[0]
            raise input_error(
                f"{len(self._damaged)} of {self._lines} lines cannot be read; the first: {why}",
                f"{self.file}:{number}",
                f"{width} numbers per line; one damaged line in 10⁴, and a torn last one, are left out",
                "correct the lines, or choose other columns",
            )


def _unit(kind: CellKind) -> str:
    return {CellKind.NUMBER: "", CellKind.TEXT: "text"}.get(kind, kind.value)


def _columns(line: TaggedLine) -> tuple[SourceColumn, ...]:
    """Return the columns of lines with a tag; without names if no line lists them."""
    names = line.names or ("",) * len(line.kinds)
    return tuple(
        SourceColumn(name, _unit(kind), place in line.labels)
        for place, (name, kind) in enumerate(zip(names, line.kinds, strict=True))
    )

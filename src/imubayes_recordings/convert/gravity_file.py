"""Gravity in a file of its own beside the acceleration without it, as phones write them: one recording of both.

The device subtracts its estimate of gravity from the reading; both have the times of the reading, row by row, and their
sum is the reading.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import zip_longest

import numpy as np

from imubayes.foundations.errors import input_error
from imubayes_recordings.convert.column_names import axis_and_words, names_gravity, quantity_of, words_of
from imubayes_recordings.convert.recording import SourceColumn, SourceRecording, Topic


class GravityBeside(SourceRecording):
    """Two files of one table: the columns of the acceleration, and the axes of gravity behind them.

    The names of the axes say of which part they are, so that their sums are read.
    """

    def __init__(self, motion: SourceRecording, gravity: SourceRecording) -> None:
        self.file, self.motion, self.gravity = motion.file, motion, gravity

    def topics(self) -> tuple[Topic, ...]:
        """Return the table; its first column is the time of both."""
        [topic], [beside] = self.motion.topics(), self.gravity.topics()
        axes = [column for column in beside.columns if axis_and_words(column.name)[0]]
        columns = (*map(_motion, topic.columns), *(SourceColumn(f"gravity {own.name}", own.unit) for own in axes))
        note = f"gravity from {self.gravity.file.name}"
        return (replace(topic, columns=columns, note=f"{topic.note}, {note}".strip(", ")),)

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows of both files; their first columns, the times, must be equal."""
        [own], [beside] = self.motion.topics(), self.gravity.topics()
        axes = [place for place, column in enumerate(beside.columns) if axis_and_words(column.name)[0]]
        width = len(own.columns)
        first = [0, *(place for place in positions if place < width)]
        second = [0, *(axes[place - width] for place in positions if place >= width)]
        order = [k for k, _ in sorted(enumerate(positions), key=lambda each: each[1] >= width)]
        for rows, others in zip_longest(self.motion.blocks(own, first), self.gravity.blocks(beside, second)):
            if (
                rows is None
                or others is None
                or len(rows) != len(others)
                or not np.array_equal(rows[:, 0], others[:, 0])
            ):
                raise input_error(
                    "gravity and the acceleration without it do not have the same times",
                    f"{self.motion.file} and {self.gravity.file}",
                    "the same time in each row of both files",
                    "export both with their own times, or record the full reading of the accelerometers",
                )
            yield np.hstack([rows[:, 1:], others[:, 1:]])[:, np.argsort(order)]

    def notes(self) -> tuple[str, ...]:
        """Return what was left out of both files."""
        return (*self.motion.notes(), *self.gravity.notes())


def with_gravity(recordings: Sequence[SourceRecording]) -> list[SourceRecording]:
    """Return recordings, with the only one of gravity and the only one of acceleration as one."""
    gravity = [own for own in recordings if names_gravity(words_of(own.file.stem))]
    motion = [own for own in recordings if own not in gravity and quantity_of(set(words_of(own.file.stem)), "") == "a"]
    if len(gravity) != 1 or len(motion) != 1 or not all(map(_is_triple, (*gravity, *motion))):
        return list(recordings)
    both = GravityBeside(motion[0], gravity[0])
    return [both if own is motion[0] else own for own in recordings if own is not gravity[0]]


def _is_triple(recording: SourceRecording) -> bool:
    """Return whether a file has one table, with a time before columns named x, y and z alone."""
    topics = recording.topics()
    axes = sorted(axis for name in topics[0].names if (axis := axis_and_words(name)[0])) if len(topics) == 1 else []
    return axes == ["x", "y", "z"] and not axis_and_words(topics[0].names[0])[0]


def _motion(column: SourceColumn) -> SourceColumn:
    return replace(column, name=f"user {column.name}") if axis_and_words(column.name)[0] else column

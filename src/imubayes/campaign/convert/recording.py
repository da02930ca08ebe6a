"""The one interface of all recordings: topics with columns, and blocks of rows.

A recording is a file of any format.  It holds topics (the only table of a text file, the messages of a ROS bag, the
arrays of a MATLAB file); a topic has columns with the units that the file states, and gives its rows in blocks, so that
a long record never is in memory as a whole.  `formats` has one module for each kind of file; everything else of a
conversion knows this interface alone.
"""

import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imubayes.foundations.errors import InputError, closest_first, input_error

BLOCK_ROWS = 1 << 16


@dataclass(frozen=True)
class SourceColumn:
    """A column of a topic.

    Attributes
    ----------
    name : as the recording writes it; empty where it has no names.
    unit : as the recording states it, in its own spelling; empty where it states none.
    """

    name: str
    unit: str = ""


@dataclass(frozen=True)
class Topic:
    """A table within a recording.

    Attributes
    ----------
    name : empty for the only table of a file.
    columns : in the order of the file.
    where : file and line or part, for errors.
    note : how the columns were found, in words; empty where the format says it.
    rate_hz : sampling rate that the recording states; None where it states none.
    misfit : whether there are names that differ in number from the data fields; the columns have none then.
    """

    name: str
    columns: tuple[SourceColumn, ...]
    where: str
    note: str = ""
    rate_hz: float | None = None
    misfit: bool = False

    @property
    def named(self) -> bool:
        """Whether the columns have names."""
        return any(column.name for column in self.columns)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the columns."""
        return tuple(column.name for column in self.columns)

    def position(self, source: str | int, target: str) -> int:
        """Return the position of a column given by name, or by number from 1.

        Raises
        ------
        InputError
            if there is no such column, or several of that name.
        """
        word, count = str(source), self.names.count(str(source))
        if count == 1:
            return self.names.index(word)
        if count == 0 and word.isdigit() and 1 <= int(word) <= len(self.columns):
            return int(word) - 1
        what = f"{count} columns are named" if count else "there is no column"
        allowed = closest_first(word, self.names) if self.named and not count else f"1 … {len(self.columns)}"
        remedy = f"state the column of {target}: {target}=NAME or {target}=NUMBER"
        raise input_error(f"{what} '{word}' for '{target}'", f"{self.where} (option columns)", allowed, remedy)


class SourceRecording(ABC):
    """A file of any format that holds topics.

    Attributes
    ----------
    file : the file, or folder.
    """

    file: Path

    @abstractmethod
    def topics(self) -> tuple[Topic, ...]:
        """Return what the file holds.

        Raises
        ------
        InputError
            if it is damaged, or holds no numbers.
        """

    @abstractmethod
    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows of some columns, (n, columns) each, NaN where empty; times in words are in seconds.

        Raises
        ------
        InputError
            at rows that cannot be read.
        """

    def notes(self) -> tuple[str, ...]:
        """Return what was left out while the blocks were read, in words."""
        return ()


def read_columns(recording: SourceRecording, topic: Topic, positions: Sequence[int]) -> np.ndarray:
    """Return columns of a topic, shape (N, columns), kept on the disk and not in memory."""
    with tempfile.TemporaryFile() as spool:
        rows = 0
        for block in recording.blocks(topic, positions):
            spool.write(np.ascontiguousarray(block, dtype=np.float64).data)
            rows += len(block)
        spool.flush()
        if rows == 0:
            raise input_error(f"{described(topic)} has no rows", topic.where, "one row or more", "record it again")
        return np.memmap(spool, dtype=np.float64, mode="r", shape=(rows, len(positions)))


def described(topic: Topic) -> str:
    """Return a topic in words."""
    return f"topic '{topic.name}'" if topic.name else "the table"


def damaged(file: Path, kind: str, error: Exception) -> InputError:
    """Return the error of a file that is of a kind and cannot be read."""
    why = str(error).splitlines()[0][:160] if str(error) else type(error).__name__
    return input_error(
        f"the {kind} file cannot be read: {why}", str(file), f"a whole {kind} file", "copy or record the file again"
    )


def needs_package(file: Path, kind: str, package: str) -> InputError:
    """Return the error of a format whose package is not installed."""
    return input_error(
        f"{kind} files need the package '{package}'", str(file), f"pip install {package}",
        "install it, or pip install 'imubayes[recordings]' for all formats",
    )  # fmt: skip

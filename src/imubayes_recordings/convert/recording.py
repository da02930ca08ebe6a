"""The one interface of all recordings: topics with columns, and blocks of rows.

A recording is a file of any format.  It holds topics (the only table of a text file, the messages of a ROS bag, the
arrays of a MATLAB file); a topic has columns with the units that the file states, and gives its rows in blocks, so that
a long record never is in memory as a whole.  `formats` has one module for each kind of file; everything else of a
conversion knows this interface alone.
"""

import io
import logging
import tempfile
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imubayes.foundations.errors import InputError, closest_first, input_error
from imubayes.foundations.units import ABSURD

BLOCK_ROWS = 1 << 16


@dataclass(frozen=True)
class SourceColumn:
    """A column of a topic.

    Attributes
    ----------
    name : as the recording writes it; empty if it has no names.
    unit : as the recording states it, in its own spelling; empty if it states none.
    is_label : whether it holds the same word in every line, such as `a/g:`.
    """

    name: str
    unit: str = ""
    is_label: bool = False


@dataclass(frozen=True)
class Topic:
    """A table within a recording.

    Attributes
    ----------
    name : empty for the only table of a file.
    columns : in the order of the file.
    where : file and line or part, for errors.
    note : how the columns were found, in words; empty if the format says it.
    rate_hz : sampling rate that the recording states; None if it states none.
    misfit : whether there are names that differ in number from the data fields; the columns have none then.
    numbered : whether the name is a number in each line, which says nothing by itself.
    kind : `a` or `g` if it is stated that the topic holds accelerometers or gyros.
    """

    name: str
    columns: tuple[SourceColumn, ...]
    where: str
    note: str = ""
    rate_hz: float | None = None
    misfit: bool = False
    numbered: bool = False
    kind: str = ""

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
    if not positions:
        allowed = "one column of numbers or more"
        raise input_error(f"{described(topic)} has no column of numbers", topic.where, allowed, "record it again")
    with tempfile.TemporaryFile() as spool:
        rows = 0
        for block in recording.blocks(topic, positions):
            spool.write(np.ascontiguousarray(block, dtype=np.float64).data)
            rows += len(block)
            refuse_expansion(recording.file, 8 * rows * len(positions))
        spool.flush()
        if rows == 0:
            raise input_error(f"{described(topic)} has no rows", topic.where, "one row or more", "record it again")
        return np.memmap(spool, dtype=np.float64, mode="r", shape=(rows, len(positions)))


def first_rows(recording: SourceRecording, topic: Topic, positions: Sequence[int]) -> np.ndarray:
    """Return the first rows of columns of a topic, shape (n, columns); n is 0 for a topic without rows."""
    return next(iter(recording.blocks(topic, positions)), np.zeros((0, len(positions))))


MOST_EXPANSION, LEAST_LIMIT = 200, 1 << 28
"""Bytes of numbers for one byte of a file, and the bytes that any file may hold: noise compresses tenfold at most."""


def refuse_expansion(file: Path, size: int) -> None:
    """Raise InputError if a file holds, or says that it holds, far more numbers than its size can be."""
    own = sum(part.stat().st_size for part in (file.rglob("*") if file.is_dir() else (file,)) if part.is_file())
    most = max(LEAST_LIMIT, MOST_EXPANSION * own)
    if size > most:
        raise input_error(
            f"the file of {own:.3g} bytes expands to {size:.3g} bytes of numbers", str(file),
            f"at most {most:.3g} bytes: recorded noise does not compress so far",
            "export the recording again, not compressed, or a shorter part of it",
        )  # fmt: skip


@dataclass(frozen=True)
class RecordingKind:
    """A kind of recordings, and what opens one.

    Attributes
    ----------
    name : of the kind, for messages.
    fits : whether a file that begins so is of the kind.
    reader : opens it.
    package : the package of an extra that the reader needs; empty if there is none.
    """

    name: str
    fits: Callable[[bytes], bool]
    reader: Callable[[Path], SourceRecording]
    package: str = ""


class ForeignRecording(SourceRecording):
    """A recording whose reader may fail in any way, and print: a failure is one error that names the file.

    Readers of other projects raise whatever a damaged byte leads to.
    """

    def __init__(self, file: Path, kind: RecordingKind) -> None:
        self.file, self.kind = file, kind
        with self._reading():
            self.reader = kind.reader(file)
        self.file = self.reader.file

    def topics(self) -> tuple[Topic, ...]:
        """Return what the file holds."""
        with self._reading():
            return self.reader.topics()

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows of some columns."""
        blocks = self.reader.blocks(topic, positions)
        while True:
            # Around each step alone: in between, others print.
            with self._reading():
                block = next(blocks, None)
            if block is None:
                return
            # What no instrument reads is an error at its place, as infinity is, before its square overflows.
            absurd = np.abs(block) > ABSURD
            yield np.where(absurd, np.copysign(np.inf, block), block) if absurd.any() else block

    def notes(self) -> tuple[str, ...]:
        """Return what was left out while the blocks were read, in words."""
        return self.reader.notes()

    @contextmanager
    def _reading(self) -> Iterator[None]:
        level, printed = logging.root.manager.disable, io.StringIO()
        logging.disable(logging.CRITICAL)
        try:
            with warnings.catch_warnings(action="ignore"), redirect_stdout(printed), redirect_stderr(printed):
                yield
        except InputError:
            raise
        except ModuleNotFoundError as error:
            if not self.kind.package:
                raise
            raise _needs_package(self.file, self.kind) from error
        except Exception as error:
            raise _damaged(self.file, self.kind.name, error) from error
        finally:
            logging.disable(level)


def described(topic: Topic) -> str:
    """Return a topic in words."""
    return f"topic '{topic.name}'" if topic.name else "the table"


def _damaged(file: Path, kind: str, error: Exception) -> InputError:
    why = str(error).splitlines()[0][:160] if str(error) else type(error).__name__
    return input_error(
        f"the {kind} file cannot be read: {why}", str(file), f"a complete {kind} file", "copy or record the file again"
    )


def _needs_package(file: Path, kind: RecordingKind) -> InputError:
    return input_error(
        f"{kind.name} files need the package '{kind.package}'", str(file), f"pip install {kind.package}",
        "install it, or pip install 'imubayes[recordings]' for all formats",
    )  # fmt: skip

"""VectorNav sentences in text: `$VNIMU,…*CS` and others, with the fields that the maker's manual defines.

The fields have no names in the log: VN-100 User Manual, section on asynchronous messages.  A sentence whose checksum is
wrong is left out and counted.  Text before a sentence in its line, such as the time of a terminal, is not read.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import islice
from operator import xor
from pathlib import Path

import numpy as np

from imubayes.foundations.wording import counted
from imubayes_recordings.convert.recording import BLOCK_ROWS, SourceColumn, SourceRecording, Topic

_SIGN = b"$VN"
_PROBED_LINES = 400


def _three(name: str, unit: str) -> tuple[SourceColumn, ...]:
    return tuple(SourceColumn(f"{name}{axis}", unit) for axis in "XYZ")


_ANGLES = tuple(SourceColumn(name, "deg") for name in ("Yaw", "Pitch", "Roll"))
_QUATERNION = tuple(SourceColumn(f"Quat{k}") for k in range(4))
_MAGNETIC, _FORCE, _RATE = _three("Mag", "gauss"), _three("Accel", "m/s^2"), _three("Gyro", "rad/s")
_WARM = (SourceColumn("Temperature", "degC"), SourceColumn("Pressure", "kPa"))
_FIELDS = {
    "VNIMU": (*_MAGNETIC, *_FORCE, *_RATE, *_WARM),
    "VNYMR": (*_ANGLES, *_MAGNETIC, *_FORCE, *_RATE),
    "VNQMR": (*_QUATERNION, *_MAGNETIC, *_FORCE, *_RATE),
    "VNQAR": (*_QUATERNION, *_FORCE, *_RATE),
    "VNMAR": (*_MAGNETIC, *_FORCE, *_RATE),
    "VNACC": _FORCE,
    "VNGYR": _RATE,
}


def is_vectornav(head: bytes) -> bool:
    """Return whether the beginning of a file holds sentences with accelerometers or gyros, and not in a table."""
    found = [line[line.index(_SIGN) + 1 :] for line in head.splitlines()[:-1] if _SIGN in line]
    return len(found) > 1 and any(line[:5].decode("ascii", "replace") in _FIELDS and b"*" in line for line in found)


@dataclass(frozen=True)
class _Sentence:
    name: str
    cells: tuple[str, ...]
    whole: bool


class VectorNavLog(SourceRecording):
    """The sentences of a log, each kind a topic; other lines are passed over."""

    def __init__(self, file: Path) -> None:
        self.file, self._damaged = file, 0

    def topics(self) -> tuple[Topic, ...]:
        """Return one topic for each kind of sentence among the first lines."""
        kinds = dict.fromkeys(sentence.name for sentence in islice(self._sentences(), _PROBED_LINES))
        return tuple(Topic(name, _FIELDS[name], str(self.file), "fields of the sentence by its name") for name in kinds)

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows of one kind of sentence; one that is damaged is a row of NaN."""
        self._damaged = 0
        own = (sentence for sentence in self._sentences() if sentence.name == topic.name)
        while chunk := list(islice(own, BLOCK_ROWS)):
            yield np.array([self._row(each, len(topic.columns)) for each in chunk])[:, list(positions)]

    def notes(self) -> tuple[str, ...]:
        """Return how many sentences were left out."""
        if not self._damaged:
            return ()
        return (f"{self.file.name}: {counted(self._damaged, 'sentence')} with a wrong checksum or length left out",)

    def _sentences(self) -> Iterator[_Sentence]:
        with self.file.open("rb") as stream:
            for line in stream:
                place = line.find(_SIGN)
                body, star, check = line[place + 1 :].strip().partition(b"*")
                name, *cells = body.decode("ascii", "replace").split(",")
                if place >= 0 and name in _FIELDS:
                    yield _Sentence(name, tuple(cells), not star or _agrees(body, check))

    def _row(self, sentence: _Sentence, width: int) -> list[float]:
        try:
            if not sentence.whole or len(sentence.cells) < width:
                raise ValueError(sentence.name)
            return [float(cell) for cell in sentence.cells[:width]]
        except ValueError:
            self._damaged += 1
            return [np.nan] * width


def _agrees(body: bytes, check: bytes) -> bool:
    """Return whether the checksum agrees: two digits, the exclusive or of all bytes, or four digits, a CRC."""
    stated = check[:2]
    if len(check) > 2 or stated == b"XX":  # a 16-bit CRC, or none
        return True
    try:
        return int(stated, 16) == reduce(xor, body, 0)
    except ValueError:
        return False

"""ArduPilot DataFlash logs, binary and text, by pymavlink."""

import os
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from imubayes.foundations.deferred_modules import DeferredModule
from imubayes_recordings.convert.recording import BLOCK_ROWS, SourceColumn, SourceRecording, Topic

MAGICS = (b"\xa3\x95\x80", b"FMT, ", b"FMT,")
_SENSORS = ("IMU", "IMU2", "IMU3", "ACC", "ACC1", "ACC2", "ACC3", "GYR", "GYR1", "GYR2", "GYR3", "IMT")
# Of the log structure of ArduPilot, if the units are not in the log.
_UNITS = {"Acc": "m/s^2", "Gyr": "rad/s", "Tim": "us", "Sam": "us", "T": "degC"}
_INSTANCE = "I"

reader: Any = DeferredModule("pymavlink.DFReader")


class DataFlashLog(SourceRecording):
    """A flight log: one topic for each message of an inertial sensor and its instance."""

    def __init__(self, file: Path) -> None:
        self.file = file
        with file.open("rb") as stream:
            self._binary = stream.read(2) == MAGICS[0][:2]
        self._instances: dict[str, tuple[str, int | None]] = {}

    def topics(self) -> tuple[Topic, ...]:
        """Return the messages of inertial sensors."""
        fields: dict[str, list[str]] = {}
        for message in self._messages():
            kind, own = message.get_type(), getattr(message, _INSTANCE, None)
            name = kind if own is None else f"{kind}[{own}]"
            if name not in fields:
                self._instances[name] = (kind, own)
                fields[name] = [field for field in message.get_fieldnames() if field != _INSTANCE]
        return tuple(
            Topic(name, tuple(SourceColumn(field, _unit(field)) for field in own), f"{self.file}, {name}")
            for name, own in sorted(fields.items())
        )

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield one row a message."""
        names, rows = [topic.columns[place].name for place in positions], []
        kind, instance = self._instances[topic.name]
        for message in self._messages(kind):
            if getattr(message, _INSTANCE, None) == instance:
                rows.append([float(getattr(message, name)) for name in names])
            if len(rows) == BLOCK_ROWS:
                yield np.array(rows)
                rows = []
        if rows:
            yield np.array(rows)

    def _messages(self, *kinds: str) -> Iterator[Any]:
        # Its other indexer is written in C, and prints past Python.
        os.environ["PYMAVLINK_FAST_INDEX"] = "0"
        with closing((reader.DFReader_binary if self._binary else reader.DFReader_text)(str(self.file))) as opened:
            while (message := opened.recv_match(type=list(kinds or _SENSORS))) is not None:
                yield message


def _unit(field: str) -> str:
    return _UNITS.get(field[:3], "")

"""ROS bags of version 1 (`.bag`) and 2 (folders, `.db3`, `.mcap`), by rosbags."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imubayes.foundations.deferred_modules import DeferredModule
from imubayes_recordings.convert.recording import BLOCK_ROWS, SourceColumn, SourceRecording, Topic

MAGICS = (b"#ROSBAG V2.0", b"\x89MCAP0\r\n", b"SQLite format 3\0")
FOLDER_FILE = "metadata.yaml"
_MOST_ELEMENTS = 9  # of an array that is taken apart into columns
# Units by the definition of the message.
_UNITS = {"linear_acceleration": "m/s^2", "angular_velocity": "rad/s", "temperature": "degC"}
_ARRIVAL = "arrival"

highlevel: Any = DeferredModule("rosbags.highlevel")
typesys: Any = DeferredModule("rosbags.typesys")


class RosBag(SourceRecording):
    """A bag: one topic for each topic of ROS whose messages hold numbers."""

    def __init__(self, file: Path) -> None:
        self.file, self._reader = file, highlevel.AnyReader
        self._types = typesys.get_typestore(typesys.Stores.LATEST)

    def topics(self) -> tuple[Topic, ...]:
        """Return the topics, with the fields of their first message."""
        found = []
        with self._opened() as bag:
            for name in sorted(bag.topics):
                connections = [each for each in bag.connections if each.topic == name]
                message = next(self._messages(bag, connections), None)
                fields = () if message is None else tuple(_leaves(message[1]))
                if fields:
                    columns = tuple(SourceColumn(path, _unit(path)) for path, _ in fields)
                    columns = (*columns, SourceColumn(_ARRIVAL, "ns"))
                    found.append(Topic(name, columns, f"{self.file}, {name}", connections[0].msgtype))
        return tuple(found)

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield one row a message."""
        names, rows = [topic.columns[place].name for place in positions], []
        with self._opened() as bag:
            for arrival, message in self._messages(bag, [each for each in bag.connections if each.topic == topic.name]):
                leaves = dict(_leaves(message)) | {_ARRIVAL: float(arrival)}
                rows.append([leaves.get(name, np.nan) for name in names])
                if len(rows) == BLOCK_ROWS:
                    yield np.array(rows)
                    rows = []
        if rows:
            yield np.array(rows)

    def _messages(self, bag: Any, connections: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        for connection, arrival, raw in bag.messages(connections=connections):
            yield arrival, bag.deserialize(raw, connection.msgtype)

    def _opened(self) -> Any:
        return self._reader([self.file], default_typestore=self._types)


def _leaves(message: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers in a message, by their path."""
    for field in dataclasses.fields(message):
        value, name = getattr(message, field.name), f"{path}{field.name}"
        if hasattr(value, "nanosec"):
            yield name, value.sec + 1e-9 * value.nanosec
        elif dataclasses.is_dataclass(value):
            yield from _leaves(value, f"{name}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield name, float(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and value.size <= _MOST_ELEMENTS:
            yield from ((f"{name}[{place}]", float(each)) for place, each in enumerate(value.ravel()))


def _unit(path: str) -> str:
    return "s" if path.endswith("stamp") else _UNITS.get(path.partition(".")[0], "")

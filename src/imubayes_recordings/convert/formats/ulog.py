"""PX4 flight logs (ULog), by pyulog."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imubayes.foundations.deferred_modules import DeferredModule
from imubayes_recordings.convert.recording import BLOCK_ROWS, SourceColumn, SourceRecording, Topic

MAGIC = b"ULog\x01\x12\x35"
# Units are in the names of fields, or in the definition of the message.
_UNITS = {"gyro_rad": "rad/s", "accelerometer_m_s2": "m/s^2"}
_OF_MESSAGE = {"sensor_accel": "m/s^2", "sensor_gyro": "rad/s", "vehicle_acceleration": "m/s^2",
               "vehicle_angular_velocity": "rad/s"}  # fmt: skip

pyulog: Any = DeferredModule("pyulog")


class ULogRecording(SourceRecording):
    """A flight log: one topic for each message and instance."""

    def __init__(self, file: Path) -> None:
        self.file = file
        content = pyulog.ULog(str(file))
        several = {data.name for data in content.data_list if data.multi_id}
        self._data = {
            f"{data.name}.{data.multi_id}" if data.name in several else data.name: data for data in content.data_list
        }
        self._dropouts = [dropout.duration for dropout in content.dropouts]

    def topics(self) -> tuple[Topic, ...]:
        """Return the messages."""
        return tuple(
            Topic(name, tuple(SourceColumn(field, _unit(data.name, field)) for field in _fields(data)),
                  f"{self.file}, {name}")
            for name, data in self._data.items()
        )  # fmt: skip

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows of a message."""
        fields = self._data[topic.name].data
        columns = [fields[topic.columns[place].name] for place in positions]
        for first in range(0, len(columns[0]), BLOCK_ROWS):
            yield np.stack([column[first : first + BLOCK_ROWS].astype(float) for column in columns], axis=1)

    def notes(self) -> tuple[str, ...]:
        """Return what the logger itself says that it lost."""
        if not self._dropouts:
            return ()
        return (f"{self.file.name}: the logger dropped data {len(self._dropouts)} times, {sum(self._dropouts)} ms",)


def _fields(data: Any) -> list[str]:
    return [name for name, values in data.data.items() if np.asarray(values).dtype.kind in "iuf"]


def _unit(message: str, field: str) -> str:
    if field.startswith("timestamp"):
        return "us"
    if field in ("x", "y", "z") or field.startswith("xyz["):
        return _OF_MESSAGE.get(message, "")
    return _UNITS.get(field.partition("[")[0], "degC" if field == "temperature" else "")

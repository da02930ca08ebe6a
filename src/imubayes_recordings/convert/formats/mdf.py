"""ASAM MDF files of measurement systems in vehicles, version 3 and 4, by asammdf."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from imubayes.foundations.deferred_modules import DeferredModule
from imubayes_recordings.convert.recording import BLOCK_ROWS, SourceColumn, SourceRecording, Topic

MAGIC = b"MDF     "
_MASTER = "time"

asammdf: Any = DeferredModule("asammdf")


class MdfRecording(SourceRecording):
    """A file: one topic for each channel group, with its master channel as time in seconds."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._groups: dict[str, tuple[int, int, list[int]]] = {}

    def topics(self) -> tuple[Topic, ...]:
        """Return the channel groups that hold numbers, with units and time."""
        found = []
        with self._opened() as content:
            for place, group in enumerate(content.groups):
                rows, master = int(group.channel_group.cycles_nr), content.masters_db.get(place)
                own: list[int] = []
                columns = [SourceColumn(_MASTER, "s")]
                for index, channel in enumerate(group.channels) if rows > 1 else ():
                    first = None if index == master else content.get(group=place, index=index, record_count=1)
                    if first is not None and first.samples.ndim == 1 and first.samples.dtype.kind in "iuf":
                        own.append(index)
                        columns.append(SourceColumn(channel.name.partition("\\")[0], first.unit or ""))
                if own:
                    name = f"group {place + 1}"
                    self._groups[name] = (place, rows, own)
                    timed = columns if master is not None else columns[1:]
                    found.append(Topic(name, tuple(timed), f"{self.file}, {name}"))
        return tuple(found)

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows as physical values."""
        group, rows, own = self._groups[topic.name]
        timed = int(topic.names[0] == _MASTER and len(topic.columns) > len(own))
        with self._opened() as content:
            for first in range(0, rows, BLOCK_ROWS):
                part = {"record_offset": first, "record_count": min(BLOCK_ROWS, rows - first)}
                columns = []
                for place in positions:
                    signal = content.get(group=group, index=own[max(place - timed, 0)], **part)
                    columns.append(signal.timestamps if timed and place == 0 else signal.samples)
                yield np.stack([np.asarray(column, dtype=np.float64) for column in columns], axis=1)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        opened = asammdf.MDF(str(self.file))
        try:
            yield opened
        finally:
            opened.close()

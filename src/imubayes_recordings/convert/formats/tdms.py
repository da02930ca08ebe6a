"""LabVIEW TDMS files, by npTDMS."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from imubayes.foundations.deferred_modules import DeferredModule
from imubayes_recordings.convert.recording import BLOCK_ROWS, SourceColumn, SourceRecording, Topic

MAGIC = b"TDSm"

nptdms: Any = DeferredModule("nptdms")


class TdmsRecording(SourceRecording):
    """A file: one topic for each group and length of its channels."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._tables: dict[str, list[tuple[str, str]]] = {}

    def topics(self) -> tuple[Topic, ...]:
        """Return the groups, with the sampling rate of their waveforms."""
        found = []
        with self._opened() as content:
            for group in content.groups():
                own = [each for each in group.channels() if len(each) > 1 and np.dtype(each.dtype).kind in "iufM"]
                lengths = sorted({len(channel) for channel in own})
                for length in lengths:
                    name = group.name if len(lengths) == 1 else f"{group.name} of {length} rows"
                    channels = [channel for channel in own if len(channel) == length]
                    self._tables[name] = [(group.name, channel.name) for channel in channels]
                    columns = tuple(SourceColumn(each.name, _unit(each)) for each in channels)
                    found.append(Topic(name, columns, f"{self.file}, {name}", rate_hz=_rate(channels)))
        return tuple(found)

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows; times count in seconds from the epoch."""
        with self._opened() as content:
            places = [self._tables[topic.name][place] for place in positions]
            channels = [content[group][channel] for group, channel in places]
            for first in range(0, len(channels[0]), BLOCK_ROWS):
                yield np.stack([_numbers(channel[first : first + BLOCK_ROWS]) for channel in channels], axis=1)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        with self.file.open("rb") as stream, nptdms.TdmsFile.open(stream) as content:
            yield content


def _unit(channel: Any) -> str:
    if np.dtype(channel.dtype).kind == "M":
        return "s"
    return str(channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription") or "")


def _rate(channels: Sequence[Any]) -> float | None:
    """Return the sampling rate that all waveforms share; a TDMS waveform has its interval in seconds."""
    steps = {float(channel.properties.get("wf_increment", 0.0)) for channel in channels}
    return 1.0 / steps.pop() if len(steps) == 1 and min(steps) > 0 else None


def _numbers(values: np.ndarray) -> np.ndarray:
    if values.dtype.kind == "M":
        return values.astype("datetime64[ns]").astype(np.int64) * 1e-9
    return values.astype(np.float64)

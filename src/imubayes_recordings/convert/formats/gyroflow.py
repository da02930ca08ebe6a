"""Gyroflow logs, `.gcsv`: a text table below lines of keys, which state the factors of times, rates and forces.

Times are in `tscale` seconds, rates in `gscale` rad/s, accelerations in `ascale` g (Gyroflow documentation, custom
logger).
"""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from imubayes_recordings.convert.formats.text import TextRecording
from imubayes_recordings.convert.formats.text_layout import open_text
from imubayes_recordings.convert.recording import SourceColumn, Topic

MAGIC = b"GYROFLOW IMU LOG"
# First letter of a column → the key of its factor, and the unit of the product.
_SCALES = {"t": ("tscale", "s"), "g": ("gscale", "rad/s"), "a": ("ascale", "g")}


class GyroflowLog(TextRecording):
    """A text table whose columns are multiplied by the factors above it."""

    def __init__(self, file: Path) -> None:
        super().__init__(file)
        self._factors = self._stated_factors()

    def topics(self) -> tuple[Topic, ...]:
        """Return the table, with the units that its factors lead to; a column without a factor has none."""
        [topic] = super().topics()
        columns = tuple(SourceColumn(name, self._scale(name)[1]) for name in topic.names)
        stated = ", ".join(f"{key} {factor:.6g}" for key, factor in self._factors.items())
        return (Topic(topic.name, columns, topic.where, f"{topic.note}, {stated}" if stated else topic.note),)

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows in the units of the topic."""
        factors = np.array([self._scale(topic.names[place])[0] for place in positions])
        for block in super().blocks(topic, positions):
            yield block * factors

    def _scale(self, name: str) -> tuple[float, str]:
        key, unit = _SCALES.get(name[:1], ("", ""))
        return (self._factors[key], unit) if key in self._factors else (1.0, "")

    def _stated_factors(self) -> dict[str, float]:
        with open_text(self.file, self.layout.encoding) as stream:
            cells = [line.strip().partition(",") for line in islice(stream, self.layout.first - 1)]
        keys = {key for key, _ in _SCALES.values()}
        return {key.strip(): float(value) for key, _, value in cells if key.strip() in keys}

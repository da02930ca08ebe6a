"""NovAtel RAWIMU logs in ASCII: `#RAWIMUA` and `%RAWIMUSA` lines.

A line gives the increments over one sample, in counts of the receiver's own scale, in the order z, −y, x: first the
accelerometers, then the gyros (OEM7 Commands and Logs Reference Manual, RAWIMU and RAWIMUS).  They become channels in
counts, x, y and z of the enclosure; their nominal scale is estimated from the recording, or given.
"""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from imubayes.foundations.wording import counted
from imubayes_recordings.convert.recording import BLOCK_ROWS, SourceColumn, SourceRecording, Topic

MAGICS = (b"%RAWIMU", b"#RAWIMU")
_SEARCHED = 400  # lines of other logs before the first
# Column → place behind the seconds of the week, and sign; between them stands the status.
_PLACES = {"ax": (4, 1.0), "ay": (3, -1.0), "az": (2, 1.0), "gx": (7, 1.0), "gy": (6, -1.0), "gz": (5, 1.0)}
_COLUMNS = (SourceColumn("time_s", "s"), *(SourceColumn(name, "count") for name in _PLACES))


def is_rawimu(head: bytes) -> bool:
    """Return whether the beginning of a file holds a RAWIMU line."""
    return any(line.startswith(MAGICS) for line in head.splitlines()[:_SEARCHED])


class RawImuLog(SourceRecording):
    """The RAWIMU lines of a log; other logs in between are passed over."""

    def __init__(self, file: Path) -> None:
        self.file, self._damaged = file, 0

    def topics(self) -> tuple[Topic, ...]:
        """Return the one topic."""
        return (Topic("RAWIMU", _COLUMNS, str(self.file), "increments in counts, order z, −y, x put right"),)

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows; the time is in seconds of the week."""
        self._damaged = 0
        with self.file.open(encoding="ascii", errors="replace") as stream:
            lines = (line for line in stream if line.encode("ascii", "replace").startswith(MAGICS))
            while chunk := list(islice(lines, BLOCK_ROWS)):
                yield np.array([self._row(line) for line in chunk])[:, list(positions)]

    def notes(self) -> tuple[str, ...]:
        """Return how many lines were left out."""
        return (f"{self.file.name}: {counted(self._damaged, 'damaged line')} left out",) if self._damaged else ()

    def _row(self, line: str) -> list[float]:
        cells = line.partition(";")[2].partition("*")[0].split(",")
        # `A` has week and seconds, the short form the same behind its header.
        try:
            seconds = float(cells[1])
            return [seconds, *(sign * float(cells[1 + place]) for place, sign in _PLACES.values())]
        except (IndexError, ValueError):
            self._damaged += 1
            return [np.nan] * len(_COLUMNS)

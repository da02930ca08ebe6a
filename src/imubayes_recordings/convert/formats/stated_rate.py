"""The sampling rate that the lines above a table state: `# Config: data_rate = 2000.0 Hz`, `OutputRate:,100Hz`."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

_RATE = re.compile(
    r"(?<![a-z])(?:(?:data|sampl[a-z]*|output|update|acquisition|logging)[ _-]*(?:rate|freq[a-z]*)|odr)"
    r"(?P<of_key>[ _]*[\[(]?hz[\])]?)?[\s\"':=,;]*(?P<value>\d+(?:\.\d+)?)[\s\"]*(?P<unit>k?hz)?(?![\w.])",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class StatedRate:
    """A sampling rate, Hz, and the line that states it, from 1."""

    hz: float
    line: int


def stated_rate(lines: Sequence[tuple[int, str]]) -> StatedRate | None:
    """Return the only rate in Hz that some lines with their numbers state; None if they state none, or several."""
    found = {}
    for number, line in lines:
        for match in _RATE.finditer(line):
            unit = (match["unit"] or match["of_key"] or "").lower()
            if unit and float(match["value"]) > 0:
                found[float(match["value"]) * (1000.0 if unit == "khz" else 1.0)] = number
    return StatedRate(*next(iter(found.items()))) if len(found) == 1 else None

"""Steps of a long computation, counted aloud with the time that is left."""

import time
from collections.abc import Callable, Iterator, Sequence

Tell = Callable[[str], None]
"""Called with a short text as a computation goes on."""

_SOONEST = 3.0
"""Seconds before the time left is estimated: the first steps compile."""


def silent(text: str) -> None:
    """Report nothing."""


def counted[Item](tell: Tell, what: str, items: Sequence[Item]) -> Iterator[Item]:
    """Yield items, and report before each which of how many it is, and about how long the rest will take.

    The estimate is by the steps after the first, which compiles what the others use again.
    """
    began = second = time.monotonic()
    for place, item in enumerate(items):
        now = time.monotonic()
        second = now if place == 1 else second
        each = (now - second) / (place - 1) if place > 1 else 0.0
        left = f", about {duration(each * (len(items) - place))} left" if each and now - began > _SOONEST else ""
        tell(f"{what}, {place + 1} of {len(items)}{left}")
        yield item


def duration(seconds: float) -> str:
    """Return a duration in words: ``40 s``, ``3 min``, ``1.5 h``."""
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"

"""Means that a clipped channel spoils: left out, because a sample at the limit says only that the input was beyond."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from imubayes.campaign.reduction.constant_spans import Span
from imubayes.campaign.run_tables import RowBatch

Limits = Mapping[str, tuple[float, ...]]
"""Channel → values at which it is clipped."""


def clipped_spans(batches: Iterable[RowBatch], spans: Sequence[Span], limits: Limits) -> dict[str, np.ndarray]:
    """Return for each clipped channel which spans hold samples at its limit, shape (len(spans),) bool."""
    found = {name: np.zeros(len(spans), dtype=bool) for name in limits}
    starts, stops = (np.array([getattr(span, end) for span in spans], dtype=int) for end in ("start", "stop"))
    for batch in batches:
        for name, values in limits.items():
            rows = batch.first + np.flatnonzero(np.isin(batch.numbers[name], values))
            place = np.searchsorted(starts, rows, side="right") - 1
            inside = (place >= 0) & (rows < stops[place])
            found[name][place[inside]] = True
    return {name: clipped for name, clipped in found.items() if clipped.any()}


def clipping_note(channel: str, limits: Sequence[float], left_out: int, of: int, noun: str) -> str:
    """Return a sentence on what was left out because a channel was clipped."""
    at = " and ".join(f"{value:g}" for value in limits)
    return f"'{channel}' is clipped at {at}: {left_out} of {of} {noun} left out"

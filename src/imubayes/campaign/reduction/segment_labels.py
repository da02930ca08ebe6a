"""Spans from the `segment` column, or from other label columns.

Consecutive rows with the same label form a span; rows with an empty label are left out.
"""

from collections.abc import Sequence

import numpy as np

from imubayes.campaign.reduction.constant_spans import REST_RATE, Span
from imubayes.campaign.run_tables import RowBatch


class SegmentTracker:
    """Collects labelled spans batch by batch; several columns form one combined label."""

    def __init__(self, columns: Sequence[str] = ("segment",)) -> None:
        self._columns = tuple(columns)
        self._label: tuple[str, ...] | None = None
        self._start = 0
        self._spans: list[tuple[tuple[str, ...] | None, int, int]] = []
        self._rate_sum: list[float] = []
        self._rate = 0.0
        self._rows = 0

    def push(self, batch: RowBatch) -> None:
        """Add the next batch."""
        combined = zip(*(batch.texts[name] for name in self._columns), strict=True)
        labels = [tuple(map(str, parts)) if all(parts) else None for parts in combined]
        rate = batch.numbers.get("table_rate_deg_s")
        absolute = np.zeros(batch.rows) if rate is None else np.nan_to_num(np.abs(rate))
        edges = [i for i in range(1, batch.rows) if labels[i] != labels[i - 1]]
        for begin, end in zip([0, *edges], [*edges, batch.rows], strict=True):
            if batch.first + begin == 0 or labels[begin] != self._label:
                self._close(batch.first + begin)
                self._label = labels[begin]
            self._rate = max(self._rate, float(np.max(absolute[begin:end], initial=0.0)))
        self._rows = batch.first + batch.rows

    def spans(self) -> list[Span]:
        """Return the labelled spans."""
        self._close(self._rows)
        return [
            Span(start, stop, rate > REST_RATE)
            for (label, start, stop), rate in zip(self._spans, self._rate_sum, strict=True)
            if label is not None and stop > start
        ]

    def _close(self, row: int) -> None:
        if row > self._start:
            self._spans.append((self._label, self._start, row))
            self._rate_sum.append(self._rate)
        self._start, self._rate = row, 0.0

"""First pass over a raw log: statistics of short blocks in bounded memory.

A block has its means, extremes and end values.  The stimulus is detected from blocks of a tenth of a second, not from
single samples.  Beyond `MOST_BLOCKS` blocks, neighbours are merged in pairs, so that a log of any length fits.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.campaign.run_tables import RowBatch
from imubayes.campaign.sampling_rate import sampling_interval

BLOCK_SECONDS = 0.1
MOST_BLOCKS = 1 << 16
EXTREMES = ("table_rate_deg_s", "table_angle_deg", "current_mA")
ENDS = ("time_s", "table_angle_deg")
_LEVELS, _TURNS, _AWAY, _LEAST_BLOCKS = 20.0, math.radians(0.5), 0.05, 20
_NO_BIAS = math.radians(30.0)  # the largest zero-rate output of data sheets is 20 deg/s


@dataclass(frozen=True)
class BlockSurvey:
    """Consecutive blocks of a raw log; every array has one element per block.

    Attributes
    ----------
    start, count : first row and number of rows.
    mean : column → mean over the non-empty cells, NaN where all are empty.
    low, high : stimulus column → minimum and maximum.
    first, last : time and angle of the first and last row.
    interval : sampling interval, s; None if the log has no time.
    """

    start: np.ndarray
    count: np.ndarray
    mean: dict[str, np.ndarray]
    low: dict[str, np.ndarray]
    high: dict[str, np.ndarray]
    first: dict[str, np.ndarray]
    last: dict[str, np.ndarray]
    interval: float | None

    @property
    def size(self) -> int:
        """Number of blocks."""
        return len(self.start)


class BlockBuilder:
    """Builds a `BlockSurvey` batch by batch."""

    def __init__(self, columns: Sequence[str]):
        self._columns = tuple(columns)
        self._interval: float | None = None
        self._length = 0
        self._carry: dict[str, np.ndarray] = {}
        self._next_row = 0
        self._parts: list[dict[str, np.ndarray]] = []
        self._blocks = 0

    def push(self, batch: RowBatch) -> None:
        """Add the next batch."""
        if self._length == 0:
            self._interval = sampling_interval(batch.numbers.get("time_s"))
            seconds = self._interval or BLOCK_SECONDS
            self._length = max(1, round(BLOCK_SECONDS / seconds))
        numbers = {
            name: np.concatenate([self._carry[name], batch.numbers[name]]) if self._carry else batch.numbers[name]
            for name in self._columns
        }
        rows = len(numbers[self._columns[0]])
        whole = rows - rows % self._length
        if whole:
            self._append({name: values[:whole] for name, values in numbers.items()}, whole)
        self._carry = {name: values[whole:].copy() for name, values in numbers.items()}

    def finish(self) -> BlockSurvey:
        """Return the survey; a last incomplete block is included."""
        rows = len(next(iter(self._carry.values()))) if self._carry else 0
        if rows:
            self._append(self._carry, rows)
            self._carry = {}
        joined = _join(self._parts)
        return BlockSurvey(
            joined.pop("start"),
            joined.pop("count"),
            {name: _ratio(joined[f"sum {name}"], joined[f"valid {name}"]) for name in self._columns},
            _pick(joined, "low "),
            _pick(joined, "high "),
            _pick(joined, "first "),
            _pick(joined, "last "),
            self._interval,
        )

    def _append(self, numbers: dict[str, np.ndarray], rows: int) -> None:
        part = _summarise(numbers, rows, self._length, self._next_row)
        self._next_row += rows
        self._parts.append(part)
        self._blocks += len(part["start"])
        if self._blocks > MOST_BLOCKS:
            merged = _merge_pairs(_join(self._parts))
            self._parts, self._blocks = [merged], len(merged["start"])
            self._length *= 2


def turning_span(rate: np.ndarray) -> float:
    """Return how fast a gyro turns at levels of rate, as on a table; 0 of noise, drift, a bias, a knock or a step.

    A turn about the vertical leaves gravity where it is, so that only a gyro shows it.

    Parameters
    ----------
    rate : means of successive blocks of a gyro, rad/s, shape (B,); NaN where there is none.
    """
    rate = rate[np.isfinite(rate)]
    if len(rate) < _LEAST_BLOCKS:
        return 0.0
    change, off = np.abs(np.diff(rate)), np.abs(rate - np.median(rate))
    usual = float(np.median(change))
    away = float(np.mean(off > max(_TURNS, _LEVELS * usual)))
    turns = (change.max() > _LEVELS * usual and away > _AWAY) or abs(np.median(rate)) > _NO_BIAS
    return float(np.abs(rate).max()) if turns else 0.0


def _summarise(numbers: dict[str, np.ndarray], rows: int, length: int, first_row: int) -> dict[str, np.ndarray]:
    starts = np.arange(0, rows, length)
    stops = np.minimum(starts + length, rows) - 1
    part = {"start": first_row + starts, "count": stops + 1 - starts}
    for name, values in numbers.items():
        present = ~np.isnan(values)
        part[f"sum {name}"] = np.add.reduceat(np.where(present, values, 0.0), starts)
        part[f"valid {name}"] = np.add.reduceat(present.astype(np.int64), starts)
        if name in EXTREMES:
            part[f"low {name}"] = np.fmin.reduceat(values, starts)
            part[f"high {name}"] = np.fmax.reduceat(values, starts)
        if name in ENDS:
            part[f"first {name}"] = values[starts]
            part[f"last {name}"] = values[stops]
    return part


def _merge_pairs(part: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    pairs = np.arange(0, len(part["start"]), 2)
    seconds = np.minimum(pairs + 1, len(part["start"]) - 1)
    merged = {}
    for key, values in part.items():
        kind = key.split(" ", 1)[0]
        if kind in ("count", "sum", "valid"):
            merged[key] = np.add.reduceat(values, pairs)
        elif kind in ("low", "high"):
            merged[key] = (np.fmin if kind == "low" else np.fmax).reduceat(values, pairs)
        else:
            merged[key] = values[seconds if kind == "last" else pairs]
    return merged


def _join(parts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def _pick(joined: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {key.removeprefix(prefix): values for key, values in joined.items() if key.startswith(prefix)}


def _ratio(total: np.ndarray, count: np.ndarray) -> np.ndarray:
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)

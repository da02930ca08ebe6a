"""The time that every entry averages over, and the order in which slow noise passes through the entries (NumPy).

A run records the middle times of its rows and the numbers of their samples, not the length of a sample.  That is the
smallest distance of neighbouring rows per sample between their middles: exact where rows follow without a gap.  Rows
of a run without times follow each other without a gap.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np

from imubayes.array_shapes import Array, Int
from imubayes.campaign_data import Campaign, Run
from imubayes.model.nodes_and_entries import Entries
from imubayes.noise.base import RowSpan

# Largest ratio of neighbouring correlation times: see `imubayes.noise.slow_components.FlickerNoise`.
_RATIO = 5.0


class Timeline(eqx.Module):
    """Times of the entries, in the order in which slow noise passes through them.

    Runs and channels follow one another in lanes of nearly equal length, which are passed side by side.

    Attributes
    ----------
    row : leaves (E,), and times (J,).
    lanes : shape (S, L), entry at each step of each lane, E where there is none.
    place : shape (E,), place of each entry in the flattened lanes.
    """

    row: RowSpan
    lanes: Int[Array, "S L"]
    place: Int[Array, " E"]


def has_row_times(campaign: Campaign) -> bool:
    """Tell whether any run shows how long a sample lasts."""
    return any(np.isfinite(_sample_length(run)) for run in campaign.runs)


def timeline(campaign: Campaign, entries: Entries, group: np.ndarray) -> Timeline:
    """Return the times of the entries.

    Parameters
    ----------
    group : shape (E,), run and channel of each entry.
    """
    spans = _spans(campaign)
    start, length = np.zeros(len(entries)), np.ones(len(entries))
    for index, (begin, lasting) in enumerate(spans):
        chosen = (entries.run == index) & ~entries.closing
        start[chosen], length[chosen] = begin[entries.row[chosen]], lasting[entries.row[chosen]]
    order = np.lexsort((start, group))
    first = np.diff(group[order], prepend=-1) != 0
    end = (start + length)[order]
    gap = np.empty(len(entries))
    gap[order] = np.where(first, np.inf, np.maximum(start[order] - np.roll(end, 1), 0.0))
    lanes = _lanes(np.split(order, np.flatnonzero(first)[1:]), len(entries))
    place = np.empty(len(entries), dtype=int)
    filled = lanes.reshape(-1) < len(entries)
    place[lanes.reshape(-1)[filled]] = np.flatnonzero(filled)
    return Timeline(RowSpan(start, length, gap, _times(spans)), lanes, place)


def _sample_length(run: Run) -> float:
    """Return the length of a sample in s, ∞ where the run does not show it."""
    time = run.covariates.get("time")
    if time is None or run.rows < 2:
        return np.inf
    order = np.argsort(time, kind="stable")
    samples = run.samples[order]
    apart = np.diff(time[order]) / (0.5 * (samples[1:] + samples[:-1]))
    return float(np.min(apart[apart > 0], initial=np.inf))


def _spans(campaign: Campaign) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the start of every row since that of its run, and its length, run by run."""
    own = [_sample_length(run) for run in campaign.runs]
    usual = min(own)
    found = []
    for run, sample in zip(campaign.runs, own, strict=True):
        if np.isfinite(sample):
            length = run.samples * sample
            start = run.covariates["time"] - length / 2
            found.append((start - start.min(initial=np.inf), length))
        else:
            length = run.samples * usual
            found.append((np.cumsum(length) - length, length))
    return found


def _times(spans: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return correlation times from half of short rows to the longest run, at least two."""
    # A remainder of a few samples at the end of a record is no row of its own.
    shortest = float(np.quantile(np.concatenate([length for _, length in spans]), 0.05)) / 2
    longest = max(float((start + length).max()) for start, length in spans if len(length))
    count = 1 + max(1, int(np.ceil(np.log(longest / shortest) / np.log(_RATIO))))
    return np.geomspace(shortest, longest, count)


def _lanes(groups: Sequence[np.ndarray], none: int) -> np.ndarray:
    """Return the entries of all groups in as few lanes as fit beside the largest group (first fit, decreasing)."""
    most = max((len(group) for group in groups), default=0)
    lanes: list[list[np.ndarray]] = []
    room: list[int] = []
    for group in sorted(groups, key=len, reverse=True):
        lane = next((place for place, left in enumerate(room) if left >= len(group)), len(lanes))
        if lane == len(lanes):
            lanes.append([])
            room.append(most)
        lanes[lane].append(group)
        room[lane] -= len(group)
    table = np.full((most, len(lanes)), none)
    for place, lane in enumerate(lanes):
        joined = np.concatenate(lane)
        table[: len(joined), place] = joined
    return table

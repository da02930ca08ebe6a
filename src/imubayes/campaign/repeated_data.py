"""Data that are read twice: two runs of one file, or with the same outputs in many rows.

Noise distinguishes readings.  That a run repeats the readings of another one by chance has a probability that follows
from the resolution of the outputs and from their noise.
"""

import math
from collections.abc import Sequence
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np

from imubayes.campaign.stream_checks import Finding
from imubayes.foundations.campaign_data import Channel, Run

LEAST_ALIKE, LEAST_SHARE_ALIKE = 3, 0.5
"""Rows alike, and their share of the shorter run."""
SURPRISE = 30.0
"""−log of the probability that they are by chance."""
_UNKNOWN, _LARGEST = 0.5, 0.9
"""Probability that two readings are alike if their noise is not known, and of coarse ones."""
_MOST_DECIMALS = 12


def check_repeats(runs: Sequence[Run], files: Sequence[str], channels: Sequence[Channel]) -> list[Finding]:
    """Return an error for every pair of runs that holds the same data."""
    found, compared = [], [_Compared(run, file) for run, file in zip(runs, files, strict=True)]
    for first, second in combinations(compared, 2):
        both = first.seen & second.seen
        if not both.any():
            continue
        same_file, alike = first.file == second.file, _rows_alike(first, second, channels, both)
        if alike or same_file:
            what = f"both read '{first.file.name}'" if same_file else f"have the same outputs in {alike} rows"
            names = f"'{first.run.name}' and '{second.run.name}'"
            found.append(
                Finding(
                    "same_data", "error", second.run.name, f"the runs {names} {what}: the data would count twice",
                    second.said, "one recording for each run", f"correct 'file' of one of {names}, or remove the run",
                )
            )  # fmt: skip
    return found


class _Compared:
    """The outputs of a run, as they are compared with every other."""

    def __init__(self, run: Run, said: str):
        self.run, self.said, self.file = run, said, Path(said).resolve()
        there = np.isfinite(run.observed)
        self.seen, filled = there.any(axis=0), np.where(there, run.observed, math.inf)
        self.varying = np.where(there, run.observed, -math.inf).max(axis=0) > filled.min(axis=0)
        self.of = cache(lambda channels: [row.tobytes() for row in filled[:, channels]])
        self.known = cache(lambda channels: frozenset(self.of(channels)))


def _rows_alike(first: _Compared, second: _Compared, channels: Sequence[Channel], both: np.ndarray) -> int:
    """Return the number of rows of the second run that are in the first, 0 if that may be by chance."""
    varying = tuple(np.flatnonzero(both & first.varying).tolist())
    if not varying or first.known(varying).isdisjoint(second.known(varying)):
        return 0
    known, run = first.known(varying), second.run
    alike = np.array([row in known for row in second.of(varying)])
    alike &= np.isfinite(run.observed[:, varying]).any(axis=1)
    if alike.sum() < max(LEAST_ALIKE, LEAST_SHARE_ALIKE * min(first.run.rows, run.rows)):
        return 0
    surprise = 0.0
    for k in varying:
        there = alike & np.isfinite(run.observed[:, k])
        values, samples = run.observed[there, k], run.samples[there]
        sd = np.where(np.isfinite(run.sample_sd[there, k]), run.sample_sd[there, k], channels[k].noise or math.nan)
        with np.errstate(divide="ignore"):
            # Two normal readings of a standard deviation s agree in a resolution q with probability q/(2√π s).
            chance = _resolution(values) * np.sqrt(samples) / (2 * math.sqrt(math.pi) * sd)
        surprise -= float(np.log(np.where(np.isnan(chance), _UNKNOWN, np.minimum(chance, _LARGEST))).sum())
    return int(alike.sum()) if surprise > SURPRISE else 0


def _resolution(values: np.ndarray) -> float:
    """Return the decimal resolution of readings."""
    for decimals in range(_MOST_DECIMALS):
        scaled = values * 10.0**decimals
        if np.all(np.abs(scaled - np.round(scaled)) <= 1e-9 * np.maximum(np.abs(scaled), 1.0)):
            return 10.0**-decimals
    return 10.0**-_MOST_DECIMALS

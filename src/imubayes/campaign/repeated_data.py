"""Data that are read twice: two runs of one file, or with the same outputs in many rows.

Noise tells readings apart.  That a run repeats the readings of another one by chance has a probability that follows
from the resolution of the outputs and from their noise.
"""

import math
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from imubayes.campaign.findings import Finding
from imubayes.campaign_data import Channel, Run

LEAST_ROWS, LEAST_SHARE = 3, 0.5
"""Rows alike, and their share of the shorter run."""
SURPRISE = 30.0
"""−log of the probability that they are by chance."""
_UNKNOWN, _LARGEST = 0.5, 0.9
"""Probability that two readings are alike where their noise is not known, and of coarse ones."""
_MOST_DECIMALS = 12


def check_repeats(runs: Sequence[Run], files: Sequence[str], channels: Sequence[Channel]) -> list[Finding]:
    """Return an error for every pair of runs that holds the same data."""
    found = []
    for (first, file), (second, other) in combinations(zip(runs, files, strict=True), 2):
        both = np.isfinite(first.observed).any(axis=0) & np.isfinite(second.observed).any(axis=0)
        same_file = Path(file).resolve() == Path(other).resolve()
        alike = _rows_alike(first, second, channels, both) if both.any() else 0
        if alike or (same_file and both.any()):
            what = f"both read '{Path(file).name}'" if same_file else f"have the same outputs in {alike} rows"
            names = f"'{first.name}' and '{second.name}'"
            found.append(
                Finding(
                    "same_data", "error", second.name, f"the runs {names} {what}: the data would count twice",
                    other, "one recording for each run", f"correct 'file' of one of {names}, or remove the run",
                )
            )  # fmt: skip
    return found


def _rows_alike(first: Run, second: Run, channels: Sequence[Channel], both: np.ndarray) -> int:
    """Return the number of rows of the second run that are in the first, 0 where that may be by chance."""
    varying = [
        k for k in np.flatnonzero(both).tolist() if np.nanmax(first.observed[:, k]) > np.nanmin(first.observed[:, k])
    ]
    if not varying:
        return 0
    own, other = (np.nan_to_num(run.observed[:, varying], nan=math.inf) for run in (first, second))
    known = {row.tobytes() for row in own}
    alike = np.array([row.tobytes() in known and np.isfinite(row).any() for row in other])
    if alike.sum() < max(LEAST_ROWS, LEAST_SHARE * min(first.rows, second.rows)):
        return 0
    surprise = 0.0
    for k in varying:
        there = alike & np.isfinite(second.observed[:, k])
        values, samples = second.observed[there, k], second.samples[there]
        sd = np.where(
            np.isfinite(second.sample_sd[there, k]), second.sample_sd[there, k], channels[k].noise or math.nan
        )
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

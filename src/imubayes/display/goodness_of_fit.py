"""How unlikely a χ² is, per run and channel.

Parameters take their share of the degrees of freedom; a run and channel has, in proportion, n·dof/N of its n values.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from scipy.special import gammainc, gammaincc

SIGNIFICANT = 0.001


def share_of_freedom(summary: Mapping[str, Any]) -> float:
    """Return degrees of freedom per residual, between 0.1 and 1; 1 where the summary does not tell."""
    count = sum(int(run.get("n") or 0) for run in summary.get("runs", ()))
    freedom = summary.get("dof") or 0
    return min(max(freedom / count, 0.1), 1.0) if count and freedom else 1.0


def tail(chi2: float, freedom: float) -> float:
    """Return the probability of a χ² as far out: positive above its mean, negative (of its size) below."""
    if not (math.isfinite(chi2) and freedom > 0):
        return math.nan
    above = float(gammaincc(freedom / 2, chi2 / 2))
    below = float(gammainc(freedom / 2, chi2 / 2))
    return above if above <= below else -below


def worst_first(summary: Mapping[str, Any]) -> list[str]:
    """Return the names of the runs, the one with the least likely χ² of a channel first."""
    share = share_of_freedom(summary)
    evidence: dict[str, float] = {}
    for run in summary.get("runs", ()):
        found = tail(_number(run.get("chi2")), share * (run.get("n") or 0))
        excess = found if found >= 0 else 1.0
        evidence[run["name"]] = min(evidence.get(run["name"], 1.0), excess)
    return sorted(evidence, key=lambda name: evidence[name])


def worst_channels(summary_runs: Sequence[Mapping[str, Any]], most: int) -> list[str]:
    """Return at most `most` channels, those of the largest χ²/n, in their own order."""
    totals: dict[str, list[float]] = {}
    for run in summary_runs:
        total = totals.setdefault(run["channel"], [0.0, 0.0])
        total[0] += _number(run.get("chi2"), 0.0)
        total[1] += run.get("n") or 0
    ranked = sorted(totals, key=lambda name: -totals[name][0] / max(totals[name][1], 1))
    return [name for name in totals if name in ranked[:most]]


def _number(value: Any, otherwise: float = math.nan) -> float:
    return float(value) if isinstance(value, int | float) else otherwise

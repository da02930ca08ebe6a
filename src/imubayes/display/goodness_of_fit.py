"""χ² in words, and its p-values per run and channel.

Parameters take up their share of the degrees of freedom: of its n values a run and channel has n·dof/N in proportion.
"""

import math
from collections.abc import Sequence

from imubayes.results.summary import RunSummary, Summary
from imubayes.tail_probabilities import chi2_cdf, chi2_survival

SIGNIFICANT = 0.001


def share_of_freedom(summary: Summary) -> float:
    """Return the degrees of freedom per residual, between 0.1 and 1; 1 where there are no residuals."""
    count = sum(run.n for run in summary.runs)
    return min(max(summary.dof / count, 0.1), 1.0) if count and summary.dof else 1.0


def chi2_text(summary: Summary) -> str:
    """Return χ² at the noise as fitted, and beside it at the noise known beforehand where that was found."""
    fitted = "–" if summary.chi2 is None else f"{summary.chi2:.1f}"
    said, known = f"chi2 {fitted} for {summary.dof:.0f} degrees of freedom", summary.known_noise
    if known is None:
        return said
    return f"{said} at the noise as fitted, {known.chi2:.1f} for {known.dof:.0f} at the noise known beforehand"


def tail(chi2: float, freedom: float) -> float:
    """Return the p-value of a χ²: of its upper tail, or minus that of the lower tail where this is smaller."""
    if not (math.isfinite(chi2) and freedom > 0):
        return math.nan
    above = float(chi2_survival(chi2, freedom))
    below = float(chi2_cdf(chi2, freedom))
    return above if above <= below else -below


def worst_first(summary: Summary) -> list[str]:
    """Return the names of the runs, the one with the least likely excess of χ² in a channel first."""
    share = share_of_freedom(summary)
    chance: dict[str, float] = {}
    for run in summary.runs:
        found = math.nan if run.chi2 is None else tail(run.chi2, share * run.n)
        chance[run.name] = min(chance.get(run.name, 1.0), found if found >= 0 else 1.0)
    return sorted(chance, key=chance.__getitem__)


def worst_channels(runs: Sequence[RunSummary], most: int) -> list[str]:
    """Return at most `most` channels, those of the largest χ²/n, in their own order."""
    channels = list(dict.fromkeys(run.channel for run in runs))

    def ratio(channel: str) -> float:
        own = [run for run in runs if run.channel == channel]
        return sum(run.chi2 or 0.0 for run in own) / max(sum(run.n for run in own), 1)

    ranked = sorted(channels, key=ratio, reverse=True)[:most]
    return [channel for channel in channels if channel in ranked]

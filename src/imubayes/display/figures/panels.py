"""What residual panels share: choice of channels, limits, and means over neighbouring points."""

from collections.abc import Sequence

import numpy as np
import polars as pl
from matplotlib.axes import Axes

from imubayes.covariates import Covariate
from imubayes.display.labels import numbers, ordered, pretty, readable
from imubayes.display.marks import line, uprights
from imubayes.display.theme import INK, MOST_PANELS

# Decades of a covariate beyond which a linear axis would press the small values together.
_WIDE = 30.0
_MOST_LEVELS, _LEAST = 26, 4
_POINTS = 4000


def chosen_channels(residuals: pl.DataFrame, channels: Sequence[str] | None) -> tuple[list[str], str]:
    """Return at most `MOST_PANELS` channels and a sentence on what was left out.

    Without a choice the channels of the largest whitened residuals are taken, in their own order.
    """
    own = ordered(residuals, "channel")
    if channels is not None:
        unknown = [name for name in channels if name not in own]
        if unknown:
            raise ValueError(f"no residuals of channel {', '.join(unknown)}; there are {', '.join(own)}")
        own = list(dict.fromkeys(channels))
    if len(own) <= MOST_PANELS:
        return own, ""
    sizes = dict(residuals.group_by("channel").agg((pl.col("whitened") ** 2).mean()).iter_rows())
    ranked = sorted(own, key=lambda name: -(sizes[name] or 0.0))[:MOST_PANELS]
    kept = [name for name in own if name in ranked]
    return kept, f"Of {len(own)} channels the {MOST_PANELS} of the largest residuals are shown."


def abscissa(values: np.ndarray, covariate: Covariate) -> tuple[np.ndarray, str]:
    """Return the values in a readable unit, and the label of the axis."""
    finite = np.abs(values[np.isfinite(values)])
    factor, unit = readable(covariate.unit, float(finite.max(initial=0.0)))
    if covariate.unit != "s":
        factor, unit = 1.0, covariate.unit
    return values * factor, f"{covariate.phrase} / {pretty(unit)}" if unit else covariate.phrase


def set_abscissa(axes: Axes, values: np.ndarray, covariate: Covariate) -> None:
    """Set scale and limits: linear, or symmetric logarithmic for rates over several decades."""
    finite = values[np.isfinite(values)]
    low, high = float(finite.min()), float(finite.max())
    sizes = np.abs(finite[finite != 0])
    if covariate.column == "table_rate_deg_s" and sizes.size and sizes.max() > _WIDE * sizes.min():
        smallest = 10.0 ** np.floor(np.log10(sizes.min()) + 1e-9)
        axes.set_xscale("symlog", linthresh=smallest, linscale=0.6)
        edge = 1.6
        axes.set_xlim(low * edge if low < 0 else low - smallest / 2, high * edge if high > 0 else high + smallest / 2)
        return
    margin = 0.03 * (high - low) or 1.0
    axes.set_xlim(low - margin, high + margin)


def thinned(count: int) -> np.ndarray | slice:
    """Return places of at most `_POINTS` evenly spaced of `count` points."""
    return slice(None) if count <= _POINTS else np.linspace(0, count - 1, _POINTS).astype(int)


def neighbour_means(
    x: np.ndarray, y: np.ndarray, groups: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return place, mean and standard error of groups of neighbouring points.

    Without given groups, each level is one where a covariate takes few levels; otherwise they are of equal number.

    Parameters
    ----------
    x, y : shape (n,).
    groups : shape (n,), ascending with x; points of one number belong together.
    """
    good = np.isfinite(x) & np.isfinite(y)
    x, y = x[good], y[good]
    if x.size < 10:
        return np.empty(0), np.empty(0), np.empty(0)
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    even = np.unique(np.linspace(0, x.size, int(np.clip(x.size // 12, 4, 16)), endpoint=False).astype(int))
    if groups is not None:
        starts = np.flatnonzero(np.diff(groups[good][order], prepend=-1))
    else:
        # Levels are told apart by gaps: 0.2 % of the range, or of the value, since rates span decades.
        step = np.maximum(0.002 * np.abs(x), 1e-6 * max(float(np.ptp(x)), 1e-300))
        starts = np.flatnonzero(np.diff(x, prepend=-np.inf) > step)
        if not 2 <= len(starts) <= _MOST_LEVELS or x.size < _LEAST * len(starts):
            starts = even
    sizes = np.diff(starts, append=x.size)
    means = np.add.reduceat(y, starts) / sizes
    scatter = np.sqrt(np.add.reduceat((y - np.repeat(means, sizes)) ** 2, starts) / np.maximum(sizes - 1, 1))
    kept = sizes >= _LEAST
    places = np.add.reduceat(x, starts) / sizes
    return places[kept], means[kept], (scatter / np.sqrt(sizes))[kept]


def draw_means(axes: Axes, x: np.ndarray, y: np.ndarray, groups: np.ndarray | None = None) -> None:
    """Draw the means of neighbouring points with two standard errors to each side."""
    place, mean, error = neighbour_means(x, y, groups)
    if place.size:
        line(axes, place, mean, color=INK, linewidth=0.9, marker="_", markersize=6, zorder=5)
        uprights(axes, place, mean - 2 * error, mean + 2 * error, INK, 0.9, zorder=5)


def spread(axes: Axes, x: np.ndarray, runs: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return places moved sideways a little by run, where few levels would make points hide each other."""
    levels = np.unique(x)
    if len(levels) > _MOST_LEVELS or len(names) < 2 or x.size < 3 * len(levels):
        return x
    transform = axes.xaxis.get_transform()
    placed = transform.transform(levels)
    low, high = transform.transform(np.array(axes.get_xlim()))
    gap = float(np.min(np.diff(placed))) if len(levels) > 1 else float(high - low)
    reach = min(0.36 * gap, 0.02 * float(high - low))
    turn = {name: place / (len(names) - 1) - 0.5 for place, name in enumerate(names)}
    moved = transform.transform(x) + 2 * reach * np.array([turn[name] for name in runs.tolist()])
    return transform.inverted().transform(moved)


def limit_of(values: np.ndarray, least: float) -> float:
    """Return the half height of a panel: all points, but not the few that would press the others flat."""
    sizes = np.abs(values[np.isfinite(values)])
    if not sizes.size:
        return least
    return max(least, min(1.1 * float(sizes.max()), 4 * float(np.quantile(sizes, 0.95))))


def row_numbers(residuals: pl.DataFrame) -> pl.DataFrame:
    """Return the residuals with `row` counted on from run to run."""
    offset, offsets = 0, {}
    for run, last in residuals.group_by("run", maintain_order=True).agg(pl.col("row").max()).iter_rows():
        offsets[run] = offset
        offset += int(last) + 1
    names = residuals.get_column("run").to_list()
    counted = residuals.get_column("row").to_numpy() + np.array([offsets[name] for name in names])
    return residuals.with_columns(pl.Series("row", counted))


__all__ = [
    "abscissa", "chosen_channels", "draw_means", "limit_of", "neighbour_means", "numbers", "row_numbers",
    "set_abscissa", "spread", "thinned",
]  # fmt: skip

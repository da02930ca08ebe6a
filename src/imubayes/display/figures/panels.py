"""Shared by residual panels: choice of channels, axes, limits, and means over neighbouring points."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator, StrMethodFormatter, SymmetricalLogLocator

from imubayes.display.figure_style import INK, MOST_PANELS
from imubayes.display.numbers_and_labels import pretty, readable
from imubayes.display.residual_columns import ordered
from imubayes.foundations.covariates import Covariate

# Ratio of the largest to the smallest rate beyond which a linear axis would crowd the small ones.
_WIDE = 30.0
_FEW = 0.05  # share of the rates that may be smaller than the smallest decade
_MOST_DECADES = 6  # of a logarithmic axis: Earth rate beside 1000 deg/s; smaller values are about its zero
_MOST_LEVELS, _LEAST = 26, 4
_POINTS = 4000


def chosen_channels(residuals: pl.DataFrame, channels: Sequence[str] | None) -> tuple[list[str], str]:
    """Return at most `MOST_PANELS` channels and a sentence on those left out.

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
    return kept, f"Shown: the {MOST_PANELS} of {len(own)} channels with the largest residuals."


def abscissa(values: np.ndarray, covariate: Covariate) -> tuple[np.ndarray, str]:
    """Return the values in a readable unit, and the label of the axis."""
    factor, unit = 1.0, covariate.unit
    if unit == "s":
        factor, unit = readable(unit, float(np.abs(values[np.isfinite(values)]).max(initial=0.0)))
    return values * factor, f"{covariate.phrase} / {pretty(unit)}" if unit else covariate.phrase


def set_abscissa(axes: Axes, values: np.ndarray, covariate: Covariate) -> None:
    """Set scale, limits and ticks: linear, or symmetric logarithmic for rates over several decades."""
    finite = values[np.isfinite(values)]
    low, high = float(finite.min(initial=np.inf)), float(finite.max(initial=-np.inf))
    sizes = np.abs(finite[finite != 0])
    # A table that swings passes through zero: a few rates that happen to be small are no decades.
    smallest = float(np.quantile(sizes, _FEW, method="lower")) if sizes.size else np.inf
    if covariate.unit == "deg/s" and sizes.size and sizes.max() > _WIDE * smallest:
        least, most = np.floor(np.log10(smallest) + 1e-9), np.ceil(np.log10(sizes.max()))
        smallest = 10.0 ** max(least, most - _MOST_DECADES)
        set_symlog(axes, "x", smallest, 9 if most - least < _MOST_DECADES else 6)
        if most - least >= _MOST_DECADES:
            _name_zero_alone(axes, smallest)
        edge = 1.6
        axes.set_xlim(low * edge if low < 0 else low - smallest / 2, high * edge if high > 0 else high + smallest / 2)
        return
    set_range(axes, finite, 0.03)
    if covariate.unit == "deg" and high - low >= 90:
        # Multiples of 45 and 90 degrees.
        axes.xaxis.set_major_locator(MaxNLocator(9, steps=[1, 1.8, 4.5, 9, 10]))


def _name_zero_alone(axes: Axes, smallest: float) -> None:
    """Leave out the labels of the smallest decade: over many decades they would touch that of zero."""
    plain = StrMethodFormatter("{x:g}")
    axes.xaxis.set_major_formatter(lambda x, _: "" if 0 < abs(x) < 1.1 * smallest else plain(x))


def set_symlog(axes: Axes, axis: Literal["x", "y"], smallest: float, most: int = 9) -> None:
    """Make an axis symmetric logarithmic above its smallest decade, with ticks at not many more than `most` decades."""
    # Just above the decade: matplotlib's locator takes log(1000)/log(10) < 3 for a lower one.
    scale = {"value": "symlog", "linthresh": 1.0001 * smallest, "linscale": 0.6}
    (axes.set_xscale if axis == "x" else axes.set_yscale)(**scale)
    set_decades(axes.xaxis if axis == "x" else axes.yaxis, most)


def set_decades(axis: Axis, most: int = 9) -> None:
    """Label at most so many decades of a logarithmic axis with plain numbers."""
    locator = axis.get_major_locator()
    assert isinstance(locator, LogLocator | SymmetricalLogLocator)
    locator.set_params(numticks=most)
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_locator(NullLocator())


def set_range(axes: Axes, x: np.ndarray, margin: float = 0.04) -> None:
    """Set the limits of the abscissa to the finite values with a relative margin."""
    finite = x[np.isfinite(x)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    room = margin * (high - low) or 1.0
    axes.set_xlim(low - room, high + room)


def thinned(count: int) -> np.ndarray | slice:
    """Return places of at most `_POINTS` evenly spaced of `count` points."""
    return slice(None) if count <= _POINTS else np.linspace(0, count - 1, _POINTS).astype(int)


def neighbour_means(
    x: np.ndarray, y: np.ndarray, groups: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return place, mean and standard error of groups of neighbouring points.

    Without given groups, each level is one if a covariate takes few levels; otherwise they are of equal number.

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
    starts = _level_starts(x) if groups is None else np.flatnonzero(np.diff(groups[good][order], prepend=-1))
    sizes = np.diff(starts, append=x.size)
    means = np.add.reduceat(y, starts) / sizes
    scatter = np.sqrt(np.add.reduceat((y - np.repeat(means, sizes)) ** 2, starts) / np.maximum(sizes - 1, 1))
    kept = sizes >= _LEAST
    places = np.add.reduceat(x, starts) / sizes
    return places[kept], means[kept], (scatter / np.sqrt(sizes))[kept]


def _level_starts(x: np.ndarray) -> np.ndarray:
    """Return where each level of ascending values begins; of groups of equal number if there are many levels."""
    # Levels are separated by gaps: 0.2 % of the value, since rates span decades.
    gap = np.maximum(0.002 * np.abs(x), 1e-6 * max(float(np.ptp(x)), 1e-300))
    starts = np.flatnonzero(np.diff(x, prepend=-np.inf) > gap)
    if 2 <= len(starts) <= _MOST_LEVELS and x.size >= _LEAST * len(starts):
        return starts
    return np.unique(np.linspace(0, x.size, int(np.clip(x.size // 12, 4, 16)), endpoint=False).astype(int))


def draw_means(axes: Axes, x: np.ndarray, y: np.ndarray, groups: np.ndarray | None = None) -> None:
    """Draw the means of neighbouring points with ±2 standard errors; no line, which would cross gaps in the data."""
    place, mean, error = neighbour_means(x, y, groups)
    if place.size:
        axes.plot(place, mean, "_", color=INK, markersize=7, markeredgewidth=1.3, zorder=5)
        axes.vlines(place, mean - 2 * error, mean + 2 * error, INK, linewidth=0.9, zorder=5)


def spread(axes: Axes, x: np.ndarray, runs: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return places shifted sideways a little by run, if few levels would make points overlap."""
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
    """Return the half height of a panel that shows all points but outliers that would compress the others."""
    sizes = np.abs(values[np.isfinite(values)])
    if not sizes.size:
        return least
    return max(least, min(1.1 * float(sizes.max()), 4 * float(np.quantile(sizes, 0.95))))


def row_numbers(residuals: pl.DataFrame) -> pl.DataFrame:
    """Return the residuals with `row` counted on from run to run."""
    counts = residuals.group_by("run", maintain_order=True).agg(pl.col("row").max() + 1)
    offsets = counts.with_columns((pl.col("row").cum_sum() - pl.col("row")).alias("offset")).drop("row")
    return residuals.join(offsets, on="run", maintain_order="left").with_columns(pl.col("row") + pl.col("offset"))

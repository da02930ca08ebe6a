"""Residuals against a covariate: a missing effect shows as a pattern along what it depends on."""

from collections.abc import Sequence

import numpy as np
import polars as pl
from matplotlib.axes import Axes

from imubayes.covariates import Covariate
from imubayes.display.figures.panels import (
    abscissa,
    chosen_channels,
    draw_means,
    limit_of,
    row_numbers,
    set_abscissa,
    spread,
    thinned,
)
from imubayes.display.labels import covariate as covariate_of
from imubayes.display.labels import pretty, readable
from imubayes.display.residual_columns import numbers, varies
from imubayes.display.rounding import significant
from imubayes.display.run_signs import RunSigns, run_signs
from imubayes.display.theme import (
    BAND,
    BAND_WIDE,
    FAINT,
    QUIET,
    SMALL,
    Picture,
    at_runs,
    panels,
    picture,
    runs_legend,
    themed,
)

_WIDTH, _LEGEND = 13.0, 2.05
_GOOD = (
    "A good model leaves no pattern: about 68 % of the points lie within the dark band (±1 sd) and 95 % within the "
    "light one (±2 sd), symmetric about zero. Left: in input units; the points of a run share its offset. Right: "
    "whitened residuals, which include the run-to-run offsets at their scatter; black: means of {groups} with ±2 "
    "standard errors, which should scatter about zero."
)


@themed
def residual_figure(
    residuals: pl.DataFrame,
    covariate: str | Covariate,
    channels: Sequence[str] | None = None,
    runs: Sequence[str] | None = None,
) -> Picture:
    """Return residuals against a covariate: a row per channel, in input units on the left, whitened on the right.

    Parameters
    ----------
    residuals : the content of `residuals.parquet`.
    covariate : column or name, such as `table_rate`.
    channels : at most six; without a choice those of the largest residuals.
    runs : all runs of the result, for the same colour of a run in every figure.
    """
    against = covariate if isinstance(covariate, Covariate) else covariate_of(covariate)
    signs = run_signs(residuals, runs)
    names, left_out = chosen_channels(residuals, channels)
    counted = residuals.filter(pl.col("channel").is_in(names))
    if against.column == "row":
        counted = row_numbers(counted)
    x_all = numbers(counted, against.column)
    known = np.isfinite(x_all)
    if not varies(x_all):
        raise ValueError(f"the residuals have no {against.phrase} that varies")
    x_all, label = abscissa(x_all, against)
    groups = "runs" if against.column == "row" else "neighbouring points"
    parts = (_GOOD.format(groups=groups), _absent(against, int(np.sum(~known)), x_all.size), left_out)
    height = max(len(names) * 1.62 + 0.35, 2.6)
    title, caption = f"Residuals against {against.phrase}", " ".join(part for part in parts if part)
    figure = picture(_WIDTH, height, title, caption)
    grid = panels(figure, len(names), 2, (0.7, 0.5, _LEGEND, 0.2), (0.83, 0.36), share_x=True)
    for row, name in zip(grid, names, strict=True):
        mask = (counted["channel"] == name).to_numpy()
        own, x = counted.filter(pl.Series(mask)), x_all[mask]
        for axes in row:
            set_abscissa(axes, x_all, against)
            _mark_runs(axes, against, counted)
        _in_input_units(row[0], own, x, signs)
        _whitened(row[1], own, x, signs, by_run=against.column == "row")
    for axes in grid[-1]:
        axes.set_xlabel(f"{label}, in the order of the runs" if against.column == "row" else label)
    shown = counted.filter(pl.Series(known)).get_column("run").unique().to_list()
    runs_legend(figure, figure.inside[2] - _LEGEND + 0.3, signs, shown)
    return figure


def _in_input_units(axes: Axes, own: pl.DataFrame, x: np.ndarray, signs: RunSigns) -> None:
    y, sd = numbers(own, "input_residual"), numbers(own, "input_sd")
    factor, unit = readable(own["input_unit"][0] or "", float(np.nanmedian(np.abs(sd))))
    _bands(axes, x, sd * factor)
    _points(axes, x, y * factor, own, signs, 3.2 * float(np.nanmedian(sd * factor)), pretty(unit))
    axes.set_ylabel(pretty(unit))


def _whitened(axes: Axes, own: pl.DataFrame, x: np.ndarray, signs: RunSigns, by_run: bool) -> None:
    y = numbers(own, "whitened")
    for width, colour in ((2, BAND_WIDE), (1, BAND)):
        axes.axhspan(-width, width, color=colour, linewidth=0, zorder=1)
    _points(axes, x, y, own, signs, 3.5, "sd")
    # Means of residuals that are not whitened would be those of the run offsets, with standard errors too small.
    draw_means(axes, x, y, np.unique(own["run"].to_numpy(), return_inverse=True)[1] if by_run else None)
    axes.set_ylabel("whitened / sd")


def _points(
    axes: Axes, x: np.ndarray, y: np.ndarray, own: pl.DataFrame, signs: RunSigns, least: float, unit: str
) -> None:
    limit = limit_of(y, least)
    good = np.isfinite(x) & np.isfinite(y)
    x, y, runs = x[good], y[good], np.array(own["run"].to_list())[good]
    kept = thinned(x.size)
    names = list(dict.fromkeys(runs[kept].tolist()))
    placed = spread(axes, x[kept], runs[kept], names)
    size = 4.2 if x.size < 400 else (3.2 if x.size < 1500 else 2.2)
    clipped = np.clip(y[kept], -0.97 * limit, 0.97 * limit)
    at_runs(axes, placed, clipped, runs[kept], signs, markersize=size, alpha=0.8)
    axes.axhline(0, color=QUIET, linewidth=0.7, zorder=1.5)
    axes.set_ylim(-limit, limit)
    axes.set_title(own["channel"][0])
    axes.set_title(_note(y, unit, limit), loc="right", weight="normal", color=QUIET, size=SMALL)


def _note(y: np.ndarray, unit: str, limit: float) -> str:
    if not y.size:
        return "no rows with this covariate"
    outside = int(np.count_nonzero(np.abs(y) > limit))
    text = f"rms {significant(float(np.sqrt(np.mean(y**2))))} {unit}, n = {y.size}"
    return text + (f", {outside} beyond the axis" if outside else "")


def _bands(axes: Axes, x: np.ndarray, sd: np.ndarray) -> None:
    """Draw ±1 and ±2 sd; a flat band where the rows are alike, the median of neighbours where they are not."""
    good = np.isfinite(x) & np.isfinite(sd)
    if not good.any():
        return
    x, sd = x[good], sd[good]
    alike = np.quantile(sd, 0.95) < 1.3 * np.quantile(sd, 0.05)
    order = np.argsort(x, kind="stable")
    groups = np.array_split(order, 1 if alike else int(np.clip(len(order) // 8, 1, 24)))
    middle = np.array([np.median(sd[group]) for group in groups])
    low, high = axes.get_xlim()
    place = np.concatenate([[low], [x[group].mean() for group in groups], [high]])
    middle = np.concatenate([middle[:1], middle, middle[-1:]])
    for width, colour in ((2, BAND_WIDE), (1, BAND)):
        axes.fill_between(place, -width * middle, width * middle, color=colour, linewidth=0, zorder=1)


def _mark_runs(axes: Axes, against: Covariate, counted: pl.DataFrame) -> None:
    """Mark where a run begins, where rows are counted on."""
    if against.column == "row":
        starts = counted.group_by("run", maintain_order=True).agg(pl.col("row").min())["row"].to_numpy()
        for start in starts[1:]:
            axes.axvline(start - 0.5, color=FAINT, linewidth=0.7, zorder=1.2)


def _absent(against: Covariate, without: int, count: int) -> str:
    if not without:
        return ""
    reason = "are means over whole turns or have no angle" if against.name == "table_angle" else "lack it"
    return f"{without} of {count} values {reason} and are left out."

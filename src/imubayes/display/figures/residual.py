"""Residuals against a covariate: where a model fails, it fails along something."""

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
from imubayes.display.labels import numbers, ordered, pretty, readable, varies
from imubayes.display.marks import band, level, points, strip, uprights
from imubayes.display.rounding import significant
from imubayes.display.theme import BAND, BAND_WIDE, FAINT, QUIET, Picture, RunSigns, axes_at, picture, themed
from imubayes.display.ticks import frame

_WIDTH, _LEGEND = 13.0, 2.05
_GOOD = (
    "A good model leaves no pattern: about 68 % of the points lie in the dark band (±1 sd) and 95 % in the light one "
    "(±2 sd), evenly above and below. Left: in input units, each run with its own offset, so that its points lie "
    "together. Right: whitened, with the offsets of runs taken at their scatter; black are means of {groups} with "
    "±2 standard errors, which should scatter about zero."
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
    runs : all runs of the result, for the same colour of a run in every picture.
    """
    against = covariate if isinstance(covariate, Covariate) else covariate_of(covariate)
    signs = RunSigns(runs if runs is not None else ordered(residuals, "run"))
    names, left_out = chosen_channels(residuals, channels)
    counted = residuals.filter(pl.col("channel").is_in(names))
    if against.column == "row":
        counted = row_numbers(counted)
    x_all = numbers(counted, against.column)
    without = int(np.count_nonzero(~np.isfinite(x_all)))
    if not varies(x_all):
        raise ValueError(f"the residuals have no {against.phrase} that varies")
    x_all, label = abscissa(x_all, against)
    label = label if against.column != "row" else "row, in the order of the runs"
    groups = "the runs" if against.column == "row" else "neighbouring points"
    parts = (_GOOD.format(groups=groups), _absent(against, without, x_all.size), left_out)
    caption = " ".join(part for part in parts if part)
    height = max(len(names) * 1.62 + 0.35, 2.6)
    figure = picture(_WIDTH, height, f"Residuals against {against.phrase}", caption)
    left, bottom, right, top = figure.inside
    across = (right - left - _LEGEND - 2 * 0.78) / 2
    pitch = (height - 0.35) / len(names)
    shown = set(counted.filter(pl.Series(np.isfinite(x_all))).get_column("run").unique())
    for place, name in enumerate(names):
        mask = (counted.get_column("channel") == name).to_numpy()
        own, x = counted.filter(pl.Series(mask)), x_all[mask]
        base = top - (place + 1) * pitch + 0.12
        for column, whitened in enumerate((False, True)):
            axes = axes_at(figure, left + 0.7 + column * (across + 0.83), base, across, pitch - 0.36)
            set_abscissa(axes, x_all, against)
            unit = _panel(axes, own, x, whitened, signs, against)
            _borders(axes, against, counted)
            below = label if place == len(names) - 1 else None
            frame(axes, 9, 4, below, unit, turns=against.unit == "deg")
    signs.legend(figure, right - _LEGEND + 0.3, top, bottom, sorted(shown))
    return figure


def _panel(axes: Axes, own: pl.DataFrame, x: np.ndarray, whitened: bool, signs: RunSigns, against: Covariate) -> str:
    name = own.get_column("channel")[0]
    y = numbers(own, "whitened" if whitened else "input_residual")
    good = np.isfinite(x) & np.isfinite(y)
    if whitened:
        strip(axes, 2, BAND_WIDE)
        strip(axes, 1, BAND)
        limit = limit_of(y, 3.5)
        shown_unit = "whitened / sd"
    else:
        sd = numbers(own, "input_sd")
        unit = own.get_column("input_unit")[0] or ""
        factor, shown_unit = readable(unit, float(np.nanmedian(np.abs(sd))))
        y, sd = y * factor, sd * factor
        _bands(axes, x, sd)
        limit = limit_of(y, 3.2 * float(np.nanmedian(sd)))
        shown_unit = pretty(shown_unit)
    level(axes, 0, QUIET)
    runs = np.array(own.get_column("run").to_list())
    outside = int(np.count_nonzero(np.abs(y[good]) > limit))
    _scatter(axes, x[good], np.clip(y[good], -0.97 * limit, 0.97 * limit), runs[good], signs)
    if whitened:
        # Means of what is not whitened would be those of the runs' offsets, and their errors too small.
        groups = np.unique(runs[good], return_inverse=True)[1] if against.column == "row" else None
        draw_means(axes, x[good], y[good], groups)
    axes.set_ylim(-limit, limit)
    axes.set_title(name)
    note = _note(y[good], "sd" if whitened else shown_unit, outside)
    axes.set_title(note, loc="right", weight="normal", color=QUIET, size=8)
    return shown_unit


def _note(y: np.ndarray, unit: str, outside: int) -> str:
    if not y.size:
        return "no rows with this covariate"
    rms = float(np.sqrt(np.mean(y**2)))
    text = f"rms {significant(rms)} {unit}, n = {y.size}"
    return text + (f", {outside} beyond the edge" if outside else "")


def _scatter(axes: Axes, x: np.ndarray, y: np.ndarray, runs: np.ndarray, signs: RunSigns) -> None:
    kept = thinned(x.size)
    x, y, runs = x[kept], y[kept], runs[kept]
    size = 4.2 if x.size < 400 else (3.2 if x.size < 1500 else 2.2)
    names = list(dict.fromkeys(runs.tolist()))
    x = spread(axes, x, runs, names)
    marker = {name: signs.marker(name) for name in names}
    hue = {name: signs.hue(name) for name in names}
    markers = np.array([marker[name] for name in runs.tolist()])
    colours = np.array([hue[name] for name in runs.tolist()])
    for one in dict.fromkeys(marker.values()):
        for colour in dict.fromkeys(hue.values()):
            mask = (markers == one) & (colours == colour)
            if mask.any():
                points(axes, x[mask], y[mask], one, size, colour, alpha=0.8, zorder=3)


def _bands(axes: Axes, x: np.ndarray, sd: np.ndarray) -> None:
    """Draw ±1 and ±2 sd; a flat band where the rows are alike, the median of neighbours where they are not."""
    good = np.isfinite(x) & np.isfinite(sd)
    if not good.any():
        return
    x, sd = x[good], sd[good]
    if np.quantile(sd, 0.95) < 1.3 * np.quantile(sd, 0.05):
        for width, colour in ((2, BAND_WIDE), (1, BAND)):
            strip(axes, width * float(np.median(sd)), colour)
        return
    order = np.argsort(x, kind="stable")
    groups = np.array_split(order, int(np.clip(len(order) // 8, 1, 24)))
    place = np.array([x[group].mean() for group in groups])
    middle = np.array([np.median(sd[group]) for group in groups])
    low, high = axes.get_xlim()
    place = np.concatenate([[low], place, [high]])
    middle = np.concatenate([middle[:1], middle, middle[-1:]])
    for width, colour in ((2, BAND_WIDE), (1, BAND)):
        band(axes, place, -width * middle, width * middle, colour)


def _borders(axes: Axes, against: Covariate, counted: pl.DataFrame) -> None:
    """Mark where a run begins, when rows are counted on."""
    if against.column != "row":
        return
    starts = counted.group_by("run", maintain_order=True).agg(pl.col("row").min()).get_column("row").to_list()
    uprights(axes, np.array(starts[1:]) - 0.5, *axes.get_ylim(), FAINT, 0.7, zorder=1.2)


def _absent(against: Covariate, without: int, count: int) -> str:
    if not without:
        return ""
    reason = "are means over whole turns or have no angle" if against.name == "table_angle" else "do not have it"
    return f"{without} of {count} values {reason} and are left out."

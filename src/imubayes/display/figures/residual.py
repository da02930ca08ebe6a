"""Figures of a fit's residuals: against a covariate, and a χ²/n map of the goodness of fit by run and channel.

A missing effect shows as a pattern of the residuals along what it depends on.
"""

from collections.abc import Sequence

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle

from imubayes.display import figure_style as style
from imubayes.display import fit_cautions as cautions
from imubayes.display import numbers_and_labels as numbers
from imubayes.display import residual_columns
from imubayes.display.figures import panels
from imubayes.display.numbers_and_labels import covariate as covariate_of
from imubayes.foundations.covariates import Covariate
from imubayes.foundations.wording import counted
from imubayes.results.summary import Summary

_WIDTH, _LEGEND = 13.0, 2.05
_GOOD = (
    "A good model leaves no pattern: about 68 % of the points lie within the dark band (±1 sd) and 95 % within the "
    "light one (±2 sd), symmetric about zero. Left: in input units; the points of a run share its offset. Right: "
    "whitened residuals, which include the run-to-run offsets at their scatter; black: means of {groups} with ±2 "
    "standard errors, which should scatter about zero."
)


@style.themed
def residual_figure(
    residuals: pl.DataFrame,
    covariate: str | Covariate,
    channels: Sequence[str] | None = None,
    runs: Sequence[str] | None = None,
) -> style.Picture:
    """Return residuals against a covariate: a row per channel, in input units on the left, whitened on the right.

    Parameters
    ----------
    residuals : the content of `residuals.parquet`.
    covariate : column or name, such as `table_rate`.
    channels : at most six; without a choice those of the largest residuals.
    runs : all runs of the result, for the same colour of a run in every figure.
    """
    against = covariate if isinstance(covariate, Covariate) else covariate_of(covariate)
    signs = style.run_signs(residuals, runs)
    names, left_out = panels.chosen_channels(residuals, channels)
    counted = residuals.filter(pl.col("channel").is_in(names))
    if against.column == "row":
        counted = panels.row_numbers(counted)
    x_all = residual_columns.numbers(counted, against.column)
    known = np.isfinite(x_all)
    if not residual_columns.varies(x_all):
        raise ValueError(f"the residuals have no {against.phrase} that varies")
    x_all, label = panels.abscissa(x_all, against)
    groups = "runs" if against.column == "row" else "neighbouring points"
    parts = (_GOOD.format(groups=groups), _absent(against, int(np.sum(~known)), x_all.size), left_out)
    height = max(len(names) * 1.62 + 0.35, 2.6)
    title, caption = f"Residuals against {against.phrase}", " ".join(part for part in parts if part)
    figure = style.picture(_WIDTH, height, title, caption)
    grid = style.panels(figure, len(names), 2, (0.7, 0.5, _LEGEND, 0.2), (0.83, 0.36), share_x=True)
    for row, name in zip(grid, names, strict=True):
        mask = (counted["channel"] == name).to_numpy()
        own, x = counted.filter(pl.Series(mask)), x_all[mask]
        for axes in row:
            panels.set_abscissa(axes, x_all, against)
            _mark_runs(axes, against, counted)
        _in_input_units(row[0], own, x, signs)
        _whitened(row[1], own, x, signs, by_run=against.column == "row")
    for axes in grid[-1]:
        axes.set_xlabel(f"{label}, in the order of the runs" if against.column == "row" else label)
    shown = counted.filter(pl.Series(known)).get_column("run").unique().to_list()
    style.runs_legend(figure, figure.inside[2] - _LEGEND + 0.3, signs, shown)
    return figure


def _in_input_units(axes: Axes, own: pl.DataFrame, x: np.ndarray, signs: style.RunSigns) -> None:
    y, sd = residual_columns.numbers(own, "input_residual"), residual_columns.numbers(own, "input_sd")
    factor, unit = numbers.readable(own["input_unit"][0] or "", float(np.nanmedian(np.abs(sd))))
    _bands(axes, x, sd * factor)
    _points(axes, x, y * factor, own, signs, 3.2 * float(np.nanmedian(sd * factor)), numbers.pretty(unit))
    axes.set_ylabel(numbers.pretty(unit))


def _whitened(axes: Axes, own: pl.DataFrame, x: np.ndarray, signs: style.RunSigns, by_run: bool) -> None:
    y = residual_columns.numbers(own, "whitened")
    for width, colour in ((2, style.BAND_WIDE), (1, style.BAND)):
        axes.axhspan(-width, width, color=colour, linewidth=0, zorder=1)
    _points(axes, x, y, own, signs, 3.5, "sd")
    # Means of residuals that are not whitened would be those of the run offsets, with standard errors too small.
    panels.draw_means(axes, x, y, np.unique(own["run"].to_numpy(), return_inverse=True)[1] if by_run else None)
    axes.set_ylabel("whitened / sd")


def _points(
    axes: Axes, x: np.ndarray, y: np.ndarray, own: pl.DataFrame, signs: style.RunSigns, least: float, unit: str
) -> None:
    limit = panels.limit_of(y, least)
    good = np.isfinite(x) & np.isfinite(y)
    x, y, runs = x[good], y[good], np.array(own["run"].to_list())[good]
    kept = panels.thinned(x.size)
    names = list(dict.fromkeys(runs[kept].tolist()))
    placed = panels.spread(axes, x[kept], runs[kept], names)
    size = 4.2 if x.size < 400 else (3.2 if x.size < 1500 else 2.2)
    clipped = np.clip(y[kept], -0.97 * limit, 0.97 * limit)
    style.at_runs(axes, placed, clipped, runs[kept], signs, markersize=size, alpha=0.8)
    axes.axhline(0, color=style.QUIET, linewidth=0.7, zorder=1.5)
    axes.set_ylim(-limit, limit)
    axes.set_title(own["channel"][0])
    axes.set_title(_note(y, unit, limit), loc="right", weight="normal", color=style.QUIET, size=style.SMALL)


def _note(y: np.ndarray, unit: str, limit: float) -> str:
    if not y.size:
        return "no rows with this covariate"
    outside = int(np.count_nonzero(np.abs(y) > limit))
    text = f"rms {numbers.significant(float(np.sqrt(np.mean(y**2))))} {unit}, n = {y.size}"
    return text + (f", {outside} beyond the axis" if outside else "")


def _bands(axes: Axes, x: np.ndarray, sd: np.ndarray) -> None:
    """Draw ±1 and ±2 sd; a flat band if the rows are alike, the median of neighbours if they are not."""
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
    for width, colour in ((2, style.BAND_WIDE), (1, style.BAND)):
        axes.fill_between(place, -width * middle, width * middle, color=colour, linewidth=0, zorder=1)


def _mark_runs(axes: Axes, against: Covariate, counted: pl.DataFrame) -> None:
    """Mark where a run begins, if rows are counted on."""
    if against.column == "row":
        starts = counted.group_by("run", maintain_order=True).agg(pl.col("row").min())["row"].to_numpy()
        for start in starts[1:]:
            axes.axvline(start - 0.5, color=style.FAINT, linewidth=0.7, zorder=1.2)


def _absent(against: Covariate, without: int, count: int) -> str:
    if not without:
        return ""
    reason = "means over whole turns or without an angle" if against.name == "table_angle" else "without it"
    return f"{without} of {counted(count, 'value')} left out: {reason}."


_MOST_RUNS, _MOST_CHANNELS = 40, 12
_CELL = (0.78, 0.27)
HEAT = ((255, 255, 248), (254, 204, 143), (247, 112, 92), (182, 55, 122), (81, 18, 124), (25, 10, 50))
"""Light to dark (magma) from χ²/n = 1 to the worst cell, on a logarithmic scale: the colours of `explore` on white."""
_LEAST_WORST, _DARK = 10.0, 0.18
"""The scale goes this far at least.  Letters are white on colours of less relative luminance."""


@style.themed
def run_chi2_figure(summary: Summary) -> style.Picture:
    """Return a map of χ²/n over runs and channels at the noise known beforehand, light to dark up to the worst cell.

    Of more than 40 runs or 12 channels, the worst are shown.  A result of an earlier version has χ² as fitted alone.
    """
    share, cells = cautions.share_of_freedom(summary), _cells(summary)
    runs, channels = _chosen(summary)
    shown = {key: cells.get(key) for key in ((run, channel) for run in runs for channel in channels)}
    ratios = [chi2 / n for n, chi2 in filter(None, shown.values()) if np.isfinite(chi2)]
    worst = max([_LEAST_WORST, *ratios])
    figure = style.picture(
        max(2.7 + len(channels) * _CELL[0] + 2.5, 8.0),
        max(0.4 + len(runs) * _CELL[1], 1.75),
        "Goodness of fit by run and channel",
        _caption(summary, len(runs), len(channels), sum(cell is not None for cell in shown.values()), share),
        alarm=cautions.alarm_in_picture(summary),
    )
    left, bottom, right, top = figure.inside
    across, base = len(channels) * _CELL[0], top - 0.35 - len(runs) * _CELL[1]
    axes = style.panels(figure, margins=(2.2, base - bottom, right - left - 2.2 - across, 0.35))[0, 0]
    axes.set(xlim=(0, len(channels)), ylim=(len(runs), 0))
    for (run, channel), cell in shown.items():
        _draw_cell(axes, channels.index(channel), runs.index(run), cell, share, worst)
    axes.xaxis.tick_top()
    axes.set_xticks([place + 0.5 for place in range(len(channels))], [numbers.shortened(name, 11) for name in channels])
    axes.set_yticks([place + 0.5 for place in range(len(runs))], [numbers.shortened(name, 32) for name in runs])
    axes.tick_params(length=0, labelsize=8.5)
    axes.spines[:].set_visible(False)
    handles = [
        Patch(facecolor=_heat(ratio, worst), edgecolor="#bbbbbb", linewidth=0.5, label=label)
        for ratio, label in _decades(worst)
    ]
    style.legend_at(figure, left + 2.35 + across, top - 0.35, handles, handlelength=1.2, title="χ²/n")
    return figure


Chi2OfCell = tuple[int, float]
"""Readings and χ² of one channel in one run."""


def _cells(summary: Summary) -> dict[tuple[str, str], Chi2OfCell]:
    """Return the cells at the noise known beforehand; as fitted if a result has no others."""
    known = summary.known_noise.runs if summary.known_noise is not None else ()
    if known:
        return {(each.run, each.channel): (each.n, each.chi2) for each in known}
    return {(run.name, run.channel): (run.n, run.chi2) for run in summary.runs if run.n and run.chi2 is not None}


def _decades(worst: float) -> list[tuple[float, str]]:
    """Return what the legend has: 1, at most four powers of ten, and the worst cell."""
    most = np.log10(worst)
    step = int(np.ceil(most / 4))
    powers = [10.0**power for power in range(step, int(np.ceil(most)), step) if power < most - 0.15 * step]
    return [(1.0, "1 or less"), *((each, numbers.ratio_text(each)) for each in powers), (worst, _worst_text(worst))]


def _worst_text(worst: float) -> str:
    return numbers.ratio_text(worst) + (", the worst cell" if worst > _LEAST_WORST else "")


def _heat(ratio: float, worst: float) -> tuple[float, float, float]:
    """Return the colour of a cell, red, green and blue in 0 … 1."""
    share = np.clip(np.log(max(ratio, 1.0)) / np.log(worst), 0.0, 1.0)
    places = np.linspace(0, 1, len(HEAT))
    red, green, blue = (float(np.interp(share, places, part)) / 255 for part in zip(*HEAT, strict=True))
    return red, green, blue


def _ink(colour: tuple[float, float, float]) -> str:
    """Return the colour of letters that is read best on a colour (relative luminance of WCAG)."""
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in colour]
    return style.INK if np.dot((0.2126, 0.7152, 0.0722), linear) > _DARK else "white"


def _chosen(summary: Summary) -> tuple[list[str], list[str]]:
    """Return the runs and channels to show, in their own order."""
    runs = list(dict.fromkeys(run.name for run in summary.runs))
    if len(runs) > _MOST_RUNS:
        kept = set(cautions.worst_first(summary)[:_MOST_RUNS])
        runs = [name for name in runs if name in kept]
    return runs, cautions.worst_channels(summary.runs, _MOST_CHANNELS)


def _caption(summary: Summary, runs: int, channels: int, cells: int, share: float) -> str:
    known = summary.known_noise is not None and summary.known_noise.runs
    caption = (
        f"χ²/n: mean square of the residuals over the noise {'known beforehand' if known else 'as fitted'}. In a good "
        f"model it is about {share:.2f} (the parameters take up the rest of 1) and no cell is dark. "
        "Colour: logarithmic from 1 to the worst cell. Bold: χ² too large for the n of the cell, p < "
        f"{cautions.SIGNIFICANT:g}; by chance {cells * cautions.SIGNIFICANT:.2g} of {cells} "
        f"{'cell is' if cells == 1 else 'cells are'} expected to be bold."
    )
    all_runs, all_channels = len({run.name for run in summary.runs}), len({run.channel for run in summary.runs})
    if runs < all_runs or channels < all_channels:
        caption += f" Shown: {runs} of {all_runs} runs and {channels} of {all_channels} channels, the worst."
    return caption


def _draw_cell(axes: Axes, column: int, row: int, cell: Chi2OfCell | None, share: float, worst: float) -> None:
    if cell is None or not np.isfinite(cell[1]):
        axes.add_patch(Rectangle((column, row), 1, 1, facecolor="white", edgecolor="white", linewidth=1.5))
        axes.text(column + 0.5, row + 0.53, numbers.NO_NUMBER, ha="center", va="center", color=style.QUIET)
        return
    n, chi2 = cell
    colour, large = _heat(chi2 / n, worst), 0 <= cautions.tail(chi2, share * n) < cautions.SIGNIFICANT
    axes.add_patch(Rectangle((column, row), 1, 1, facecolor=colour, edgecolor="#e4e4e4", linewidth=0.8))
    axes.text(
        column + 0.5, row + 0.53, numbers.ratio_text(chi2 / n), ha="center", va="center", size=style.SMALL,
        color=_ink(colour), weight="bold" if large else "normal",
    )  # fmt: skip

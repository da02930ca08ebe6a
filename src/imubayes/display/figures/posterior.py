"""Figures of the posterior: corner plot of joint uncertainties and correlations, and narrowing against the prior.

The corner plot shows chosen quantities.  It is drawn here rather than by `arviz_plots.plot_pair`: that import alone
takes longer than all figures of a small result, and the axes are deviations from the mean in a readable unit.
Identifiability is how much narrower the data made each quantity than its prior.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from imubayes.display import figure_style as style
from imubayes.display.fit_cautions import alarm_in_picture
from imubayes.display.fit_quality_tables import NOT_DETERMINED
from imubayes.display.numbers_and_labels import concise, pretty, readable, shortened, significant
from imubayes.display.quantity_tables import is_nuisance
from imubayes.results.stored_tables import complete, draws_of, thinned
from imubayes.results.summary import Quantity, Summary, in_output_units

_CELLS = 36
_LEVELS = (0.95, 0.5)
_FILLS = ("#cfe2f0", "#7fb2d6")
_MOST, _DRAWS = 8, 50_000
_CAPTION = (
    "Diagonal: marginal posterior with its 95 % equal-tailed interval shaded; dashed: width of the prior, if it is "
    "comparable. Below: highest-density regions of pairs that hold 50 % and 95 % of the draws, and the correlation. "
    "Axes: deviation from the posterior mean given above. Round regions: quantities that the runs determine "
    "separately; a narrow inclined region: only a combination is determined."
)


@dataclass(frozen=True)
class _Column:
    """Draws of one quantity as deviations from their mean, in a readable unit."""

    unit: str
    heading: str
    x: np.ndarray
    prior_sd: float | None
    limits: tuple[float, float]


@style.themed
def corner_figure(posterior: Any, names: Sequence[str], summary: Summary) -> style.Picture:
    """Return the corner plot of chosen parameters and derived quantities, at most eight.

    Parameters
    ----------
    posterior : DataTree, its posterior group, a path to `posterior.nc`, or draws by name.
    names : as in the summary.
    summary : for units and prior widths.
    """
    entries = {entry.name: entry for entry in (*in_output_units(summary).parameters, *summary.derived)}
    draws = thinned(complete(draws_of(posterior, names)), _DRAWS)
    absent = [name for name in names if name not in draws or name not in entries]
    if absent or not names:
        raise ValueError(f"no draws of {', '.join(absent) or 'anything: no name was given'}")
    wanted = list(dict.fromkeys(names))
    columns = [_column(draws[name], entries[name]) for name in wanted[:_MOST]]
    figure, grid = _empty_corner(len(columns), len(wanted), summary)
    for row, up in enumerate(columns):
        for column, across in enumerate(columns):
            axes = grid[row, column]
            if column > row:
                axes.remove()
            elif column == row:
                _marginal(axes, across)
            else:
                _pair(axes, across, up)
            _label(axes, across.unit, up.unit, row, column, len(columns))
    return figure


def _empty_corner(count: int, wanted: int, summary: Summary) -> tuple[style.Picture, np.ndarray]:
    side = min(1.75, 11.6 / count) if count > 2 else 2.6
    width, height = max(count * side + 1.5, 8.5), count * side + 0.9
    caption = _CAPTION + (f" Shown: the first {count} of {wanted} quantities." if wanted > count else "")
    how = "" if summary.sampled else "not sampled: draws from the Laplace approximation at the mode"
    figure = style.picture(width, height, "Joint posterior", caption, how, alarm=alarm_in_picture(summary))
    margin = 0.75 + max(0.0, (width - 0.6 - 0.85 - count * side) / 2)
    right = width - 0.6 - margin - count * side
    return figure, style.panels(figure, count, count, (margin, 0.5, max(right, 0.1), 0.4), (0.12, 0.12))


def _label(axes: Axes, across: str, up: str, row: int, column: int, count: int) -> None:
    axes.xaxis.set_major_locator(MaxNLocator(4, prune="both"))
    axes.yaxis.set_major_locator(MaxNLocator(4 if row != column else 1, prune="both"))
    axes.tick_params(labelbottom=row == count - 1, labelleft=column == 0 and row > 0, left=row != column)
    if row == count - 1:
        axes.set_xlabel(f"Δ / {across}", size=style.SMALL)
    if column == 0 and row:
        axes.set_ylabel(f"Δ / {up}", size=style.SMALL)


def _column(draws: np.ndarray, entry: Quantity) -> _Column:
    mean, sd = float(np.mean(draws)), float(np.std(draws))
    factor, unit = _deviation(entry.unit, mean, sd)
    heading = f"{shortened(entry.name, 30)}\n{concise(mean, sd)} {pretty(entry.unit)}"
    x = (draws - mean) * factor
    low, high = (float(end) for end in np.quantile(x, [0.001, 0.999]))
    margin = 0.12 * (high - low) or 1.0
    prior_sd = entry.prior_sd * factor if entry.prior_sd else None
    return _Column(pretty(unit), heading, x, prior_sd, (low - margin, high + margin))


def _deviation(unit: str, mean: float, sd: float) -> tuple[float, str]:
    """Return factor and unit in which deviations are plain numbers: of a scale factor, parts per million of it."""
    if " per " in unit and 0 < sd < 0.01 * abs(mean):
        return 1e6 / abs(mean), "ppm"
    factor, name = readable(unit, 3 * sd)
    size = 3 * sd * factor
    power = 3 * math.floor(math.log10(size) / 3) if sd > 0 else 0
    if not power or 0.01 < size < 1e4:
        return factor, name
    return factor / 10.0**power, f"$10^{{{power}}}$ {pretty(name)}"


def _marginal(axes: Axes, column: _Column) -> None:
    heights, edges = np.histogram(column.x, bins=_CELLS, range=column.limits, density=True)
    smooth = scipy.ndimage.gaussian_filter(heights, _kernel(column.x.size, 1.0, 0.2, (0.8, 2.0)))
    fine = np.linspace(*column.limits, 240)
    curve = np.interp(fine, 0.5 * (edges[1:] + edges[:-1]), smooth)
    low, high = np.quantile(column.x, [0.025, 0.975])
    axes.fill_between(fine, 0, curve, where=((fine >= low) & (fine <= high)).tolist(), color=_FILLS[0], linewidth=0)
    axes.plot(fine, curve, color=style.BLUE)
    top = curve.max()
    if column.prior_sd and column.prior_sd < 6 * float(np.std(column.x)):
        # Centred on the posterior: the widths are to be compared.
        prior = np.exp(-0.5 * (fine / column.prior_sd) ** 2) / (column.prior_sd * np.sqrt(2 * np.pi))
        axes.plot(fine, prior, "--", color=style.QUIET, linewidth=0.9)
        top = max(top, prior.max())
    axes.set(xlim=column.limits, ylim=(0, 1.45 * top))
    axes.spines["left"].set_visible(False)
    axes.text(0, 1, column.heading, size=7.5, linespacing=1.25, va="top", transform=axes.transAxes)


def _kernel(count: int, width: float, power: float, limits: tuple[float, float]) -> float:
    """Return the width of a smoothing kernel in cells: few draws make ragged densities."""
    return float(np.clip(width * (20000 / count) ** power, *limits))


def _pair(axes: Axes, across: _Column, up: _Column) -> None:
    counts, x_edges, y_edges = np.histogram2d(across.x, up.x, bins=_CELLS, range=(across.limits, up.limits))
    density = scipy.ndimage.gaussian_filter(counts.T, _kernel(across.x.size, 1.1, 1 / 6, (0.9, 2.2)))
    ranked = np.sort(density.ravel())[::-1]
    held = np.cumsum(ranked) / ranked.sum()
    levels = [float(ranked[np.searchsorted(held, level)]) for level in _LEVELS]
    x, y = 0.5 * (x_edges[1:] + x_edges[:-1]), 0.5 * (y_edges[1:] + y_edges[:-1])
    if 0 < levels[0] < levels[1] < ranked[0]:
        axes.contourf(x, y, density, levels=[*levels, ranked[0] * 1.01], colors=_FILLS)
        axes.contour(x, y, density, levels=levels, colors=[style.BLUE], linewidths=0.7)
    else:
        axes.plot(across.x[:2000], up.x[:2000], ",", color=style.BLUE)
    axes.axvline(0, color=style.QUIET, linewidth=0.4, zorder=0)
    axes.axhline(0, color=style.QUIET, linewidth=0.4, zorder=0)
    axes.set(xlim=across.limits, ylim=up.limits)
    _write_correlation(axes, across.x, up.x)


def _write_correlation(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    spread = float(np.std(x) * np.std(y))
    correlation = float(np.mean((x - x.mean()) * (y - y.mean()))) / spread if spread else 0.0
    text = "0.00" if abs(correlation) < 0.005 else f"{correlation:+.2f}".replace("-", "−")
    place, side = (0.97, "right") if correlation < 0 else (0.03, "left")
    colour, weight = (style.INK, "bold") if abs(correlation) > 0.7 else (style.QUIET, "normal")
    axes.text(place, 0.97, text, transform=axes.transAxes, size=7.5, va="top", ha=side, color=colour, weight=weight)


_MOST_PARAMETERS = 48
_PARTLY = 0.9
_IDENTIFIABILITY = (
    "Posterior over prior standard deviation, logarithmic: a bar of one decade is an uncertainty ten times smaller "
    "than before the test. A good set of runs gives a long bar to each quantity of the specification. Vermilion: less "
    "than 10 % of the information is from the data, the estimate is that of the prior; orange: 10 % to 90 %, the "
    "prior still contributes."
)
_LEAST = 1e-6
_TICKS = (1e-6, 1e-5, 1e-4, 1e-3, 0.01, 0.1, 1.0)


@style.themed
def identifiability_figure(summary: Summary) -> style.Picture:
    """Return bars of posterior over prior sd of parameters and derived quantities; of many, the least determined."""
    entries = [
        (entry.from_data, entry.name)
        for entry in (*summary.parameters, *summary.derived)
        if entry.from_data is not None and not is_nuisance(entry) and not entry.repeats_misalignments
    ]
    if not entries:
        raise ValueError("the summary gives the share from the data for no quantity")
    ranked = sorted(entries, key=lambda entry: entry[0])
    shown, rest = ranked[:_MOST_PARAMETERS], ranked[_MOST_PARAMETERS:]
    caption = _IDENTIFIABILITY
    if rest:
        most = significant(narrowing(rest[0][0]), 2)
        caption += f" The other {len(rest)} of {len(entries)} have a ratio of at most {most}."
    columns = 1 if len(shown) <= 16 else 2
    lines = -(-len(shown) // columns)
    width, height = 12.0 if columns == 2 else 8.0, lines * 0.235 + 0.55
    counts = _counts([share for share, _ in entries])
    figure = style.picture(width, height, "Identifiability", caption, counts, alarm=alarm_in_picture(summary))
    least = 10.0 ** math.floor(min(-1.0, math.log10(min(narrowing(share) for share, _ in shown))))
    grid = style.panels(figure, 1, columns, (2.55, 0.5, 0.85, 0.05), (3.4, 0))
    for column, axes in enumerate(grid[0]):
        _bars(axes, shown[column * lines : (column + 1) * lines], lines, least)
    return figure


def narrowing(from_data: float) -> float:
    """Return posterior over prior standard deviation, √(1 − from_data), at least 10⁻⁶."""
    return max(math.sqrt(max(1 - from_data, 0.0)), _LEAST)


def _bars(axes: Axes, entries: Sequence[tuple[float, str]], lines: int, least: float) -> None:
    colours = [
        style.VERMILION if s < NOT_DETERMINED else (style.ORANGE if s < _PARTLY else style.BLUE) for s, _ in entries
    ]
    ratios = [min(narrowing(share), 1.0) for share, _ in entries]
    places = range(len(entries))
    axes.set_xscale("log")
    axes.barh(places, [1 - least] * len(entries), left=least, height=0.62, color="#f0f0f0")
    axes.barh(places, [1 - ratio for ratio in ratios], left=ratios, height=0.62, color=colours)
    for place, ratio in zip(places, ratios, strict=True):
        text = f"< {_LEAST:g}" if ratio <= _LEAST else significant(ratio, 2)
        axes.annotate(text, (1, place), (4, 0), textcoords="offset points", size=style.SMALL, va="center", ha="left")
    axes.set(xlim=(least, 1), ylim=(lines - 0.5, -0.6), xlabel="posterior sd / prior sd")
    ticks = [tick for tick in _TICKS if tick >= least]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    style.name_rows(axes, [name for _, name in entries], 38)
    axes.grid(axis="x")
    axes.spines["left"].set_visible(False)
    axes.spines["bottom"].set_color(style.QUIET)


def _counts(shares: Sequence[float]) -> str:
    weak = sum(share < NOT_DETERMINED for share in shares)
    partly = sum(NOT_DETERMINED <= share < _PARTLY for share in shares)
    full = len(shares) - weak - partly
    return f"of {len(shares)} quantities {full} determined by the data, {partly} partly, {weak} not"

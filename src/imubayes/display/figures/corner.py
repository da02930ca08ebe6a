"""Joint posterior of chosen quantities: how large the uncertainties are and which hang together."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from scipy.ndimage import gaussian_filter

from imubayes.display.fit_tables import alarm_of
from imubayes.display.labels import pretty, readable, shortened
from imubayes.display.rounding import concise
from imubayes.display.theme import BLUE, INK, QUIET, SMALL, Picture, axes_at, picture, themed
from imubayes.display.ticks import frame, power_of_ten
from imubayes.results.posterior_draws import complete, draws_of, thinned

_CELLS = 36
_LEVELS = (0.95, 0.5)
_FILLS = ("#cfe2f0", "#7fb2d6")
_MOST, _DRAWS = 8, 50_000
_CAPTION = (
    "Diagonal: posterior of one quantity, its 95 % equal-tailed interval shaded; grey dashes: the width of its prior, "
    "where that is not much wider. Below: pairs, with the smallest areas that hold 50 % and 95 % of the draws, and "
    "their correlation. Axes are deviations from the posterior mean that stands on top. Round areas are quantities the "
    "runs tell apart; a thin slanted one is a pair of which only a combination is known."
)


@themed
def corner_figure(posterior: Any, names: Sequence[str], summary: Mapping[str, Any]) -> Picture:
    """Return the corner plot of chosen parameters and derived quantities, at most eight.

    Parameters
    ----------
    posterior : DataTree, its posterior group, a path to `posterior.nc`, or draws by name.
    names : as in the summary.
    summary : the content of `summary.json`, for units, means and prior widths.
    """
    entries = {one["name"]: one for one in (*summary["parameters"], *summary["derived"])}
    draws = thinned(complete(draws_of(posterior, names)), _DRAWS)
    absent = [name for name in names if name not in draws or name not in entries]
    if absent or not names:
        raise ValueError(f"no draws of {', '.join(absent) or 'anything: no name was given'}")
    shown = list(dict.fromkeys(names))[:_MOST]
    columns = [_column(draws[name], entries[name]) for name in shown]
    count = len(shown)
    side = min(1.75, 11.6 / count) if count > 2 else 2.6
    height = count * side + 0.6
    width = max(count * side + 1.5, 8.5)
    how = "" if summary.get("sampled", True) else "not sampled: draws from the Laplace approximation about the fit"
    more = len(set(names)) - count
    caption = _CAPTION + (f" Of {count + more} quantities the first {count} are shown." if more else "")
    figure = picture(width, height, "Joint posterior", caption, how, alarm=alarm_of(summary))
    left, bottom, right, _ = figure.inside
    margin = left + 0.75 + max(0.0, (right - left - 0.85 - count * side) / 2 if count < 4 else 0.0)
    base = bottom + 0.5
    for row in range(count):
        for column in range(row + 1):
            tall = side - 0.12 - 0.3 * (row == column)
            axes = axes_at(figure, margin + column * side, base + (count - 1 - row) * side, side - 0.12, tall)
            if row == column:
                _single(axes, columns[row])
            else:
                _pair(axes, columns[column], columns[row])
            frame(
                axes, 5, 5 if row != column else 0,
                f"Δ / {columns[column].unit}" if row == count - 1 else None,
                f"Δ / {columns[row].unit}" if column == 0 and row else None,
                SMALL, 0.09,
            )  # fmt: skip
    return figure


class _Column:
    """Draws of one quantity as deviations from their mean, in a readable unit."""

    def __init__(self, name: str, unit: str, heading: str, x: np.ndarray, prior_sd: float | None):
        self.name, self.unit, self.heading, self.x, self.prior_sd = name, unit, heading, x, prior_sd
        low, high = np.quantile(x, [0.001, 0.999])
        margin = 0.12 * (high - low) or 1.0
        self.limits = (float(low - margin), float(high + margin))


def _column(draws: np.ndarray, entry: Mapping[str, Any]) -> _Column:
    mean, sd = float(np.mean(draws)), float(np.std(draws))
    factor, unit = _deviation(entry["unit"], mean, sd)
    prior = entry.get("prior_sd")
    heading = f"{shortened(entry['name'], 30)}\n{concise(mean, sd)} {pretty(entry['unit'])}"
    return _Column(entry["name"], pretty(unit), heading, (draws - mean) * factor, prior * factor if prior else None)


def _deviation(unit: str, mean: float, sd: float) -> tuple[float, str]:
    """Return factor and unit in which deviations are plain numbers: of a scale factor, parts per million of it."""
    if " per " in unit and 0 < sd < 0.01 * abs(mean):
        return 1e6 / abs(mean), "ppm"
    factor, name = readable(unit, 3 * sd)
    power = 3 * math.floor(math.log10(3 * sd * factor) / 3) if sd > 0 else 0
    # Numbers of more than four digits would run into those of the next panel.
    if -2 < math.log10(max(3 * sd * factor, 1e-300)) < 4 or not power:
        return factor, name
    return factor / 10.0**power, f"{power_of_ten(power)} {pretty(name)}"


def _single(axes: Axes, one: _Column) -> None:
    heights, edges = np.histogram(one.x, bins=_CELLS, range=one.limits, density=True)
    middle = 0.5 * (edges[1:] + edges[:-1])
    low, high = np.quantile(one.x, [0.025, 0.975])
    smooth = gaussian_filter(heights, float(np.clip(1.0 * (20000 / one.x.size) ** 0.2, 0.8, 2.0)))
    fine = np.linspace(*one.limits, 240)
    curve = np.interp(fine, middle, smooth)
    axes.fill_between(fine, 0, curve, where=(fine >= low) & (fine <= high), color=_FILLS[0], linewidth=0)
    axes.plot(fine, curve, color=BLUE, linewidth=1.2)
    top = curve.max()
    if one.prior_sd and one.prior_sd < 6 * float(np.std(one.x)):
        # The prior's centre is not that of the posterior; its width is what compares.
        prior = np.exp(-0.5 * (fine / one.prior_sd) ** 2) / (one.prior_sd * np.sqrt(2 * np.pi))
        axes.plot(fine, prior, "--", color=QUIET, linewidth=0.9)
        top = max(top, prior.max())
    axes.set(xlim=one.limits, ylim=(0, 1.08 * top))
    axes.spines["left"].set_visible(False)
    axes.set_title(one.heading, size=7.5, weight="normal", color=INK, linespacing=1.25, pad=3)


def _pair(axes: Axes, across: _Column, up: _Column) -> None:
    counts, x_edges, y_edges = np.histogram2d(across.x, up.x, bins=_CELLS, range=(across.limits, up.limits))
    # Few draws make ragged contours; the width that serves a plane falls with the sixth root of their number.
    density = gaussian_filter(counts.T, float(np.clip(1.1 * (20000 / across.x.size) ** (1 / 6), 0.9, 2.2)))
    ranked = np.sort(density.ravel())[::-1]
    held = np.cumsum(ranked) / ranked.sum()
    levels = [float(ranked[np.searchsorted(held, level)]) for level in _LEVELS]
    x, y = 0.5 * (x_edges[1:] + x_edges[:-1]), 0.5 * (y_edges[1:] + y_edges[:-1])
    if 0 < levels[0] < levels[1] < ranked[0]:
        axes.contourf(x, y, density, levels=[*levels, ranked[0] * 1.01], colors=_FILLS)
        axes.contour(x, y, density, levels=levels, colors=[BLUE], linewidths=0.7)
    else:
        axes.plot(across.x[:2000], up.x[:2000], ",", color=BLUE)
    axes.axvline(0, color=QUIET, linewidth=0.4, zorder=0)
    axes.axhline(0, color=QUIET, linewidth=0.4, zorder=0)
    axes.set(xlim=across.limits, ylim=up.limits)
    spread = float(np.std(across.x) * np.std(up.x))
    correlation = float(np.mean((across.x - across.x.mean()) * (up.x - up.x.mean()))) / spread if spread else 0.0
    strong = abs(correlation) > 0.7
    text = "0.00" if abs(correlation) < 0.005 else f"{correlation:+.2f}".replace("-", "−")
    right = correlation < 0
    axes.text(
        0.97 if right else 0.03,
        0.97,
        text,
        transform=axes.transAxes,
        size=7.5,
        va="top",
        ha="right" if right else "left",
        color=INK if strong else QUIET,
        weight="bold" if strong else "normal",
    )

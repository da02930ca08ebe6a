"""Identifiability: how much narrower the data made each quantity than its prior."""

import math
from collections.abc import Sequence

from matplotlib.axes import Axes

from imubayes.display.fit_cautions import alarm_of
from imubayes.display.fit_quality_tables import NOT_DETERMINED
from imubayes.display.labels import shortened
from imubayes.display.quantity_tables import is_nuisance
from imubayes.display.rounding import significant
from imubayes.display.theme import BLUE, ORANGE, QUIET, SMALL, VERMILION, Picture, panels, picture, themed
from imubayes.results.summary import Summary

_MOST = 48
_PARTLY = 0.9
_CAPTION = (
    "Posterior over prior standard deviation, logarithmic: a bar of one decade is an uncertainty ten times smaller "
    "than before the test. A good set of runs gives a long bar to each quantity of the specification. Vermilion: less "
    "than 10 % of the information is from the data, the estimate is that of the prior; orange: 10 % to 90 %, the "
    "prior still contributes."
)
_LEAST = 1e-6
_TICKS = (1e-6, 1e-5, 1e-4, 1e-3, 0.01, 0.1, 1.0)


@themed
def identifiability_figure(summary: Summary) -> Picture:
    """Return bars of posterior over prior sd of parameters and derived quantities; of many, the least determined."""
    entries = [
        (entry.from_data, entry.name)
        for entry in (*summary.parameters, *summary.derived)
        if entry.from_data is not None and not is_nuisance(entry) and not entry.repeats_misalignments
    ]
    if not entries:
        raise ValueError("the summary gives the share from the data for no quantity")
    ranked = sorted(entries, key=lambda entry: entry[0])
    shown, rest = ranked[:_MOST], ranked[_MOST:]
    caption = _CAPTION
    if rest:
        most = significant(narrowing(rest[0][0]), 2)
        caption += f" The other {len(rest)} of {len(entries)} have a ratio of at most {most}."
    columns = 1 if len(shown) <= 16 else 2
    lines = -(-len(shown) // columns)
    width, height = 12.0 if columns == 2 else 8.0, lines * 0.235 + 0.55
    counts = _counts([share for share, _ in entries])
    figure = picture(width, height, "Identifiability", caption, counts, alarm=alarm_of(summary))
    least = 10.0 ** math.floor(min(-1.0, math.log10(min(narrowing(share) for share, _ in shown))))
    grid = panels(figure, 1, columns, (2.55, 0.5, 0.85, 0.05), (3.4, 0))
    for column, axes in enumerate(grid[0]):
        _bars(axes, shown[column * lines : (column + 1) * lines], lines, least)
    return figure


def narrowing(from_data: float) -> float:
    """Return posterior over prior standard deviation, √(1 − from_data), at least 10⁻⁶."""
    return max(math.sqrt(max(1 - from_data, 0.0)), _LEAST)


def _bars(axes: Axes, entries: Sequence[tuple[float, str]], lines: int, least: float) -> None:
    colours = [VERMILION if s < NOT_DETERMINED else (ORANGE if s < _PARTLY else BLUE) for s, _ in entries]
    ratios = [min(narrowing(share), 1.0) for share, _ in entries]
    places = range(len(entries))
    axes.set_xscale("log")
    axes.barh(places, [1 - least] * len(entries), left=least, height=0.62, color="#f0f0f0")
    axes.barh(places, [1 - ratio for ratio in ratios], left=ratios, height=0.62, color=colours)
    for place, ratio in zip(places, ratios, strict=True):
        text = f"< {_LEAST:g}" if ratio <= _LEAST else significant(ratio, 2)
        axes.annotate(text, (1, place), (4, 0), textcoords="offset points", size=SMALL, va="center", ha="left")
    axes.set(xlim=(least, 1), ylim=(lines - 0.5, -0.6), xlabel="posterior sd / prior sd")
    ticks = [tick for tick in _TICKS if tick >= least]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_yticks(places, [shortened(name, 38) for _, name in entries])
    axes.grid(axis="x")
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.spines["bottom"].set_color(QUIET)


def _counts(shares: Sequence[float]) -> str:
    weak = sum(share < NOT_DETERMINED for share in shares)
    partly = sum(NOT_DETERMINED <= share < _PARTLY for share in shares)
    full = len(shares) - weak - partly
    return f"of {len(shares)} quantities {full} determined by the data, {partly} partly, {weak} not"

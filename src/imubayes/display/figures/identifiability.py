"""Identifiability: the share of the information on each quantity that comes from the data."""

from collections.abc import Sequence

from matplotlib.axes import Axes

from imubayes.display.fit_cautions import alarm_of
from imubayes.display.fit_quality_tables import NOT_DETERMINED
from imubayes.display.labels import shortened
from imubayes.display.quantity_tables import is_nuisance
from imubayes.display.rounding import percent
from imubayes.display.theme import BLUE, ORANGE, QUIET, SMALL, VERMILION, Picture, panels, picture, themed
from imubayes.results.summary import Summary

_MOST = 48
_PARTLY = 0.9
_CAPTION = (
    "Share from the data = 1 − (posterior sd / prior sd)². A good set of runs fills every bar that matters for the "
    "specification. Below 10 % (vermilion) the estimate is that of the prior; from 10 % to 90 % (orange) the prior "
    "still contributes."
)


@themed
def identifiability_figure(summary: Summary) -> Picture:
    """Return bars of `from_data` of parameters and derived quantities; if they are many, the least determined."""
    entries = [
        (entry.from_data, entry.name)
        for entry in (*summary.parameters, *summary.derived)
        if entry.from_data is not None and not is_nuisance(entry)
    ]
    if not entries:
        raise ValueError("the summary gives the share from the data for no quantity")
    ranked = sorted(entries, key=lambda entry: entry[0])
    shown, rest = ranked[:_MOST], ranked[_MOST:]
    caption = _CAPTION
    if rest:
        caption += f" The other {len(rest)} of {len(entries)} have at least {percent(rest[0][0])} from the data."
    columns = 1 if len(shown) <= 16 else 2
    lines = -(-len(shown) // columns)
    width, height = 12.0 if columns == 2 else 8.0, lines * 0.235 + 0.55
    counts = _counts([share for share, _ in entries])
    figure = picture(width, height, "Identifiability", caption, counts, alarm=alarm_of(summary))
    grid = panels(figure, 1, columns, (2.55, 0.5, 0.85, 0.05), (3.4, 0))
    for column, axes in enumerate(grid[0]):
        _bars(axes, shown[column * lines : (column + 1) * lines], lines)
    return figure


def _bars(axes: Axes, entries: Sequence[tuple[float, str]], lines: int) -> None:
    shares = [min(max(share, 0.0), 1.0) for share, _ in entries]
    colours = [VERMILION if s < NOT_DETERMINED else (ORANGE if s < _PARTLY else BLUE) for s in shares]
    places = range(len(entries))
    axes.barh(places, [100.0] * len(entries), height=0.62, color="#f0f0f0")
    axes.barh(places, [100 * share for share in shares], height=0.62, color=colours)
    for place, share in zip(places, shares, strict=True):
        axes.text(102, place, percent(share), size=SMALL, va="center", ha="left")
    axes.set(xlim=(0, 100), ylim=(lines - 0.5, -0.6), xlabel="share from the data / %", xticks=[0, 25, 50, 75, 100])
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

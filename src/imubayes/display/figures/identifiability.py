"""What the runs determined and what they did not: the share of each quantity that comes from the data."""

from collections.abc import Mapping, Sequence
from typing import Any

from imubayes.display.fit_tables import alarm_of
from imubayes.display.labels import shortened
from imubayes.display.rounding import percent
from imubayes.display.theme import BLUE, FAINT, ORANGE, QUIET, VERMILION, Picture, axes_at, picture, themed

_MOST = 48
_NOT, _PARTLY = 0.1, 0.9
_CAPTION = (
    "from data = 1 − (posterior sd / prior sd)². A good set of runs fills every bar that matters for the "
    "specification. Below 10 % (vermilion) the number is the prior's, not a measurement; between 10 % and 90 % "
    "(orange) the prior still counts."
)


@themed
def identifiability_figure(summary: Mapping[str, Any]) -> Picture:
    """Return bars of `from_data` of parameters and derived quantities; if they are many, the least determined."""
    entries = [
        one
        for one in (*summary["parameters"], *summary["derived"])
        if one.get("from_data") is not None and not one.get("nuisance")
    ]
    if not entries:
        raise ValueError("the summary says of no quantity what came from the data")
    ranked = sorted(entries, key=lambda one: one["from_data"])
    shown, rest = ranked[:_MOST], ranked[_MOST:]
    caption = _CAPTION
    if rest:
        caption += (
            f" The other {len(rest)} of {len(entries)} have at least {percent(rest[0]['from_data'])} from the data."
        )
    columns = 1 if len(shown) <= 16 else 2
    lines = -(-len(shown) // columns)
    width, height = 12.0 if columns == 2 else 8.0, lines * 0.235 + 0.55
    title = "What the runs determined"
    figure = picture(width, height, title, caption, _counts(entries), alarm=alarm_of(summary))
    left, bottom, right, _ = figure.inside
    across = (right - left) / columns
    for column in range(columns):
        part = shown[column * lines : (column + 1) * lines]
        axes = axes_at(figure, left + column * across + 2.55, bottom + 0.5, across - 2.55 - 0.85, lines * 0.235)
        _bars(axes, part, lines)
    return figure


def _bars(axes, part: Sequence[Mapping[str, Any]], lines: int) -> None:
    shares = [min(max(one["from_data"], 0.0), 1.0) for one in part]
    colours = [VERMILION if s < _NOT else (ORANGE if s < _PARTLY else BLUE) for s in shares]
    places = range(len(part))
    axes.barh(places, [100.0] * len(part), height=0.62, color="#f0f0f0")
    axes.barh(places, [100 * s for s in shares], height=0.62, color=colours)
    for place, share in zip(places, shares, strict=True):
        axes.text(102, place, percent(share), size=8, va="center", ha="left")
    axes.set(xlim=(0, 100), ylim=(lines - 0.5, -0.6), xlabel="share from the data / %")
    axes.set_yticks(places, [shortened(one["name"], 38) for one in part])
    axes.set_xticks([0, 25, 50, 75, 100])
    axes.grid(axis="x", color=FAINT, linewidth=0.5)
    axes.set_axisbelow(True)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.spines["bottom"].set_color(QUIET)


def _counts(entries: Sequence[Mapping[str, Any]]) -> str:
    weak = sum(1 for one in entries if one["from_data"] < _NOT)
    partly = sum(1 for one in entries if _NOT <= one["from_data"] < _PARTLY)
    full = len(entries) - weak - partly
    return f"of {len(entries)} quantities {full} from the data, {partly} partly, {weak} not determined"

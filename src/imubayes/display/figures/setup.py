"""Figures of the set-up: how the unit sits on each table, and the runs of a campaign on a time axis.

The sketch of a table shows its axis, zero and sense of rotation, and the axes of the body.  The timeline shows when
each run was recorded, in which mounting and at which temperature.
"""

import itertools
from collections.abc import Sequence
from datetime import UTC, timedelta
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.lines import Line2D

from imubayes.display import figure_style as style
from imubayes.display.numbers_and_labels import shortened
from imubayes.foundations.campaign_data import Campaign, Run, Table
from imubayes.foundations.wording import counted
from imubayes.procedures.ambient import instant

_LEGEND, _LINE = 2.05, 0.24
_NO_MOUNTING = "no mounting"
_CAPTION = (
    "Bars: runs by procedure, from start to end, in the hue of their mounting. Lower panel: lowest to highest reading "
    "of the thermometer that varied most. A good campaign interleaves mountings and temperatures: if all runs of one "
    "mounting are at one end, ageing and mounting cannot be distinguished."
)


@style.themed
def campaign_timeline_figure(campaign: Campaign) -> style.Picture:
    """Return the runs of a campaign on a time axis.

    Raises
    ------
    ValueError
        if no run states its start.
    """
    runs = [run for run in campaign.runs if run.start is not None]
    if not runs:
        raise ValueError("no run states its start")
    kinds = list(dict.fromkeys(run.procedure for run in runs))
    mountings = list(dict.fromkeys(run.mounting or _NO_MOUNTING for run in runs))
    hues = {name: style.HUES[place % len(style.HUES)] for place, name in enumerate(mountings)}
    height = _LINE * len(kinds) + 2.6
    left_out = len(campaign.runs) - len(runs)
    missing = f" {left_out} of {counted(len(campaign.runs), 'run')} left out: no start is stated." if left_out else ""
    figure = style.picture(11.5, height, f"Runs of {campaign.name}", _CAPTION + missing)
    upper, lower = style.panels(figure, 2, 1, (1.6, 0.5, _LEGEND, 0.1), (0.85, 0.3), share_x=True)[:, 0]
    lower.xaxis.set_visible(True)
    for run in runs:
        start, end = _span(run)
        hue = hues[run.mounting or _NO_MOUNTING]
        place = [kinds.index(run.procedure)] * 2
        upper.plot([start, end], place, color=hue, linewidth=8, solid_capstyle="butt")
        upper.plot([start, end], place, "|", color=hue, markersize=8, markeredgewidth=1.6)
        _temperature(lower, run, start, end, hue)
    upper.set_yticks(range(len(kinds)), [kind.replace("_", " ") for kind in kinds])
    upper.set(ylim=(len(kinds) - 0.4, -0.6))
    lower.set_ylabel("temperature / °C")
    locator = AutoDateLocator(minticks=3, maxticks=8)
    lower.xaxis.set_major_locator(locator)
    lower.xaxis.set_major_formatter(ConciseDateFormatter(locator, tz=UTC))
    lower.set_xlabel("UTC")
    handles = [Line2D([], [], color=hue, linewidth=5, label=shortened(name, 25)) for name, hue in hues.items()]
    style.legend_at(figure, figure.inside[2] - _LEGEND + 0.3, figure.inside[3], handles, handlelength=0.8)
    return figure


def _span(run: Run) -> tuple[float, float]:
    """Return start and end of a run as matplotlib dates; a run without times is a point."""
    assert run.start is not None
    start = instant(run.start)
    times = run.covariates.get("time", np.zeros(1))
    known = times[np.isfinite(times)]
    seconds = float(known.max()) if known.size else 0.0
    return float(date2num(start)), float(date2num(start + timedelta(seconds=seconds)))


def _temperature(axes: Axes, run: Run, start: float, end: float, hue: str) -> None:
    """Draw the range of the thermometer that varied most, of the unit or of its converter."""
    recorded = [run.covariates.get(name, np.empty(0)) for name in ("temperature", "converter_temperature")]
    ranges = [(float(known.min()), float(known.max())) for each in recorded if (known := each[np.isfinite(each)]).size]
    if ranges:
        low, high = max(ranges, key=lambda found: found[1] - found[0])
        axes.plot([(start + end) / 2] * 2, [low, high], "o-", color=hue, linewidth=3, markersize=4)


_BODY = (style.BLUE, style.GREEN, style.VERMILION)
# East, North and up on the page, as they are seen from the south and above.
_VIEW = np.array([[0.93, 0.36, 0.0], [-0.16, 0.42, 0.89]])
_COMPASS = np.array([-1.5, -1.2])
_ABREAST, _WIDE, _HIGH = 3, 3.7, 3.4
# Lengths on the page: half the edge of the unit, its distance along the axis, its axes; the radius of the table, its
# shaft, the arm of a centrifuge.
_HALF, _SEAT, _AXIS, _RADIUS, _SHAFT, _ARM = 0.27, 0.38, 0.95, 1.3, 1.0, 1.45
# Channels whose input axis is within 5 deg of an axis of the body are named at it; of the others so many are drawn.
_ALONG, _MOST_SKEW = np.cos(np.radians(5.0)), 8
_SKETCH_CAPTION = (
    "Set-up as the campaign states it, at angle 0 of all axes, seen from the south and above. Disc: the table, with "
    "its zero, its axis and the sense in which angle and rate are positive. Box: the unit, with the axes of its body "
    "and the channels along them. If the real bench looks different, a mounting or a table is entered wrongly."
)

Pair = tuple[str, str]


def mounted_pairs(campaign: Campaign) -> list[Pair]:
    """Return the pairs of table and mounting that runs use, in the order of the runs."""
    return list(dict.fromkeys((run.table, run.mounting) for run in campaign.runs if run.table and run.mounting))


@style.themed
def mounting_sketch_figure(campaign: Campaign, pairs: Sequence[Pair] | None = None) -> style.Picture:
    """Return a sketch of each pair of table and mounting.

    Parameters
    ----------
    pairs : table and mounting, by name; if None, all that runs use.

    Raises
    ------
    ValueError
        if no run uses a table with a mounting.
    """
    pairs = mounted_pairs(campaign) if pairs is None else pairs
    if not pairs:
        raise ValueError("no run has a table and a mounting")
    columns = min(_ABREAST, len(pairs))
    rows = -(-len(pairs) // columns)
    figure = style.picture(max(7.5, _WIDE * columns), _HIGH * rows, f"Mountings of {campaign.name}", _SKETCH_CAPTION)
    grid = style.panels(figure, rows, columns, (0.0, 0.0, 0.0, 0.4), (0.1, 0.5)).flatten()
    for axes in grid:
        axes.axis("off")
    for axes, (table, mounting) in zip(grid, pairs, strict=False):
        _panel(axes, campaign, table, mounting)
    return figure


def _panel(axes: Axes, campaign: Campaign, table: str, mounting: str) -> None:
    stand = campaign.tables[table].to_local
    body = stand @ campaign.mountings[mounting].body_to_table
    for name, way in (("E", (1, 0, 0)), ("N", (0, 1, 0)), ("up", (0, 0, 1))):
        _arrow(axes, np.array(way) * 0.4, name, style.QUIET, 0.9, _COMPASS)
    _disc(axes, stand)
    _table_axes(axes, campaign.tables[table])
    seat = _VIEW @ (stand[:, 2] * _SEAT)
    _box(axes, body, seat)
    for place, colour in enumerate(_BODY):
        _arrow(axes, body[:, place] * _AXIS, _label(campaign, place), colour, 2.0, seat)
    for name, axis in _skew(campaign):
        _arrow(axes, body @ axis * _AXIS, name, style.QUIET, 1.0, seat)
    angles = np.degrees(np.arccos(np.clip(stand[:, 2] @ body, -1, 1)))
    runs = sum((run.table, run.mounting) == (table, mounting) for run in campaign.runs)
    axes.set(xlim=(-2.0, 2.0), ylim=(-1.75, 1.95), aspect="equal")
    axes.set_title(f"{shortened(mounting, 20)} on {shortened(table, 20)}, {runs} run{'s' if runs != 1 else ''}")
    said = ", ".join(f"{name} {angle:.4g}°" for name, angle in zip("xyz", angles, strict=True))
    axes.text(0.5, 0.0, f"to the axis: {said}", transform=axes.transAxes, ha="center", va="bottom", color=style.QUIET)


def _disc(axes: Axes, stand: np.ndarray) -> None:
    """Draw the table: its disc, axis, zero mark and positive sense."""

    def rim(degrees: np.ndarray, radius: float) -> np.ndarray:
        angle = np.radians(degrees)
        return _RADIUS * radius * (_VIEW @ stand @ np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)]))

    axes.fill(*rim(np.linspace(0, 360, 73), 1.0), facecolor="#f4f4f4", edgecolor=style.FAINT)
    axes.plot(*np.stack([rim(np.zeros(1), 0.88)[:, 0], rim(np.zeros(1), 1.06)[:, 0]]).T, color=style.INK, linewidth=2)
    _text(axes, rim(np.zeros(1), 1.25)[:, 0], "0°", style.INK)
    turned = rim(np.linspace(195, 245, 30), 1.08)
    axes.plot(*turned[:, :-1], color=style.INK, linewidth=1.1)
    _head(axes, turned[:, -4], turned[:, -1], style.INK, 1.1)
    _text(axes, rim(np.array([220.0]), 1.2)[:, 0], "+", style.INK, fontsize=11)


def _table_axes(axes: Axes, table: Table) -> None:
    """Draw the axes of a table as shafts that end at it: beyond, the axes of the body have their labels."""
    inner, outer = table.to_local[:, 2], table.outer_to_local
    if table.inner_axis is None:
        _shaft(axes, inner, "table axis", _SHAFT)
    elif table.arm:
        start = _VIEW @ (-outer[:, 0] * _ARM)
        axes.plot(*np.stack([start, np.zeros(2)]).T, color=style.QUIET, linewidth=1.5)
        _text(axes, start / 2, f"{table.arm:.3g} m", style.QUIET, va="bottom")
        _shaft(axes, inner, "inner axis", _SHAFT)
        _arrow(axes, outer[:, 2] * _AXIS, "outer axis", style.QUIET, 1.2, start)
    else:
        middle = [] if table.middle_axis is None else [("middle", outer @ np.array(table.middle_axis))]
        shafts: list[tuple[str, np.ndarray]] = []
        for name, way in (("inner", inner), *middle, ("outer", outer[:, 2])):
            same = [place for place, (_, other) in enumerate(shafts) if way @ other > _ALONG]
            if same:
                shafts[same[0]] = (f"{shafts[same[0]][0]} and {name}", way)
            else:
                shafts.append((name, way))
        for place, (name, way) in enumerate(shafts):
            _shaft(axes, way, f"{name} axis", _SHAFT if place == 0 else _RADIUS + 0.3)


def _shaft(axes: Axes, way: np.ndarray, label: str, length: float) -> None:
    tail = _VIEW @ way * -length
    _arrow(axes, way * length, "", style.INK, 1.2, tail)
    _text(axes, tail * (1 + 0.16 / length), label, style.INK, _side(tail[0]))


def _box(axes: Axes, body: np.ndarray, seat: np.ndarray) -> None:
    corners = list(itertools.product((-_HALF, _HALF), repeat=3))
    for first, second in itertools.combinations(corners, 2):
        if sum(a != b for a, b in zip(first, second, strict=True)) == 1:
            ends = [seat + _VIEW @ body @ np.array(end) for end in (first, second)]
            axes.plot(*np.stack(ends).T, color=style.INK, linewidth=0.6)


def _label(campaign: Campaign, place: int) -> str:
    """Return the name of an axis of the body, with the channels along it."""
    along = [each.name for each in campaign.channels if each.kind != "angle" and each.axes[0, place] > _ALONG]
    return "xyz"[place] + (f": {', '.join(along)}" if along else "")


def _skew(campaign: Campaign) -> list[tuple[str, np.ndarray]]:
    """Return the channels along none of the axes of the body, with their input axes; none if they are many."""
    found: dict[tuple[float, ...], list[str]] = {}
    for channel in campaign.channels:
        if channel.kind != "angle" and channel.axes[0].max() <= _ALONG:
            found.setdefault(tuple(np.round(channel.axes[0], 2).tolist()), []).append(channel.name)
    if len(found) > _MOST_SKEW:
        return []
    return [(", ".join(names), np.array(axis)) for axis, names in found.items()]


def _arrow(axes: Axes, way: np.ndarray, label: str, colour: str, width: float, start: np.ndarray | None = None) -> None:
    """Draw an arrow in East, North and up from a place on the page, with its label beyond its end."""
    start = np.zeros(2) if start is None else start
    end = start + _VIEW @ way
    _head(axes, start, end, colour, width)
    beyond = end + 0.13 * (end - start) / max(float(np.linalg.norm(end - start)), 0.2)
    _text(axes, beyond, label, colour, _side(end[0] - start[0]))


def _head(axes: Axes, start: np.ndarray, end: np.ndarray, colour: str, width: float) -> None:
    look = {"arrowstyle": "-|>", "color": colour, "linewidth": width, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (end[0], end[1]), (start[0], start[1]), arrowprops=look)


def _text(
    axes: Axes, place: np.ndarray, label: str, colour: str, ha: str = "center", va: str = "center", **look: Any
) -> None:
    axes.text(place[0], place[1], label, color=colour, ha=ha, va=va, **look)


def _side(across: float) -> str:
    """Return how a label beyond the end of an arrow is aligned, which goes so far across the page."""
    return "left" if across > 0.25 else "right" if across < -0.25 else "center"

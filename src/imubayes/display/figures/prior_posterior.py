"""Before and after the runs: the prior and the posterior of chosen quantities, mounting angles above all."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from imubayes.display.fit_tables import alarm_of
from imubayes.display.labels import pretty, shortened
from imubayes.display.marks import band, line, points, uprights
from imubayes.display.rounding import concise, significant
from imubayes.display.theme import (
    BAND,
    BAND_WIDE,
    BLUE,
    FAINT,
    QUIET,
    SMALL,
    VERMILION,
    Picture,
    axes_at,
    picture,
    themed,
)
from imubayes.display.ticks import frame, tick_places

_MOST = 40
_NAMES, _NUMBERS = 2.35, 1.3  # room for the names on the left and the numbers on the right, inches
_FAMILIES = ("mounting_error.", "mounting_angle[")
_ON_PAPER = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0}
_CAPTION = (
    "Left: the posterior with its 95 % interval, in prior standard deviations from the prior's centre; an estimate "
    "beyond the bands says that the equipment is worse than stated, or the model is wrong (where the prior has no one "
    "centre, the estimate stands as a number). Right: standard uncertainty before the runs (open) and after (filled), "
    "on a logarithmic axis. With a good set of runs every line is long; a short one, in vermilion, is a quantity that "
    "the runs did not determine."
)


def mounting_quantities(summary: Mapping[str, Any]) -> list[str]:
    """Return the names of mounting errors and mounting angles whose prior and posterior are known."""
    entries = (*summary["parameters"], *summary["derived"])
    return [one["name"] for one in entries if one["name"].startswith(_FAMILIES) and _known(one)]


@themed
def prior_posterior_figure(summary: Mapping[str, Any], names: Sequence[str] | None = None) -> Picture:
    """Return prior against posterior; without names those of the mountings, the least determined if they are many.

    The prior's width is `prior_sd`, or where it is not given that which `from_data` implies; its centre is
    `prior_mean`, and 0 for errors.  Without a centre the left panel gives the estimate as a number.
    """
    entries = {one["name"]: one for one in (*summary["parameters"], *summary["derived"])}
    wanted = [name for name in (names or mounting_quantities(summary)) if name in entries and _known(entries[name])]
    if not wanted:
        raise ValueError("no quantity with a prior and a posterior width was named")
    caption = _CAPTION
    chosen = [entries[name] for name in wanted]
    if len(chosen) > _MOST:
        ranked = sorted(range(len(chosen)), key=lambda place: _ratio(chosen[place]), reverse=True)[:_MOST]
        caption += f" Shown are the {_MOST} least determined of {len(chosen)}."
        chosen = [chosen[place] for place in sorted(ranked)]
    tall = len(chosen) * 0.24
    title = "Mounting, before and after the runs" if names is None else "Prior and posterior"
    figure = picture(12.0, tall + 0.85, title, caption, alarm=alarm_of(summary))
    left, bottom, right, top = figure.inside
    inner = right - left - _NAMES - _NUMBERS
    share = 0.45 if any(_centre(one) is not None for one in chosen) else 0.0
    gap = 0.35 if share else 0.0
    start = left + _NAMES + share * inner + gap
    panels = [axes_at(figure, start, bottom + 0.5, (1 - share) * inner - gap, tall)]
    unit = _widths(panels[0], chosen)
    if share:
        panels.insert(0, axes_at(figure, left + _NAMES, bottom + 0.5, share * inner, tall))
        _shifts(panels[0], chosen)
        frame(panels[0], 7, 0, "estimate / prior standard deviations")
    frame(panels[-1], 7, 0, f"standard uncertainty / {unit}")
    for axes in panels:
        axes.set_ylim(len(chosen) - 0.4, -0.6)
        axes.spines["left"].set_visible(False)
    for place, one in enumerate(chosen):
        along = panels[0].get_yaxis_transform()
        name = shortened(one["name"], 34)
        panels[0].text(-0.01, place, name, transform=along, size=SMALL, ha="right", va="center_baseline")
    _legend(figure, right, top)
    return figure


def _shifts(axes: Axes, chosen: Sequence[Mapping[str, Any]]) -> None:
    ends = (-0.6, len(chosen) - 0.4)
    for half, colour in ((2.0, BAND_WIDE), (1.0, BAND)):
        band(axes, np.array([-half, half]), np.full(2, ends[0]), np.full(2, ends[1]), colour)
    line(axes, [0, 0], ends, color=QUIET, linewidth=0.7)
    reach = 3.0
    for place, one in enumerate(chosen):
        centre = _centre(one)
        if centre is None:
            text = f"{concise(one['mean'], one['sd'])} {pretty(one['unit'])}"
            axes.text(0, place, text, size=SMALL, color=QUIET, ha="center", va="center", bbox=_ON_PAPER)
            continue
        prior = _prior_sd(one) or 1.0
        middle = (one["mean"] - centre) / prior
        low, high = (one["q025"] - centre) / prior, (one["q975"] - centre) / prior
        reach = max(reach, 1.08 * max(abs(low), abs(high)))
        colour = _colour(one)
        line(axes, [low, high], [place, place], color=colour, linewidth=2.0, solid_capstyle="butt")
        points(axes, [middle], [place], "o", 4.5, colour)
    axes.set_xlim(-reach, reach)


def _widths(axes: Axes, chosen: Sequence[Mapping[str, Any]]) -> str:
    """Draw uncertainty before and after, in one unit for all where they share a dimension."""
    units = {one["unit"] for one in chosen}
    angles = units <= {"deg", "arcsec", "arcmin"}
    factor = {"deg": 3600.0, "arcmin": 60.0, "arcsec": 1.0}
    axes.set_xscale("log")
    sizes = []
    for place, one in enumerate(chosen):
        scale = factor[one["unit"]] if angles else 1.0
        before, after = (_prior_sd(one) or math.nan) * scale, one["sd"] * scale
        sizes += [before, after]
        colour = _colour(one)
        line(axes, [after, before], [place, place], color=colour, linewidth=1.0, alpha=0.6)
        points(axes, [before], [place], "o", 5, "white", markeredgecolor=QUIET, markeredgewidth=1.0)
        points(axes, [after], [place], "o", 5, colour)
        text = f"{significant(before, 2)} → {significant(after, 2)}" + ("" if angles else f" {pretty(one['unit'])}")
        axes.text(1.015, place, text, transform=axes.get_yaxis_transform(), size=8, va="center", ha="left")
    finite = np.array([size for size in sizes if np.isfinite(size) and size > 0])
    limits = (float(finite.min()) / 1.6, float(finite.max()) * 1.6)
    axes.set_xlim(limits)
    grid = np.array(tick_places(*limits, 7, 0.0))
    uprights(axes, grid, -0.6, len(chosen) - 0.4, FAINT, 0.6, zorder=0.5)
    axes.text(1.015, -1.0, "before → after", transform=axes.get_yaxis_transform(), size=SMALL, color=QUIET, va="center")
    if angles:
        return "arcsec"
    return pretty(next(iter(units))) if len(units) == 1 else "the unit of each"


def _known(one: Mapping[str, Any]) -> bool:
    return bool(one["sd"] and _prior_sd(one) and not one.get("nuisance"))


def _prior_sd(one: Mapping[str, Any]) -> float | None:
    if one.get("prior_sd"):
        return float(one["prior_sd"])
    share, sd = one.get("from_data"), one.get("sd")
    if share is None or not sd or not 0 <= share < 1:
        return None
    return float(sd) / math.sqrt(1 - share)


def _centre(one: Mapping[str, Any]) -> float | None:
    if one.get("prior_mean") is not None:
        return float(one["prior_mean"])
    return 0.0 if one["name"].startswith(("mounting_error.", "table_axis_tilt.")) else None


def _ratio(one: Mapping[str, Any]) -> float:
    return one["sd"] / (_prior_sd(one) or math.inf)


def _colour(one: Mapping[str, Any]) -> str:
    # A tenth of the variance from the data is 5 % off the standard deviation.
    return VERMILION if _ratio(one) ** 2 > 0.9 else BLUE


def _legend(figure: Picture, right: float, top: float) -> None:
    width, height = figure.get_size_inches()
    handles = [
        Patch(color=BAND, label="prior, ±1 sd"),
        Patch(color=BAND_WIDE, label="prior, ±2 sd"),
        Line2D([], [], marker="o", markerfacecolor="white", markeredgecolor=QUIET, linestyle="", label="before"),
        Line2D([], [], marker="o", color=BLUE, linestyle="", markersize=5, label="after"),
        Line2D([], [], marker="o", color=VERMILION, linestyle="", markersize=5, label="not determined"),
    ]
    figure.legend(
        handles=handles, loc="upper right", bbox_to_anchor=(1 - 0.2 / width, 1 - 0.02 / height), ncols=5,
        handlelength=1.2, columnspacing=1.2, borderaxespad=0.6,
    )  # fmt: skip


__all__ = ["mounting_quantities", "prior_posterior_figure"]

"""Before and after the runs: the prior and the posterior of chosen quantities, mounting angles above all."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from imubayes.report.display import pretty, shortened
from imubayes.report.rounding import concise, significant
from imubayes.report.sheets import alarm_of
from imubayes.report.theme import (
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

_MOST = 40
_FAMILIES = ("mounting_error.", "mounting_angle[")
_ON_PAPER = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0}
_CAPTION = (
    "Left: the posterior with its 95 % interval, in prior standard deviations from the prior's centre; an estimate "
    "beyond the bands says that the equipment is worse than stated, or the model is wrong (where the prior has no one "
    "centre, the estimate stands as a number). Right: standard uncertainty before the runs (open) and after (filled), "
    "on a logarithmic axis. Of a good set of runs every line is long; a short one, in vermilion, is a quantity that "
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
    height = len(chosen) * 0.24 + 0.85
    title = "Mounting, before and after the runs" if names is None else "Prior and posterior"
    figure = picture(12.0, height, title, caption, alarm=alarm_of(summary))
    left, bottom, right, top = figure.inside
    tall = height - 0.85
    centred = [_centre(one) is not None for one in chosen]
    inner = right - left - 2.35 - 1.3
    share = 0.45 if any(centred) else 0.0
    second = axes_at(
        figure, left + 2.35 + share * inner + (0.35 if share else 0), bottom + 0.5, (1 - share) * inner - 0.35, tall
    )
    axes_left = second
    if any(centred):
        first = axes_at(figure, left + 2.35, bottom + 0.5, share * inner, tall)
        _shifts(first, chosen)
        axes_left = first
        second.tick_params(labelleft=False)
    unit = _widths(second, chosen)
    second.set_xlabel(f"standard uncertainty / {unit}")
    axes_left.set_yticks(range(len(chosen)), [shortened(one["name"], 34) for one in chosen])
    for axes in {axes_left, second}:
        axes.set_ylim(len(chosen) - 0.4, -0.6)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
    _legend(figure, right, top)
    return figure


def _shifts(axes: Axes, chosen: Sequence[Mapping[str, Any]]) -> None:
    axes.axvspan(-2, 2, color=BAND_WIDE, linewidth=0)
    axes.axvspan(-1, 1, color=BAND, linewidth=0)
    axes.axvline(0, color=QUIET, linewidth=0.7)
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
        axes.plot([low, high], [place, place], color=colour, linewidth=2.0, solid_capstyle="butt")
        axes.plot([middle], [place], "o", color=colour, markersize=4.5, markeredgewidth=0)
    axes.set_xlim(-reach, reach)
    axes.set_xlabel("estimate / prior standard deviations")
    axes.set_yticks(range(len(chosen)), [""] * len(chosen))


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
        axes.plot([after, before], [place, place], color=colour, linewidth=1.0, alpha=0.6)
        axes.plot(
            [before], [place], "o", markerfacecolor="white", markeredgecolor=QUIET, markersize=5, markeredgewidth=1.0
        )
        axes.plot([after], [place], "o", color=colour, markersize=5, markeredgewidth=0)
        text = f"{significant(before, 2)} → {significant(after, 2)}" + ("" if angles else f" {pretty(one['unit'])}")
        axes.text(1.015, place, text, transform=axes.get_yaxis_transform(), size=8, va="center", ha="left")
    finite = np.array([size for size in sizes if np.isfinite(size) and size > 0])
    axes.set_xlim(finite.min() / 1.6, finite.max() * 1.6)
    axes.text(1.015, -1.0, "before → after", transform=axes.get_yaxis_transform(), size=SMALL, color=QUIET, va="center")
    axes.grid(axis="x", color=FAINT, linewidth=0.6)
    axes.set_axisbelow(True)
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

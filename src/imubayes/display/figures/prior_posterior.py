"""Figures of estimates: prior and posterior of chosen quantities, and bias and scale factor over temperature.

Prior and posterior, of mounting angles above all, are estimate and standard uncertainty: a forest plot out of the
summary alone; densities as in `arviz_plots.plot_prior_posterior` would need a panel for each.  Bias and scale factor of
every channel are drawn over the temperatures of its runs, as the fit knows them.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from imubayes.display import figure_style as style
from imubayes.display.figures.panels import set_decades, thinned
from imubayes.display.fit_cautions import alarm_in_picture
from imubayes.display.numbers_and_labels import concise, pretty, significant
from imubayes.display.quantity_tables import is_nuisance
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.quantity_names import name_of
from imubayes.results.summary import Quantity, Summary, in_output_units
from imubayes.results.temperature_range import ThermalModel, course_over_range, depends_on_temperature

_MOST = 40
_NAMES, _NUMBERS = 2.35, 1.3  # room for the names on the left and the numbers on the right, inches
_FAMILIES = ("mounting_error.", "mounting_angle[")
_DETERMINED = 0.95  # largest ratio of posterior to prior sd of a quantity that the data determined
_ARCSEC = {"deg": 3600.0, "arcmin": 60.0, "arcsec": 1.0}
_ON_PAPER = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0}
_CAPTION = (
    "Left: posterior mean and 95 % interval in prior standard deviations; an estimate outside the bands means that the "
    "equipment is worse than stated or that the model is wrong (if the prior has no single centre, the estimate is "
    "given as a number). Right: standard uncertainty before (open) and after the runs (filled), logarithmic axis. With "
    "a good set of runs every line is long; a short one, in vermilion, is a quantity that the data did not determine."
)


def mounting_quantities(summary: Summary) -> list[str]:
    """Return the names of mounting errors and mounting angles whose prior and posterior widths are known."""
    entries = (*summary.parameters, *summary.derived)
    return [entry.name for entry in entries if entry.name.startswith(_FAMILIES) and _is_known(entry)]


@style.themed
def prior_posterior_figure(summary: Summary, names: Sequence[str] | None = None) -> style.Picture:
    """Return prior against posterior; without names those of the mountings, the least determined if they are many.

    The prior of an error is centred on 0; without a centre the left panel gives the estimate as a number.
    """
    chosen, caption = _chosen(summary, names)
    title = "Mounting: prior and posterior" if names is None else "Prior and posterior"
    figure = style.picture(12.0, len(chosen) * 0.24 + 0.85, title, caption, alarm=alarm_in_picture(summary))
    centred = any(map(_is_centred, chosen))
    widths = (0.45, 0.55) if centred else (1.0,)
    grid = style.panels(figure, 1, len(widths), (_NAMES, 0.5, _NUMBERS, 0.3), (0.35, 0), widths=widths)[0]
    if centred:
        _shifts(grid[0], chosen)
    _widths(grid[-1], chosen)
    for axes in grid:
        axes.set(ylim=(len(chosen) - 0.4, -0.6), yticks=[])
        axes.spines["left"].set_visible(False)
    style.name_rows(grid[0], [entry.name for entry in chosen])
    bands = (Patch(color=style.BAND, label="prior, ±1 sd"), Patch(color=style.BAND_WIDE, label="prior, ±2 sd"))
    before = style.dot(style.QUIET, "before", markerfacecolor="white", markeredgewidth=1.0)
    style.legend_above(
        figure, [*bands, before, style.dot(style.BLUE, "after"), style.dot(style.VERMILION, "not determined")]
    )
    return figure


def _chosen(summary: Summary, names: Sequence[str] | None) -> tuple[list[Quantity], str]:
    """Return the quantities to draw, at most `_MOST`, in order, and the caption."""
    entries = {entry.name: entry for entry in (*in_output_units(summary).parameters, *summary.derived)}
    wanted = [name for name in (names or mounting_quantities(summary)) if name in entries and _is_known(entries[name])]
    if not wanted:
        raise ValueError("no quantity with a prior and a posterior width was named")
    chosen: list[Quantity] = [entries[name] for name in wanted]
    if len(chosen) <= _MOST:
        return chosen, _CAPTION
    kept = sorted(chosen, key=_ratio, reverse=True)[:_MOST]
    caption = f"{_CAPTION} Shown: the {_MOST} least determined of {len(chosen)}."
    return [entry for entry in chosen if entry in kept], caption


def _shifts(axes: Axes, chosen: Sequence[Quantity]) -> None:
    for half, colour in ((2.0, style.BAND_WIDE), (1.0, style.BAND)):
        axes.axvspan(-half, half, color=colour, linewidth=0)
    axes.axvline(0, color=style.QUIET, linewidth=0.7)
    reach = 3.0
    for place, entry in enumerate(chosen):
        if not _is_centred(entry):
            text = f"{concise(_number(entry.mean), _number(entry.sd))} {pretty(entry.unit)}"
            axes.text(0, place, text, size=style.SMALL, color=style.QUIET, ha="center", va="center", bbox=_ON_PAPER)
            continue
        prior = _number(entry.prior_sd)
        low, middle, high = (_number(value) / prior for value in (entry.q025, entry.mean, entry.q975))
        reach = max(reach, 1.08 * abs(low), 1.08 * abs(high))
        axes.plot([low, high], [place, place], color=_colour(entry), linewidth=2.0, solid_capstyle="butt")
        axes.plot([middle], [place], "o", color=_colour(entry), markersize=4.5)
    axes.set(xlim=(-reach, reach), xlabel="estimate / prior standard deviations")


def _widths(axes: Axes, chosen: Sequence[Quantity]) -> None:
    """Draw uncertainty before and after, in one unit for all if they share a dimension."""
    units = {entry.unit for entry in chosen}
    angles = units <= set(_ARCSEC)
    unit = "arcsec" if angles else (pretty(next(iter(units))) if len(units) == 1 else "unit of each")
    beside: dict[str, Any] = {"transform": axes.get_yaxis_transform(), "size": style.SMALL, "va": "center"}
    sizes: list[float] = []
    for place, entry in enumerate(chosen):
        scale = _ARCSEC[entry.unit] if angles else 1.0
        before, after = _number(entry.prior_sd) * scale, _number(entry.sd) * scale
        sizes += [before, after]
        axes.plot([after, before], [place, place], color=_colour(entry), linewidth=1.0, alpha=0.6)
        axes.plot([before], [place], "o", color="white", markeredgecolor=style.QUIET, markeredgewidth=1.0, markersize=5)
        axes.plot([after], [place], "o", color=_colour(entry), markersize=5)
        text = f"{significant(before, 2)} → {significant(after, 2)}" + ("" if angles else f" {pretty(entry.unit)}")
        axes.text(1.015, place, text, **beside)
    axes.text(1.015, -1.0, "before → after", color=style.QUIET, **beside)
    axes.set(xscale="log", xlim=(min(sizes) / 1.6, max(sizes) * 1.6), xlabel=f"standard uncertainty / {unit}")
    set_decades(axes.xaxis)
    axes.grid(axis="x")


def _is_known(entry: Quantity) -> bool:
    return bool(entry.sd and entry.prior_sd and entry.mean is not None and not is_nuisance(entry))


def _is_centred(entry: Quantity) -> bool:
    return entry.name.startswith(("mounting_error.", "table_axis_tilt."))


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _ratio(entry: Quantity) -> float:
    return _number(entry.sd) / (entry.prior_sd or math.inf)


def _colour(entry: Quantity) -> str:
    return style.VERMILION if _ratio(entry) > _DETERMINED else style.BLUE


_OVER_TEMPERATURE = {
    "gyro": ("gyro_bias.bias", "gyro_scale_factor.scale"),
    "accelerometer": ("accel_bias.bias", "accel_scale_factor.scale"),
}
_WORDS = ("bias", "scale factor error")
_LEAST_SPAN = 1.0  # °C
_CURVE_CAPTION = (
    "Line: posterior mean over the temperatures at which the unit was recorded; band: 95 % interval (equal-tailed), "
    "often narrower than the line. Marks at the lower edge: mean temperatures of the runs. The band of a good campaign "
    "is narrow beside the change over temperature; where it opens, a run at that temperature would be the most "
    "informative."
)


@dataclass(frozen=True)
class ThermalCourse:
    """One quantity of a channel over temperature: draws (S, T) at temperatures (T,), and its unit."""

    quantity: str
    unit: str
    temperature: np.ndarray
    values: np.ndarray


def thermal_courses(
    campaign: Campaign, draws: Mapping[str, np.ndarray], thermal: ThermalModel
) -> dict[str, list[ThermalCourse | None]]:
    """Return bias and scale factor of the channels with thermal terms, by channel; None for what has no parameter."""
    low, high = _span(campaign)
    if not high - low > _LEAST_SPAN:
        return {}
    found: dict[str, list[ThermalCourse | None]] = {}
    for channel in campaign.channels:
        names = [name_of(family, channel.name) for family in _OVER_TEMPERATURE.get(channel.kind, ())]
        if any(name in draws and depends_on_temperature(name, draws) for name in names):
            found[channel.name] = [_course(name, draws, thermal, (low, high)) for name in names]
    return dict(list(found.items())[: style.MOST_PANELS])


def _course(
    name: str, draws: Mapping[str, np.ndarray], thermal: ThermalModel, span: tuple[float, float]
) -> ThermalCourse | None:
    if name not in draws:
        return None
    kept = thinned(len(draws[name]))
    own = {key: value[kept] for key, value in draws.items() if key == name or key in thermal.units}
    return ThermalCourse(name, thermal.units[name], *course_over_range(name, thermal.units[name], own, thermal, span))


@style.themed
def temperature_figure(campaign: Campaign, courses: Mapping[str, Sequence[ThermalCourse | None]]) -> style.Picture:
    """Return bias and scale factor error over temperature: a row per channel with thermal terms."""
    height = max(len(courses) * 1.5 + 0.35, 2.6)
    figure = style.picture(11.5, height, "Bias and scale factor over temperature", _CURVE_CAPTION)
    grid = style.panels(figure, len(courses), 2, (0.95, 0.5, 0.1, 0.2), (1.1, 0.36), share_x=True)
    marks = [float(each.mean()) for each in _recorded(campaign) if each.size]
    for row, (channel, pair) in zip(grid, courses.items(), strict=True):
        for axes, course, word in zip(row, pair, _WORDS, strict=True):
            axes.set_title(f"{channel}: {word}")
            _panel(axes, course)
            axes.plot(
                marks, [0.03] * len(marks), "|", color=style.INK, markeredgewidth=1.0, markersize=7,
                transform=axes.get_xaxis_transform(),
            )  # fmt: skip
    for axes in grid[-1]:
        axes.xaxis.set_visible(True)
        axes.set_xlabel("temperature / °C")
    return figure


def _panel(axes: Axes, course: ThermalCourse | None) -> None:
    if course is None:
        axes.set_yticks([])
        axes.text(0.5, 0.5, "not in the model", color=style.QUIET, ha="center", va="center", transform=axes.transAxes)
        return
    low, high = np.quantile(course.values, (0.025, 0.975), axis=0)
    axes.fill_between(course.temperature, low, high, color=style.BAND, linewidth=0)
    axes.plot(course.temperature, course.values.mean(axis=0), color=style.BLUE, linewidth=1.2)
    sd, unit = course.values.std(axis=0), pretty(course.unit)
    ends = " … ".join(dict.fromkeys(significant(float(end), 2) for end in (sd.min(), sd.max())))
    axes.set_title(f"sd {ends} {unit}", loc="right", weight="normal", color=style.QUIET, size=style.SMALL)
    axes.set_ylabel(unit)


def _recorded(campaign: Campaign) -> list[np.ndarray]:
    known = [run.covariates.get("temperature", np.empty(0)) for run in campaign.runs]
    return [each[np.isfinite(each)] for each in known]


def _span(campaign: Campaign) -> tuple[float, float]:
    """Return the lowest and highest temperature recorded, °C; (0, 0) if none is."""
    found = np.concatenate([np.empty(0), *_recorded(campaign)])
    return (float(found.min()), float(found.max())) if found.size else (0.0, 0.0)

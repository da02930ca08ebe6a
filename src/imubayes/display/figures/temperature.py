"""Bias and scale factor of every channel over the temperatures of its runs, as the fit knows them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from imubayes.display import figure_style as style
from imubayes.display.figures.panels import thinned
from imubayes.display.numbers_and_labels import pretty, significant
from imubayes.foundations.campaign_data import Campaign
from imubayes.qualification.temperature_range import ThermalModel, course_over_range, depends_on_temperature

_OVER_TEMPERATURE = {
    "gyro": ("gyro_bias.bias", "gyro_scale_factor.scale"),
    "accelerometer": ("accel_bias.bias", "accel_scale_factor.scale"),
}
_WORDS = ("bias", "scale factor error")
_LEAST_SPAN = 1.0  # °C
_CURVE_CAPTION = (
    "Line: posterior mean over the temperatures at which the unit was recorded; band: 95 % interval (equal-tailed), "
    "often narrower than the line. Marks at the lower edge: mean temperatures of the runs. The band of a good campaign "
    "is narrow beside the change over temperature; where it opens, a run at that temperature would tell most."
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
        names = [f"{family}[{channel.name}]" for family in _OVER_TEMPERATURE.get(channel.kind, ())]
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
    """Return the lowest and highest temperature recorded, °C; (0, 0) where none is."""
    found = np.concatenate([np.empty(0), *_recorded(campaign)])
    return (float(found.min()), float(found.max())) if found.size else (0.0, 0.0)

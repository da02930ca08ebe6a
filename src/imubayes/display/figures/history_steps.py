"""How the error of each channel fell from model to model."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used
from matplotlib.axes import Axes

from imubayes.display.figure_style import FAINT, HUES, SMALL, Picture, panels, picture, themed
from imubayes.display.numbers_and_labels import pretty, readable, significant

_BAR = 0.16
"""Half the length of a bar, in steps."""
_NOTICEABLE = 0.03
"""Relative change of residual or noise from which on a channel has a hue."""


@dataclass(frozen=True)
class ChannelSteps:
    """A channel through the models of a path.

    Attributes
    ----------
    channel, unit : its name and input unit.
    rms : residual rms of each model, NaN where it is unknown.
    noise : standard deviation of the residual that is known beforehand with each model, NaN where it is unknown.
    """

    channel: str
    unit: str
    rms: Sequence[float]
    noise: Sequence[float]

    @property
    def changed(self) -> bool:
        """Whether a step changed residual or known noise noticeably."""
        sizes = [np.asarray(each, dtype=float) for each in (self.rms, self.noise)]
        known = [size[np.isfinite(size)] for size in sizes]
        return any(size.size > 1 and np.ptp(size) > _NOTICEABLE * size.max() for size in known)


@themed
def error_per_step_figure(steps: Sequence[str], channels: Sequence[ChannelSteps]) -> Picture:
    """Return residual rms and known noise of every channel, model by model.

    Parameters
    ----------
    steps : what each step added; the first is the model it began with.
    channels : of the path; those that a step changed have a hue.
    """
    caption = (
        "Line: residual rms of a channel over all rows and runs; short bar: its noise known beforehand, run offsets "
        "included. The addition of a missing effect lowers the line; that of a noise component moves the bar alone. "
        "In a good last model line and bar meet. Grey: channels that no step changed by more than "
        f"{100 * _NOTICEABLE:.0f} %."
    )
    units = list(dict.fromkeys(each.unit for each in channels))
    figure = picture(max(6.5, 5.2 * len(units) + 0.6), 3.3, "Residual error by step", caption)
    grid = panels(figure, 1, max(len(units), 1), (0.75, 0.55, 0.75, 0.25), (1.35, 0.36))[0]
    for axes, unit in zip(grid, units, strict=False):
        own = [each for each in channels if each.unit == unit]
        factor, shown = readable(unit, max(float(np.nanmax(each.rms)) for each in own))
        _lines(axes, own, factor)
        room = max(9, int(figure.get_figwidth() / len(units) / len(steps) * 9))
        axes.set_xticks(range(len(steps)), [_folded(step.replace("+ ", "+"), room) for step in steps])
        axes.tick_params(axis="x", length=0)
        axes.set_ylabel(f"rms residual / {pretty(shown)}")
    return figure


def _lines(axes: Axes, channels: Sequence[ChannelSteps], factor: float) -> None:
    """Draw the channels of one unit, those that changed with hue and name."""
    changed = [each for each in channels if each.changed][: len(HUES)]
    for each in sorted(channels, key=lambda each: each in changed):
        hue = HUES[changed.index(each)] if each in changed else FAINT
        rms, noise = (np.asarray(sizes, dtype=float) * factor for sizes in (each.rms, each.noise))
        axes.plot(rms, "o-", color=hue, linewidth=1.4, markersize=5, zorder=3 if each in changed else 1.5)
        if each not in changed:
            continue
        places = np.arange(len(noise), dtype=float)
        axes.hlines(noise, places - _BAR, places + _BAR, hue, linewidth=2.2, alpha=0.55, zorder=2.5)
    most = max(float(np.nanmax([*each.rms, *each.noise])) for each in channels) * factor
    axes.set(xlim=(-0.55, len(channels[0].rms) - 0.3), ylim=(0, 1.12 * most))
    for place in (0, len(channels[0].rms) - 1):
        _named(axes, changed, place, factor)


def _named(axes: Axes, changed: Sequence[ChannelSteps], place: int, factor: float) -> None:
    """Write the residuals of one model beside its bars, with the channels' names beside the last model."""
    known = [(each, float(each.rms[place]) * factor) for each in changed if np.isfinite(each.rms[place])]
    points = axes.get_window_extent().height * 72 / axes.figure.dpi
    heights = spread_apart([value for _, value in known], 1.2 * SMALL * axes.get_ylim()[1] / points)
    for (each, value), at in zip(known, heights, strict=True):
        label = significant(value) + (f"  {each.channel}" if place else "")
        x, side = (place + 1.2 * _BAR, "left") if place else (place - 1.2 * _BAR, "right")
        axes.text(x, at, label, size=SMALL, va="center", ha=side, color=HUES[changed.index(each)])


def spread_apart(values: Sequence[float], least: float) -> list[float]:
    """Return heights close to values, in their order and at least `least` apart, none below half of that."""
    if not values:
        return []
    order = np.argsort(values, kind="stable")
    places = np.arange(len(values)) * least
    # Without the distances asked for the heights only have to rise: the least-squares fit is isotonic.
    free = scipy.optimize.isotonic_regression(np.asarray(values, dtype=float)[order] - places).x
    heights = np.empty(len(values))
    heights[order] = np.maximum(free, 0.5 * least) + places
    return heights.tolist()


def _folded(name: str, room: int) -> str:
    """Return a name on several lines, broken at its underscores."""
    lines = [""]
    for part in name.replace(" ", " \0").replace("_", "_\0").split("\0"):
        if lines[-1] and len(lines[-1]) + len(part) > room:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines[:4])

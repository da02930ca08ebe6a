"""Ticks of the panels: few, round, plain numbers.

A page of twelve panels spends five sixths of its time on matplotlib's tick objects, of which each is five artists.
Here the marks of an axis are one artist and the labels are text, placed once, for the limits the panel has.
"""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, MultipleLocator, NullLocator
from matplotlib.transforms import ScaledTranslation

from imubayes.display.marks import points
from imubayes.display.theme import INK, QUIET, SMALL, TEXT

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_AWAY = 4.5  # points between frame and label


def frame(
    axes: Axes,
    x: int = 5,
    y: int = 4,
    x_label: str | None = "",
    y_label: str | None = "",
    label_size: float = TEXT,
    inset: float = 0.0,
    turns: bool = False,
) -> None:
    """Give a panel ticks and labels for the limits and scales it has; to be called last.

    Parameters
    ----------
    x, y : about how many ticks, 0 for none.
    x_label, y_label : below and beside the numbers; None leaves out the numbers too.
    label_size : points.
    inset : share of the panel at both ends without ticks, where the numbers of panels side by side would touch.
    turns : whether x is an angle in degrees, which is counted in eighths of a turn.
    """
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(NullLocator())
        axis.set_minor_locator(NullLocator())
    figure = axes.get_figure(root=True)
    assert figure is not None
    widest = 0
    if x:
        places = tick_places(*axes.get_xlim(), x, _threshold(axes.xaxis), inset, turns)
        along = axes.get_xaxis_transform()
        points(axes, places, np.zeros(len(places)), 3, 3, QUIET, markeredgewidth=0.7, transform=along, clip_on=False)
        away = along + ScaledTranslation(0, -_AWAY / 72, figure.dpi_scale_trans)
        for place, text in zip(places, tick_texts(places), strict=True) if x_label is not None else ():
            axes.text(place, 0, text, size=SMALL, color=INK, ha="center", va="top", transform=away)
    if y:
        places = tick_places(*axes.get_ylim(), y, _threshold(axes.yaxis), inset)
        along = axes.get_yaxis_transform()
        points(axes, np.zeros(len(places)), places, 0, 3, QUIET, markeredgewidth=0.7, transform=along, clip_on=False)
        away = along + ScaledTranslation(-_AWAY / 72, 0, figure.dpi_scale_trans)
        texts = tick_texts(places) if y_label is not None else []
        for place, text in zip(places, texts, strict=bool(texts)):
            axes.text(0, place, text, size=SMALL, color=INK, ha="right", va="center_baseline", transform=away)
        widest = max((len(text) for text in texts), default=0)
    # Labels at given places: matplotlib would measure every text of the axis to find them.
    below = _AWAY + 3 + SMALL if x else 3
    beside = _AWAY + 5 + max(4, widest) * 0.64 * SMALL if y else 3
    whole = axes.transAxes
    axes.xaxis.set_label_coords(0.5, 0, whole + ScaledTranslation(0, -below / 72, figure.dpi_scale_trans))
    axes.yaxis.set_label_coords(0, 0.5, whole + ScaledTranslation(-beside / 72, 0, figure.dpi_scale_trans))
    if x_label:
        axes.set_xlabel(x_label, size=label_size)
    if y_label:
        axes.set_ylabel(y_label, size=label_size)


def tick_places(
    low: float, high: float, most: int, threshold: float | None = None, inset: float = 0.0, turns: bool = False
) -> list[float]:
    """Return round numbers between two limits: evenly spaced, or decades of a symmetric logarithmic scale.

    Parameters
    ----------
    threshold : below it a logarithmic scale is linear; 0 where it is logarithmic throughout, None where linear.
    inset : share of the range at both ends that stays free.
    turns : whether a range of a quarter turn and more is counted in eighths of a turn.
    """
    if threshold == 0:
        return _log_places(low, high, most)
    if threshold is None:
        margin = (1e-9 - inset) * (high - low)
        locator = MaxNLocator(most, steps=[1, 2, 2.5, 5, 10])
        if turns and high - low >= 90:
            step = next((s for s in (45, 90, 180, 360) if (high - low) / s <= most), 720)
            locator = MultipleLocator(step)
        found = locator.tick_values(low, high)
        return [float(place) for place in found if low - margin <= place <= high + margin]
    first = round(math.log10(threshold))
    last = math.floor(math.log10(max(abs(low), abs(high))) + 1e-9)
    sides = (low < -threshold) + (high > threshold)
    stride = max(1, math.ceil((last - first + 1) * sides / max(most - 1, 1)))
    decades = [10.0**power for power in range(last, first - 1, -stride)]
    found = sorted({0.0, *decades, *(-decade for decade in decades)})
    return [place for place in found if low <= place <= high]


def tick_texts(places: Sequence[float]) -> list[str]:
    """Return numbers as short as their spacing allows, all with the same decimals unless they are decades."""
    sizes = [abs(place) for place in places if place]
    if not sizes:
        return ["0" for _ in places]
    gaps = np.diff(places)
    even = len(places) < 2 or np.allclose(gaps, gaps[0])
    if not even:
        return [_decade(place) for place in places]
    if max(sizes) >= 1e7 or max(sizes) < 1e-5:
        return [_signed(f"{place:.4g}".replace("e+0", "e").replace("e-0", "e-")) for place in places]
    step = float(gaps[0]) if len(places) > 1 else sizes[0]
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    # A step of 2.5 needs one decimal more than one of 2.
    decimals += not math.isclose(round(step, decimals), step, rel_tol=1e-6)
    return [_signed(f"{place:.{decimals}f}") for place in places]


def _decade(place: float) -> str:
    """Return 0.1, 1, … 1000 as they are and the larger ones as powers: 10⁴."""
    if place == 0 or 1e-4 < abs(place) < 5000:
        return _signed(f"{place:.6g}")
    power = math.floor(math.log10(abs(place)) + 1e-9)
    digit = round(abs(place) / 10.0**power)
    text = power_of_ten(power)
    return ("−" if place < 0 else "") + (text if digit == 1 else f"{digit}·{text}")


def power_of_ten(power: int) -> str:
    """Return a power of ten as print has it: 10⁻³."""
    return "10" + str(power).translate(_RAISED)


def _signed(text: str) -> str:
    if text.startswith("-") and float(text) == 0:
        return text[1:]
    return text.replace("-", "−")


def _log_places(low: float, high: float, most: int) -> list[float]:
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for digits in ((1, 2, 5), (1, 3), (1,)):
        found = [digit * 10.0**power for power in powers for digit in digits if low <= digit * 10.0**power <= high]
        if len(found) <= most:
            break
    return found[:: math.ceil(len(found) / most)]


def _threshold(axis) -> float | None:
    if axis.get_scale() == "log":
        return 0.0
    return axis.get_transform().linthresh if axis.get_scale() == "symlog" else None

"""Drawings of a unit for the qualification report: its errors, and the geometry of its mountings.

Errors are drawn against rate, angle and temperature, with limits, coverage band and what the model leaves.  Mountings
show if the sensitive axes point, and what was known of the angles before and after the calibration.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imubayes.display.figure_style import BAND, BAND_WIDE, BLUE, INK, MARKERS, QUIET, RED, SMALL
from imubayes.display.numbers_and_labels import pretty, readable
from imubayes_qualification.certificate import report_pictures
from imubayes_qualification.display.report.document import (
    WIDTH,
    Drawing,
    Drawings,
    drawn,
    hue,
    legend,
    line,
    place,
    title,
)

_NORMAL = 1.96
_ABSCISSAE = {
    "input_rate": "rate along the input axis",
    "input_angle": "angle of the input axis above the horizontal",
    "temperature": "temperature",
    "table_angle": "table angle",
}
_TITLES = {
    ("gyro", "input_rate"): "Gyros: error against rate",
    ("accelerometer", "input_angle"): "Accelerometers: error against angle",
    ("gyro", "temperature"): "Gyros: bias against temperature",
    ("accelerometer", "temperature"): "Accelerometers: bias against temperature",
    ("gyro", "table_angle"): "Gyros: residual against table angle",
    ("accelerometer", "table_angle"): "Accelerometers: residual against table angle",
}
CAPTION = (
    "Upper panels: error of the unit with its nominal constants (scale factor and bias together; bias alone against "
    "temperature), posterior mean with its 95 % coverage band, which is often narrower than the line. Red: limits of "
    "the specification, if it has them. A good unit stays between the red lines with its whole band. Lower "
    "panels: means of the residuals in classes of equal width, in units of their standard deviations. A "
    "good model leaves no trend: 95 % of the means lie in the grey band, and they change sign often."
)


def error_drawings(data: report_pictures.PictureData) -> Drawings | None:
    """Return the drawings of errors; None if there are none."""
    found = [_error_drawing(picture) for picture in data.errors]
    return Drawings(found, CAPTION) if found else None


def _error_drawing(picture: report_pictures.ErrorPicture) -> Drawing:
    both = bool(picture.curves)
    height = 3.5 if both else 2.2
    name = _TITLES[picture.kind, picture.abscissa]

    def draw(figure: Figure) -> None:
        title(figure, name)
        channels = list(dict.fromkeys(each.channel for each in (*picture.curves, *picture.residuals)))
        handles = [
            Line2D(
                [], [], color=hue(k), linestyle=line(k), marker=MARKERS[k % len(MARKERS)], markersize=3, label=channel
            )
            for k, channel in enumerate(channels)
        ]
        if picture.limits:
            handles.append(Line2D([], [], color=RED, linewidth=1.4, label="limit"))
        legend(figure, handles)
        below = place(figure, 0.72, 0.42, WIDTH - 0.82, 0.95 if both else 1.2)
        _residual_panel(below, picture.residuals, channels)
        below.set_xlabel(f"{_ABSCISSAE[picture.abscissa]} / {pretty(picture.x_unit)}")
        if both:
            above = place(figure, 0.72, 1.55, WIDTH - 0.82, 1.42)
            _curve_panel(above, picture, channels)
            above.set_xlim(below.get_xlim())
            above.tick_params(labelbottom=False)

    return drawn(f"{picture.kind}-{picture.abscissa}", name, height, draw)


def _curve_panel(axes: Axes, picture: report_pictures.ErrorPicture, channels: list[str]) -> None:
    sizes = [abs(value) for curve in picture.curves for value in curve.y]
    factor, unit = readable(picture.unit, max(sizes, default=0.0))
    axes.axhline(0, color=QUIET, linewidth=0.5)
    for curve in picture.curves:
        k = channels.index(curve.channel)
        x = np.array(curve.x)
        low, high = (factor * np.array(part) for part in (curve.low, curve.high))
        axes.fill_between(x, low, high, color=hue(k), alpha=0.3, linewidth=0)
        axes.plot(x, factor * np.array(curve.y), color=hue(k), linestyle=line(k))
    seen = set()
    for limit in picture.limits:
        for side in (limit.lower, limit.upper):
            if side is not None and (limit.x, side) not in seen:
                seen.add((limit.x, side))
                axes.plot(limit.x, factor * np.array(side), color=RED, linewidth=1.4)
    axes.set_ylabel(f"error / {pretty(unit)}")


def _residual_panel(axes: Axes, residuals: tuple[report_pictures.ResidualMeans, ...], channels: list[str]) -> None:
    axes.axhspan(-_NORMAL, _NORMAL, color=BAND_WIDE, zorder=0)
    axes.axhline(0, color=QUIET, linewidth=0.5)
    for means in residuals:
        k = channels.index(means.channel)
        size = np.array(means.mean) * np.sqrt(means.count)
        axes.plot(
            means.x, size, MARKERS[k % len(MARKERS)], color=hue(k), markersize=3, linestyle=line(k), linewidth=0.6
        )
    low, high = axes.get_ylim()
    reach = max(3.2, abs(low), abs(high))
    axes.set_ylim(-reach, reach)
    axes.set_ylabel("residual / sd")


def worst_drawing(worst: report_pictures.WorstResidual) -> Drawings:
    """Return the drawing of the class means that stand out most."""
    name = f"Largest residual: {worst.channel} against {worst.abscissa}"

    def draw(figure: Figure) -> None:
        title(figure, name)
        axes = place(figure, 0.72, 0.42, WIDTH - 0.82, 1.35)
        axes.axhspan(-worst.expected, worst.expected, color=BAND_WIDE, zorder=0)
        axes.axhspan(-_NORMAL, _NORMAL, color=BAND, zorder=0)
        axes.axhline(0, color=QUIET, linewidth=0.5)
        size = np.array(worst.means.mean) * np.sqrt(worst.means.count)
        axes.plot(worst.means.x, size, "o-", color=INK, markersize=3.5, linewidth=0.7)
        reach = 1.15 * max(worst.expected, worst.largest)
        axes.set_ylim(-reach, reach)
        unit = f" / {pretty(worst.unit)}" if worst.unit else ""
        axes.set_xlabel(worst.abscissa + unit)
        axes.set_ylabel("residual / sd")

    caption = (
        "Means of the residuals in classes, for the channel and covariate with the largest of "
        f"{worst.classes} such means, in units of their standard deviations. The largest is {worst.largest:.1f}; by "
        "chance alone the largest of so many exceeds "
        f"{worst.expected:.1f} (light band) in 5 % of all reports. Dark band: 95 % of single means. A good result "
        "stays within the light band and shows no trend."
    )
    return Drawings([drawn("worst-residual", name, 2.1, draw)], caption)


# Direction from which the axes are seen, and the largest deviation as drawn.
_VIEW = math.radians(35), math.radians(18)
_LARGEST = 14.0
_STEPS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000)
# An axis this close to the axis of rotation has no azimuth of its own: it is drawn tilted to the right.
_ALONG, _RIGHT = 1.0, 125.0
_MOST_AXES = 8
_GEOMETRY = (
    "Sensitive axes in the frame of the table; the axis of rotation points up (black). Dashed: nominal direction; "
    "solid: found direction, with the deviation of its angle to the axis of rotation exaggerated as stated. "
    "Azimuths are nominal. Below: nominal and found angle. In a good mounting every solid line is close to its dashed "
    "one at a large exaggeration; the deviation itself does no harm once it is known."
)
_DENSITIES = (
    "Deviation of the true mounting angle from its nominal value. Left: prior density, from the stated uncertainty of "
    "seat, sensitive axis and table, and the posterior as a vertical line. Right: posterior density about its mean, on "
    "a scale of its own. With a good set of runs the posterior is much narrower than the prior and lies within it; a "
    "posterior at the edge of its prior means that the fixture is worse than stated."
)


def mounting_drawings(data: report_pictures.PictureData) -> Drawings | None:
    """Return the geometry of every mounting; None if there is none."""
    return _by_mounting(_geometry, data.mountings, _GEOMETRY)


def _by_mounting[Drawn: (report_pictures.MountingPicture, report_pictures.AngleDensity)](
    draw: Callable[[str, Sequence[Drawn]], Drawing], parts: Sequence[Drawn], caption: str
) -> Drawings | None:
    """Return a drawing of the parts of each mounting; None if there are none."""
    names = dict.fromkeys(each.mounting for each in parts)
    found = [draw(name, [each for each in parts if each.mounting == name]) for name in names]
    return Drawings(found, caption) if found else None


def exaggeration(axes: Sequence[report_pictures.AxisInMounting]) -> int:
    """Return the factor by which deviations are drawn larger, so that the largest is visible and below 14°."""
    largest = max(abs(each.found - each.nominal) for each in axes)
    return max((step for step in _STEPS if step * largest <= _LARGEST), default=1)


def _geometry(mounting: str, pictures: Sequence[report_pictures.MountingPicture]) -> Drawing:
    shown = [axes for picture in pictures for axes in picture.axes]
    factor = exaggeration(shown)
    most = max(min(len(picture.axes), _MOST_AXES) for picture in pictures)
    below = 0.1 + 0.16 * most
    name = f"Mounting {mounting}: deviations × {factor}"

    def draw(figure: Figure) -> None:
        title(figure, name)
        half = (WIDTH - 0.2) / len(pictures)
        for k, picture in enumerate(pictures):
            axes = place(figure, 0.1 + k * half, below, half, 1.75)
            _panel(axes, picture, factor)
            lines = [f"{each.channel}: {each.nominal:.4f}° → {each.found:.4f}°" for each in picture.axes[:_MOST_AXES]]
            width, height = figure.get_size_inches()
            left, top = (0.25 + k * half) / width, (below - 0.02) / height
            figure.text(left, top, "\n".join(lines), va="top", size=SMALL, linespacing=1.35)

    return drawn(f"mounting-{_word(mounting)}", name, 2.05 + below, draw)


def _word(name: str) -> str:
    return "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in name)


def _panel(axes: Axes, picture: report_pictures.MountingPicture, factor: int) -> None:
    axes.set(xlim=(-1.3, 1.3), ylim=(-0.75, 1.35), aspect="equal")
    axes.set_axis_off()
    kind = "gyros" if picture.kind == "gyro" else "accelerometers"
    axes.text(-1.25, 1.3, kind, va="top", size=SMALL, color=QUIET)
    _arrow(axes, np.array([0.0, 1.22]), INK, "-", 1.4)
    ring = np.radians(np.linspace(0, 360, 73))
    circle = np.stack([_seen(angle, math.pi / 2) for angle in ring])
    axes.plot(circle[:, 0], circle[:, 1], color=BAND, linewidth=0.7)
    for k, each in enumerate(picture.axes[:_MOST_AXES]):
        azimuth = math.radians(_RIGHT if each.nominal < _ALONG else each.azimuth)
        nominal = _seen(azimuth, math.radians(each.nominal))
        found = _seen(azimuth, math.radians(each.nominal + factor * (each.found - each.nominal)))
        _arrow(axes, nominal, hue(k), (0, (3, 2)), 0.9)
        _arrow(axes, found, hue(k), "-", 1.6)
        side = "left" if found[0] >= -0.05 else "right"
        axes.text(found[0] * 1.08 + (0.04 if side == "left" else -0.04), found[1] * 1.08, each.channel,
                  color=hue(k), ha=side, va="center", size=SMALL, weight="bold")  # fmt: skip


def _seen(azimuth: float, angle: float) -> np.ndarray:
    """Return where a unit vector at an azimuth and an angle to the vertical is seen, (2,)."""
    x, y, z = math.sin(angle) * math.cos(azimuth), math.sin(angle) * math.sin(azimuth), math.cos(angle)
    turn, lift = _VIEW
    toward = math.cos(turn) * x + math.sin(turn) * y
    return np.array([-math.sin(turn) * x + math.cos(turn) * y, math.cos(lift) * z - math.sin(lift) * toward])


def _arrow(axes: Axes, tip: np.ndarray, colour: str, style: object, width: float) -> None:
    axes.plot([0, tip[0]], [0, tip[1]], color=colour, linestyle=style, linewidth=width)


def angle_drawings(data: report_pictures.PictureData) -> Drawings | None:
    """Return prior against posterior of the mounting angles, one drawing per mounting; None if there are none."""
    return _by_mounting(_densities, data.angles, _DENSITIES)


def _densities(mounting: str, angles: Sequence[report_pictures.AngleDensity]) -> Drawing:
    name = f"Mounting {mounting}: prior and posterior of the angles"
    widest = max(max(map(abs, each.prior_x)) for each in angles)
    factor, unit = (1 / 60, "arcmin") if widest > 120 else (1.0, "arcsec")
    centred = [np.array(each.posterior_x) - _mean(each) for each in angles]
    fine, fine_unit = readable("deg", max(float(np.abs(x).max()) for x in centred) / 3600)
    fine /= 3600
    rows = len(angles)

    def draw(figure: Figure) -> None:
        title(figure, name)
        height = 0.36 * rows
        left, right = place(figure, 0.55, 0.42, 1.72, height), place(figure, 2.5, 0.42, 1.72, height)
        for k, each in enumerate(angles):
            row = rows - 1 - k
            _ridge(left, factor * np.array(each.prior_x), np.array(each.prior), row, BAND, QUIET)
            left.plot([factor * _mean(each)] * 2, [row, row + 0.85], color=BLUE, linewidth=1.6)
            _ridge(right, fine * centred[k], np.array(each.posterior), row, BLUE, BLUE)
        for axes in (left, right):
            axes.set(ylim=(-0.1, rows), yticks=[])
            axes.spines["left"].set_visible(False)
        left.set_yticks([rows - 0.7 - k for k in range(rows)], [each.channel for each in angles])
        left.tick_params(axis="y", length=0)
        left.set_xlabel(f"from nominal / {unit}")
        right.set_xlabel(f"from the estimate / {fine_unit}")

    return drawn(f"angle-{_word(mounting)}", name, 0.75 + 0.36 * rows, draw)


def _mean(found: report_pictures.AngleDensity) -> float:
    x, weight = np.array(found.posterior_x), np.array(found.posterior)
    return float(np.sum(x * weight) / np.sum(weight))


def _ridge(axes: Axes, x: np.ndarray, density: np.ndarray, row: int, fill: str, edge: str) -> None:
    shape = row + 0.8 * density / density.max()
    axes.fill_between(x, row, shape, color=fill, alpha=0.5, linewidth=0)
    axes.plot(x, shape, color=edge, linewidth=0.8)

"""Drawings of errors against rate, angle and temperature, with limits, coverage band and what the model leaves."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from imubayes.display.labels import pretty, readable
from imubayes.display.qualification.document import Drawing, Drawings
from imubayes.display.qualification.svg_drawing import WIDTH, drawn, hue, legend, line, place, title
from imubayes.display.run_signs import MARKERS
from imubayes.display.theme import BAND, BAND_WIDE, INK, QUIET, RED
from imubayes.qualification.report_pictures import ErrorPicture, PictureData, ResidualMeans, WorstResidual

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
    "the specification, where it has them. A good unit stays between the red lines with its whole band. Lower "
    "panels: what the model leaves, as means of residuals in classes of equal width, in their standard deviations. A "
    "good model leaves no trend: 95 % of the means lie in the grey band, and they change sign often."
)


def error_drawings(data: PictureData) -> Drawings | None:
    """Return the drawings of errors; None where there are none."""
    found = [_error_drawing(picture) for picture in data.errors]
    return Drawings(found, CAPTION) if found else None


def _error_drawing(picture: ErrorPicture) -> Drawing:
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


def _curve_panel(axes: Axes, picture: ErrorPicture, channels: list[str]) -> None:
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


def _residual_panel(axes: Axes, residuals: tuple[ResidualMeans, ...], channels: list[str]) -> None:
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


def worst_drawing(worst: WorstResidual) -> Drawings:
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
        f"The class means that stand out most, of {worst.classes} means over all channels and covariates, in their "
        f"standard deviations. The largest is {worst.largest:.1f}; by chance alone the largest of so many exceeds "
        f"{worst.expected:.1f} (light band) in 5 % of all reports. Dark band: 95 % of single means. A good result "
        "stays within the light band and shows no trend."
    )
    return Drawings([drawn("worst-residual", name, 2.1, draw)], caption)

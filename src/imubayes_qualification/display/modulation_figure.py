"""Picture of a run with rotation modulation: the biases as seen by the carrier, and their cumulative mean."""

import numpy as np
from matplotlib.axes import Axes

from imubayes.display import figure_style as style
from imubayes.display.numbers_and_labels import pretty, readable

_CAPTION = (
    "Left: the biases of the unit as seen by the carrier, across the axis of rotation (with the effect of a mounting "
    "error). Points: single rows, on a circle; line: cumulative mean, which spirals to the centre. Right: length of "
    "that mean, its expected value, and the mean along the axis, which rotation does not modulate. A good run ends on "
    "a whole turn."
)


@style.themed
def modulation_figure(
    turns: np.ndarray,
    across: np.ndarray,
    mean: np.ndarray,
    along: np.ndarray,
    expected: np.ndarray,
    unit: str,
    run: str,
) -> style.Picture:
    """Return the rotating bias vector, and its cumulative mean.

    Parameters
    ----------
    turns : shape (R,), turns up to the end of each row.
    across : shape (R, 2), biases across the axis as seen by the carrier, in `unit`.
    mean : shape (R, 2), their cumulative mean.
    along : shape (R,), cumulative mean along the axis.
    expected : shape (R,), expected length of `mean`.
    """
    factor, shown = readable(unit, float(np.hypot(*across.T).max()))
    across, mean, along, expected = across * factor, mean * factor, along * factor, expected * factor
    figure = style.picture(9.2, 3.6, f"Rotation modulation: {run}", _CAPTION)
    circle, course = style.panels(figure, 1, 2, (0.75, 0.5, 0.1, 0.1), (1.0, 0), widths=(3.0, 3.75))[0]
    _draw_circle(circle, across, mean, pretty(shown))
    length = np.hypot(*mean.T)
    course.plot(turns, np.abs(along), "--", color=style.QUIET, label=f"along the axis, {abs(along[-1]):.3g}")
    course.plot(
        turns, length, color=style.VERMILION, linewidth=1.4, label=f"across the axis, {length[-1]:.3g}", zorder=3
    )
    course.plot(turns, expected, color=style.BLUE, linewidth=1.0, label="across the axis, expected")
    highest = 1.15 * max(float(length.max()), float(np.abs(along).max()))
    course.set(xlim=(0, turns[-1]), ylim=(0, highest), xlabel="turns", ylabel=f"cumulative mean / {pretty(shown)}")
    course.legend(loc="upper right", fontsize=style.SMALL)
    return figure


def _draw_circle(axes: Axes, across: np.ndarray, mean: np.ndarray, unit: str) -> None:
    axes.axhline(0, color=style.FAINT, linewidth=0.7)
    axes.axvline(0, color=style.FAINT, linewidth=0.7)
    axes.plot(*across.T, "o", color=style.BLUE, markersize=3, alpha=0.55)
    axes.plot(*mean.T, color=style.VERMILION, linewidth=1.4, zorder=4)
    axes.plot(*mean[-1], "o", color=style.VERMILION, markersize=6, zorder=5)
    reach = 1.15 * float(np.abs(across).max())
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    axes.set(xlabel=f"x of the carrier / {unit}", ylabel=f"y of the carrier / {unit}")

"""A bias vector that turns with the unit and averages out, beside the part along the axis that stays."""

import numpy as np

from imubayes.display.labels import pretty, readable
from imubayes.display.marks import level, line, points
from imubayes.display.theme import BLUE, FAINT, QUIET, SMALL, VERMILION, Picture, axes_at, picture, themed
from imubayes.display.ticks import frame


@themed
def modulation_figure(
    turns: np.ndarray,
    turning: np.ndarray,
    mean: np.ndarray,
    along: np.ndarray,
    expected: np.ndarray,
    unit: str,
    run: str,
) -> Picture:
    """Return the turning bias vector, and what is left of its mean as the unit turns.

    Parameters
    ----------
    turns : shape (R,), turns swept up to the end of each row.
    turning : shape (R, 2), what the carrier feels of the biases across the axis, in `unit`.
    mean : shape (R, 2), the mean of it so far.
    along : shape (R,), the mean along the axis so far.
    expected : shape (R,), length that the mean across the axis should have.
    """
    caption = (
        "Left: what the carrier feels across the axis of rotation of the unit's biases, and of what an error of the "
        "seat makes of the rotation. Points are single rows, which go round; the line is their mean so far, which "
        "spirals into the middle. Right: the length of that mean, with what it should be, and the mean along the axis, "
        "which turning does not touch. A good run ends on a whole turn."
    )
    factor, shown = readable(unit, float(np.hypot(*turning.T).max()))
    figure = picture(9.2, 3.6, f"Rotation modulation: {run}", caption)
    left, bottom, right, top = figure.inside
    side = top - bottom - 0.6
    reach = 1.15 * float(np.abs(turning).max()) * factor
    circle = axes_at(figure, left + 0.75, bottom + 0.5, side, side)
    circle.set(xlim=(-reach, reach), ylim=(-reach, reach))
    level(circle, 0.0, FAINT)
    line(circle, [0, 0], [-reach, reach], color=FAINT, linewidth=0.7)
    points(circle, turning[:, 0] * factor, turning[:, 1] * factor, "o", 3, BLUE, alpha=0.55)
    line(circle, mean[:, 0] * factor, mean[:, 1] * factor, color=VERMILION, linewidth=1.4, zorder=4)
    points(circle, mean[-1:, 0] * factor, mean[-1:, 1] * factor, "o", 6, VERMILION, zorder=5)
    frame(circle, 4, 4, f"x of the carrier / {pretty(shown)}", f"y of the carrier / {pretty(shown)}")
    start = left + 0.75 + side + 1.0
    course = axes_at(figure, start, bottom + 0.5, right - start - 0.1, side)
    length = np.hypot(*mean.T) * factor
    highest = 1.15 * max(float(length.max()), float(np.abs(along).max()) * factor)
    course.set(xlim=(0, float(turns[-1])), ylim=(0, highest))
    line(course, turns, np.abs(along) * factor, color=QUIET, linewidth=1.2, linestyle="--")
    line(course, turns, expected * factor, color=BLUE, linewidth=1.0)
    line(course, turns, length, color=VERMILION, linewidth=1.4, zorder=3)
    words = (
        (f"along the axis, {abs(along[-1]) * factor:.3g}", QUIET),
        (f"across the axis, {length[-1]:.3g}", VERMILION),
        ("across the axis, as it should be", BLUE),
    )
    for place, (text, colour) in enumerate(words):
        said = course.text(0.98, 0.95 - 0.08 * place, text, size=SMALL, color=colour, transform=course.transAxes)
        said.set(ha="right", va="top")
    frame(course, 6, 4, "turns", f"mean so far / {pretty(shown)}")
    return figure

"""Navigation errors of a mission that follow from a calibration: tables and a picture."""

import math

import numpy as np

from imubayes.display import figure_style as style
from imubayes.display.layout import Report, Sheet, cells
from imubayes.display.numbers_and_labels import listed, significant
from imubayes.qualification.onboard.navigation_impact import NavigationImpact

_ROWS = 9
_ARCMIN = math.degrees(60.0)
_CAPTION = (
    "Standard deviations that the calibration alone leaves: start and alignment are exact. Horizontal: root of the sum "
    "of the variances along North and East (DRMS)."
)


def navigation_report(found: NavigationImpact) -> Report:
    """Return the errors over the mission, and what each source does to them at its end."""
    rows = []
    for place in np.unique(np.linspace(0, len(found.errors) - 1, _ROWS).astype(int))[1:]:
        at = found.errors[place]
        north, east, down = (significant(_ARCMIN * value, 2) for value in at.attitude_rad)
        height = significant(at.position_m[2], 2) if at.position_m[2] else "aided"
        speed = significant(math.hypot(*at.velocity_m_s[:2]), 2)
        rows.append(cells(f"{at.time_s / 60:.3g}", significant(at.horizontal_m, 2), height, speed, north, east, down))
    head = ("t / min", "horizontal / m", "height / m", "speed / m/s", "tilt N / arcmin", "tilt E / arcmin",
            "heading / arcmin")  # fmt: skip
    errors = Sheet("Navigation errors, standard deviations", head, rows, ())
    sources = [
        cells(" ".join(filter(None, (each.kind, each.source))), significant(each.horizontal_m, 2),
              significant(_ARCMIN * each.attitude_rad, 2))
        for each in found.sources
    ]  # fmt: skip
    note = "Constants are correlated by the fit that they come from: squares of the sources need not add up."
    table = Sheet(
        "At the end, each source alone", ("source", "horizontal / m", "attitude / arcmin"), sources, note=note
    )
    lines = [f"Unit {found.serial or 'without a serial number'}, {found.mission}."]
    left = [f"Not in these numbers: {listed(found.not_in)}."] if found.not_in else []
    return Report(lines, [errors, table], left)


@style.themed
def navigation_figure(found: NavigationImpact) -> style.Picture:
    """Return horizontal position and attitude errors against time."""
    figure = style.picture(6.6, 4.6, f"Navigation errors: {found.mission}", _CAPTION)
    upper, lower = style.panels(figure, 2, 1, (0.85, 0.5, 0.1, 0.15), (0.3, 0.35)).flat
    minutes = np.array([each.time_s for each in found.errors]) / 60
    upper.plot(minutes, [each.horizontal_m for each in found.errors], color=style.INK)
    upper.set_ylabel("horizontal / m")
    for place, (label, colour) in enumerate(
        (("tilt N", style.BLUE), ("tilt E", style.GREEN), ("heading", style.VERMILION))
    ):
        lower.plot(minutes, [_ARCMIN * each.attitude_rad[place] for each in found.errors], color=colour, label=label)
    lower.set(xlabel="time / min", ylabel="attitude / arcmin")
    lower.legend(fontsize=style.SMALL)
    for axes in (upper, lower):
        axes.set_xlim(0, minutes[-1])
        axes.set_ylim(bottom=0)
    return figure

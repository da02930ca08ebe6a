"""Navigation errors of a mission that follow from a calibration: tables and a picture."""

import math
from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes

from imubayes.display import figure_style as style
from imubayes.display.layout import Report, Sheet, cells
from imubayes.display.numbers_and_labels import listed, pretty, significant
from imubayes.foundations.covariates import CONDITIONS
from imubayes_qualification.onboard.navigation_impact import ErrorSource, NavigationImpact

_ROWS = 9
_ARCMIN = math.degrees(60.0)
_CAPTION = (
    "Standard deviations due to the calibration alone: start and alignment are exact. Horizontal: root of the sum "
    "of the variances along North and East (DRMS)."
)
_SIZE = (
    "Every coefficient is taken at the largest size that is met in practice and that the data do not contradict. The "
    "part that the fit absorbs is subtracted. These are not standard uncertainties: no interval and no probability is "
    "claimed."
)
_BARS = 8  # effects that the runs could not show, in the picture


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
        cells(_label(each), significant(each.horizontal_m, 2),
              significant(_ARCMIN * each.attitude_rad, 2))
        for each in found.sources
    ]  # fmt: skip
    note = "The constants are correlated: the squares of the sources need not add up to the square of the total."
    table = Sheet(
        "At the end, each source alone", ("source", "horizontal / m", "attitude / arcmin"), sources, note=note
    )
    lines = [f"Unit {found.serial or 'without a serial number'}, {found.mission}."]
    left = [f"These numbers do not include: {listed(found.not_in)}."] if found.not_in else []
    return Report(lines, [errors, table, *_not_shown(found)], [*left, *_not_propagated(found)])


def _label(each: ErrorSource) -> str:
    return " ".join(filter(None, (each.kind, each.source)))


def _not_shown(found: NavigationImpact) -> Iterator[Sheet]:
    """Yield the table of the effects that the runs could not show; none without one."""
    rows = [
        cells(f"{each.source} ({each.kind})", f"{significant(each.size, 2)} {pretty(each.unit)}",
              significant(each.horizontal_m, 2), significant(_ARCMIN * each.attitude_rad, 2))
        for each in found.not_shown
    ]  # fmt: skip
    if rows:
        head = ("effect", "largest size", "horizontal / m", "attitude / arcmin")
        note = f"{_SIZE} The errors above do not include them."
        yield Sheet("At the end, each effect that the runs could not show", head, rows, note=note)


def _not_propagated(found: NavigationImpact) -> Iterator[str]:
    """Yield what is left out of that table, and why."""
    if not found.diagnosed:
        yield (
            "Errors due to effects that the runs could not show are not included. `imubayes diagnose RESULT` lists "
            "these effects; then run this command again."
        )
    left = []
    for needs in dict.fromkeys(each.needs for each in found.not_propagated):
        names = [each.effect for each in found.not_propagated if each.needs == needs]
        words = (CONDITIONS.get(need, need) for need in needs)
        why = f"needs {' and '.join(words)}" if needs else "memory, a threshold, a shape, or a lever arm"
        stated = needs and all(need.endswith("temperature") for need in needs)
        left.append(f"{listed(names)} ({why}{', see --temperature' if stated else ''})")
    if left:
        yield f"Not shown by the runs and not propagated, with the reason: {'; '.join(left)}."


@style.themed
def navigation_figure(found: NavigationImpact) -> style.Picture:
    """Return horizontal position and attitude errors against time, and what each source does at the end."""
    caption = f"{_CAPTION} Open bars: effects that the runs could not show. {_SIZE}" if found.not_shown else _CAPTION
    figure = style.picture(12.0, 4.6, f"Navigation errors: {found.mission}", caption)
    upper, lower = style.panels(figure, 2, 1, (0.85, 0.5, 6.8, 0.15), (0.3, 0.35)).flat
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
    _bars(style.panels(figure, 1, 1, (7.6, 0.5, 0.6, 0.15))[0, 0], found)
    return figure


def _bars(axes: Axes, found: NavigationImpact) -> None:
    """Draw the horizontal error at the end by each source alone, on a logarithmic axis; zeros have no bar."""
    own = [(_label(each), each.horizontal_m) for each in found.sources]
    hidden = [(f"{each.source} ({each.kind})", each.horizontal_m) for each in found.not_shown[:_BARS]]
    shown = [(name, size) for name, size in (*own, *hidden) if size > 0]
    solid = sum(size > 0 for _, size in own)
    sizes, places = [size for _, size in shown], range(len(shown))
    if not shown:
        return
    least = 10.0 ** math.floor(math.log10(min(sizes)) - 0.1)
    axes.set_xscale("log")
    drawn = axes.barh(places, [size - least for size in sizes], left=least, height=0.62, color=style.INK)
    for bar in drawn.patches[solid:]:
        bar.set(facecolor="none", edgecolor=style.VERMILION)
    for place, size in enumerate(sizes):
        axes.annotate(significant(size, 2), (size, place), (4, 0), textcoords="offset points", size=style.SMALL,
                      va="center")  # fmt: skip
    axes.set(xlim=(least, 3 * max(sizes)), ylim=(len(shown) - 0.5, -0.5), xlabel="horizontal at the end / m")
    axes.minorticks_off()
    style.name_rows(axes, [name for name, _ in shown], 44)

"""The campaign on a time axis: when each run was recorded, in which mounting and at which temperature."""

from datetime import UTC, timedelta

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.lines import Line2D

from imubayes.campaign_data import Campaign, Run
from imubayes.display.labels import shortened
from imubayes.display.run_signs import HUES
from imubayes.display.theme import Picture, legend_at, panels, picture, themed
from imubayes.procedures.ambient import instant

_LEGEND, _LINE = 2.05, 0.24
_NO_MOUNTING = "no mounting"
_CAPTION = (
    "Bars: runs by procedure, from start to end, in the hue of their mounting. Lower panel: lowest to highest reading "
    "of the thermometer that varied most. A good campaign interleaves mountings and temperatures: where all runs of "
    "one mounting are at one end, ageing and mounting cannot be told apart."
)


@themed
def campaign_timeline_figure(campaign: Campaign) -> Picture:
    """Return the runs of a campaign on a time axis.

    Raises
    ------
    ValueError
        where no run states its start.
    """
    runs = [run for run in campaign.runs if run.start is not None]
    if not runs:
        raise ValueError("no run states its start")
    kinds = list(dict.fromkeys(run.procedure for run in runs))
    mountings = list(dict.fromkeys(run.mounting or _NO_MOUNTING for run in runs))
    hues = {name: HUES[place % len(HUES)] for place, name in enumerate(mountings)}
    height = _LINE * len(kinds) + 2.6
    left_out = len(campaign.runs) - len(runs)
    missing = f" {left_out} of {len(campaign.runs)} runs state no start and are left out." if left_out else ""
    figure = picture(11.5, height, f"Runs of {campaign.name}", _CAPTION + missing)
    upper, lower = panels(figure, 2, 1, (1.6, 0.5, _LEGEND, 0.1), (0.85, 0.3), share_x=True)[:, 0]
    lower.xaxis.set_visible(True)
    for run in runs:
        start, end = _span(run)
        hue = hues[run.mounting or _NO_MOUNTING]
        place = [kinds.index(run.procedure)] * 2
        upper.plot([start, end], place, color=hue, linewidth=8, solid_capstyle="butt")
        upper.plot([start, end], place, "|", color=hue, markersize=8, markeredgewidth=1.6)
        _temperature(lower, run, start, end, hue)
    upper.set_yticks(range(len(kinds)), [kind.replace("_", " ") for kind in kinds])
    upper.set(ylim=(len(kinds) - 0.4, -0.6))
    lower.set_ylabel("temperature / °C")
    locator = AutoDateLocator(minticks=3, maxticks=8)
    lower.xaxis.set_major_locator(locator)
    lower.xaxis.set_major_formatter(ConciseDateFormatter(locator, tz=UTC))
    lower.set_xlabel("UTC")
    handles = [Line2D([], [], color=hue, linewidth=5, label=shortened(name, 25)) for name, hue in hues.items()]
    legend_at(figure, figure.inside[2] - _LEGEND + 0.3, figure.inside[3], handles, handlelength=0.8)
    return figure


def _span(run: Run) -> tuple[float, float]:
    """Return start and end of a run as matplotlib dates; a run without times is a point."""
    assert run.start is not None
    start = instant(run.start)
    times = run.covariates.get("time", np.zeros(1))
    known = times[np.isfinite(times)]
    seconds = float(known.max()) if known.size else 0.0
    return float(date2num(start)), float(date2num(start + timedelta(seconds=seconds)))


def _temperature(axes: Axes, run: Run, start: float, end: float, hue: str) -> None:
    """Draw the range of the thermometer that varied most, of the unit or of its converter."""
    recorded = [run.covariates.get(name, np.empty(0)) for name in ("temperature", "converter_temperature")]
    ranges = [(float(known.min()), float(known.max())) for each in recorded if (known := each[np.isfinite(each)]).size]
    if ranges:
        low, high = max(ranges, key=lambda found: found[1] - found[0])
        axes.plot([(start + end) / 2] * 2, [low, high], "o-", color=hue, linewidth=3, markersize=4)

"""Goodness of fit of every run and channel: a map of χ²/n."""

from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle

from imubayes.display.fit_cautions import alarm_of
from imubayes.display.goodness_of_fit import SIGNIFICANT, share_of_freedom, tail, worst_channels, worst_first
from imubayes.display.labels import shortened
from imubayes.display.rounding import NO_NUMBER, ratio_text
from imubayes.display.theme import INK, QUIET, SMALL, Picture, legend_at, panels, picture, themed
from imubayes.results.summary import RunSummary, Summary

_MOST_RUNS, _MOST_CHANNELS = 40, 12
_CELL = (0.78, 0.27)
_CLASSES = (
    ("too large, p < 0.001", "#c2410c", "white"),
    ("large, p < 0.05", "#fbd3b4", INK),
    ("consistent with noise", "#f6f6f6", INK),
    ("small, p < 0.05", "#c9dff0", INK),
    ("too small, p < 0.001", "#1f6aa5", "white"),
    ("no values", "white", QUIET),
)


@themed
def run_chi2_figure(summary: Summary) -> Picture:
    """Return a map of χ²/n over runs and channels, coloured by its p-value under noise alone.

    Of more than 40 runs or 12 channels, the worst are shown.
    """
    share = share_of_freedom(summary)
    entries = {(run.name, run.channel): run for run in summary.runs}
    runs, channels = _chosen(summary)
    shown = {key: entries.get(key) for key in ((run, channel) for run in runs for channel in channels)}
    figure = picture(
        max(2.7 + len(channels) * _CELL[0] + 2.5, 8.0),
        max(0.4 + len(runs) * _CELL[1], 1.55),
        "Goodness of fit by run and channel",
        _caption(summary, len(runs), len(channels), sum(run is not None for run in shown.values()), share),
        alarm=alarm_of(summary),
    )
    left, bottom, right, top = figure.inside
    across, base = len(channels) * _CELL[0], top - 0.35 - len(runs) * _CELL[1]
    axes = panels(figure, margins=(2.2, base - bottom, right - left - 2.2 - across, 0.35))[0, 0]
    axes.set(xlim=(0, len(channels)), ylim=(len(runs), 0))
    for (run, channel), entry in shown.items():
        _draw_cell(axes, channels.index(channel), runs.index(run), entry, share)
    axes.xaxis.tick_top()
    axes.set_xticks([place + 0.5 for place in range(len(channels))], [shortened(name, 11) for name in channels])
    axes.set_yticks([place + 0.5 for place in range(len(runs))], [shortened(name, 32) for name in runs])
    axes.tick_params(length=0, labelsize=8.5)
    axes.spines[:].set_visible(False)
    handles = [Patch(facecolor=c, edgecolor="#bbbbbb", linewidth=0.5, label=label) for label, c, _ in _CLASSES]
    legend_at(figure, left + 2.35 + across, top - 0.35, handles, handlelength=1.2)
    return figure


def _chosen(summary: Summary) -> tuple[list[str], list[str]]:
    """Return the runs and channels to show, in their own order."""
    runs = list(dict.fromkeys(run.name for run in summary.runs))
    if len(runs) > _MOST_RUNS:
        kept = set(worst_first(summary)[:_MOST_RUNS])
        runs = [name for name in runs if name in kept]
    return runs, worst_channels(summary.runs, _MOST_CHANNELS)


def _caption(summary: Summary, runs: int, channels: int, cells: int, share: float) -> str:
    caption = (
        f"χ²/n: mean square of the whitened residuals. In a good model it is about {share:.2f} (the parameters take up "
        "the rest of 1) and no cell is dark. Colour: p-value of χ² for the n of the cell; by chance "
        f"{cells * SIGNIFICANT:.2g} of {cells} {'cell is' if cells == 1 else 'cells are'} expected to be dark orange. "
        "Blue: less scatter than the noise model assumes."
    )
    all_runs, all_channels = len({run.name for run in summary.runs}), len({run.channel for run in summary.runs})
    if runs < all_runs or channels < all_channels:
        caption += f" Shown: {runs} of {all_runs} runs and {channels} of {all_channels} channels, the worst."
    return caption


def _draw_cell(axes: Axes, column: int, row: int, entry: RunSummary | None, share: float) -> None:
    text, (_, colour, ink) = _class_of(entry, share)
    axes.add_patch(Rectangle((column, row), 1, 1, facecolor=colour, edgecolor="white", linewidth=1.5))
    axes.text(column + 0.5, row + 0.53, text, ha="center", va="center", size=SMALL, color=ink)


def _class_of(entry: RunSummary | None, share: float) -> tuple[str, tuple[str, str, str]]:
    if entry is None or not entry.n or entry.chi2 is None:
        return NO_NUMBER, _CLASSES[5]
    chance = tail(entry.chi2, share * entry.n)
    strength = 2 if abs(chance) < SIGNIFICANT else (1 if abs(chance) < 0.05 else 0)
    return ratio_text(entry.chi2 / entry.n), _CLASSES[2 - strength if chance >= 0 else 2 + strength]

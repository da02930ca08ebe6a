"""Which run and channel does not fit: a map of χ²/n."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.patches import Patch, Rectangle

from imubayes.display.fit_tables import alarm_of
from imubayes.display.goodness_of_fit import SIGNIFICANT, share_of_freedom, tail, worst_channels, worst_first
from imubayes.display.labels import shortened
from imubayes.display.rounding import ratio_text
from imubayes.display.theme import INK, PAPER, QUIET, Picture, axes_at, picture, themed

_MOST_RUNS, _MOST_CHANNELS = 40, 12
_CLASSES = (
    ("too large, chance < 0.001", "#c2410c", PAPER),
    ("large, chance < 0.05", "#fbd3b4", INK),
    ("as noise would give", "#f6f6f6", INK),
    ("small, chance < 0.05", "#c9dff0", INK),
    ("too small, chance < 0.001", "#1f6aa5", PAPER),
    ("no values", PAPER, QUIET),
)


@themed
def run_chi2_figure(summary: Mapping[str, Any]) -> Picture:
    """Return a map of χ²/n over runs and channels, coloured by how unlikely the value is under noise alone.

    Of more than 40 runs or 12 channels, those that fit worst are shown.
    """
    share = share_of_freedom(summary)
    entries = {(one["name"], one["channel"]): one for one in summary["runs"]}
    all_runs = list(dict.fromkeys(name for name, _ in entries))
    kept = set(all_runs if len(all_runs) <= _MOST_RUNS else worst_first(summary)[:_MOST_RUNS])
    runs = [name for name in all_runs if name in kept]
    all_channels = list(dict.fromkeys(channel for _, channel in entries))
    channels = worst_channels(summary["runs"], _MOST_CHANNELS)
    cells = sum(1 for run, channel in entries if run in kept and channel in channels)
    expected = max(cells * SIGNIFICANT, 0.001)
    caption = (
        "χ²/n of each run and channel: the mean square of the whitened residuals. A good model has no dark cell and "
        f"numbers about {share:.2f} (the parameters take up the rest of 1); the colour says how likely a value so far "
        f"out is for its n. Of {cells} {'cell' if cells == 1 else 'cells'} about {expected:.2g} would be dark orange "
        "by chance. Blue: less scatter than the noise that the model assumes."
    )
    if len(runs) < len(all_runs) or len(channels) < len(all_channels):
        shown = f"{len(runs)} of {len(all_runs)} runs and {len(channels)} of {len(all_channels)} channels"
        caption += f" Shown: {shown}, the worst."
    height = max(0.4 + len(runs) * 0.27, 1.55)
    width = max(2.7 + len(channels) * 0.78 + 2.5, 8.0)
    figure = picture(width, height, "Fit of every run and channel", caption, alarm=alarm_of(summary))
    left, _, _, top = figure.inside
    base = top - 0.35 - len(runs) * 0.27
    axes = axes_at(figure, left + 2.2, base, len(channels) * 0.78, len(runs) * 0.27)
    axes.set(xlim=(0, len(channels)), ylim=(len(runs), 0))
    for row, run in enumerate(runs):
        for column, channel in enumerate(channels):
            text, place = _cell(entries.get((run, channel)), share)
            _, colour, ink = _CLASSES[place]
            axes.add_patch(Rectangle((column, row), 1, 1, facecolor=colour, edgecolor=PAPER, linewidth=1.5))
            axes.text(column + 0.5, row + 0.53, text, ha="center", va="center", size=8, color=ink)
    axes.xaxis.tick_top()
    axes.set_xticks(np.arange(len(channels)) + 0.5, [shortened(name, 11) for name in channels])
    axes.set_yticks(np.arange(len(runs)) + 0.5, [shortened(name, 32) for name in runs])
    axes.tick_params(length=0, labelsize=8.5)
    axes.spines[:].set_visible(False)
    figure.legend(
        handles=[Patch(facecolor=c, edgecolor="#bbbbbb", linewidth=0.5, label=label) for label, c, _ in _CLASSES],
        loc="upper left", bbox_to_anchor=((left + 2.2 + len(channels) * 0.78 + 0.15) / width,
                                          (top - 0.35) / figure.get_size_inches()[1]),
        borderaxespad=0, handlelength=1.2, labelspacing=0.5,
    )  # fmt: skip
    return figure


def _cell(entry: Mapping[str, Any] | None, share: float) -> tuple[str, int]:
    count = int(entry["n"] or 0) if entry else 0
    if entry is None or not count or entry["chi2"] is None:
        return "–", 5
    chance = tail(float(entry["chi2"]), share * count)
    strong, mild = abs(chance) < SIGNIFICANT, abs(chance) < 0.05
    text = ratio_text(entry["chi2"] / count)
    if chance >= 0:
        return text, 0 if strong else (1 if mild else 2)
    return text, 4 if strong else (3 if mild else 2)

"""Residuals in units of the recorded noise: by how much rows scatter more than the samples within them say."""

import math

import numpy as np

from imubayes.adequacy.adequacy_record import NoiseComparison
from imubayes.adequacy.known_noise import KnownNoise
from imubayes.display.figures.panels import limit_of, thinned
from imubayes.display.labels import shortened
from imubayes.display.rounding import value_and_sd
from imubayes.display.run_signs import RunSigns
from imubayes.display.theme import (
    BAND,
    BLUE,
    INK,
    QUIET,
    VERMILION,
    Picture,
    at_runs,
    panels,
    picture,
    runs_legend,
    themed,
)

_LEGEND = 2.05
_MOST_CHANNELS = 12


@themed
def recorded_noise_figure(record: KnownNoise, signs: RunSigns | None = None) -> Picture:
    """Return the rows of the channel that disagrees most, and the ratio of fitted to recorded noise of every channel.

    Parameters
    ----------
    record : with at least one comparison; of more than 12 channels the most deviating are shown.
    """
    ranked = sorted(record.of_rows, key=lambda each: -abs(math.log(each.ratio)))
    worst, shown = ranked[0], [each for each in record.of_rows if each in ranked[:_MOST_CHANNELS]]
    here = record.channel == worst.channel
    runs, scatter = record.run[here], record.scatter[here]
    value, sd = value_and_sd(worst.ratio, worst.ratio_sd)
    outside = float(np.mean(np.abs(scatter) > 2))
    caption = (
        f"Left: residual of each row of {worst.channel} in standard deviations of a row's mean as recorded, in the "
        "order of the runs (colours); grey: ±2 sd. In a good model 5 % of the rows lie outside and no pattern shows; "
        f"here {100 * outside:.0f} % lie outside. Right: fitted over recorded noise with ±2 standard uncertainties; in "
        "a good model 1. A ratio above 1 is scatter from row to row that the samples within a row do not show."
    )
    title = f"Fitted noise of {worst.channel} is {value} ± {sd} times the recorded noise"
    figure = picture(11.5, 3.5, title, caption)
    signs = signs if signs is not None else RunSigns(runs.tolist())
    runs_legend(figure, figure.inside[2] - _LEGEND + 0.3, signs)
    left, right = panels(figure, 1, 2, (0.75, 0.45, _LEGEND, 0.25), (1.1, 0.36), widths=(1.6, 1.0))[0]
    high = limit_of(scatter, 3.0)
    left.axhspan(-2, 2, color=BAND, linewidth=0, zorder=1)
    left.axhline(0, color=QUIET, linewidth=0.7, zorder=1.5)
    at, kept = np.arange(len(scatter), dtype=float), thinned(len(scatter))
    clipped = np.clip(scatter, -0.98 * high, 0.98 * high)
    at_runs(left, at[kept], clipped[kept], runs[kept], signs, markersize=4.2 if len(scatter) < 400 else 2.6, alpha=0.75)
    left.set(ylim=(-high, high), xlabel="row, in the order of the runs", ylabel="residual / recorded sd of the row")
    left.set_title(f"{worst.channel}: rows")
    _draw_ratios(right, shown)
    return figure


def _draw_ratios(axes, shown: list[NoiseComparison]) -> None:
    """Draw the ratio of each channel with ±2 standard uncertainties, on a logarithmic axis."""
    places = np.arange(len(shown))
    ratio = np.array([each.ratio for each in shown])
    factor = np.exp(2 * np.array([each.ratio_sd for each in shown]) / ratio)
    colours = [INK if each.agrees else (VERMILION if each.ratio > 1 else BLUE) for each in shown]
    axes.axvline(1.0, color=QUIET, linewidth=0.9, zorder=1.5)
    for place, low, value, top, colour in zip(places, ratio / factor, ratio, ratio * factor, colours, strict=True):
        axes.plot([low, top], [place, place], color=colour, linewidth=1.6, solid_capstyle="butt")
        axes.plot([value], [place], "o", color=colour, markersize=5)
    most = max(1.6, float(np.max(np.maximum(ratio * factor, factor / ratio))) * 1.1)
    axes.set_xscale("log")
    ticks = [each for each in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0) if 1 / most <= each <= most]
    axes.set_xticks(ticks, [f"{each:g}" for each in ticks])
    axes.minorticks_off()
    axes.set(xlim=(1 / most, most), ylim=(len(shown) - 0.5, -0.5), xlabel="fitted / recorded noise")
    axes.set_yticks(places, [shortened(each.channel, 14) for each in shown])
    axes.set_title("all channels" if len(shown) > 1 else "this channel")

"""Allan deviation of a static record with its intervals, and the fitted noise terms as lines."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from imubayes.display import figure_style as style
from imubayes.display.numbers_and_labels import pretty
from imubayes_recordings.noise_analysis.noise_record import ChannelNoise, fitted_deviations, undetermined_deviations
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm

STYLES = {
    NoiseTerm.QUANTISATION: ("Q, slope −1", style.PURPLE),
    NoiseTerm.WHITE: ("N, slope −½", style.BLUE),
    NoiseTerm.FLICKER: ("B, floor 0.664 B", style.GREEN),
    NoiseTerm.RANDOM_WALK: ("K, slope +½", style.VERMILION),
    NoiseTerm.MARKOV: ("Gauss–Markov", style.SKY),
    NoiseTerm.RAMP: ("R, slope +1", style.ORANGE),
}
MOST_CHANNELS = 12
_COLUMNS = 3
_FEW_DECADES = 300.0  # ratio of the ends of the axis up to which 2 and 5 are labelled too
_CAPTION = (
    "Points: overlapping Allan deviation with 95 % chi-square intervals; those at long averaging times are correlated "
    "and come from few differences. Lines: noise terms fitted to the record, not to the points; dashed where the "
    "record "
    "does not determine the term, at its most probable value. N: white noise; B: bias instability (flicker noise); "
    "K: random walk; Q: quantisation; R: ramp."
)


@style.themed
def allan_figure(channels: list[ChannelNoise]) -> style.Picture:
    """Return the Allan deviations of the channels of one record, at most 12 of them, one panel each."""
    shown = channels[:MOST_CHANNELS]
    columns = min(_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    title = f"Allan deviation of {shown[0].run}"
    figure = style.picture(max(3.7 * columns, 6.6), 2.9 * rows + 0.35, title, _CAPTION)
    grid = style.panels(figure, rows, columns, (0.75, 0.5, 0.1, 0.65), (0.75, 0.75))
    for axes, noise in zip(grid.flat, shown, strict=False):
        _draw(axes, noise)
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    dashed = {term for noise in shown for term in undetermined_deviations(noise, np.ones(1))}
    seen = [term for term in STYLES if term in dashed or any(noise.of(term).determined for noise in shown)]
    handles = [Line2D([], [], color=STYLES[term][1], label=STYLES[term][0]) for term in seen]
    handles.append(Line2D([], [], color=style.INK, linewidth=1.6, label="all terms"))
    if dashed:
        handles.append(Line2D([], [], color=style.QUIET, linewidth=1.0, linestyle=(0, (4, 3)), label="not determined"))
    width, height = figure.get_size_inches()
    corner = (figure.inside[0] / width, (figure.inside[3] + 0.05) / height)
    figure.legend(handles=handles, loc="upper left", bbox_to_anchor=corner, ncols=len(handles), fontsize=style.SMALL)
    return figure


def _draw(axes: Axes, noise: ChannelNoise) -> None:
    tau = np.array([point.tau_s for point in noise.allan])
    value = np.array([point.deviation for point in noise.allan])
    ends = np.array([[point.low, point.high] for point in noise.allan]).T
    axes.set(xscale="log", yscale="log")
    axes.errorbar(tau, value, np.abs(ends - value), fmt="o", color=style.QUIET, markersize=3, linewidth=0.9, zorder=3)
    fine = np.geomspace(tau[0], tau[-1], 200)
    parts, total = fitted_deviations(noise, fine)
    for term, deviation in parts.items():
        axes.plot(fine, deviation, color=STYLES[term][1], linewidth=1.0, zorder=2)
    for term, deviation in undetermined_deviations(noise, fine).items():
        axes.plot(fine, deviation, color=STYLES[term][1], linewidth=1.0, linestyle=(0, (4, 3)), zorder=2)
    axes.plot(fine, total, color=style.INK, linewidth=1.6, zorder=4)
    low, high = float(ends[0].min()), float(ends[1].max())
    axes.set(xlim=(0.7 * tau[0], 1.4 * tau[-1]), ylim=(0.4 * low, 1.6 * high))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(10, numticks=8))
        axis.set_minor_formatter(NullFormatter())
    if high / low < _FEW_DECADES:
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_locator(LogLocator(10, subs=(2.0, 5.0)))
        axes.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set(xlabel="averaging time / s", ylabel=f"Allan deviation / {pretty(noise.deviation_unit)}")
    axes.set_title(noise.channel)

"""Residuals of one channel against what the missing effect depends on, before and after it is added."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from imubayes.criticism.residual_evidence import ResidualEvidence
from imubayes.display.figures.panels import draw_means, limit_of, set_range, thinned
from imubayes.display.labels import pretty, readable
from imubayes.display.rounding import significant
from imubayes.display.run_signs import RunSigns
from imubayes.display.theme import BAND, INK, QUIET, Picture, at_runs, panels, picture, runs_legend, themed

_LEGEND = 2.05
_LEAST_INPUT = 1 / 3


@dataclass(frozen=True)
class FollowedCovariate:
    """The covariate that the change of a residual follows (n points).

    Attributes
    ----------
    at : shape (n,), its values.
    label : its name and unit, for the axis.
    over : shape (n,), the input, in the unit of the residual, where the residual over the input follows it.
    """

    at: np.ndarray
    label: str
    over: np.ndarray | None = None


@themed
def evidence_figure(evidence: ResidualEvidence, against: str, signs: RunSigns | None = None) -> Picture:
    """Return the residual against the covariate of a candidate, and against the part that the candidate explains.

    Parameters
    ----------
    evidence : the residual; a large unit is replaced by one of plain numbers.
    against : the covariate with its unit.
    signs : of the runs; without them each run has its own hue.
    """
    channel, effect, runs, at = evidence.channel, evidence.effect, evidence.run.tolist(), evidence.at
    factor, shown = readable(evidence.unit, float(np.median(np.abs(evidence.residual))))
    residual, explained = evidence.residual * factor, evidence.explained * factor
    over = evidence.over
    divided = "" if over is None else " over its input, where that is a third of the largest or more"
    without = " without the offset of each run" if evidence.within else ""
    caption = (
        f"Left: residual of {channel}{without}{divided}; black: the part that {effect} explains and the "
        "present model cannot absorb. "
        "Right: residual against that part; if the candidate is the cause, every run follows the line "
        "of slope 1 within its noise. A good model shows no pattern on the left and an uncorrelated cloud about zero "
        "on the right."
    )
    high = limit_of(np.concatenate([residual, explained]), 1e-12)
    names = np.array(list(runs))
    title = f"Residual of {channel} and the part explained by {effect}"
    figure, signs, (left, right) = _pair_of_panels(title, caption, names, signs)
    _cloud(right, explained, residual, names, signs, high)
    if over is None:
        _cloud(left, at, residual, names, signs, high)
        left.plot(at, explained, "D", color=INK, markersize=2.6, zorder=6)
        left.set_title("against its covariate" if evidence.covariate is not None else "row by row")
        left.set(xlabel=against, ylabel=f"residual / {pretty(shown)}")
    else:
        _over_input(left, evidence, over.input, names, signs)
        left.set(
            xlabel=against, ylabel="residual / input / ppm", title=f"over its input, against {over.covariate.phrase}"
        )
    right.axline((0, 0), slope=1, color=INK, linewidth=1.3, zorder=6)
    right.set_title(f"against the explained part; slope {significant(_slope(explained, residual))}")
    right.set(xlabel=f"explained / {pretty(shown)}", ylabel=f"residual / {pretty(shown)}")
    return figure


@themed
def before_after_figure(
    followed: FollowedCovariate,
    before: np.ndarray,
    after: np.ndarray,
    runs: Sequence[str],
    channel: str,
    unit: str,
    step: str,
    floor: float | None = None,
    signs: RunSigns | None = None,
    within: bool = False,
) -> Picture:
    """Return the residual of a channel against a covariate, before and after a step, on one scale.

    Parameters
    ----------
    followed : the covariate.
    before, after : shape (n,), residuals in `unit`.
    runs : of each point.
    channel, unit : for the labels.
    step : between the fits, such as ``adding gyro_bias_drift``.
    floor : noise of one row in `unit`, drawn as a band; None for none.
    signs : of the runs; without them each run has its own hue.
    within : whether the residuals are about the mean of each run.
    """
    factor, shown = readable(unit, float(np.median(np.abs(before))))
    names, at, over = np.array(list(runs)), followed.at, followed.over
    divided, quantity = "in input units", f"residual / {pretty(shown)}"
    if over is not None:
        large, over = _large_inputs(over)
        names, at, floor = names[large], at[large], None if floor is None else floor / float(np.median(np.abs(over)))
        before, after, factor, shown = before[large] / over, after[large] / over, 1e6, "ppm"
        divided, quantity = "over its input, where that is a third of the largest or more,", "residual / input / ppm"
    before, after = before * factor, after * factor
    caption = (
        f"Residual of {channel} {divided}{' about the mean of each run,' if within else ''} before and after "
        f"{step}, on one scale; black: "
        "means of neighbouring points with ±2 standard errors. A good model leaves a band without pattern about zero"
        + (", as wide as the grey band, the noise of one row (±1 sd)." if floor is not None else ".")
    )
    high = limit_of(np.concatenate([before, after]), 3 * floor * factor if floor else 1e-12)
    figure, signs, grid = _pair_of_panels(f"{channel} before and after {step}", caption, names, signs)
    for axes, word, y in zip(grid, ("before", "after"), (before, after), strict=True):
        if floor is not None:
            axes.axhspan(-floor * factor, floor * factor, color=BAND, linewidth=0, zorder=1)
        _cloud(axes, at, y, names, signs, high)
        draw_means(axes, at, y)
        axes.set_title(f"{word}: rms {significant(float(np.sqrt(np.nanmean(y**2))))} {pretty(shown)}")
        axes.set_xlabel(followed.label)
    grid[0].set_ylabel(quantity)
    return figure


@themed
def added_variable_figure(
    added: np.ndarray, residual: np.ndarray, runs: Sequence[str], effect: str, signs: RunSigns | None = None
) -> Picture:
    """Return the added-variable plot: whitened residual against what the effect would explain, one colour per run.

    Parameters
    ----------
    added, residual : shape (n,), both whitened and projected off what the present model can absorb.
    runs : of each point.
    effect : for the labels.
    signs : of the runs; without them each run has its own hue.
    """
    caption = (
        f"Added-variable plot of {effect}: whitened residual against the part that the effect would explain, both "
        "projected off what the present model can absorb. Line: expected slope 1. A real effect shows the same slope "
        "in every run (colours by mounting or run); a spurious one rests on a few points of one run."
    )
    names = np.array(list(runs))
    figure = picture(7.2, 4.0, f"{effect}: consistency between runs", caption)
    signs = _signs(figure, names, signs)
    axes = panels(figure, 1, 1, (0.65, 0.45, _LEGEND + 0.1, 0.25))[0, 0]
    _cloud(axes, added, residual, names, signs, limit_of(residual, 3.0))
    axes.axline((0, 0), slope=1, color=INK, linewidth=1.3, zorder=6)
    axes.set_title(f"slope {significant(_slope(added, residual))}")
    axes.set(xlabel="explained by the effect / sd", ylabel="residual / sd")
    return figure


def _pair_of_panels(
    title: str, caption: str, runs: np.ndarray, signs: RunSigns | None
) -> tuple[Picture, RunSigns, np.ndarray]:
    figure = picture(11.5, 3.5, title, caption)
    return figure, _signs(figure, runs, signs), panels(figure, 1, 2, (0.75, 0.45, _LEGEND, 0.25))[0]


def _signs(figure: Picture, runs: np.ndarray, signs: RunSigns | None) -> RunSigns:
    """List the runs of a figure; return their signs, those of the runs themselves where none are given."""
    signs = signs if signs is not None else RunSigns(runs.tolist())
    runs_legend(figure, figure.inside[2] - _LEGEND + 0.3, signs, runs.tolist())
    return signs


def _over_input(
    axes: Axes, evidence: ResidualEvidence, stimulus: np.ndarray, runs: np.ndarray, signs: RunSigns
) -> None:
    """Draw the residual over the input in ppm, where the input is large enough not to magnify the noise."""
    large, divisor = _large_inputs(stimulus)
    ratio, explained = (1e6 * each[large] / divisor for each in (evidence.residual, evidence.explained))
    high = limit_of(np.concatenate([ratio, explained]), 1e-12)
    _cloud(axes, evidence.at[large], ratio, runs[large], signs, high)
    axes.plot(evidence.at[large], explained, "D", color=INK, markersize=2.6, zorder=6)


def _large_inputs(stimulus: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where the input is large enough not to magnify the noise, and the input there."""
    size = np.abs(stimulus)
    large = size >= _LEAST_INPUT * np.nanmax(size)
    return large, stimulus[large]


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    good = np.isfinite(x) & np.isfinite(y)
    return float(x[good] @ y[good] / max(float(x[good] @ x[good]), 1e-300))


def _cloud(axes: Axes, x: np.ndarray, y: np.ndarray, runs: np.ndarray, signs: RunSigns, high: float) -> None:
    good = np.isfinite(x) & np.isfinite(y)
    set_range(axes, x)
    axes.set_ylim(-high, high)
    axes.axhline(0, color=QUIET, linewidth=0.7, zorder=1.5)
    x, y, runs = x[good], np.clip(y[good], -0.98 * high, 0.98 * high), runs[good]
    kept = thinned(x.size)
    size = 4.2 if x.size < 400 else 2.6
    at_runs(axes, x[kept], y[kept], runs[kept], signs, markersize=size, alpha=0.75)

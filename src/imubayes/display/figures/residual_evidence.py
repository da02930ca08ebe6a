"""The residual of one channel against what a missing effect depends on, before and after the effect is added."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from imubayes.criticism.residual_evidence import ResidualEvidence
from imubayes.display.figures.panels import draw_means, limit_of, thinned
from imubayes.display.labels import pretty, readable
from imubayes.display.marks import level, line, points, strip
from imubayes.display.rounding import significant
from imubayes.display.theme import BAND, INK, QUIET, Picture, RunSigns, axes_at, picture, themed
from imubayes.display.ticks import frame

_WIDTH, _LEGEND, _HEIGHT = 11.5, 2.05, 3.5


@themed
def evidence_figure(evidence: ResidualEvidence, against: str) -> Picture:
    """Return the residual against the covariate of a candidate, and against the part that the candidate explains.

    Parameters
    ----------
    evidence : the residual; a large unit is replaced by one of plain numbers.
    against : the covariate with its unit.
    """
    channel, effect, runs, at = evidence.channel, evidence.effect, evidence.run.tolist(), evidence.at
    factor, shown = readable(evidence.unit, float(np.median(np.abs(evidence.residual))))
    residual, explained = evidence.residual * factor, evidence.explained * factor
    caption = (
        f"Left: residual of {channel} in each row; colours are runs; black marks are the part that {effect} explains, "
        "past what the model can absorb. Right: one against the other; where the candidate is the cause, every "
        "run follows the line of slope 1 and scatters about it by noise. A good model shows no structure on the "
        "left and a shapeless cloud about zero on the right."
    )
    title = f"Residual of {channel} and the part that {effect} explains"
    figure = picture(_WIDTH, _HEIGHT, title, caption)
    signs = RunSigns(list(dict.fromkeys(runs)))
    left, bottom, right, top = figure.inside
    across = (right - left - _LEGEND - 2 * 0.85) / 2
    high = limit_of(np.concatenate([residual, explained]), 1e-12)
    names = np.array(list(runs))
    for column, x in enumerate((at, explained)):
        axes = axes_at(figure, left + 0.75 + column * (across + 0.85), bottom + 0.45, across, top - bottom - 0.7)
        _range(axes, x)
        axes.set_ylim(-high, high)
        level(axes, 0, QUIET)
        _cloud(axes, x, residual, names, signs, high)
        if column == 0:
            order = np.argsort(at, kind="stable")
            good = order[np.isfinite(at[order])]
            points(axes, at[good], explained[good], "D", 2.6, INK, zorder=6)
            axes.set_title("against the covariate")
        else:
            ends = np.array(axes.get_xlim())
            line(axes, ends, ends, color=INK, linewidth=1.3, zorder=6)
            axes.set_title(f"against the explained part; slope {significant(_slope(x, residual))}")
        label = against if column == 0 else f"explained / {pretty(shown)}"
        frame(axes, 6, 5, label, f"residual / {pretty(shown)}")
    signs.legend(figure, right - _LEGEND + 0.3, top, bottom, list(dict.fromkeys(runs)))
    return figure


@themed
def before_after_figure(
    at: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    runs: Sequence[str],
    channel: str,
    unit: str,
    against: str,
    added: str,
    floor: float | None = None,
) -> Picture:
    """Return the residual of a channel against a covariate, before and after an addition, on one scale.

    Parameters
    ----------
    at : shape (n,), the covariate.
    before, after : shape (n,), residuals in `unit`.
    runs : of each point.
    channel, unit, against : for the labels.
    added : the effect.
    floor : noise of one row in `unit`, drawn as a band; None for none.
    """
    factor, shown = readable(unit, float(np.median(np.abs(before))))
    before, after = before * factor, after * factor
    caption = (
        f"Residual of {channel} in input units before and after adding {added}, on the same scale; colours are runs, "
        "black are means of neighbouring points with ±2 standard errors. A good model leaves a shapeless band about "
        "zero" + (", as wide as the grey band, the noise of one row (±1 sd)." if floor is not None else ".")
    )
    figure = picture(_WIDTH, _HEIGHT, f"{channel} before and after adding {added}", caption)
    signs = RunSigns(list(dict.fromkeys(runs)))
    left, bottom, right, top = figure.inside
    across = (right - left - _LEGEND - 2 * 0.85) / 2
    high = limit_of(np.concatenate([before, after]), 3 * floor * factor if floor else 1e-12)
    names = np.array(list(runs))
    for column, (word, y) in enumerate((("before", before), ("after", after))):
        axes = axes_at(figure, left + 0.75 + column * (across + 0.85), bottom + 0.45, across, top - bottom - 0.7)
        _range(axes, at)
        axes.set_ylim(-high, high)
        if floor is not None:
            strip(axes, floor * factor, BAND)
        level(axes, 0, QUIET)
        _cloud(axes, at, y, names, signs, high)
        good = np.isfinite(at) & np.isfinite(y)
        draw_means(axes, at[good], y[good])
        size = significant(float(np.sqrt(np.nanmean(y**2))))
        axes.set_title(f"{word}: rms {size} {pretty(shown)}")
        frame(axes, 6, 5, against, f"residual / {pretty(shown)}" if column == 0 else "")
    signs.legend(figure, right - _LEGEND + 0.3, top, bottom, list(dict.fromkeys(runs)))
    return figure


@themed
def added_variable_figure(added: np.ndarray, residual: np.ndarray, runs: Sequence[str], effect: str) -> Picture:
    """Return the added-variable plot: whitened residual against what the effect would explain, one colour per run.

    Parameters
    ----------
    added, residual : shape (n,), both whitened and with everything taken out that the model can take up.
    runs : of each point.
    effect : for the labels.
    """
    slope = _slope(added, residual)
    caption = (
        f"Added-variable plot of {effect}: what is left of the measurements against what the effect would explain of "
        "them, in noise standard deviations, both freed of what the model before can take up. The line is the expected "
        "size, slope 1. An effect that is really there shows the same slope in every run (colour); one that only fits "
        "an accident lives off a few points of one run."
    )
    figure = picture(7.2, 4.0, f"{effect}: does every run support it?", caption)
    signs = RunSigns(list(dict.fromkeys(runs)))
    left, bottom, right, top = figure.inside
    axes = axes_at(figure, left + 0.65, bottom + 0.45, right - left - _LEGEND - 0.75, top - bottom - 0.7)
    _range(axes, added)
    high = limit_of(residual, 3.0)
    axes.set_ylim(-high, high)
    level(axes, 0, QUIET)
    _cloud(axes, added, residual, np.array(list(runs)), signs, high)
    ends = np.array(axes.get_xlim())
    line(axes, ends, ends, color=INK, linewidth=1.3, zorder=6)
    axes.set_title(f"slope {significant(slope)}")
    frame(axes, 6, 6, "explained by the effect / sd", "residual / sd")
    signs.legend(figure, right - _LEGEND + 0.3, top, bottom, list(dict.fromkeys(runs)))
    return figure


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    good = np.isfinite(x) & np.isfinite(y)
    return float(x[good] @ y[good] / max(float(x[good] @ x[good]), 1e-300))


def _range(axes: Axes, x: np.ndarray) -> None:
    finite = x[np.isfinite(x)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    margin = 0.04 * (high - low) or 1.0
    axes.set_xlim(low - margin, high + margin)


def _cloud(axes: Axes, x: np.ndarray, y: np.ndarray, runs: np.ndarray, signs: RunSigns, high: float) -> None:
    good = np.isfinite(x) & np.isfinite(y)
    x, y, runs = x[good], np.clip(y[good], -0.98 * high, 0.98 * high), runs[good]
    kept = thinned(x.size)
    x, y, runs = x[kept], y[kept], runs[kept]
    size = 4.2 if x.size < 400 else 2.6
    for name in dict.fromkeys(runs.tolist()):
        here = runs == name
        points(axes, x[here], y[here], signs.marker(name), size, signs.hue(name), alpha=0.75, zorder=3)

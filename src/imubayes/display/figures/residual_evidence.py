"""Figures of a diagnosis and of an addition: residuals of one channel, before and after, and against recorded noise.

Residuals of a channel are drawn against what the missing effect depends on, before and after it is added.  Residuals in
units of the recorded noise show by how much rows scatter more than the samples within them say.  The channel and the
covariate of each picture, and the place where it is kept, are chosen here as well.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from matplotlib.axes import Axes

from imubayes.adequacy.adequacy_record import NoiseComparison
from imubayes.adequacy.known_noise import KnownNoise
from imubayes.criticism.diagnosis_record import CovariateLabel, EffectGroup
from imubayes.criticism.residual_evidence import ResidualEvidence, of_runs
from imubayes.display import figure_style as style
from imubayes.display import residual_columns
from imubayes.display.figures.panels import draw_means, limit_of, set_range, thinned
from imubayes.display.numbers_and_labels import pretty, readable, shortened, significant, value_and_sd
from imubayes.foundations.covariates import INPUTS, Covariate, shown
from imubayes.responses.residual_covariates import ResidualCovariate
from imubayes.results.folder_files import DIAGNOSIS_PICTURE, FIGURES, NOISE_PICTURE, RESIDUALS

_LEGEND = 2.05
_MOST_CHANNELS = 12


@style.themed
def recorded_noise_figure(record: KnownNoise, signs: style.RunSigns | None = None) -> style.Picture:
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
        "a good model 1. A ratio above 1 is scatter from row to row that the samples within a row do not show; below 1 "
        "scatter of the samples, such as a vibration, averages out within a row."
    )
    title = f"Fitted noise of {worst.channel} is {value} ± {sd} times the recorded noise"
    figure = style.picture(11.5, 3.5, title, caption)
    signs = signs if signs is not None else style.RunSigns(runs.tolist())
    style.runs_legend(figure, figure.inside[2] - _LEGEND + 0.3, signs)
    left, right = style.panels(figure, 1, 2, (0.75, 0.45, _LEGEND, 0.25), (1.1, 0.36), widths=(1.6, 1.0))[0]
    high = limit_of(scatter, 3.0)
    left.axhspan(-2, 2, color=style.BAND, linewidth=0, zorder=1)
    left.axhline(0, color=style.QUIET, linewidth=0.7, zorder=1.5)
    at, kept = np.arange(len(scatter), dtype=float), thinned(len(scatter))
    clipped = np.clip(scatter, -0.98 * high, 0.98 * high)
    style.at_runs(
        left, at[kept], clipped[kept], runs[kept], signs, markersize=4.2 if len(scatter) < 400 else 2.6, alpha=0.75
    )
    left.set(ylim=(-high, high), xlabel="row, in the order of the runs", ylabel="residual / recorded sd of the row")
    left.set_title(f"{worst.channel}: rows")
    _draw_ratios(right, shown)
    return figure


def _draw_ratios(axes, shown: list[NoiseComparison]) -> None:
    """Draw the ratio of each channel with ±2 standard uncertainties, on a logarithmic axis."""
    places = np.arange(len(shown))
    ratio = np.array([each.ratio for each in shown])
    factor = np.exp(2 * np.array([each.ratio_sd for each in shown]) / ratio)
    colours = [style.INK if each.agrees else (style.VERMILION if each.ratio > 1 else style.BLUE) for each in shown]
    axes.axvline(1.0, color=style.QUIET, linewidth=0.9, zorder=1.5)
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


_LEAST_INPUT = 1 / 3


@dataclass(frozen=True)
class FollowedCovariate:
    """The covariate that the change of a residual follows (n points).

    Attributes
    ----------
    at : shape (n,), its values.
    label : its name and unit, for the axis.
    over : shape (n,), the input, in the unit of the residual, if the residual over the input follows it.
    """

    at: np.ndarray
    label: str
    over: np.ndarray | None = None


@style.themed
def evidence_figure(evidence: ResidualEvidence, against: str, signs: style.RunSigns | None = None) -> style.Picture:
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
    divided = "" if over is None else " over its input, for inputs above a third of the largest"
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
        left.plot(at, explained, "D", color=style.INK, markersize=2.6, zorder=6)
        left.set_title("against its covariate" if evidence.covariate is not None else "row by row")
        left.set(xlabel=against, ylabel=f"residual / {pretty(shown)}")
    else:
        _over_input(left, evidence, over.input, names, signs)
        left.set(
            xlabel=against, ylabel="residual / input / ppm", title=f"over its input, against {over.covariate.phrase}"
        )
    right.axline((0, 0), slope=1, color=style.INK, linewidth=1.3, zorder=6)
    right.set_title(f"against the explained part; slope {significant(_slope(explained, residual))}")
    right.set(xlabel=f"explained / {pretty(shown)}", ylabel=f"residual / {pretty(shown)}")
    return figure


@style.themed
def before_after_figure(
    followed: FollowedCovariate,
    before: np.ndarray,
    after: np.ndarray,
    runs: Sequence[str],
    channel: str,
    unit: str,
    step: str,
    floor: float | None = None,
    signs: style.RunSigns | None = None,
    within: bool = False,
) -> style.Picture:
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
        divided, quantity = "over its input, for inputs above a third of the largest,", "residual / input / ppm"
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
            axes.axhspan(-floor * factor, floor * factor, color=style.BAND, linewidth=0, zorder=1)
        _cloud(axes, at, y, names, signs, high)
        draw_means(axes, at, y)
        axes.set_title(f"{word}: rms {significant(float(np.sqrt(np.nanmean(y**2))))} {pretty(shown)}")
        axes.set_xlabel(followed.label)
    grid[0].set_ylabel(quantity)
    return figure


@style.themed
def added_variable_figure(
    added: np.ndarray, residual: np.ndarray, runs: Sequence[str], effect: str, signs: style.RunSigns | None = None
) -> style.Picture:
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
        "without what the present model can absorb. Line: expected slope 1. A real effect shows the same slope "
        "in every run (colours by mounting or run); a spurious one depends on a few points of one run."
    )
    names = np.array(list(runs))
    figure = style.picture(7.2, 4.0, f"{effect}: consistency between runs", caption)
    signs = _signs(figure, names, signs)
    axes = style.panels(figure, 1, 1, (0.65, 0.45, _LEGEND + 0.1, 0.25))[0, 0]
    _cloud(axes, added, residual, names, signs, limit_of(residual, 3.0))
    axes.axline((0, 0), slope=1, color=style.INK, linewidth=1.3, zorder=6)
    axes.set_title(f"slope {significant(_slope(added, residual))}")
    axes.set(xlabel="explained by the effect / sd", ylabel="residual / sd")
    return figure


def _pair_of_panels(
    title: str, caption: str, runs: np.ndarray, signs: style.RunSigns | None
) -> tuple[style.Picture, style.RunSigns, np.ndarray]:
    figure = style.picture(11.5, 3.5, title, caption)
    return figure, _signs(figure, runs, signs), style.panels(figure, 1, 2, (0.75, 0.45, _LEGEND, 0.25))[0]


def _signs(figure: style.Picture, runs: np.ndarray, signs: style.RunSigns | None) -> style.RunSigns:
    """List the runs of a figure; return their signs, those of the runs themselves if none are given."""
    signs = signs if signs is not None else style.RunSigns(runs.tolist())
    style.runs_legend(figure, figure.inside[2] - _LEGEND + 0.3, signs, runs.tolist())
    return signs


def _over_input(
    axes: Axes, evidence: ResidualEvidence, stimulus: np.ndarray, runs: np.ndarray, signs: style.RunSigns
) -> None:
    """Draw the residual over the input in ppm, if the input is large enough not to magnify the noise."""
    large, divisor = _large_inputs(stimulus)
    ratio, explained = (1e6 * each[large] / divisor for each in (evidence.residual, evidence.explained))
    high = limit_of(np.concatenate([ratio, explained]), 1e-12)
    _cloud(axes, evidence.at[large], ratio, runs[large], signs, high)
    axes.plot(evidence.at[large], explained, "D", color=style.INK, markersize=2.6, zorder=6)


def _large_inputs(stimulus: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where the input is large enough not to magnify the noise, and the input there."""
    size = np.abs(stimulus)
    large = size >= _LEAST_INPUT * np.nanmax(size)
    return large, stimulus[large]


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    good = np.isfinite(x) & np.isfinite(y)
    return float(x[good] @ y[good] / max(float(x[good] @ x[good]), 1e-300))


def _cloud(axes: Axes, x: np.ndarray, y: np.ndarray, runs: np.ndarray, signs: style.RunSigns, high: float) -> None:
    good = np.isfinite(x) & np.isfinite(y)
    set_range(axes, x)
    axes.set_ylim(-high, high)
    axes.axhline(0, color=style.QUIET, linewidth=0.7, zorder=1.5)
    x, y, runs = x[good], np.clip(y[good], -0.98 * high, 0.98 * high), runs[good]
    kept = thinned(x.size)
    size = 4.2 if x.size < 400 else 2.6
    style.at_runs(axes, x[kept], y[kept], runs[kept], signs, markersize=size, alpha=0.75)


_LEVELS, _LEAST_SHARE, _TIME_LAST = 24, 0.15, 0.1
# A ratio to the input is shown if it determines clearly more than the plain residual.
_RATIO_LAST = 0.05
_BY_ROW = "row, in the order of the runs"


def save_evidence(folder: Path, evidence: ResidualEvidence) -> Path:
    """Draw the residual that shows a missing effect into the `figures` of its result folder; return the file."""
    covariate = evidence.covariate if evidence.over is None else evidence.over.covariate
    against = _label(covariate) if covariate is not None else _BY_ROW
    return _saved(folder, evidence_figure(evidence, against, _signs_of(folder)), DIAGNOSIS_PICTURE)


def _label(covariate: Covariate | ResidualCovariate | CovariateLabel) -> str:
    return covariate.phrase + (f" / {pretty(covariate.unit)}" if covariate.unit else "")


def save_recorded_noise(folder: Path, record: KnownNoise) -> Path:
    """Draw fitted against recorded noise into the `figures` of a result folder; return the file."""
    return _saved(folder, recorded_noise_figure(record, _signs_of(folder)), NOISE_PICTURE)


def _signs_of(folder: Path) -> style.RunSigns | None:
    """Return the signs of the runs of a result folder; None if it has no residuals."""
    file = folder / RESIDUALS
    return style.run_signs(pl.read_parquet(file)) if file.is_file() else None


def _saved(folder: Path, drawn: style.Picture, name: str) -> Path:
    target = folder / FIGURES
    target.mkdir(exist_ok=True)
    return drawn.save(target / name)


def before_after(
    before: pl.DataFrame,
    after: pl.DataFrame,
    step: str,
    floors: Mapping[str, float] | None = None,
    group: EffectGroup | None = None,
) -> style.Picture | None:
    """Return the residual of the channel that changed most against its covariate; None if the tables do not match.

    Parameters
    ----------
    before, after : `residuals.parquet` of two fits of one campaign.
    step : between the fits, such as ``adding gyro_bias_drift``.
    floors : channel → noise of one row, input units.
    group : of the diagnosis before, whose channel and covariate are shown; without it those that changed most.  If
        its residual is about the mean of each run, so are both.
    """
    keys = ["run", "row", "channel"]
    joined = before.join(after.select([*keys, pl.col("input_residual").alias("after")]), on=keys, how="inner")
    joined = joined.filter(~pl.col("channel").str.starts_with("closure_"))
    if not joined.height:
        return None
    change = ((pl.col("input_residual") - pl.col("after")) / pl.col("input_sd")) ** 2
    channel = joined.group_by("channel").agg(change.sum().alias("worth")).sort("worth")["channel"][-1]
    if group is not None and group.residual.channel in joined["channel"].unique().to_list():
        channel = group.residual.channel
    named = group.covariate if group is not None else None
    own = joined.filter(pl.col("channel") == channel)
    before_own, after_own = own["input_residual"].to_numpy(), own["after"].to_numpy()
    runs, within = own["run"].to_numpy(), group is not None and group.within
    if within:
        before_own, after_own = (each - of_runs(each, runs) for each in (before_own, after_own))
    if named is not None and named.name in INPUTS.values() and "input_observed" in own.columns:
        followed = FollowedCovariate(residual_columns.numbers(own, "input_observed"), _label(named))
    else:
        followed = followed_covariate(own, before_own - after_own, named.name if named is not None else None)
    return before_after_figure(
        followed, before_own, after_own, runs.tolist(), channel, own["input_unit"][0], step,
        (floors or {}).get(channel), style.run_signs(before), within,
    )  # fmt: skip


def followed_covariate(own: pl.DataFrame, change: np.ndarray, named: str | None = None) -> FollowedCovariate:
    """Return the covariate that a change follows best, by the means of its levels; the row if it follows none.

    One that is named goes first if the table has it; time, along which everything changes, goes last.  If the
    change over the input follows a covariate clearly better than the change itself follows any, that one is returned
    with the input: a change of the scale factor with temperature, in rows of both signs of the input.
    """
    stimulus = residual_columns.numbers(own, "input_observed")
    best, followed = _LEAST_SHARE, FollowedCovariate(np.arange(own.height, dtype=float), _BY_ROW)
    for covariate in shown():
        x = residual_columns.numbers(own, covariate.column)
        late = _TIME_LAST if covariate.si == "s" else 0.0
        shares = (_share(x, change) + (2.0 if covariate.column == named else 0.0), _share_of_ratio(x, change, stimulus))
        for share, over in ((shares[0], None), (shares[1] - _RATIO_LAST, stimulus)):
            if share - late > best:
                best, followed = share - late, FollowedCovariate(x, _label(covariate), over)
    return followed


def _share(x: np.ndarray, y: np.ndarray) -> float:
    """Return the share of the variance of y between levels of x, less what chance gives."""
    return _share_of_ratio(x, y, np.ones(len(y)))


def _share_of_ratio(x: np.ndarray, y: np.ndarray, stimulus: np.ndarray) -> float:
    """Return the share of the variance of y that a ratio y/stimulus by levels of x gives, less what chance gives.

    It is 0 if one ratio for all levels gives as much.
    """
    good = np.isfinite(x) & np.isfinite(stimulus)
    if good.sum() < 0.6 * len(x) or np.ptp(x[good]) == 0:
        return 0.0
    x, y, stimulus = x[good], y[good], stimulus[good]
    edges = np.unique(np.quantile(x, np.linspace(0, 1, min(_LEVELS, max(3, len(x) // 6)) + 1)))
    level = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    weight = np.bincount(level, stimulus**2, len(edges) - 1)
    product = np.bincount(level, stimulus * y, len(edges) - 1)
    whole, squares = float(np.sum((y - y.mean()) ** 2)), float(y @ y)
    rest = squares - float(np.sum(product**2 / np.where(weight > 0, weight, np.inf)))
    constant = squares - (float(product.sum() ** 2 / weight.sum()) if weight.sum() > 0 else 0.0)
    chance = (len(edges) - 2) * rest / max(len(x) - len(edges) + 1, 1)
    if whole <= 0 or constant - rest - chance <= _LEAST_SHARE * whole:
        return 0.0
    return 1 - (rest + chance) / whole


def added_variable(table: pl.DataFrame, added: str, residuals: pl.DataFrame | None = None) -> style.Picture | None:
    """Return the added-variable plot of an addition; None if it has no points.

    `residuals` of the same campaign determine the mountings and temperatures of its runs.
    """
    if not table.height:
        return None
    signs = None if residuals is None else style.run_signs(residuals)
    columns = (table["added"].to_numpy(), table["residual"].to_numpy(), table["run"].to_list())
    return added_variable_figure(*columns, added, signs)

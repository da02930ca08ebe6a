"""Measurement with model and 95 % band, for one run."""

from collections.abc import Sequence

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from imubayes.covariates import Covariate, shown
from imubayes.display.figures.panels import abscissa, chosen_channels, limit_of, set_abscissa, thinned
from imubayes.display.labels import covariate, numbers, ordered, pretty, readable, varies
from imubayes.display.marks import band, level, line, points
from imubayes.display.theme import (
    BAND_WIDE,
    BLUE,
    INK,
    QUIET,
    VERMILION,
    Picture,
    axes_at,
    picture,
    themed,
)
from imubayes.display.ticks import frame
from imubayes.procedures import Procedure, Reduction, procedure_named

_PITCH = 3.0
_NORMAL = 1.959964  # 97.5 % point of the standard normal
_MODEL_BAND = "#f3c9a8"
_GOOD = (
    "Upper panels: measurement over model. Lower panels: measurement less model, in input units. A good model has 95 % "
    "of the points inside the light band (noise, run offset and model together) without a trend; the points of one run "
    "may lie off zero together, by the run's own offset. The orange band is the model's own 95 % uncertainty."
)


@themed
def measurement_figure(residuals: pl.DataFrame, run: str, channels: Sequence[str] | None = None) -> Picture:
    """Return measurement, model and residual of one run, a pair of panels per channel.

    Parameters
    ----------
    residuals : the content of `residuals.parquet`.
    run : its name.
    channels : at most six; without a choice those of the largest residuals.
    """
    recorded = residuals.filter(pl.col("run") == run)
    if recorded.is_empty():
        raise ValueError(f"no residuals of run '{run}'; there are {', '.join(ordered(residuals, 'run'))}")
    names, left_out = chosen_channels(recorded, channels)
    recorded = recorded.filter(pl.col("channel").is_in(names))
    against = driver(recorded)
    columns = min(len(names), 3)
    lines = -(-len(names) // 3)
    width = {1: 8.0, 2: 10.5, 3: 13.0}[columns]
    x_all, label = abscissa(numbers(recorded, against.column), against)
    phrase = against.phrase
    procedure = _procedure(recorded)
    if against.column == "row" and procedure.row_name != "row":
        phrase = label = procedure.row_name
    figure = picture(
        width,
        lines * _PITCH + 0.4,
        run,
        f"{_GOOD} {left_out}".strip(),
        f"{procedure.name.replace('_', ' ')}, against {phrase}",
    )
    left, _, right, top = figure.inside
    across = (right - left) / columns
    turns = against.unit == "deg"
    for place, name in enumerate(names):
        mask = (recorded.get_column("channel") == name).to_numpy()
        own, x = recorded.filter(pl.Series(mask)), x_all[mask]
        corner = left + (place % 3) * across + 0.8
        base = top - (place // 3 + 1) * _PITCH
        upper = axes_at(figure, corner, base + 1.38, across - 0.95, 1.32)
        lower = axes_at(figure, corner, base + 0.08, across - 0.95, 1.2)
        for axes in (upper, lower):
            set_abscissa(axes, x_all, against)
        _measured(upper, own, x)
        unit = _remaining(lower, own, x)
        frame(upper, 6, 5, None, pretty(own.get_column("output_unit")[0] or ""), turns=turns)
        frame(lower, 6, 4, label if place + 3 >= len(names) else None, unit, turns=turns)
    _legend(figure)
    return figure


def driver(recorded: pl.DataFrame) -> Covariate:
    """Return what drives a run: the covariate its procedure varies, as far as it is there and varies."""
    keys = (*_procedure(recorded).abscissae, *(known.name for known in shown()))
    for key in dict.fromkeys(keys):
        one = covariate(key)
        values = numbers(recorded, one.column)
        if key == "row" or (varies(values) and np.isfinite(values).mean() > 0.9):
            return one
    return covariate("row")


def _procedure(recorded: pl.DataFrame) -> Procedure:
    return procedure_named(str(recorded.get_column("procedure")[0]))


def _measured(axes: Axes, own: pl.DataFrame, x: np.ndarray) -> None:
    observed, predicted = numbers(own, "observed"), numbers(own, "predicted")
    wide = _NORMAL * np.hypot(numbers(own, "sd"), np.nan_to_num(numbers(own, "model_sd")))
    order = np.argsort(x, kind="stable")
    band(axes, x[order], (predicted - wide)[order], (predicted + wide)[order], BAND_WIDE)
    if _procedure(own).reduction is Reduction.POSES or x.size < 2:
        points(axes, x, predicted, "_", 9, VERMILION, markeredgewidth=1.4)
    else:
        line(axes, x[order], predicted[order], color=VERMILION)
    kept = thinned(x.size)
    points(axes, x[kept], observed[kept], "o", 4, BLUE, alpha=0.85, zorder=3)
    _set_ordinate(axes, x, observed, predicted, float(np.nanmax(wide)))
    axes.set_title(own.get_column("channel")[0])


def _set_ordinate(axes: Axes, x: np.ndarray, observed: np.ndarray, predicted: np.ndarray, wide: float) -> None:
    """Let the panel show the model's shape: not less than three bands high, logarithmic where the rates are."""
    both = np.concatenate([observed[np.isfinite(observed)], predicted - wide, predicted + wide])
    low, high = float(both.min()), float(both.max())
    if axes.get_xscale() == "symlog":
        inner = float(np.max(np.abs(predicted[np.abs(x) == np.min(np.abs(x[x != 0]))])))
        largest = max(abs(low), abs(high))
        if 0 < inner < largest / 30:
            axes.set_yscale("symlog", linthresh=10.0 ** np.ceil(np.log10(inner)), linscale=0.6)
            axes.set_ylim(-2 * largest if low < -inner else -inner, 2 * largest if high > inner else inner)
            return
    middle, half = 0.5 * (low + high), max(0.53 * (high - low), 3 * wide) or 1.0
    axes.set_ylim(middle - half, middle + half)


def _remaining(axes: Axes, own: pl.DataFrame, x: np.ndarray) -> str:
    """Draw residual and bands in input units; the factor to input units is that of the row itself."""
    y, sd = numbers(own, "input_residual"), numbers(own, "input_sd")
    output_sd = numbers(own, "sd")
    with np.errstate(divide="ignore", invalid="ignore"):
        model = numbers(own, "model_sd") * np.where(output_sd > 0, sd / output_sd, np.nan)
    factor, unit = readable(own.get_column("input_unit")[0] or "", float(np.nanmedian(sd)))
    y, sd, model = y * factor, sd * factor, np.nan_to_num(model * factor)
    order = np.argsort(x, kind="stable")
    wide = _NORMAL * np.hypot(sd, model)[order]
    narrow = _NORMAL * model[order]
    place = x[order]
    low, high = axes.get_xlim()
    place = np.concatenate([[low], place, [high]])
    for half, colour in ((wide, BAND_WIDE), (narrow, _MODEL_BAND)):
        half = np.concatenate([half[:1], half, half[-1:]])
        band(axes, place, -half, half, colour)
    level(axes, 0, VERMILION, 1.0)
    limit = limit_of(y, 1.25 * float(np.nanmax(wide)))
    kept = thinned(x.size)
    drawn = np.clip(y[kept], -0.97 * limit, 0.97 * limit)
    points(axes, x[kept], drawn, "o", 4, BLUE, alpha=0.85, zorder=3)
    axes.set_ylim(-limit, limit)
    return pretty(unit)


def _legend(figure: Picture) -> None:
    handles = [
        Line2D([], [], marker="o", color=BLUE, linestyle="", markersize=5, label="measured"),
        Line2D([], [], color=VERMILION, label="model"),
        Patch(color=_MODEL_BAND, label="model, 95 %"),
        Patch(color=BAND_WIDE, label="measurement, 95 %"),
    ]
    width, height = figure.get_size_inches()
    figure.legend(
        handles=handles, loc="upper right", bbox_to_anchor=(1 - 0.2 / width, 1 - 0.02 / height), ncols=4,
        labelcolor=INK, handlelength=1.4, columnspacing=1.2, borderaxespad=0.6, edgecolor=QUIET,
    )  # fmt: skip

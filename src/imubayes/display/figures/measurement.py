"""Figures of a run: measurement with model and 95 % band, and the gyro bias under rotation modulation.

Under rotation modulation the bias vector across the axis averages out, and its component along the axis stays.
"""

from collections.abc import Sequence

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from imubayes.display import figure_style as style
from imubayes.display import residual_columns
from imubayes.display.figures import panels
from imubayes.display.numbers_and_labels import covariate, pretty, readable
from imubayes.foundations.covariates import Covariate, shown
from imubayes.procedures import Procedure, procedure_named

_PITCH = 3.0
_SAME_LEVEL, _MOST_LEVELS = 0.01, 30  # share of the largest rate within which rates are one level; levels of a test
_MODEL_BAND = "#f3c9a8"
_GOOD = (
    "Upper panels: measurement and model. Lower panels: residual in input units. In a good model 95 % of the points "
    "lie within the light band (noise, run offset and model uncertainty combined) without a trend; the points of a run "
    "may share its offset. Orange band: 95 % uncertainty of the model alone."
)


@style.themed
def measurement_figure(residuals: pl.DataFrame, run: str, channels: Sequence[str] | None = None) -> style.Picture:
    """Return measurement, model and residual of one run, a pair of panels per channel.

    Parameters
    ----------
    residuals : the content of `residuals.parquet`.
    run : its name.
    channels : at most six; without a choice those of the largest residuals.
    """
    recorded = residuals.filter(pl.col("run") == run)
    if recorded.is_empty():
        raise ValueError(
            f"no residuals of run '{run}'; there are {', '.join(residual_columns.ordered(residuals, 'run'))}"
        )
    names, left_out = panels.chosen_channels(recorded, channels)
    recorded = recorded.filter(pl.col("channel").is_in(names))
    against = driver(recorded)
    columns = min(len(names), 3)
    lines = -(-len(names) // columns)
    x_all, label = panels.abscissa(residual_columns.numbers(recorded, against.column), against)
    procedure, phrase = _procedure(recorded), against.phrase
    if against.column == "row" and procedure.row_name != "row":
        phrase = label = procedure.row_name
    subtitle = f"{procedure.name.replace('_', ' ')}, against {phrase}"
    width = {1: 8.0, 2: 10.5, 3: 13.0}[columns]
    figure = style.picture(width, lines * _PITCH + 0.4, run, f"{_GOOD} {left_out}".strip(), subtitle)
    grid = style.panels(figure, 2 * lines, columns, (0.8, 0.48, 0.15, 0.3), (0.95, 0.25), share_x=True)
    for place, name in enumerate(names):
        mask = (recorded["channel"] == name).to_numpy()
        own, x = recorded.filter(pl.Series(mask)), x_all[mask]
        upper, lower = grid[2 * (place // columns) : 2 * (place // columns) + 2, place % columns]
        for axes in (upper, lower):
            panels.set_abscissa(axes, x_all, against)
        _measured(upper, own, x)
        _residual(lower, own, x)
        if place + columns >= len(names):
            lower.set_xlabel(label)
            lower.xaxis.set_visible(True)
            lower.tick_params(labelbottom=True)
    for axes in grid[-2:, len(names) - columns * (lines - 1) :].flat:
        axes.remove()
    model = Line2D([], [], color=style.VERMILION, label="model")
    bands = (Patch(color=_MODEL_BAND, label="model, 95 %"), Patch(color=style.BAND_WIDE, label="measurement, 95 %"))
    style.legend_above(figure, [style.dot(style.BLUE, "measured"), model, *bands])
    return figure


def driver(recorded: pl.DataFrame) -> Covariate:
    """Return what drives a run: the covariate its procedure varies, as far as it is there and varies.

    Of a table that swings neither rate nor angle alone drives all channels: its rows follow one another in time.
    """
    keys = (*_procedure(recorded).abscissae, *(each.name for each in shown()))
    if _swings(recorded):
        keys = ("time", *keys)
    for key in dict.fromkeys(keys):
        known = covariate(key)
        values = residual_columns.numbers(recorded, known.column)
        if key == "row" or (residual_columns.varies(values) and np.isfinite(values).mean() > 0.9):
            return known
    return covariate("row")


def _swings(recorded: pl.DataFrame) -> bool:
    """Return whether the rows have an angle while the table turns, at rates that are no levels."""
    own = recorded.filter(pl.col("channel") == recorded["channel"][0])
    rate, angle = (residual_columns.numbers(own, f"table_{name}") for name in ("rate_deg_s", "angle_deg"))
    turning = np.isfinite(rate) & (rate != 0)
    if not np.isfinite(angle[turning]).sum() > len(rate) / 2:
        return False
    return len(np.unique(np.round(rate[turning] / np.abs(rate[turning]).max() / _SAME_LEVEL))) > _MOST_LEVELS


def _procedure(recorded: pl.DataFrame) -> Procedure:
    return procedure_named(str(recorded.get_column("procedure")[0]))


def _measured(axes: Axes, own: pl.DataFrame, x: np.ndarray) -> None:
    observed, predicted = residual_columns.numbers(own, "observed"), residual_columns.numbers(own, "predicted")
    wide = residual_columns.band(own)
    order = np.argsort(x, kind="stable")
    band = ((predicted - wide)[order], (predicted + wide)[order])
    axes.fill_between(x[order], *band, color=style.BAND_WIDE, linewidth=0, zorder=1)
    if _procedure(own).reduction.by_hand or x.size < 2:
        axes.plot(x, predicted, "_", color=style.VERMILION, markersize=9, markeredgewidth=1.4)
    else:
        axes.plot(x[order], predicted[order], color=style.VERMILION)
    kept = panels.thinned(x.size)
    axes.plot(x[kept], observed[kept], "o", color=style.BLUE, markersize=4, alpha=0.85, zorder=3)
    _set_ordinate(axes, x, observed, predicted, float(np.nanmax(wide)))
    axes.set_title(own["channel"][0])
    axes.set_ylabel(pretty(own["output_unit"][0] or ""))


def _set_ordinate(axes: Axes, x: np.ndarray, observed: np.ndarray, predicted: np.ndarray, wide: float) -> None:
    """Show the shape of the model: at least three bands high, logarithmic if the rates are."""
    both = np.concatenate([observed[np.isfinite(observed)], predicted - wide, predicted + wide])
    low, high = float(both.min()), float(both.max())
    if axes.get_xscale() == "symlog":
        inner = float(np.max(np.abs(predicted[np.abs(x) == np.min(np.abs(x[x != 0]))])))
        largest = max(abs(low), abs(high))
        if 0 < inner < largest / 30:
            panels.set_symlog(axes, "y", 10.0 ** np.ceil(np.log10(inner)), 5)
            axes.set_ylim(-2 * largest if low < -inner else -inner, 2 * largest if high > inner else inner)
            return
    middle, half = 0.5 * (low + high), max(0.53 * (high - low), 3 * wide) or 1.0
    axes.set_ylim(middle - half, middle + half)


def _residual(axes: Axes, own: pl.DataFrame, x: np.ndarray) -> None:
    """Draw residual and bands in input units; the factor to input units is that of the row itself."""
    y, sd, output_sd = (residual_columns.numbers(own, name) for name in ("input_residual", "input_sd", "sd"))
    with np.errstate(divide="ignore", invalid="ignore"):
        model = residual_columns.numbers(own, "model_sd") * np.where(output_sd > 0, sd / output_sd, np.nan)
    factor, unit = readable(own["input_unit"][0] or "", float(np.nanmedian(sd)))
    y, sd, model = y * factor, sd * factor, np.nan_to_num(model * factor)
    order = np.argsort(x, kind="stable")
    low, high = axes.get_xlim()
    place = np.concatenate([[low], x[order], [high]])
    wide = residual_columns.NORMAL * np.hypot(sd, model)
    for half, colour in ((wide[order], style.BAND_WIDE), (residual_columns.NORMAL * model[order], _MODEL_BAND)):
        half = np.concatenate([half[:1], half, half[-1:]])
        axes.fill_between(place, -half, half, color=colour, linewidth=0, zorder=1)
    axes.axhline(0, color=style.VERMILION, linewidth=1.0, zorder=1.5)
    limit = panels.limit_of(y, 1.25 * float(np.nanmax(wide)))
    kept = panels.thinned(x.size)
    axes.plot(x[kept], np.clip(y[kept], -0.97 * limit, 0.97 * limit), "o", color=style.BLUE, markersize=4, alpha=0.85)
    axes.set_ylim(-limit, limit)
    axes.set_ylabel(pretty(unit))

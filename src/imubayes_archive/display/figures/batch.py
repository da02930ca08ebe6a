"""Pictures of a batch: calibrations over dates, pooled evidence by campaign, and before against after."""

from collections.abc import Sequence

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

from imubayes.display import figure_style as style
from imubayes.display.numbers_and_labels import pretty
from imubayes_archive.unit_fits.pooled_discovery import PooledDiscovery, PooledFinding

_MOST_ROWS, _MOST_PANELS, _MOST_UNITS = 20, 6, 60
# Standard uncertainties above so many times the median do not set the limits of an axis.
_VAGUE = 5.0
_DRIFT = (
    "Each point is one calibration: the estimate with its standard uncertainty, the prior of the model divided "
    "out; very uncertain ones may reach beyond the axis. Lines join the calibrations of one unit. Without drift these "
    "lines are level within the uncertainties."
)
_EVIDENCE = (
    "Natural logarithm of the evidence of each campaign: positive values favour the effect, negative ones oppose "
    "it. A unit with several calibrations has a bar for each, with its date. If the effect has the same size in all "
    "units, the bars refer to that common coefficient, otherwise to the coefficient of each campaign. Vermilion: units "
    "that have the effect with a probability above 0.9."
)
_CHANGE = (
    "Old against new estimate of each campaign in standard deviations of the change that the new model allows; "
    "vermilion: significant at a false discovery rate of 5 %. If the old model was complete, the points "
    "scatter about zero."
)


@style.themed
def drift_picture(estimates: pl.DataFrame, parameters: Sequence[str]) -> style.Picture:
    """Return the estimates of some parameters over the dates of the calibrations.

    Parameters
    ----------
    estimates : as `imubayes_archive.population.drift.dated_estimates` returns them.
    parameters : names; six at most are drawn.
    """
    chosen = list(parameters)[:_MOST_PANELS]
    rows = max(1, (len(chosen) + 1) // 2)
    figure = style.picture(11.0, 2.1 * rows + 0.5, "Calibrations over dates", _DRIFT)
    grid = style.panels(figure, rows, 2 if len(chosen) > 1 else 1, (0.8, 0.5, 0.1, 0.3), (0.9, 0.75))
    for axes in grid.flat[len(chosen) :]:
        axes.set_visible(False)
    for axes, name in zip(grid.flat, chosen, strict=False):
        table = estimates.filter((pl.col("parameter") == name) & pl.col("date").is_not_null()).sort("date")
        days = table["date"].cast(pl.Int32).to_numpy()  # since 1970, as Matplotlib counts them
        value, sd = table["estimate"].to_numpy(), table["estimate_sd"].to_numpy()
        owners = table["unit"].to_numpy()
        for unit in np.unique(owners):
            mine = owners == unit
            if mine.sum() > 1:
                axes.plot(days[mine], value[mine], color=style.VERMILION, linewidth=0.9, zorder=2)
        axes.errorbar(
            days, value, sd, linestyle="", marker="o", markersize=3, color=style.BLUE, elinewidth=0.6, zorder=3
        )
        _limit(axes, value, sd)
        unit = pretty(table["unit_of_measure"][0]) if table.height else ""
        axes.set_title(f"{name} / {unit}" if unit else name, loc="left", fontsize=9)
        locator = AutoDateLocator(maxticks=6)
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
        axes.set_xlabel("date of calibration")
    return figure


def _limit(axes: Axes, value: np.ndarray, sd: np.ndarray) -> None:
    """Bound an axis by the estimates that are well known: one vague estimate would flatten all others."""
    known = sd <= _VAGUE * np.median(sd) if len(sd) else np.zeros(0, bool)
    if known.all():
        return
    low, high = np.min((value - sd)[known]), np.max((value + sd)[known])
    margin = 0.08 * (high - low)
    axes.set_ylim(low - margin, high + margin)


@style.themed
def evidence_picture(found: PooledDiscovery, units: pl.DataFrame) -> style.Picture:
    """Return the evidence of every campaign for each effect found; of nothing if none was.

    Parameters
    ----------
    units : as `imubayes_archive.unit_fits.posterior_table.read_units` returns them.
    """
    rows = max(1, len(found.findings))
    figure = style.picture(11.0, 2.4 * rows + 0.3, "Pooled evidence by campaign", _EVIDENCE)
    grid = style.panels(figure, rows, 1, (0.7, 0.8, 0.1, 0.3), (0.8, 1.05))
    if not found.findings:
        grid[0, 0].text(0.5, 0.5, "no effect is missing that these units show together", ha="center", color=style.QUIET)
        grid[0, 0].set_axis_off()
    names = campaign_names(units)
    for axes, each in zip(grid[:, 0], found.findings, strict=False):
        _evidence_bars(axes, each, names)
    return figure


def campaign_names(units: pl.DataFrame) -> dict[str, str]:
    """Return the unit of each campaign by digest, with the date if the unit has several campaigns."""
    several = units.filter(pl.col("unit").is_duplicated() & pl.col("date").is_not_null())
    dates = dict(several.select("digest", "date").iter_rows())
    return {
        digest: f"{unit} {dates[digest]:%Y-%m}" if digest in dates else unit
        for digest, unit in units.select("digest", "unit").iter_rows()
    }


def _evidence_bars(axes: Axes, each: PooledFinding, names: dict[str, str]) -> None:
    """Draw one bar a campaign, the strongest first; the middle ones are left out if there are many."""
    ordered = sorted(each.every_unit, key=lambda unit: unit.gain, reverse=True)
    if len(ordered) > _MOST_UNITS:
        ordered = ordered[: _MOST_UNITS // 2] + ordered[-_MOST_UNITS // 2 :]
    heights = np.array([unit.gain for unit in ordered])
    named = np.array([unit.unit in each.named for unit in ordered])
    colours = np.where(named, style.VERMILION, np.where(heights > 0, style.BLUE, style.QUIET))
    axes.bar(np.arange(len(ordered)), heights, color=colours, width=0.8, zorder=3)
    axes.axhline(0, color=style.INK, linewidth=0.8, zorder=4)
    axes.set_xticks(np.arange(len(ordered)), [names[unit.digest] for unit in ordered], rotation=90, fontsize=6)
    axes.set(ylabel="log evidence", xlim=(-1, len(ordered)))
    left = len(each.every_unit) - len(ordered)
    note = f"; {left} in the middle are left out" if left else ""
    title = f"{' or '.join(each.effects[:3])}: vermilion units show it by themselves{note}"
    axes.set_title(title, loc="left", fontsize=9)


@style.themed
def change_picture(changes: pl.DataFrame) -> style.Picture:
    """Return the changes of every parameter from one model to another.

    Parameters
    ----------
    changes : schema `population.model_comparison.CHANGES`.
    """
    ranked = changes.group_by("parameter").agg(pl.col("p").min()).sort("p")["parameter"].to_list()[:_MOST_ROWS]
    figure = style.picture(11.0, 0.32 * max(len(ranked), 2) + 0.7, "Before and after: changes with the model", _CHANGE)
    axes = style.panels(figure, 1, 1, (2.6, 0.5, 0.3, 0.1))[0, 0]
    axes.axvspan(-2, 2, color=style.BAND_WIDE, zorder=0)
    axes.axvline(0, color=style.FAINT, zorder=1)
    random = np.random.default_rng(0)
    for row, name in enumerate(ranked):
        table = changes.filter(pl.col("parameter") == name)
        deviation = table["change_sd"].to_numpy()
        place = np.clip(table["change"].to_numpy() / np.where(deviation > 0, deviation, np.inf), -9.8, 9.8)
        colours = np.where(table["significant"].to_numpy(), style.VERMILION, style.BLUE)
        axes.scatter(place, row + random.uniform(-0.28, 0.28, len(place)), s=14, c=colours, linewidths=0, zorder=3)
    style.name_rows(axes, ranked)
    axes.set(ylim=(len(ranked) - 0.4, -0.6), xlim=(-10, 10), xlabel="change / standard deviation of the change")
    style.legend_above(figure, [style.dot(style.BLUE, "campaign"), style.dot(style.VERMILION, "significant")])
    return figure

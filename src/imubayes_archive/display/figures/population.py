"""Picture of a population: units of each parameter, alone and given the others, groups and outlying units marked."""

from collections.abc import Sequence

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from imubayes.display import figure_style as style
from imubayes.display import residual_columns
from imubayes.display.loop.diagnosis_sentences import probability
from imubayes.display.numbers_and_labels import pretty, shortened
from imubayes.foundations.errors import Issue, closest_first, refuse
from imubayes.results.unit_page import UNIT_LINK
from imubayes_archive.population.parameter_population import ParameterPopulation, Populations

_MOST_UNITS, _WIDE = 60, 0.5
_CAPTION = (
    "Each row is one unit, ordered by its value. Grey: its own estimate with standard uncertainty, the prior of its "
    "model divided out; a line leads to its estimate given the population, in the colour of its group, with standard "
    "uncertainty. Bands: one and two spreads of the first group about its mean. Units in vermilion are outlying at a "
    "false discovery rate of 5 %. Parameters are in the order in which their units deviate most."
)


@style.themed
def population_picture(found: Populations, units: pl.DataFrame, parameters: Sequence[str] = ()) -> style.Picture:
    """Return a panel for each parameter.

    Parameters
    ----------
    found, units : as `imubayes_archive.population.hierarchical_fit.HierarchicalFit` holds them.
    parameters : names of those to draw; the six that deviate most if there are none.
    """
    known = {each.parameter: each for each in drawn(found)}
    refuse(
        Issue(f"'{name}' has no population", "--parameter", closest_first(name, known), "name one of these")
        for name in parameters
        if name not in known
    )
    chosen = [known[name] for name in parameters if name in known] or ranked(list(known.values()))
    chosen = chosen[: style.MOST_PANELS]
    tables = [_rows(each, units) for each in chosen]
    rows = max(1, -(-len(chosen) // 3))
    height = max(1.6, 0.11 * max((table.height for table in tables), default=1) + 0.5)
    figure = style.picture(12.0, (height + 0.9) * rows, "Population of the units", _CAPTION,
                           "" if parameters else _left_out(known, chosen))  # fmt: skip
    grid = style.panels(figure, rows, min(3, max(1, len(chosen))), (0.8, 0.5, 0.2, 0.45), (0.95, 0.95))
    for axes in grid.flat[len(chosen) :]:
        axes.set_visible(False)
    for axes, each, table in zip(grid.flat, chosen, tables, strict=False):
        _panel(axes, each, table)
    style.legend_above(figure, _legend())
    return figure


def drawn(found: Populations) -> list[ParameterPopulation]:
    """Return the populations that can be drawn: those with a mean and a spread."""
    return [each for each in found.parameters if each.mean is not None and each.spread]


def ranked(found: Sequence[ParameterPopulation]) -> list[ParameterPopulation]:
    """Return populations ordered by what deviates: findings, then outlying units, derived quantities last."""

    def key(each: ParameterPopulation) -> tuple[bool, float, float]:
        findings = each.laws.findings if each.laws is not None else ()
        farthest = max((abs(unit.distance) for unit in each.outlying), default=0.0)
        return each.kind == "derived", -max((one.probability for one in findings), default=0.0), -farthest

    return sorted(found, key=key)


def _left_out(known: dict[str, ParameterPopulation], chosen: Sequence[ParameterPopulation]) -> str:
    left = len(known) - len(chosen)
    return f"{left} more parameters with --parameter" if left > 0 else ""


def _legend() -> list:
    return [
        Patch(color=style.BAND, label="±1 spread"), Patch(color=style.BAND_WIDE, label="±2 spreads"),
        style.dot(style.QUIET, "unit alone"), style.dot(style.BLUE, "given the population"),
        style.dot(style.VERMILION, "outlying", marker="D"), style.dot(style.INK, "not to be trusted", marker="X"),
    ]  # fmt: skip


def _rows(each: ParameterPopulation, units: pl.DataFrame) -> pl.DataFrame:
    """Return the units of a parameter in the order of their values; the middle ones are left out if there are many."""
    table = units.filter(pl.col("parameter") == each.parameter).sort("shrunk")
    if table.height > _MOST_UNITS:
        half = _MOST_UNITS // 2
        kept = pl.concat([table.head(half), table.tail(half)])
        outlying = table.filter(pl.col("outlying") & ~pl.col("digest").is_in(kept["digest"].to_list()))
        table = pl.concat([kept, outlying]).sort("shrunk")
    return table


def _panel(axes: Axes, each: ParameterPopulation, table: pl.DataFrame) -> None:
    own, own_sd, value, sd = (
        residual_columns.numbers(table, name) for name in ("estimate", "estimate_sd", "shrunk", "shrunk_sd")
    )
    place = np.arange(table.height)
    _bands(axes, each)
    colours = _colours(each, table)
    for row in place:
        if np.isfinite(own[row]):
            axes.plot([own[row], value[row]], [row, row], color=style.FAINT, linewidth=0.8, zorder=2)
    axes.errorbar(
        own, place, xerr=own_sd, linestyle="", marker="o", markersize=3, color=style.QUIET, elinewidth=0.6, zorder=2
    )
    for row in place:
        mark, _, bars = axes.errorbar(
            value[row], row, xerr=sd[row], marker=_marker(table, int(row)), markersize=4,
            color=colours[row], elinewidth=1.2, zorder=3,
        )  # fmt: skip
        for artist in (mark, *bars):
            artist.set_url(UNIT_LINK.format(table["digest"][int(row)]))
    _name_units(axes, table)
    _limits(axes, own, own_sd, value, sd)
    unit = pretty(each.unit_of_measure)
    axes.set_xlabel(unit if unit not in ("", "1") else "")
    axes.set_ylim(-1, table.height)
    axes.set_title(f"{shortened(each.parameter, 40)}{_said(each)}", loc="left", fontsize=9)


def _marker(table: pl.DataFrame, row: int) -> str:
    if not table["trusted"][row]:
        return "X"
    return "D" if table["outlying"][row] else "o"


def _said(each: ParameterPopulation) -> str:
    if each.laws is None or not each.laws.findings:
        return ""
    first = each.laws.findings[0]
    kind = first.kind if first.kind != "groups" else f"{len(first.groups)} groups"
    over = f" over {first.covariate}" if first.covariate else ""
    return f"\n{kind}{over}, probability {probability(first.probability)}"


def _bands(axes: Axes, each: ParameterPopulation) -> None:
    assert each.mean is not None
    assert each.spread is not None
    for width, colour in ((2, style.BAND_WIDE), (1, style.BAND)):
        ends = np.array([each.mean - width * each.spread, each.mean + width * each.spread])
        axes.axvspan(*(np.exp(ends) if each.scale == "log" else ends), color=colour, zorder=0)
    if _is_wide(each):
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_locator(NullLocator())


def _is_wide(each: ParameterPopulation) -> bool:
    """Whether the units of a scale differ by so much that its logarithm is drawn."""
    return each.scale == "log" and each.predictive_sd is not None and each.predictive_sd > _WIDE


def _colours(each: ParameterPopulation, table: pl.DataFrame) -> list[str]:
    """Return the colour of each unit: that of its group in the first finding, vermilion if it is outlying."""
    groups = each.laws.findings[0].groups if each.laws is not None and each.laws.findings else ()
    hues = [hue for hue in style.HUES if hue != style.VERMILION]
    of_unit = {unit: hues[place % len(hues)] for place, group in enumerate(groups) for unit in group.units}
    return [
        style.VERMILION if outlying else of_unit.get(unit, style.BLUE)
        for unit, outlying in table.select("unit", "outlying").iter_rows()
    ]


def _name_units(axes: Axes, table: pl.DataFrame) -> None:
    """Write the names of all units if there is room, else those of outlying ones."""
    names = table["unit"].to_list()
    if table.height > 2 * style.MOST_PANELS * 4:
        names = [name if outlying else "" for name, outlying in table.select("unit", "outlying").iter_rows()]
    axes.set_yticks(range(len(names)), [shortened(name, 12) for name in names], fontsize=6)
    for label, digest in zip(axes.get_yticklabels(), table["digest"], strict=True):
        label.set_url(UNIT_LINK.format(digest))
    axes.tick_params(axis="y", length=0)


def _limits(axes: Axes, own: np.ndarray, own_sd: np.ndarray, value: np.ndarray, sd: np.ndarray) -> None:
    """Bound the axis by what is well known: a unit that was hardly measured would flatten all others."""
    # On a logarithmic axis two standard deviations are a factor.
    if logarithmic := axes.get_xscale() == "log":
        ends = np.concatenate([value / (1 + 2 * sd / value), value + 2 * sd])
    else:
        ends = np.concatenate([value - 2 * sd, value + 2 * sd])
    known = np.isfinite(own) & (own_sd <= 5 * np.nanmedian(own_sd)) if np.isfinite(own_sd).any() else np.zeros(0, bool)
    ends = np.concatenate([ends, own[known] - own_sd[known], own[known] + own_sd[known]]) if known.any() else ends
    if logarithmic:
        ends = ends[ends > 0]
    low, high = float(np.min(ends)), float(np.max(ends))
    margin = 0.05 * (high - low)
    axes.set_xlim(0.9 * low if logarithmic else low - margin, high + margin)

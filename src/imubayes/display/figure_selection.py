"""Which pictures a result gets, in the order in which they tell its story: overview first, single runs last."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import polars as pl

from imubayes.covariates import Covariate
from imubayes.display.figures import (
    corner_figure,
    identifiability_figure,
    measurement_figure,
    prior_posterior_figure,
    residual_figure,
    run_chi2_figure,
)
from imubayes.display.figures.prior_posterior import mounting_quantities
from imubayes.display.goodness_of_fit import worst_first
from imubayes.display.labels import covariates_of, numbers, ordered, varies
from imubayes.display.theme import MOST_PANELS, Picture
from imubayes.results.result import Result

MOST_RUNS, MOST_CORNER = 24, 6
Plan = Iterator[tuple[str, Callable[[], Picture]]]


def plan(stored: Result, names: Sequence[str], draws: Mapping[str, Any]) -> Plan:
    """Yield a name and a way to draw for every picture, the overview first."""
    summary, residuals = stored.summary.model_dump(), stored.residuals.table
    runs = ordered(residuals, "run")
    if summary["runs"]:
        yield "fit-of-runs", lambda: run_chi2_figure(summary)
    for one in covariates_of(residuals):
        for page, channels in _pages(_channels_with(residuals, one)):
            yield (
                f"residuals-{one.name.replace('_', '-')}{page}",
                lambda one=one, channels=channels: residual_figure(residuals, one, channels, runs),
            )
    if any(one.get("from_data") is not None for one in (*summary["parameters"], *summary["derived"])):
        yield "identifiability", lambda: identifiability_figure(summary)
    if mounting_quantities(summary):
        yield "mounting-prior-posterior", lambda: prior_posterior_figure(summary)
    drawn = [name for name in names if name in draws]
    if drawn:
        yield "corner", lambda: corner_figure(draws, drawn, summary)
    for run, file in _files_of_runs(runs_shown(stored)):
        own = residuals.filter(pl.col("run") == run)
        for page, channels in _pages(ordered(own, "channel")):
            yield (
                f"run-{file}{page}",
                lambda own=own, run=run, channels=channels: measurement_figure(own, run, channels),
            )


def _channels_with(residuals: pl.DataFrame, one: Covariate) -> list[str]:
    """Return the channels whose rows have a covariate that varies; closing rotations have hardly any."""
    names = ordered(residuals, "channel")
    return [name for name in names if varies(numbers(residuals.filter(pl.col("channel") == name), one.column))]


def _pages(channels: Sequence[str]) -> list[tuple[str, list[str]]]:
    pages = [list(channels[start : start + MOST_PANELS]) for start in range(0, len(channels), MOST_PANELS)]
    return [(f"-{number}" if len(pages) > 1 else "", page) for number, page in enumerate(pages, 1)]


def runs_shown(stored: Result) -> list[str]:
    """Return the runs that get a picture of their own: all, or those that fit worst where there are many."""
    runs = ordered(stored.residuals.table, "run")
    if len(runs) <= MOST_RUNS:
        return runs
    ranked = [name for name in worst_first(stored.summary.model_dump()) if name in runs]
    kept = set((ranked + [name for name in runs if name not in ranked])[:MOST_RUNS])
    return [name for name in runs if name in kept]


def _files_of_runs(runs: Sequence[str]) -> list[tuple[str, str]]:
    """Return a file name for each run: its own, where that is one, and different from all others."""
    taken: set[str] = set()
    found = []
    for run in runs:
        plain = "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "_" for c in run)[:80]
        name, number = plain, 2
        while name.lower() in taken:
            name, number = f"{plain}_{number}", number + 1
        taken.add(name.lower())
        found.append((run, name))
    return found


def corner_choice(summary: Mapping[str, Any], most: int = MOST_CORNER) -> list[str]:
    """Return the quantities whose joint posterior tells most.

    Scale factor and mounting angle of one channel are told apart only by combining runs, and only where the axis is
    neither along nor across the rotation: those with the least from the data come first, each with its scale factor.
    """
    derived = [one for one in summary["derived"] if one.get("sd")]
    angles = [one for one in derived if one["name"].startswith("mounting_angle[")]
    oblique = [one for one in angles if 10 < abs(one["mean"]) % 90 < 80]
    scales = {one["name"][len("scale_factor[") : -1]: one["name"] for one in derived if _is_scale(one["name"])}
    chosen: list[str] = []
    for one in sorted(oblique or angles, key=_from_data)[: most // 2]:
        channel = one["name"].partition("[")[2].partition(",")[0]
        chosen += [one["name"], *([scales[channel]] if channel in scales else [])]
    rest = sorted((one for one in derived if _is_scale(one["name"])), key=_from_data)
    chosen += [one["name"] for one in rest]
    if len(dict.fromkeys(chosen)) < 2:
        parameters = [one for one in summary["parameters"] if one.get("sd") and not one.get("nuisance")]
        loose = [one for one in parameters if _from_data(one) > 0.1]
        chosen += [one["name"] for one in sorted(loose, key=_from_data)]
    unique = set(list(dict.fromkeys(chosen))[:most])
    in_order = [one["name"] for one in (*summary["parameters"], *derived) if one["name"] in unique]
    return sorted(in_order, key=_is_scale)


def _is_scale(name: str) -> bool:
    return name.startswith("scale_factor[")


def _from_data(one: Mapping[str, Any]) -> float:
    share = one.get("from_data")
    return 1.0 if share is None else float(share)

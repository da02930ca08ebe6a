"""The figures of a result: overview first, single runs last."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl

from imubayes.display import figures
from imubayes.display.figure_style import MOST_PANELS, Picture
from imubayes.display.figures.panels import neighbour_means
from imubayes.display.figures.prior_posterior import mounting_quantities
from imubayes.display.fit_cautions import worst_first
from imubayes.display.named_covariate import OBSERVED
from imubayes.display.residual_columns import covariates_of, numbers, ordered, varies
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.covariates import INPUTS, Covariate
from imubayes.foundations.quantity_names import MOUNTING_ANGLE, SCALE_FACTOR, QuantityName, family_of, name_of
from imubayes.results.summary import Quantity, Summary
from imubayes.results.temperature_range import ThermalModel

MOST_RUNS, MOST_CORNER = 6, 6
# Pairs correlated less have joint regions that their intervals already show; those correlated more are one quantity
# under two names.
_CORRELATED, _SAME = 0.5, 0.9999
Plan = Iterator[tuple[str, Callable[[], Picture]]]


def plan(
    summary: Summary,
    residuals: pl.DataFrame,
    names: Sequence[str],
    draws: Mapping[str, Any],
    chosen: Sequence[str],
    campaign: Campaign | None = None,
    thermal: ThermalModel | None = None,
    named: Covariate | None = None,
) -> Plan:
    """Yield a name and a function that draws it for every figure, the overview first.

    Parameters
    ----------
    names, draws : quantities of the corner plot, and their draws.
    chosen : runs that have a figure each.
    named : the covariate that the diagnosis names.
    """
    runs = ordered(residuals, "run")
    if summary.runs:
        yield "fit-of-runs", lambda: figures.run_chi2_figure(summary)
    for covariate in _abscissae(residuals, named):
        for page, channels in _pages(_channels_with(residuals, covariate)):
            yield (
                f"{_against(covariate)}{page}",
                lambda covariate=covariate, channels=channels: figures.residual_figure(
                    residuals, covariate, channels, runs
                ),
            )
    if any(entry.from_data is not None for entry in (*summary.parameters, *summary.derived)):
        yield "identifiability", lambda: figures.identifiability_figure(summary)
    if mounting_quantities(summary):
        yield "mounting-prior-posterior", lambda: figures.prior_posterior_figure(summary)
    drawn = [name for name in names if name in draws]
    if drawn:
        yield "corner", lambda: figures.corner_figure(draws, drawn, summary)
    if campaign is not None:
        yield from _of_campaign(campaign, draws, thermal)
    for run, file in _files_of_runs(chosen):
        own = residuals.filter(pl.col("run") == run)
        for page, channels in _pages(ordered(own, "channel")):
            yield (
                f"run-{file}{page}",
                lambda own=own, run=run, channels=channels: figures.measurement_figure(own, run, channels),
            )


def _of_campaign(campaign: Campaign, draws: Mapping[str, Any], thermal: ThermalModel | None) -> Plan:
    """Yield the figures that take the runs as they were recorded."""
    courses = {} if thermal is None else figures.thermal_courses(campaign, draws, thermal)
    if courses:
        yield "temperature", lambda: figures.temperature_figure(campaign, courses)
    for page, pairs in _pages(figures.mounted_pairs(campaign)):
        yield f"mountings{page}", lambda pairs=pairs: figures.mounting_sketch_figure(campaign, pairs)
    if any(run.start is not None for run in campaign.runs):
        yield "campaign-timeline", lambda: figures.campaign_timeline_figure(campaign)


def most_telling_first(
    names: Sequence[str],
    summary: Summary,
    residuals: pl.DataFrame,
    chosen: Sequence[str],
    named: Covariate | None = None,
) -> list[str]:
    """Return the names of figures in the order in which to look at them.

    The map of χ², the residuals against the covariate that the diagnosis names, or against that with the clearest
    pattern, the run that fits worst, the true mounting angles, and what the data determined; then all others.
    """
    covariates = sorted(
        _abscissae(residuals, named), key=lambda each: -np.inf if each == named else -pattern(residuals, each)
    )
    files = dict(_files_of_runs(chosen))
    worst = [f"run-{files[run]}" for run in worst_first(summary) if run in files]
    wanted = [
        "fit-of-runs", *map(_against, covariates[:1]), *worst[:1], "mounting-prior-posterior", "identifiability",
        "temperature", "mountings", "corner", "campaign-timeline", *map(_against, covariates[1:]), *worst[1:],
    ]  # fmt: skip
    place = {name: number for number, name in reversed(list(enumerate(wanted)))}
    return sorted(names, key=lambda name: place.get(name, place.get(name.rpartition("-")[0], len(wanted))))


def _abscissae(residuals: pl.DataFrame, named: Covariate | None) -> list[Covariate]:
    known = covariates_of(residuals)
    return known if named is None or named in known else [named, *known]


def pattern(residuals: pl.DataFrame, covariate: Covariate) -> float:
    """Return how clearly whitened residuals follow a covariate.

    This is the largest (χ² − k)/√2k of a channel, χ² of the means of k groups of neighbouring points.
    """
    clearest = 0.0
    for channel in _channels_with(residuals, covariate):
        own = residuals.filter(pl.col("channel") == channel)
        _, mean, error = neighbour_means(numbers(own, covariate.column), numbers(own, "whitened"))
        known = error > 0
        count = int(known.sum())
        if count:
            clearest = max(clearest, float((np.sum((mean[known] / error[known]) ** 2) - count) / np.sqrt(2 * count)))
    return clearest


def _against(covariate: Covariate) -> str:
    return f"residuals-{covariate.name.replace('_', '-')}"


def _channels_with(residuals: pl.DataFrame, covariate: Covariate) -> list[str]:
    """Return the channels whose rows have a covariate that varies; closing rotations lack most."""
    if covariate.column == OBSERVED:
        residuals = residuals.filter(pl.col("kind").replace_strict(INPUTS, default=None) == covariate.name)
    names = ordered(residuals, "channel")
    return [name for name in names if varies(numbers(residuals.filter(pl.col("channel") == name), covariate.column))]


def _pages[T](panels: Sequence[T]) -> list[tuple[str, list[T]]]:
    """Return what the panels of each page show, with the ending of its name."""
    pages = [list(panels[start : start + MOST_PANELS]) for start in range(0, len(panels), MOST_PANELS)]
    return [(f"-{number}" if len(pages) > 1 else "", page) for number, page in enumerate(pages, 1)]


def runs_shown(summary: Summary, residuals: pl.DataFrame) -> list[str]:
    """Return the runs that get a figure of their own if none are named: all, or of many those that fit worst."""
    runs = ordered(residuals, "run")
    if len(runs) <= MOST_RUNS:
        return runs
    ranked = [name for name in worst_first(summary) if name in runs]
    kept = set((ranked + [name for name in runs if name not in ranked])[:MOST_RUNS])
    return [name for name in runs if name in kept]


def _files_of_runs(runs: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield a file name for each run: its own, if that is one, and different from all others."""
    taken: set[str] = set()
    for run in runs:
        plain = "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "_" for c in run)[:80]
        name, number = plain, 2
        while name.lower() in taken:
            name, number = f"{plain}_{number}", number + 1
        taken.add(name.lower())
        yield run, name


def corner_choice(summary: Summary, draws: Mapping[str, np.ndarray], most: int = MOST_CORNER) -> list[str]:
    """Return the quantities whose joint posterior is most informative.

    These are the most correlated pairs of derived quantities, then of parameters: their single intervals hide that only
    a combination is determined.  If few pairs are correlated, scale factor and mounting angle of one channel, which
    are separated only by combining runs, and only if the axis is inclined to the axis of rotation: the angles with
    the least from the data come first, each with its scale factor.

    Parameters
    ----------
    draws : of the quantities, (n,) each, by name; those that are missing are not looked at.
    most : number of quantities.
    """
    of_interest = [entry.name for entry in summary.parameters if not entry.nuisance]
    derived = [entry.name for entry in summary.derived if not entry.repeats_misalignments]
    chosen = _correlated(derived, draws) + _correlated(of_interest, draws)
    if len(chosen) < 2:
        chosen = _angles_with_scales(summary, most // 2)
    if len(chosen) < 2:
        chosen += _least_determined(summary)
    kept = set(chosen[:most])
    in_order = [entry.name for entry in (*summary.parameters, *summary.derived) if entry.name in kept]
    return sorted(in_order, key=_is_scale)


def _correlated(names: Sequence[str], draws: Mapping[str, np.ndarray]) -> list[str]:
    """Return the quantities of pairs that are correlated, the most correlated pair first; each is in one pair."""
    known = [name for name in names if name in draws and np.ptp(draws[name]) > 0]
    if len(known) < 2:
        return []
    strength = np.triu(np.abs(np.corrcoef([draws[name] for name in known])), 1)
    strength[strength > _SAME] = 0.0
    chosen: list[str] = []
    for place in np.argsort(-strength, axis=None, kind="stable"):
        first, second = np.unravel_index(place, strength.shape)
        if strength[first, second] < _CORRELATED:
            break
        if known[first] not in chosen and known[second] not in chosen:
            chosen += [known[first], known[second]]
    return chosen


def _angles_with_scales(summary: Summary, most: int) -> list[str]:
    derived = sorted((entry for entry in summary.derived if entry.sd), key=_from_data)
    scales = [entry.name for entry in derived if _is_scale(entry.name)]
    pairs = [name for angle in _angles(derived)[:most] for name in (angle, _scale_of(angle)) if name]
    return list(dict.fromkeys(name for name in (*pairs, *scales) if not _is_scale(name) or name in scales))


def _least_determined(summary: Summary) -> list[str]:
    loose = [entry for entry in summary.parameters if entry.sd and not entry.nuisance and _from_data(entry) > 0.1]
    return [entry.name for entry in sorted(loose, key=_from_data)]


def _angles(derived: Sequence[Quantity]) -> list[str]:
    """Return the mounting angles, only the inclined axes if there are any."""
    angles = [entry for entry in derived if family_of(entry.name) == MOUNTING_ANGLE and entry.mean is not None]
    inclined = [entry for entry in angles if 10 < abs(entry.mean or 0.0) % 90 < 80]
    return [entry.name for entry in inclined or angles]


def _scale_of(angle: str) -> str:
    return name_of(SCALE_FACTOR, QuantityName.of(angle).first)


def _is_scale(name: str) -> bool:
    return family_of(name) == SCALE_FACTOR


def _from_data(entry: Quantity) -> float:
    return 1.0 if entry.from_data is None else entry.from_data

"""From the table of a batch to the population of every parameter, and to what is known of each unit given the others.

A unit counts once, with its latest calibration: two calibrations of one unit are not two draws from the population.
Parameters are taken on the scale on which their prior is normal, or nearly: as they are, or as logarithms.  A prior
that is neither normal nor lognormal is replaced by the one with its mean and standard deviation; for a parameter that
the data determine this matters little, and the others carry no information.  Each parameter is treated by itself,
with its marginal posterior: correlations between parameters of a unit are not used.

Structure comes first: groups of units, steps, trends and covariates (`imubayes.batch.population_search`) are taken out
of the estimates, and mean and spread are those of the units within a group.  A noise scale is taken as its logarithm,
and its population has the prior of the model on its mean: few units determine a noise scale, and those that do not
still bound it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np
import polars as pl

from imubayes.batch.archive_covariates import covariates_of
from imubayes.batch.noise_scale_population import ScaleLikelihoods, scale_population
from imubayes.batch.population import (
    LEAST_UNITS,
    Population,
    ShrunkUnits,
    UnitPosteriors,
    compared,
    population,
    population_of,
    shrunk,
)
from imubayes.batch.population_findings import PopulationLaws, laws_of
from imubayes.batch.population_search import Structure, UnitCovariate, search
from imubayes.batch.population_structure import UnitEstimates
from imubayes.foundations.records import Record, finite

Scale = Literal["linear", "log"]
StatedPriors = Mapping[str, tuple[float, float]]
"""Mean and standard deviation of the prior of a model by parameter, on the scale of its population."""
# Relative agreement of (sd/prior sd)² with 1 − from_data, which is computed where the prior is normal.
_NORMAL_PRIOR = 0.05

SHRUNK = pl.Schema(
    {
        "unit": pl.String, "digest": pl.String, "date": pl.Date, "parameter": pl.String, "unit_of_measure": pl.String,
        "estimate": pl.Float64, "estimate_sd": pl.Float64, "shrunk": pl.Float64, "shrunk_sd": pl.Float64,
        "distance": pl.Float64, "p": pl.Float64, "outlying": pl.Boolean,
    }
)  # fmt: skip
"""One row per unit and parameter: the unit's own estimate without the prior of its model, and with the population."""


class OutlyingUnit(Record):
    """A unit that is unlike the others in a parameter.

    Attributes
    ----------
    value, sd : its own estimate, the prior of its model divided out; on the scale of the population.
    distance : from the population mean, in standard deviations.
    p : two-sided p-value of the distance.
    """

    unit: str
    value: float
    sd: float
    distance: float
    p: float


class ParameterPopulation(Record):
    """The population of one parameter; numbers are None where `reason` says why there is no estimate.

    Attributes
    ----------
    scale : ``linear``, or ``log``: the numbers below are of the natural logarithm of the parameter in its unit.
    units, informative : number of units, and of those whose data carry information.
    law, freedom : ``normal`` or ``student`` with its degrees of freedom.
    mean, mean_sd, mean_interval : of the population mean, with its 95 % interval; of the first group if there are some.
    spread, spread_sd, spread_interval : half the width of the central 68.3 % of the population.
    next_mean, predictive_sd : mean and standard deviation of the next unit, mean and spread being uncertain.
    information_error : bits lost to the Monte Carlo error of the units' posteriors.
    outlying : units at a false discovery rate of 5 %, within their groups.
    laws : groups, steps, trends and covariates; None for derived quantities and if too few units are informative.
    """

    parameter: str
    unit_of_measure: str
    kind: str
    scale: Literal["linear", "log"]
    units: int
    informative: int
    reason: str
    law: Literal["normal", "student"]
    freedom: float | None
    mean: float | None
    mean_sd: float | None
    mean_interval: tuple[float, float] | None
    spread: float | None
    spread_sd: float | None
    spread_interval: tuple[float, float] | None
    next_mean: float | None
    predictive_sd: float | None
    information_error: float
    outlying: tuple[OutlyingUnit, ...]
    laws: PopulationLaws | None


class Populations(Record):
    """The populations of all parameters of a batch; `left_out` counts campaigns without estimates."""

    format: Literal[1] = 1
    model: str
    units: int
    campaigns: int
    left_out: int
    parameters: tuple[ParameterPopulation, ...]


def populations(
    parameters: pl.DataFrame, units: pl.DataFrame, stated: StatedPriors = MappingProxyType({})
) -> tuple[Populations, pl.DataFrame]:
    """Return the population of every parameter, and the units with it as prior (schema `SHRUNK`).

    Parameters
    ----------
    parameters, units : as `imubayes.batch.posterior_table.read_parameters` and `read_units` return them.
    stated : mean and standard deviation of the prior of the model, of parameters that these units were fitted with
        other priors of.
    """
    found, frames = [], [SHRUNK.to_frame()]
    for each in unit_populations(parameters, units, stated):
        found.append(_record(each))
        if each.units is not None:
            frames.append(_frame(each))
    record = Populations(
        model=units["model"][0] if units.height else "",
        units=units["unit"].n_unique(),
        campaigns=units.height,
        left_out=units.filter(pl.col("status") != "fitted").height,
        parameters=tuple(found),
    )
    return record, pl.concat(frames)


@dataclass(frozen=True)
class UnitPopulation:
    """The population of one parameter, with its units.

    Attributes
    ----------
    table : rows of the parameter, one for each unit, ordered by unit.
    scale : ``linear`` or ``log``, on which all numbers are.
    posteriors : of the units.
    structure : groups, steps, trends and covariates; None if it was not searched.
    population : of the units within their groups.
    units : of the units given the population; None without one.
    """

    table: pl.DataFrame
    scale: Scale
    posteriors: UnitPosteriors
    structure: Structure | None
    population: Population
    units: ShrunkUnits | None


def unit_populations(
    parameters: pl.DataFrame, units: pl.DataFrame, stated: StatedPriors = MappingProxyType({})
) -> Iterator[UnitPopulation]:
    """Yield the population of every parameter; arguments as of `populations`."""
    by_digest = units.unique("digest", keep="first")
    for rows in usable_rows(parameters):
        # Rows are in the order of the dates: the last one of a unit is its latest calibration.
        table = rows.unique("unit", keep="last", maintain_order=True).sort("unit")
        posteriors, scale = posteriors_of(table, units)
        posteriors = posteriors.with_stated(stated.get(table["parameter"][0]))
        of_units = table.select("digest").join(by_digest, on="digest", how="left", maintain_order="left")
        structure = _structure(table["kind"][0], posteriors, covariates_of(of_units))
        explained = np.zeros(table.height)
        if structure is not None:
            explained[posteriors.informative] = structure.explained
        within = posteriors.shifted(explained)
        if _has_likelihoods(table):
            outcome, known = _of_scales(table, within, explained, stated.get(table["parameter"][0]))
        else:
            outcome = population(within)
            known = shrunk(within, outcome) if outcome.posterior is not None else None
        if known is not None and structure is not None and structure.findings:
            known = _with_structure(known, within, outcome, structure)
        yield UnitPopulation(table, scale, posteriors, structure, outcome, known)


def _has_likelihoods(table: pl.DataFrame) -> bool:
    """Whether the rows are of a noise scale whose logarithm has a likelihood in every unit."""
    return table["log_likelihood"].null_count() == 0 and bool(table["log_likelihood"].explode().is_finite().all())


def _of_scales(
    table: pl.DataFrame, within: UnitPosteriors, explained: np.ndarray, stated: tuple[float, float] | None
) -> tuple[Population, ShrunkUnits | None]:
    """Return the population of a noise scale, and its units given it."""
    informative = int(within.informative.sum())
    if table.height < LEAST_UNITS:
        return Population(table.height, informative, f"fewer than {LEAST_UNITS} units have an estimate of it"), None
    prior = stated or (float(np.median(within.prior_mean + explained)), float(np.median(within.prior_sd)))
    grids, values = (np.array(table[name].to_list()) for name in ("log_grid", "log_likelihood"))
    found = scale_population(ScaleLikelihoods.of(grids - explained[:, None], values, prior), prior)
    outcome = population_of(found.posterior, table.height, informative)
    others = found.others_mean, found.others_sd
    return outcome, replace(compared(within, outcome, found.mean, found.sd), others=others)


def _structure(kind: str, posteriors: UnitPosteriors, covariates: list[UnitCovariate]) -> Structure | None:
    """Return the structure of the informative units; None for derived quantities and for few units."""
    used = np.flatnonzero(posteriors.informative)
    if kind == "derived" or len(used) <= LEAST_UNITS:
        return None
    estimate, variance = (each[used] for each in posteriors.likelihood)
    prior = posteriors.stated_sd
    # A parameter may scatter more than its prior says: the data then show how far it reaches.
    width = max(float(np.std(estimate)), prior if np.isfinite(prior) else 0.0)
    if not np.isfinite(width) or width <= 0:
        width = max(10 * float(np.std(estimate)), 1e-300)
    return search(UnitEstimates(estimate, variance, width), [each.of(used) for each in covariates])


def _with_structure(known: ShrunkUnits, within: UnitPosteriors, outcome: Population, found: Structure) -> ShrunkUnits:
    """Return units given their group: its location is added, and so is its variance as far as the unit relies on it."""
    used = within.informative
    explained, doubt = np.zeros(len(known.mean)), np.zeros(len(known.mean))
    explained[used], doubt[used] = found.explained, found.doubt
    variance = within.likelihood[1]
    relies = np.where(used, 1 / (1 + outcome.spread**2 / variance), 1.0)
    # A unit that was not measured may be in any of the groups.
    explained[~used], doubt[~used] = np.mean(found.explained), np.var(found.explained) + np.mean(found.doubt)
    return replace(known, mean=known.mean + explained, sd=np.sqrt(known.sd**2 + relies**2 * doubt))


def usable_rows(parameters: pl.DataFrame) -> Iterator[pl.DataFrame]:
    """Yield the rows of each parameter that have an estimate, in the order of their dates, undated ones first."""
    usable = parameters.filter((pl.col("status") == "fitted") & pl.col("mean").is_not_null())
    ordered = usable.sort("date", "digest", nulls_last=False, maintain_order=True)
    for (_,), rows in ordered.group_by(["parameter"], maintain_order=True):
        yield rows


def posteriors_of(table: pl.DataFrame, units: pl.DataFrame) -> tuple[UnitPosteriors, Scale]:
    """Return the posteriors of one parameter on the scale on which its prior is nearly normal; noise as logarithms.

    Parameters
    ----------
    table : rows of the parameter.
    units : table of the units, with the number of draws behind each.
    """
    draws = dict(zip(units["digest"], units["draws"].fill_null(np.inf), strict=True))
    columns = {name: table[name].cast(pl.Float64).fill_null(np.nan).to_numpy() for name in (*_NUMBERS, *_LOGARITHMS)}
    mean, sd, prior_mean, prior_sd = (columns[name] for name in _NUMBERS[:4])
    number = np.array([draws[digest] for digest in table["digest"]], dtype=float)
    logarithms = [columns[name] for name in _LOGARITHMS]
    if table["kind"][0] == "noise" and np.all(np.isfinite(logarithms)):
        return UnitPosteriors(*logarithms, number), "log"
    with np.errstate(divide="ignore", invalid="ignore"):
        as_normal = np.abs((sd / prior_sd) ** 2 / (1 - columns["from_data"]) - 1) < _NORMAL_PRIOR
    positive = bool(np.all(columns["q2_5"] > 0))
    if np.mean(as_normal) >= 0.5 or not positive:
        flat = ~np.isfinite(prior_sd) | ~np.isfinite(prior_mean) | (prior_sd <= 0)
        prior = np.where(flat, 0.0, prior_mean), np.where(flat, np.inf, prior_sd)
        return UnitPosteriors(mean, sd, *prior, number), "linear"
    # Of a lognormal distribution; the quantiles are those of the logarithm.
    middle = np.log(columns["q50"])
    width = (np.log(columns["q97_5"]) - np.log(columns["q2_5"])) / (2 * 1.959964)
    with np.errstate(divide="ignore", invalid="ignore"):
        square = np.log1p((prior_sd / prior_mean) ** 2)
        median = np.log(prior_mean) - square / 2
    known = np.isfinite(square) & np.isfinite(median) & (square > 0)
    prior = np.where(known, median, 0.0), np.where(known, np.sqrt(np.where(known, square, 1.0)), np.inf)
    return UnitPosteriors(middle, width, *prior, number), "log"


_LOGARITHMS = ("log_mean", "log_sd", "prior_log_mean", "prior_log_sd")
_NUMBERS = ("mean", "sd", "prior_mean", "prior_sd", "from_data", "q2_5", "q50", "q97_5")


def _record(each: UnitPopulation) -> ParameterPopulation:
    outcome, table = each.population, each.table
    given = outcome.posterior is not None
    names = table.filter(pl.Series(each.posteriors.informative))["unit"].to_list()
    next_mean, next_sd = _next_unit(each)
    return ParameterPopulation(
        parameter=table["parameter"][0],
        unit_of_measure=table["unit_of_measure"][0],
        kind=table["kind"][0],
        scale=each.scale,
        units=outcome.units,
        informative=outcome.informative,
        reason=outcome.reason,
        law="normal" if np.isinf(outcome.freedom) else "student",
        freedom=finite(outcome.freedom),
        mean=finite(outcome.mean),
        mean_sd=finite(outcome.mean_sd),
        mean_interval=outcome.mean_interval if given else None,
        spread=finite(outcome.spread),
        spread_sd=finite(outcome.spread_sd),
        spread_interval=outcome.spread_interval if given else None,
        next_mean=finite(next_mean),
        predictive_sd=finite(next_sd),
        information_error=outcome.information_error,
        outlying=_outlying(table, each.posteriors, each.units) if each.units is not None else (),
        laws=laws_of(each.structure, names) if each.structure is not None else None,
    )


def _next_unit(each: UnitPopulation) -> tuple[float, float]:
    """Return mean and sd of the next unit: as the latest one over dates and serial numbers, or of any group."""
    outcome, structure = each.population, each.structure
    if structure is None or not structure.findings:
        return outcome.mean, outcome.predictive_sd
    latest = structure.explained
    for found in structure.findings:
        covariate = found.candidate.covariate
        if covariate is not None and covariate.ordered is not None:
            latest = structure.explained[covariate.ordered == np.max(covariate.ordered)]
    variance = np.var(latest) + np.mean(structure.doubt)
    return outcome.mean + float(np.mean(latest)), float(np.sqrt(outcome.predictive_sd**2 + variance))


def _outlying(table: pl.DataFrame, posteriors: UnitPosteriors, shares: ShrunkUnits) -> tuple[OutlyingUnit, ...]:
    """Return the outlying units, the farthest first."""
    estimate, variance = posteriors.likelihood
    places = sorted(np.flatnonzero(shares.outlying), key=lambda place: -abs(shares.distance[place]))
    return tuple(
        OutlyingUnit(
            unit=table["unit"][int(place)],
            value=float(estimate[place]),
            sd=float(np.sqrt(variance[place])),
            distance=float(shares.distance[place]),
            p=float(shares.p[place]),
        )
        for place in places
    )


def _frame(each: UnitPopulation) -> pl.DataFrame:
    """Return the units of a parameter with the population as prior; logarithms become values again."""
    assert each.units is not None
    table, posteriors, shares = each.table, each.posteriors, each.units
    estimate, variance = posteriors.likelihood
    # The estimate of a noise scale is one only if its data outweigh its prior.
    known = posteriors.informative & ((posteriors.from_data > 0.5) | (each.scale == "linear"))
    own, own_sd = np.where(known, estimate, np.nan), np.where(known, np.sqrt(np.where(known, variance, 1.0)), np.nan)
    mean, sd = shares.mean, shares.sd
    if each.scale == "log":
        own, mean = np.exp(own), np.exp(mean)
        own_sd, sd = own * own_sd, mean * sd
    columns = {
        "estimate": own, "estimate_sd": own_sd, "shrunk": mean, "shrunk_sd": sd,
        "distance": shares.distance, "p": shares.p, "outlying": shares.outlying,
    }  # fmt: skip
    kept = table.select("unit", "digest", "date", "parameter", "unit_of_measure")
    return kept.with_columns(pl.Series(name, values) for name, values in columns.items()).with_columns(
        pl.col(pl.Float64).fill_nan(None)
    )

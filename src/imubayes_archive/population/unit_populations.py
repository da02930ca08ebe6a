"""The units of a batch and the population of each parameter: spreads one by one, means and units jointly.

A unit counts once, with its latest calibration: two calibrations of one unit are not two draws from the population.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import polars as pl

from imubayes_archive.population.archive_covariates import covariates_of
from imubayes_archive.population.confounded_spreads import confounded, spread_marginal
from imubayes_archive.population.joint_population import JointPopulation, JointUnits
from imubayes_archive.population.noise_scale_population import ScaleLikelihoods, scale_population
from imubayes_archive.population.population import (
    LEAST_UNITS,
    Population,
    ShrunkUnits,
    UnitPosteriors,
    compared,
    population,
    population_of,
    shrunk,
)
from imubayes_archive.population.population_search import Structure, UnitCovariate, search
from imubayes_archive.population.population_structure import UnitEstimates

Scale = Literal["linear", "log"]
# Relative agreement of (sd/prior sd)² with 1 − from_data, which is computed if the prior is normal.
_NORMAL_PRIOR = 0.05
# Sweeps over all parameters at most; changes of a mean in its standard deviations and of a spread that end them.
_SWEEPS, _SETTLED = 8, 0.02


@dataclass(frozen=True)
class UnitPopulation:
    """The population of one parameter, with its units.

    Attributes
    ----------
    table : rows of the parameter, one for each unit, ordered by unit.
    scale : ``linear`` or ``log``, on which all numbers are.
    posteriors : what the data of the units say, the means of the other parameters given if they are joint.
    own : what the data of each unit alone say of it.
    structure : groups, steps, trends and covariates; None if it was not searched.
    population : of the units within their groups.
    units : of the units given the population; None without one.
    """

    table: pl.DataFrame
    scale: Scale
    posteriors: UnitPosteriors
    own: UnitPosteriors
    structure: Structure | None
    population: Population
    units: ShrunkUnits | None


def unit_populations(parameters: pl.DataFrame, units: pl.DataFrame) -> Iterator[UnitPopulation]:
    """Yield the population of every parameter.

    Parameters
    ----------
    parameters, units : as `imubayes_archive.unit_fits.posterior_table.read_parameters` and `read_units` return them.
    """
    by_digest = units.unique("digest", keep="first")
    tables = latest_tables(parameters)
    joint = {each.table["parameter"][0]: each for each in _joint(tables, units, by_digest)}
    for table in tables:
        yield joint.get(table["parameter"][0]) or _alone(table, units, by_digest)


def latest_tables(parameters: pl.DataFrame) -> list[pl.DataFrame]:
    """Return the rows of each parameter, those of the latest calibration of each unit, ordered by unit."""
    # Rows are in the order of the dates: the last one of a unit is its latest calibration.
    return [rows.unique("unit", keep="last", maintain_order=True).sort("unit") for rows in usable_rows(parameters)]


def _alone(table: pl.DataFrame, units: pl.DataFrame, by_digest: pl.DataFrame) -> UnitPopulation:
    """Return the population of one parameter by itself: of a noise scale, a derived quantity, or of logarithms."""
    posteriors, scale = posteriors_of(table, units)
    structure = _structure(posteriors, _covariates(table, by_digest))
    explained = _explained(structure, posteriors)
    within = posteriors.shifted(explained)
    if _has_likelihoods(table):
        outcome, known = _of_scales(table, within, explained)
    else:
        outcome = population(within)
        known = shrunk(within, outcome) if outcome.posterior is not None else None
    if known is not None and structure is not None and structure.findings:
        known = _with_structure(known, within, outcome, structure)
    return UnitPopulation(table, scale, posteriors, posteriors, structure, outcome, known)


def _covariates(table: pl.DataFrame, by_digest: pl.DataFrame) -> list[UnitCovariate]:
    return covariates_of(table.select("digest").join(by_digest, on="digest", how="left", maintain_order="left"))


def _explained(structure: Structure | None, posteriors: UnitPosteriors) -> np.ndarray:
    """Return the location of each unit by its structure, 0 for a unit without information."""
    explained = np.zeros(len(posteriors.mean))
    if structure is not None:
        explained[posteriors.informative] = structure.explained
    return explained


def _joint(tables: Sequence[pl.DataFrame], units: pl.DataFrame, by_digest: pl.DataFrame) -> list[UnitPopulation]:
    """Return the populations of all parameters on a linear scale, whose means are estimated jointly."""
    chosen = [each for each in tables if each["kind"][0] == "parameter" and posteriors_of(each, units)[1] == "linear"]
    if not chosen:
        return []
    together = pl.concat(chosen)
    latest = together.unique("unit", keep="last", maintain_order=True).sort("unit")["digest"]
    rows = latest.to_frame().join(by_digest, on="digest", how="left", maintain_order="left")
    known = rows.filter(pl.col("covariance").list.len() > 0)
    of_units = together.filter(pl.col("digest").is_in(known["digest"].to_list()))
    joint = JointUnits.of(of_units, known)
    spreads = _settled(JointPopulation.start(joint))
    searched, covariates = spreads, covariates_of(known)
    structures = [_structure(searched.site(place), covariates) for place in range(len(joint.names))]
    for place, found in enumerate(structures):
        spreads = spreads.with_offsets(place, _explained(found, searched.site(place)))
    if any(found is not None and found.findings for found in structures):
        spreads = _settled(spreads)
    shared = confounded(spreads)
    return [_of_joint(spreads, place, together, known, found, shared) for place, found in enumerate(structures)]


def _settled(spreads: JointPopulation) -> JointPopulation:
    """Return the population after sweeps over the spreads of its parameters, until nothing moves."""
    for _ in range(_SWEEPS):
        before = spreads
        for place in range(len(spreads.variance)):
            outcome = population(_within(spreads, place))
            if outcome.posterior is not None:
                spreads = spreads.with_spread(place, *_spread(spreads, place, outcome))
        (mean, covariance), (old, _) = spreads.means, before.means
        moved = np.max(np.abs(mean - old) / np.sqrt(np.diag(covariance)))
        if moved < _SETTLED and np.allclose(spreads.variance, before.variance, rtol=_SETTLED):
            break
    return spreads


def _within(spreads: JointPopulation, place: int) -> UnitPosteriors:
    """Return what the data say of a parameter, within its groups."""
    return spreads.site(place).shifted(spreads.offsets[:, place] * spreads.units.width[place])


def _spread(spreads: JointPopulation, place: int, outcome: Population) -> tuple[float, np.ndarray | None]:
    """Return the spread of a population, and the weights of its units if its law has heavy tails."""
    posterior = outcome.posterior
    assert posterior is not None
    spread = float(np.sqrt(posterior.weight @ posterior.scale**2))
    if np.isinf(outcome.freedom):
        return spread, None
    estimate, variance = _within(spreads, place).likelihood
    square = np.where(np.isfinite(variance), (estimate - outcome.mean) ** 2 / (variance + spread**2), 0.0)
    return spread, (outcome.freedom + 1) / (outcome.freedom + square)


def _of_joint(
    spreads: JointPopulation,
    place: int,
    together: pl.DataFrame,
    known: pl.DataFrame,
    structure: Structure | None,
    shared: np.ndarray,
) -> UnitPopulation:
    """Return the population of one of the parameters whose means were estimated jointly.

    Parameters
    ----------
    shared : shape (K,), the parameters whose spreads the units determine only together.
    """
    name, width, centre = spreads.units.names[place], spreads.units.width[place], spreads.units.centre[place]
    rows = together.filter(pl.col("parameter") == name)
    table = known.select("digest").join(rows, on="digest", how="inner", maintain_order="left")
    mine = spreads.units.present[:, place]
    site = spreads.site(place).of(mine)
    within = _within(spreads, place).of(mine)
    outcome, alone = population(within), posteriors_of(table, known)[0]
    if outcome.posterior is None:
        return UnitPopulation(table, "linear", site, alone, structure, outcome, None)
    (mean, covariance), (own, sd) = spreads.means, (each[:, place] for each in spreads.given)
    # A unit is compared with the scatter that all parameters make together, which is known.
    held = outcome.with_mean(centre + width * mean[place], width * float(np.sqrt(covariance[place, place])))
    outcome = held
    if place in shared:
        marginal = spread_marginal(spreads, place, shared, held.freedom)
        own, sd = marginal.mean, marginal.sd
        posterior = marginal.posterior.in_unit(centre, width)
        outcome = population_of(posterior, held.units, held.informative, held.information_error)
    units = compared(within, held, centre + width * own[mine], width * sd[mine])
    if structure is not None and structure.findings:
        relies = (spreads.conditional[:, place, place] * spreads.precision[:, place])[mine]
        doubt = np.full(len(relies), float(np.mean(structure.doubt)))
        if int(site.informative.sum()) == len(structure.doubt):
            doubt[site.informative] = structure.doubt
        units = replace(units, sd=np.sqrt(units.sd**2 + relies**2 * doubt))
    return UnitPopulation(table, "linear", site, alone, structure, outcome, units)


def _has_likelihoods(table: pl.DataFrame) -> bool:
    """Whether the rows are of a noise scale whose logarithm has a likelihood in every unit."""
    return table["log_likelihood"].null_count() == 0 and bool(table["log_likelihood"].explode().is_finite().all())


def _of_scales(
    table: pl.DataFrame, within: UnitPosteriors, explained: np.ndarray
) -> tuple[Population, ShrunkUnits | None]:
    """Return the population of a noise scale, and its units given it."""
    informative = int(within.informative.sum())
    if table.height < LEAST_UNITS:
        return Population(
            table.height, informative, f"fewer than {LEAST_UNITS} units have an estimate of the parameter"
        ), None
    prior = float(np.median(within.prior_mean + explained)), float(np.median(within.prior_sd))
    grids, values = (np.array(table[name].to_list()) for name in ("log_grid", "log_likelihood"))
    found = scale_population(ScaleLikelihoods.of(grids - explained[:, None], values, prior), prior)
    outcome = population_of(found.posterior, table.height, informative)
    others = found.others_mean, found.others_sd
    return outcome, replace(compared(within, outcome, found.mean, found.sd), others=others)


def _structure(posteriors: UnitPosteriors, covariates: list[UnitCovariate]) -> Structure | None:
    """Return the structure of the informative units; None for few units."""
    used = np.flatnonzero(posteriors.informative)
    if len(used) <= LEAST_UNITS:
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
    middle, width, before, wide = (columns[name] for name in _LOGARITHMS)
    if table["kind"][0] == "noise" and np.all(np.isfinite([middle, width, before, wide])):
        return UnitPosteriors(middle, width, before, wide, number), "log"
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


def own_estimates(own: UnitPosteriors, scale: Scale) -> tuple[np.ndarray, np.ndarray]:
    """Return estimate and standard uncertainty of each unit by its data, (n,) each; NaN without information.

    Logarithms become values again.
    """
    estimate, variance = own.likelihood
    estimate, sd = (np.where(own.informative, each, np.nan) for each in (estimate, np.sqrt(variance)))
    return (np.exp(estimate), np.exp(estimate) * sd) if scale == "log" else (estimate, sd)


_LOGARITHMS = ("log_mean", "log_sd", "prior_log_mean", "prior_log_sd")
_NUMBERS = ("mean", "sd", "prior_mean", "prior_sd", "from_data", "q2_5", "q50", "q97_5")

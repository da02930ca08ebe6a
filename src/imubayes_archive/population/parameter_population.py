"""From the table of a batch to the population of every parameter, and to what is known of each unit given the others.

A unit counts once, with its latest calibration: two calibrations of one unit are not two draws from the population.
Parameters are taken on the scale on which their prior is normal, or nearly: as they are, or as logarithms.  A prior
that is neither normal nor lognormal is replaced by the one with its mean and standard deviation; for a parameter that
the data determine this matters little, and the others carry no information.

Structure comes first: groups of units, steps, trends and covariates (`population.population_search`) are taken out
of the estimates, and mean and spread are those of the units within a group.  A noise scale is taken as its logarithm,
and its population has the prior of the model on its mean: few units determine a noise scale, and those that do not
still bound it.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import polars as pl

from imubayes.foundations.records import Record, finite
from imubayes_archive.population.population import ShrunkUnits, UnitPosteriors
from imubayes_archive.population.population_findings import PopulationLaws, laws_of
from imubayes_archive.population.unit_populations import (
    Scale,
    UnitPopulation,
    latest_tables,
    own_estimates,
    posteriors_of,
    unit_populations,
)
from imubayes_archive.unit_fits.posterior_table import doubted

LEAST_OF_SCALES = 0.5
"""Share of the information on a noise scale that must come from a unit's data for its own estimate to be one."""

SHRUNK = pl.Schema(
    {
        "unit": pl.String, "digest": pl.String, "date": pl.Date, "parameter": pl.String, "unit_of_measure": pl.String,
        "estimate": pl.Float64, "estimate_sd": pl.Float64, "shrunk": pl.Float64, "shrunk_sd": pl.Float64,
        "distance": pl.Float64, "p": pl.Float64, "outlying": pl.Boolean,
        "trusted": pl.Boolean,
    }
)  # fmt: skip
"""One row per unit and parameter: its own estimate without the prior of the model, and the one given the population.

Units whose noise contradicts the model are not `trusted`: neither interval holds."""


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
    """The population of one parameter; numbers are None if `reason` says why there is no estimate.

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
    laws : groups, steps, trends and covariates; None if too few units are informative.
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

    def to_polars(self) -> pl.DataFrame:
        """Return one row per parameter (schema `POPULATIONS`): population, laws that were found, outlying units."""
        return pl.DataFrame([_row(each) for each in self.parameters], schema=POPULATIONS, orient="row")


POPULATIONS = pl.Schema(
    {
        "parameter": pl.String, "unit_of_measure": pl.String, "scale": pl.String, "units": pl.Int64,
        "informative": pl.Int64, "reason": pl.String, "law": pl.String, "mean": pl.Float64, "mean_sd": pl.Float64,
        "spread": pl.Float64, "spread_sd": pl.Float64, "next_mean": pl.Float64, "predictive_sd": pl.Float64,
        "found": pl.List(pl.String), "probability": pl.List(pl.Float64), "outlying": pl.List(pl.String),
    }
)  # fmt: skip
"""One row per parameter: as in `ParameterPopulation`; `found` holds groups, steps, trends and covariates by name."""


def _row(each: ParameterPopulation) -> tuple[object, ...]:
    findings = each.laws.findings if each.laws is not None else ()
    return (
        each.parameter, each.unit_of_measure, each.scale, each.units, each.informative, each.reason, each.law,
        each.mean, each.mean_sd, each.spread, each.spread_sd, each.next_mean, each.predictive_sd,
        [" ".join(filter(None, (found.kind, found.covariate, found.at))) for found in findings],
        [found.probability for found in findings], [unit.unit for unit in each.outlying],
    )  # fmt: skip


def populations(parameters: pl.DataFrame, units: pl.DataFrame) -> tuple[Populations, pl.DataFrame]:
    """Return the population of every parameter, and the units with it as prior (schema `SHRUNK`).

    Parameters
    ----------
    parameters, units : as `imubayes_archive.unit_fits.posterior_table.read_parameters` and `read_units` return them.
    """
    found, frames, doubts = [], [SHRUNK.to_frame()], doubted(units)["digest"].to_list()
    for each in unit_populations(parameters, units):
        found.append(_record(each))
        if each.units is not None:
            frames.append(_frame(each, doubts))
    record = Populations(
        model=units["model"][0] if units.height else "",
        units=units["unit"].n_unique(),
        campaigns=units.height,
        left_out=units.filter(pl.col("status") != "fitted").height,
        parameters=tuple(found),
    )
    return record, pl.concat(frames)


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


def _frame(each: UnitPopulation, doubts: Sequence[str]) -> pl.DataFrame:
    """Return the units of a parameter with the population as prior; logarithms become values again."""
    assert each.units is not None
    table, shares = each.table, each.units
    own, own_sd = _shown_alone(each.own, each.scale)
    mean, sd = shares.mean, shares.sd
    if each.scale == "log":
        mean = np.exp(mean)
        sd = mean * sd
    columns = {
        "estimate": own, "estimate_sd": own_sd, "shrunk": mean, "shrunk_sd": sd,
        "distance": shares.distance, "p": shares.p, "outlying": shares.outlying,
    }  # fmt: skip
    kept = table.select("unit", "digest", "date", "parameter", "unit_of_measure")
    return kept.with_columns(pl.Series(name, values) for name, values in columns.items()).with_columns(
        pl.col(pl.Float64).fill_nan(None), trusted=~pl.col("digest").is_in(doubts)
    )


def _shown_alone(own: UnitPosteriors, scale: Scale) -> tuple[np.ndarray, np.ndarray]:
    """Return estimate and standard uncertainty of each unit; of a noise scale if its data outweigh its prior."""
    estimate, sd = own_estimates(own, scale)
    weighs = (own.from_data > LEAST_OF_SCALES) | (scale == "linear")
    return np.where(weighs, estimate, np.nan), np.where(weighs, sd, np.nan)


def estimates_alone(parameters: pl.DataFrame, units: pl.DataFrame) -> pl.DataFrame:
    """Return the own estimates of the latest calibration of each unit, by digest and parameter."""
    frames = [SHRUNK.to_frame().select("digest", "parameter", "estimate", "estimate_sd")]
    for table in latest_tables(parameters):
        own, sd = _shown_alone(*posteriors_of(table, units))
        frames.append(table.select("digest", "parameter").with_columns(estimate=own, estimate_sd=sd))
    return pl.concat(frames).with_columns(pl.col(pl.Float64).fill_nan(None))

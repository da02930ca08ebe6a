"""Drift of a batch: changes between consecutive calibrations of one unit.

The data of two calibrations are independent: the variances of their estimates add.  The prior of the model is divided
out.  Trends over the dates or serial numbers of different units are a structure of their population
(`imubayes_archive.population.population_search`).
"""

from typing import Literal

import numpy as np
import polars as pl

from imubayes.foundations.records import Record
from imubayes.foundations.tail_probabilities import chi2_survival, normal_survival
from imubayes.foundations.units import DAYS_PER_YEAR
from imubayes_archive.population.population import LEAST_UNITS, RATE, discoveries
from imubayes_archive.population.population_laws import normal_law
from imubayes_archive.population.unit_populations import own_estimates, posteriors_of, usable_rows

DRIFTS = pl.Schema(
    {
        "unit": pl.String, "parameter": pl.String, "unit_of_measure": pl.String, "from": pl.Date, "to": pl.Date,
        "years": pl.Float64, "change": pl.Float64, "change_sd": pl.Float64, "p": pl.Float64,
        "significant": pl.Boolean,
    }
)  # fmt: skip
"""One row per unit, parameter and pair of consecutive calibrations; the change of the logarithm for scales."""


class Drift(Record):
    """How a parameter changes between calibrations of one unit.

    Attributes
    ----------
    pairs, significant : pairs of consecutive calibrations, and those whose change is significant.
    mean, mean_sd : change per year, common to all units.
    spread : standard deviation of the change between two calibrations beyond its uncertainty; None for few pairs.
    p : of no change in any unit.
    units : with significant changes, the clearest first.
    """

    parameter: str
    unit_of_measure: str
    scale: Literal["linear", "log"]
    pairs: int
    significant: int
    mean: float
    mean_sd: float
    spread: float | None
    p: float
    units: tuple[str, ...]


class Drifts(Record):
    """The drift of every parameter of a batch, the most significant first."""

    format: Literal[1] = 1
    model: str
    rate: float = RATE
    parameters: tuple[Drift, ...]


def drifts(parameters: pl.DataFrame, units: pl.DataFrame) -> tuple[Drifts, pl.DataFrame]:
    """Return the drift of every parameter, and every change between calibrations (schema `DRIFTS`).

    Parameters
    ----------
    parameters, units : as `imubayes_archive.unit_fits.posterior_table.read_parameters` and `read_units` return them.
    """
    pairs = [DRIFTS.to_frame()]
    scales: dict[str, Literal["linear", "log"]] = {}
    for rows in usable_rows(parameters):
        posteriors, scale = posteriors_of(rows, units)
        estimate, variance = posteriors.likelihood
        known = rows.with_columns(estimate=estimate, variance=variance).filter(pl.Series(posteriors.informative))
        scales[rows["parameter"][0]] = scale
        pairs.append(_pairs(known))
    changes = pl.concat(pairs)
    changes = changes.with_columns(pl.Series("significant", discoveries(changes["p"].to_numpy(), RATE), pl.Boolean))
    found = [_drift(each, scales[each["parameter"][0]]) for each in changes.partition_by("parameter")]
    model = units["model"][0] if units.height else ""
    return Drifts(model=model, parameters=tuple(sorted(found, key=lambda each: each.p))), changes


def dated_estimates(parameters: pl.DataFrame, units: pl.DataFrame) -> pl.DataFrame:
    """Return the estimates of every calibration with a date, the prior of the model divided out.

    The columns are unit, date, parameter, unit_of_measure, estimate and estimate_sd; logarithms become values again.
    """
    found = []
    for rows in usable_rows(parameters):
        posteriors, scale = posteriors_of(rows, units)
        own, deviation = own_estimates(posteriors, scale)
        kept = rows.select("unit", "date", "parameter", "unit_of_measure").with_columns(
            estimate=own, estimate_sd=deviation
        )
        found.append(kept.filter(pl.Series(posteriors.informative) & kept["date"].is_not_null()))
    return pl.concat(found) if found else pl.DataFrame()


def _pairs(rows: pl.DataFrame) -> pl.DataFrame:
    """Return the changes between consecutive calibrations of each unit."""
    ordered = rows.filter(pl.col("date").is_not_null()).sort("unit", "date", "digest")
    pairs = ordered.select(
        "unit",
        "parameter",
        "unit_of_measure",
        pl.col("date").shift(1).over("unit").alias("from"),
        pl.col("date").alias("to"),
        (pl.col("estimate") - pl.col("estimate").shift(1).over("unit")).alias("change"),
        (pl.col("variance") + pl.col("variance").shift(1).over("unit")).sqrt().alias("change_sd"),
    ).filter(pl.col("change").is_not_null())
    distance = (pairs["change"] / pairs["change_sd"]).abs().to_numpy()
    return pairs.with_columns(
        ((pl.col("to") - pl.col("from")).dt.total_days() / DAYS_PER_YEAR).alias("years"),
        pl.Series("p", 2 * normal_survival(distance), pl.Float64),
        pl.lit(False).alias("significant"),
    ).select(DRIFTS.names())


def _drift(changes: pl.DataFrame, scale: Literal["linear", "log"]) -> Drift:
    change, variance = changes["change"].to_numpy(), changes["change_sd"].to_numpy() ** 2
    years = changes["years"].to_numpy()
    information = float(np.sum(years**2 / variance))
    several = changes.height >= LEAST_UNITS
    return Drift(
        parameter=changes["parameter"][0],
        unit_of_measure=changes["unit_of_measure"][0],
        scale=scale,
        pairs=changes.height,
        significant=int(changes["significant"].sum()),
        mean=float(np.sum(years * change / variance)) / information if information > 0 else 0.0,
        mean_sd=information**-0.5 if information > 0 else 0.0,
        spread=normal_law(change, variance).of_scale()[0] if several else None,
        p=float(chi2_survival(np.sum(change**2 / variance), changes.height)),
        units=tuple(changes.filter("significant").sort("p")["unit"].unique(maintain_order=True)[:8]),
    )

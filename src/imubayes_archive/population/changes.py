"""Changes in a batch: trends over dates and serial numbers, drift between calibrations, and two models compared.

A trend is the slope of a regression of the units' estimates, the prior of their model divided out.  Units scatter about
the line by a spread that is estimated with it:

    yᵢ ~ N(a + b xᵢ, vᵢ + τ²),   flat priors on a, b and τ ≥ 0.

Each unit counts once, with its first dated calibration.  Drift is the change between consecutive calibrations of one
unit, whose data are independent: the variances add.

Two models are compared on the same campaigns, parameter by parameter and unit by unit.  Both fits saw the same data:
their estimates are correlated, and the variance of their difference is not the sum.  Where the new model contains the
old one and the old one is right, the old estimate is efficient and the difference has variance var_new − var_old (J.
Hausman, Econometrica 46, 1978).  A difference beyond that says that the old estimate was wrong by what the old model
lacks.
"""

from collections.abc import Iterator
from typing import Literal

import numpy as np
import polars as pl

from imubayes.foundations.records import Record, finite
from imubayes.foundations.tail_probabilities import chi2_survival, normal_survival, t_survival
from imubayes.foundations.units import DAYS_PER_YEAR
from imubayes_archive.population.archive_covariates import serial_number
from imubayes_archive.population.population import LEAST_UNITS, discoveries
from imubayes_archive.population.population_laws import normal_law
from imubayes_archive.population.unit_populations import own_estimates, posteriors_of, usable_rows

RATE = 0.05
"""False discovery rate of changed estimates (convention)."""
# Variance of a difference, as a share of the larger variance, below which it is the numerical error of the two fits.
_LEAST_SHARE = 1e-4
_MOST_UNITS = 8

CHANGES = pl.Schema(
    {
        "unit": pl.String, "campaign": pl.String, "digest": pl.String, "date": pl.Date, "parameter": pl.String,
        "unit_of_measure": pl.String, "old": pl.Float64, "old_sd": pl.Float64, "new": pl.Float64,
        "new_sd": pl.Float64, "change": pl.Float64, "change_sd": pl.Float64, "p": pl.Float64,
        "significant": pl.Boolean,
    }
)  # fmt: skip
"""One row per campaign and parameter that both batches have."""


class ParameterChange(Record):
    """How the estimates of one parameter changed over all campaigns.

    Attributes
    ----------
    campaigns, significant : number of campaigns, and of those whose change is significant.
    mean_change, mean_change_sd : weighted mean of the changes, and its standard deviation; None where it is not known.
    rms_ratio : root mean square of the changes in units of the new standard deviation.
    sd_ratio : median ratio of the new standard deviation to the old.
    p : of no change in any campaign.
    most_changed : units with significant changes, the clearest first.
    """

    parameter: str
    unit_of_measure: str
    campaigns: int
    significant: int
    mean_change: float | None
    mean_change_sd: float | None
    rms_ratio: float
    sd_ratio: float
    p: float
    most_changed: tuple[str, ...]


class ModelComparison(Record):
    """Two batches compared.

    Attributes
    ----------
    old, new : hashes of the models.
    campaigns, only_old, only_new : with estimates in both, and in one alone.
    added, removed : parameters of one model alone.
    delta_chi2, delta_log_evidence : sums over the campaigns in both, new − old.
    better : number of campaigns whose log evidence rose.
    parameters : of both models, the clearest change first.
    """

    format: Literal[1] = 1
    old: str
    new: str
    campaigns: int
    only_old: int
    only_new: int
    added: tuple[str, ...]
    removed: tuple[str, ...]
    delta_chi2: float | None
    delta_log_evidence: float | None
    better: int
    rate: float = RATE
    parameters: tuple[ParameterChange, ...]


def compare_models(
    old: tuple[pl.DataFrame, pl.DataFrame], new: tuple[pl.DataFrame, pl.DataFrame]
) -> tuple[ModelComparison, pl.DataFrame]:
    """Return what changed from an old to a new model, and every change (schema `CHANGES`).

    Parameters
    ----------
    old, new : tables of parameters and of units, as `batch.posterior_table` reads them.
    """
    before, after = (_estimates(parameters) for parameters, _ in (old, new))
    changes = _changes(before.join(after, on=["digest", "parameter"], suffix="_new"))
    both = _both(old[1], new[1])
    record = ModelComparison(
        old=_model(old[1]),
        new=_model(new[1]),
        campaigns=both.height,
        only_old=_fitted(old[1]).height - both.height,
        only_new=_fitted(new[1]).height - both.height,
        added=_missing(after, before),
        removed=_missing(before, after),
        delta_chi2=_sum(both["chi2_new"] - both["chi2"]),
        delta_log_evidence=_sum(both["log_evidence_new"] - both["log_evidence"]),
        better=int((both["log_evidence_new"] > both["log_evidence"]).sum()),
        parameters=tuple(sorted(map(_parameter, changes.partition_by("parameter")), key=lambda each: each.p)),
    )
    return record, changes


def _model(units: pl.DataFrame) -> str:
    return units["model"][0] if units.height else ""


def _fitted(units: pl.DataFrame) -> pl.DataFrame:
    return units.filter(pl.col("status") == "fitted")


def _both(old: pl.DataFrame, new: pl.DataFrame) -> pl.DataFrame:
    columns = ["digest", "chi2", "log_evidence"]
    return _fitted(old).select(columns).join(_fitted(new).select(columns), on="digest", suffix="_new")


def _estimates(parameters: pl.DataFrame) -> pl.DataFrame:
    """Return the estimates of campaigns that were fitted."""
    usable = (pl.col("status") == "fitted") & pl.col("mean").is_not_null() & pl.col("sd").is_not_null()
    return parameters.filter(usable).select(
        "unit", "campaign", "digest", "date", "parameter", "unit_of_measure", "mean", "sd"
    )


def _missing(these: pl.DataFrame, those: pl.DataFrame) -> tuple[str, ...]:
    return tuple(sorted(set(these["parameter"]) - set(those["parameter"])))


def _sum(values: pl.Series) -> float | None:
    return finite(float(values.drop_nulls().sum())) if values.drop_nulls().len() else None


def _changes(joined: pl.DataFrame) -> pl.DataFrame:
    """Return every change with its standard deviation and p-value."""
    old_sd, new_sd = joined["sd"].to_numpy(), joined["sd_new"].to_numpy()
    change = joined["mean_new"].to_numpy() - joined["mean"].to_numpy()
    # Also where the new model is the smaller one.
    variance = np.maximum(np.abs(new_sd**2 - old_sd**2), _LEAST_SHARE * np.maximum(new_sd, old_sd) ** 2)
    deviation = np.sqrt(variance)
    p = 2 * normal_survival(np.abs(change) / np.where(deviation > 0, deviation, np.inf))
    columns = {
        "old": joined["mean"].to_numpy(), "old_sd": old_sd, "new": joined["mean_new"].to_numpy(), "new_sd": new_sd,
        "change": change, "change_sd": deviation, "p": p, "significant": discoveries(p, RATE),
    }  # fmt: skip
    kept = joined.select("unit", "campaign", "digest", "date", "parameter", "unit_of_measure")
    return kept.with_columns(pl.Series(name, values) for name, values in columns.items()).match_to_schema(CHANGES)


def _parameter(changes: pl.DataFrame) -> ParameterChange:
    change, deviation = changes["change"].to_numpy(), changes["change_sd"].to_numpy()
    known = deviation > 0
    weight = np.where(known, 1 / np.where(known, deviation, 1.0) ** 2, 0.0)
    total = float(weight.sum())
    chi2 = float(np.sum(weight * change**2))
    clearest = changes.filter("significant").sort("p")["unit"].unique(maintain_order=True)
    new_sd = changes["new_sd"].to_numpy()
    return ParameterChange(
        parameter=changes["parameter"][0],
        unit_of_measure=changes["unit_of_measure"][0],
        campaigns=changes.height,
        significant=int(changes["significant"].sum()),
        mean_change=float(weight @ change) / total if total > 0 else None,
        mean_change_sd=total**-0.5 if total > 0 else None,
        rms_ratio=float(np.sqrt(np.mean((change / np.where(new_sd > 0, new_sd, np.inf)) ** 2))),
        sd_ratio=float(np.median(new_sd / np.where(changes["old_sd"].to_numpy() > 0, changes["old_sd"].to_numpy(), 1))),
        p=float(chi2_survival(chi2, max(int(known.sum()), 1))) if known.any() else 1.0,
        most_changed=tuple(clearest[:_MOST_UNITS]),
    )


DRIFTS = pl.Schema(
    {
        "unit": pl.String, "parameter": pl.String, "unit_of_measure": pl.String, "from": pl.Date, "to": pl.Date,
        "years": pl.Float64, "change": pl.Float64, "change_sd": pl.Float64, "p": pl.Float64,
        "significant": pl.Boolean,
    }
)  # fmt: skip
"""One row per unit, parameter and pair of consecutive calibrations; the change of the logarithm for scales."""


class Trend(Record):
    """The trend of a parameter over dates or serial numbers.

    Attributes
    ----------
    over, per : ``date`` with ``year``, or ``serial`` with ``100 serial numbers``.
    scale : ``linear``, or ``log``: the slope is of the natural logarithm.
    slope, slope_sd : per year, or per 100 serial numbers.
    p : two-sided, of no slope.
    significant : at a false discovery rate of 5 % over all parameters.
    """

    parameter: str
    unit_of_measure: str
    scale: Literal["linear", "log"]
    over: Literal["date", "serial"]
    per: str
    units: int
    slope: float
    slope_sd: float
    p: float
    significant: bool


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


class Trends(Record):
    """Trends and drifts of a batch, the most significant first."""

    format: Literal[1] = 1
    model: str
    rate: float = RATE
    trends: tuple[Trend, ...]
    drifts: tuple[Drift, ...]


def trends(parameters: pl.DataFrame, units: pl.DataFrame) -> tuple[Trends, pl.DataFrame]:
    """Return the trends and drifts of every parameter, and every change between calibrations (schema `DRIFTS`).

    Parameters
    ----------
    parameters, units : as `imubayes_archive.unit_fits.posterior_table.read_parameters` and `read_units` return them.
    """
    lines, drifts = [], [DRIFTS.to_frame()]
    scales: dict[str, Literal["linear", "log"]] = {}
    for rows in usable_rows(parameters):
        posteriors, scale = posteriors_of(rows, units)
        estimate, variance = posteriors.likelihood
        known = rows.with_columns(estimate=estimate, variance=variance).filter(pl.Series(posteriors.informative))
        scales[rows["parameter"][0]] = scale
        lines.extend(_trends(known, scale))
        drifts.append(_drifts(known))
    changes = pl.concat(drifts)
    changes = changes.with_columns(pl.Series("significant", discoveries(changes["p"].to_numpy(), RATE), pl.Boolean))
    significant = discoveries(np.array([line.p for line in lines]), RATE)
    told = [line.model_copy(update={"significant": bool(each)}) for line, each in zip(lines, significant, strict=True)]
    found = [_drift(each, scales[each["parameter"][0]]) for each in changes.partition_by("parameter")]
    record = Trends(
        model=units["model"][0] if units.height else "",
        trends=tuple(sorted(told, key=lambda line: line.p)),
        drifts=tuple(sorted(found, key=lambda each: each.p)),
    )
    return record, changes


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


def _trends(rows: pl.DataFrame, scale: Literal["linear", "log"]) -> Iterator[Trend]:
    """Yield the trends over dates and over serial numbers, where units differ in them."""
    first = rows.sort("date", "digest", nulls_last=True).unique("unit", keep="first", maintain_order=True)
    dated = first.filter(pl.col("date").is_not_null())
    years = (dated["date"].cast(pl.Int32).cast(pl.Float64) / DAYS_PER_YEAR).to_numpy()
    numbers = [serial_number(unit) for unit in first["unit"]]
    numbered = first.filter(pl.Series([number is not None for number in numbers], dtype=pl.Boolean))
    serials = np.array([number for number in numbers if number is not None], dtype=float) / 100
    over: tuple[tuple[Literal["date", "serial"], str, pl.DataFrame, np.ndarray], ...] = (
        ("date", "year", dated, years), ("serial", "100 serial numbers", numbered, serials),
    )  # fmt: skip
    for name, per, chosen, place in over:
        if chosen.height <= LEAST_UNITS or np.ptp(place) == 0:
            continue
        slope, deviation = regression(chosen["estimate"].to_numpy(), chosen["variance"].to_numpy(), place)
        yield Trend(
            parameter=rows["parameter"][0],
            unit_of_measure=rows["unit_of_measure"][0],
            scale=scale,
            over=name,
            per=per,
            units=chosen.height,
            slope=slope,
            slope_sd=deviation,
            p=float(2 * t_survival(abs(slope) / deviation, chosen.height - 2)),
            significant=False,
        )


def regression(estimate: np.ndarray, variance: np.ndarray, place: np.ndarray) -> tuple[float, float]:
    """Return posterior mean and standard deviation of the slope of estimates (n,) over `place` (n,)."""
    centred = place - place.mean()
    rest = estimate - np.polynomial.Polynomial.fit(centred, estimate, 1)(centred)
    # The grid of τ of a population without trend, about the residuals of an ordinary line.
    scale = normal_law(rest, variance).scale
    total = variance + scale[:, None] ** 2
    weight = 1 / total
    design = np.stack([np.ones_like(centred), centred])
    information = np.einsum("pn,gn,qn->gpq", design, weight, design)
    covariance = np.linalg.inv(information)
    coefficient = np.einsum("gpq,qn,gn,n->gp", covariance, design, weight, estimate)
    misfit = np.sum((estimate - coefficient @ design) ** 2 * weight, axis=1)
    log_density = -0.5 * (np.linalg.slogdet(information)[1] + np.sum(np.log(total), axis=1) + misfit)
    share = np.exp(log_density - log_density.max()) * np.gradient(scale)
    share /= share.sum()
    mean = float(share @ coefficient[:, 1])
    return mean, float(np.sqrt(share @ (covariance[:, 1, 1] + (coefficient[:, 1] - mean) ** 2)))


def _drifts(rows: pl.DataFrame) -> pl.DataFrame:
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

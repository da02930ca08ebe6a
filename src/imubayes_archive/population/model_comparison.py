"""Two models compared on the same campaigns, parameter by parameter and unit by unit.

Both fits saw the same data: their estimates are correlated, and the variance of their difference is not the sum.  If
the new model contains the old one and the old one is right, the old estimate is efficient and the difference has
variance var_new − var_old (J. Hausman, Econometrica 46, 1978).  A difference beyond that says that the old estimate was
wrong by what the old model lacks.
"""

from typing import Literal

import numpy as np
import polars as pl

from imubayes.foundations.records import Record, finite
from imubayes.foundations.tail_probabilities import chi2_survival, normal_survival
from imubayes_archive.population.population import RATE, discoveries

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
    mean_change, mean_change_sd : weighted mean of the changes, and its standard deviation; None if it is not known.
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
    # Also if the new model is the smaller one.
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

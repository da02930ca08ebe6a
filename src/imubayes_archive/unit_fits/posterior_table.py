"""Results of the units of a batch: a table with a row per unit and parameter, and one with a row per unit.

Both are plain Parquet, written in parts: a results folder holds

    model-<hash>/model.toml                      the model; the hash is that of model, settings and code
    model-<hash>/…                               the files that it names: effects of the user's own, noise priors
    model-<hash>/part-<key>/parameters.parquet   PARAMETERS: long form, one row per unit and parameter
    model-<hash>/part-<key>/units.parquet        UNITS: one row per unit, with the covariance of its parameters
    model-<hash>/population-<key>/               units given their population, once `imubayes batch population` has run
    model-<hash>/scores-<key>/scores.parquet     scores of candidate effects, once `imubayes batch diagnose` has run

A part is a folder that appears as a whole or not at all, with a manifest of its files; so are the others.  A campaign
is identified by the digest of its files: the columns `model` and `digest` join the tables.  A unit that could not be
fitted has one row in each, without a parameter.
"""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import polars as pl

from imubayes.foundations.errors import input_error
from imubayes.results.folder_files import unbroken

PARAMETER_FILE, UNIT_FILE, MODEL_FILE = "parameters.parquet", "units.parquet", "model.toml"
_MODEL, _PART = "model-", "part-"
_AGAIN = "remove that folder and run the same `imubayes batch` command again, which creates it again"
_ORDER = ["unit", "date", "digest"]
_ESTIMATES = ("names", "mean", "covariance")
_LOGARITHMS = ("log_mean", "log_sd", "prior_log_mean", "prior_log_sd")

Status = Literal["fitted", "not_converged", "refused", "failed"]
"""`fitted`; `not_converged`: no estimates; `refused`: the campaign cannot be used; `failed`: an unexpected error."""
Kind = Literal["parameter", "noise", "derived"]
"""`parameter` and `noise`: a component of z, of the model or of its noise; `derived`: a function of the parameters."""

PARAMETERS = pl.Schema(
    {
        "model": pl.String, "unit": pl.String, "campaign": pl.String, "digest": pl.String, "date": pl.Date,
        "parameter": pl.String, "kind": pl.String, "unit_of_measure": pl.String,
        "mean": pl.Float64, "sd": pl.Float64,
        "q2_5": pl.Float64, "q25": pl.Float64, "q50": pl.Float64, "q75": pl.Float64, "q97_5": pl.Float64,
        "prior_mean": pl.Float64, "prior_sd": pl.Float64, "from_data": pl.Float64,
        "log_mean": pl.Float64, "log_sd": pl.Float64, "prior_log_mean": pl.Float64, "prior_log_sd": pl.Float64,
        "log_grid": pl.List(pl.Float64), "log_likelihood": pl.List(pl.Float64),
        "status": pl.String, "reason": pl.String, "verdict": pl.String, "seconds": pl.Float64,
    }
)  # fmt: skip
UNITS = pl.Schema(
    {
        "model": pl.String, "code": pl.String, "unit": pl.String, "campaign": pl.String, "digest": pl.String,
        "file": pl.String, "date": pl.Date, "year": pl.Int32, "structure": pl.String,
        "tables": pl.List(pl.String), "mountings": pl.List(pl.String), "procedures": pl.List(pl.String),
        "labels": pl.List(pl.String),
        "latitude": pl.Float64, "height": pl.Float64, "gravity": pl.Float64,
        "status": pl.String, "reason": pl.String, "where": pl.String, "fingerprint": pl.String, "verdict": pl.String,
        "method": pl.String, "flagged": pl.Boolean, "pareto_k": pl.Float64, "weight_skewness": pl.Float64,
        "draws": pl.Float64,
        "noise_violations": pl.List(pl.String), "noise_contradicted": pl.List(pl.String),
        "readings": pl.Int64, "chi2": pl.Float64, "log_evidence": pl.Float64, "seconds": pl.Float64,
        "names": pl.List(pl.String), "mean": pl.List(pl.Float64), "covariance": pl.List(pl.Float64),
    }
)  # fmt: skip


@dataclass(frozen=True)
class UnitIdentity:
    """Which campaign it is, on which equipment and where.

    Attributes
    ----------
    unit, campaign, digest, file : serial number, name, digest of the files, and the file or folder it was read from.
    date : of the first run that is dated.
    structure : key of the structure; empty if the campaign was fitted alone.
    tables, mountings, procedures : names, sorted.
    labels : what the campaign states of its unit and its making, such as ``lot=B7``, sorted.
    latitude, height, gravity : of the site: deg, m, m/s².
    """

    unit: str
    campaign: str
    digest: str
    file: str
    date: datetime.date | None = None
    structure: str = ""
    tables: tuple[str, ...] = ()
    mountings: tuple[str, ...] = ()
    procedures: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    latitude: float | None = None
    height: float | None = None
    gravity: float | None = None


@dataclass(frozen=True)
class Quantities:
    """Estimates of D quantities of one kind, in their units of measure; arrays of shape (D,).

    Attributes
    ----------
    names, units : shape (D,).
    quantiles : shape (5, D), at 2.5, 25, 50, 75 and 97.5 %.
    prior_mean, prior_sd : NaN where the prior has none.
    from_data : 1 − posterior variance / prior variance; NaN for a quantity that no parameter changes.
    logarithms : of noise scales; None for other kinds.
    """

    kind: Kind
    names: tuple[str, ...]
    units: tuple[str, ...]
    mean: np.ndarray
    sd: np.ndarray
    quantiles: np.ndarray
    prior_mean: np.ndarray
    prior_sd: np.ndarray
    from_data: np.ndarray
    logarithms: "Logarithms | None" = None


@dataclass(frozen=True)
class Logarithms:
    """What the data say of the natural logarithms of D noise scales; NaN for one that is not positive.

    Attributes
    ----------
    moments : shape (4, D), mean and standard deviation, posterior and prior.
    grid, likelihood : shape (D, G), logarithms of the scale, and of its likelihood there up to a constant, all other
        parameters integrated over with their priors.
    """

    moments: np.ndarray
    grid: np.ndarray
    likelihood: np.ndarray


@dataclass(frozen=True)
class Outcome:
    """How a fit ended.

    Attributes
    ----------
    reason, where, fingerprint : what went wrong, the file it is about, and a digest of the campaign as it was; empty
        for a unit that was fitted.
    verdict : of the diagnosis; empty if none was asked for.
    method : `laplace` or `emcee`.
    flagged : whether the Laplace approximation is in doubt by its importance weights; None if they were not asked.
    pareto_k, weight_skewness : of these weights.
    draws : effective number of draws that means and standard deviations were estimated from; None if they are exact.
    noise_violations : how the noise departs from its model, such as ``autocorrelation``.
    noise_contradicted : noise scales that exceed what is known of them beforehand.  With either, intervals of the unit
        must not be trusted.
    readings : number of readings.
    chi2 : squared norm of the whitened residuals.
    log_evidence : Laplace estimate of log p(y).
    seconds : time spent on the unit; its share of the time of its chunk.
    """

    status: Status
    reason: str = ""
    where: str = ""
    fingerprint: str = ""
    verdict: str = ""
    method: str = ""
    flagged: bool | None = None
    pareto_k: float | None = None
    weight_skewness: float | None = None
    draws: float | None = None
    noise_violations: tuple[str, ...] = ()
    noise_contradicted: tuple[str, ...] = ()
    readings: int = 0
    chi2: float = float("nan")
    log_evidence: float = float("nan")
    seconds: float = 0.0


@dataclass(frozen=True)
class UnitPosterior:
    """One unit of a batch.

    Attributes
    ----------
    quantities : parameters and noise scales, then derived quantities; empty if the unit has no estimates.
    covariance : shape (D, D), of parameters and noise scales, in their order and units.
    """

    identity: UnitIdentity
    outcome: Outcome
    quantities: tuple[Quantities, ...] = ()
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def joint(self) -> tuple[Quantities, ...]:
        """The quantities that the covariance is of."""
        return tuple(each for each in self.quantities if each.kind != "derived")


def doubted(units: pl.DataFrame) -> pl.DataFrame:
    """Return the rows of units whose noise contradicts the model: their intervals must not be trusted."""
    return units.filter(pl.col("noise_violations").list.len() + pl.col("noise_contradicted").list.len() > 0)


def packed(covariance: np.ndarray) -> list[float]:
    """Return the lower triangle (D (D + 1) / 2,) of a covariance (D, D), row by row."""
    return covariance[np.tril_indices(len(covariance))].tolist()


def unpacked(triangle: Sequence[float] | np.ndarray | pl.Series) -> np.ndarray:
    """Return the covariance (D, D) of a lower triangle, row by row."""
    values = np.asarray(triangle, dtype=float)
    size = int((np.sqrt(8 * len(values) + 1) - 1) / 2)
    lower = np.zeros((size, size))
    lower[np.tril_indices(size)] = values
    return lower + np.tril(lower, -1).T


def parameter_table(model: str, units: Sequence[UnitPosterior]) -> pl.DataFrame:
    """Return the long form of some units, one row per unit and parameter."""
    return pl.concat([PARAMETERS.to_frame(), *(_long_form(model, unit) for unit in units)])


def _long_form(model: str, unit: UnitPosterior) -> pl.DataFrame:
    identity, outcome, parts = unit.identity, unit.outcome, unit.quantities
    columns: dict[str, list | np.ndarray] = {"parameter": [None], "kind": [None], "unit_of_measure": [None]}
    if parts:
        columns = {
            "parameter": [name for part in parts for name in part.names],
            "kind": [part.kind for part in parts for _ in part.names],
            "unit_of_measure": [text for part in parts for text in part.units],
        }
        for name in ("mean", "sd", "prior_mean", "prior_sd", "from_data"):
            columns[name] = np.concatenate([getattr(part, name) for part in parts])
        columns |= _of_logarithms(parts)
        quantiles = np.concatenate([part.quantiles for part in parts], axis=1)
        columns |= dict(zip(("q2_5", "q25", "q50", "q75", "q97_5"), quantiles, strict=True))
    same = {
        "model": model, "unit": identity.unit, "campaign": identity.campaign, "digest": identity.digest,
        "date": identity.date, "status": outcome.status, "reason": outcome.reason, "verdict": outcome.verdict,
        "seconds": outcome.seconds,
    }  # fmt: skip
    present = {name: kind for name, kind in PARAMETERS.items() if name in columns}
    frame = pl.DataFrame(columns, schema=present, nan_to_null=True)
    return frame.with_columns(
        pl.lit(same.get(name), dtype=kind).alias(name) for name, kind in PARAMETERS.items() if name not in present
    ).select(PARAMETERS.names())


def _of_logarithms(parts: Sequence[Quantities]) -> dict[str, list | np.ndarray]:
    """Return the columns of the logarithms of noise scales, null for other kinds."""
    moments = [
        np.full((4, len(part.names)), np.nan) if part.logarithms is None else part.logarithms.moments for part in parts
    ]
    columns: dict[str, list | np.ndarray] = dict(zip(_LOGARITHMS, np.concatenate(moments, axis=1), strict=True))
    for name in ("grid", "likelihood"):
        rows = [
            [None] * len(part.names) if part.logarithms is None else getattr(part.logarithms, name).tolist()
            for part in parts
        ]
        columns[f"log_{name}"] = [row for part in rows for row in part]
    return columns


def unit_table(model: str, code: str, units: Sequence[UnitPosterior]) -> pl.DataFrame:
    """Return the units as a table, one row each."""
    rows = [
        {
            **vars(unit.identity),
            **vars(unit.outcome),
            "model": model,
            "code": code,
            "year": unit.identity.date.year if unit.identity.date else None,
            "names": [name for part in unit.joint for name in part.names],
            "mean": np.concatenate([part.mean for part in unit.joint]).tolist() if unit.joint else [],
            "covariance": packed(unit.covariance),
        }
        for unit in units
    ]
    frame = pl.DataFrame(rows, schema=UNITS, strict=False)
    return frame.with_columns(pl.col(pl.Float64).fill_nan(None))


def models_in(results: str | Path) -> list[str]:
    """Return the hashes of the models that a results folder holds, oldest first; raises InputError if none."""
    folders = [place for place in Path(results).glob(f"{_MODEL}*") if place.is_dir()]
    if not folders:
        raise input_error(
            "the folder holds no results of a batch",
            str(results),
            "a folder that `imubayes batch` has written",
            "imubayes batch ARCHIVE --model MODEL --out RESULTS",
        )
    ordered = sorted(folders, key=lambda place: ((place / MODEL_FILE).stat().st_mtime, place.name))
    return [place.name.removeprefix(_MODEL) for place in ordered]


def model_folder(results: str | Path, model: str) -> Path:
    """Return the folder of a model's parts."""
    return Path(results) / f"{_MODEL}{model}"


def kept_model(results: str | Path, model: str | None) -> Path:
    """Return the model file of a batch, as it was written; raises InputError if it is not."""
    return unbroken(model_folder(results, chosen_model(results, model)), _AGAIN) / MODEL_FILE


def part_folder(results: str | Path, model: str, key: str) -> Path:
    """Return the folder of a part."""
    return model_folder(results, model) / f"{_PART}{key}"


def read_parameters(results: str | Path, model: str | None = None) -> pl.DataFrame:
    """Return the long form of a batch, one row per unit and parameter, sorted by unit, date and digest.

    Parameters
    ----------
    results : the results folder.
    model : hash of the model, or its beginning; the only one if None.

    Raises
    ------
    InputError
        if there is no such model, or several and none is named.
    """
    return pl.concat([PARAMETERS.to_frame(), *_parts(results, model, PARAMETER_FILE)]).sort(_ORDER, maintain_order=True)


def read_units(results: str | Path, model: str | None = None) -> pl.DataFrame:
    """Return the units of a batch, one row each, as `read_parameters` does; `unpacked` gives a covariance."""
    return pl.concat([UNITS.to_frame(), *_parts(results, model, UNIT_FILE)]).sort(_ORDER, maintain_order=True)


def read_outcomes(results: str | Path, model: str | None = None) -> pl.DataFrame:
    """Return the units of a batch without their estimates, which take most of the memory."""
    columns = [name for name in UNITS.names() if name not in _ESTIMATES]
    parts = _parts(results, model, UNIT_FILE, columns)
    return pl.concat([UNITS.to_frame().select(columns), *parts]).sort(_ORDER, maintain_order=True)


def chosen_model(results: str | Path, model: str | None) -> str:
    """Return the full hash of a model of a results folder."""
    known = models_in(results)
    found = [name for name in known if name.startswith(model or "")]
    if len(found) == 1:
        return found[0]
    raise input_error(
        "the results are of several models" if found else f"there are no results of model '{model}'",
        str(results),
        ", ".join(known),
        "name one of them with --model-hash; the last one is the newest",
    )


def _parts(results: str | Path, model: str | None, name: str, columns: list[str] | None = None) -> list[pl.DataFrame]:
    folder = model_folder(results, chosen_model(results, model))
    return [pl.read_parquet(part / name, columns=columns) for part in whole_parts(folder)]


def whole_parts(folder: Path, prefix: str = _PART) -> list[Path]:
    """Return the folders of a model that begin with a prefix, each as it was written; raises InputError else."""
    return [unbroken(part, _AGAIN) for part in sorted(folder.glob(f"{prefix}*")) if part.is_dir()]

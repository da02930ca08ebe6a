"""Pictures of a diagnosis and of an addition: which channel and covariate they show, and where they are kept."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import polars as pl

from imubayes.adequacy.known_noise import KnownNoise
from imubayes.covariates import Covariate, shown
from imubayes.criticism.diagnosis_record import CovariateLabel, EffectGroup
from imubayes.criticism.residual_evidence import ResidualEvidence, of_runs
from imubayes.display.figures.recorded_noise import recorded_noise_figure
from imubayes.display.figures.residual_evidence import (
    FollowedCovariate,
    added_variable_figure,
    before_after_figure,
    evidence_figure,
)
from imubayes.display.labels import pretty
from imubayes.display.residual_columns import numbers
from imubayes.display.run_signs import RunSigns, run_signs
from imubayes.display.theme import Picture
from imubayes.responses.effect_covariates import INPUTS
from imubayes.responses.residual_covariates import ResidualCovariate
from imubayes.results.record_names import RESIDUALS

_LEVELS, _LEAST_SHARE, _TIME_LAST = 24, 0.15, 0.1
# A ratio to the input is shown where it tells clearly more than the plain residual.
_RATIO_LAST = 0.05
_BY_ROW = "row, in the order of the runs"


def save_evidence(folder: Path, evidence: ResidualEvidence) -> Path:
    """Draw the residual that shows a missing effect into the `figures` of its result folder; return the file."""
    covariate = evidence.covariate if evidence.over is None else evidence.over.covariate
    against = _label(covariate) if covariate is not None else _BY_ROW
    return _saved(folder, evidence_figure(evidence, against, _signs_of(folder)), "diagnosis.png")


def _label(covariate: Covariate | ResidualCovariate | CovariateLabel) -> str:
    return covariate.phrase + (f" / {pretty(covariate.unit)}" if covariate.unit else "")


def save_recorded_noise(folder: Path, record: KnownNoise) -> Path:
    """Draw fitted against recorded noise into the `figures` of a result folder; return the file."""
    return _saved(folder, recorded_noise_figure(record, _signs_of(folder)), "recorded_noise.png")


def _signs_of(folder: Path) -> RunSigns | None:
    """Return the signs of the runs of a result folder; None where it has no residuals."""
    file = folder / RESIDUALS
    return run_signs(pl.read_parquet(file)) if file.is_file() else None


def _saved(folder: Path, drawn: Picture, name: str) -> Path:
    target = folder / "figures"
    target.mkdir(exist_ok=True)
    return drawn.save(target / name)


def before_after(
    before: pl.DataFrame,
    after: pl.DataFrame,
    step: str,
    floors: Mapping[str, float] | None = None,
    group: EffectGroup | None = None,
) -> Picture | None:
    """Return the residual of the channel that changed most against its covariate; None where the tables do not match.

    Parameters
    ----------
    before, after : `residuals.parquet` of two fits of one campaign.
    step : between the fits, such as ``adding gyro_bias_drift``.
    floors : channel → noise of one row, input units.
    group : of the diagnosis before, whose channel and covariate are shown; without it those that changed most.  Where
        its residual is about the mean of each run, so are both.
    """
    keys = ["run", "row", "channel"]
    joined = before.join(after.select([*keys, pl.col("input_residual").alias("after")]), on=keys, how="inner")
    joined = joined.filter(~pl.col("channel").str.starts_with("closure_"))
    if not joined.height:
        return None
    change = ((pl.col("input_residual") - pl.col("after")) / pl.col("input_sd")) ** 2
    channel = joined.group_by("channel").agg(change.sum().alias("worth")).sort("worth")["channel"][-1]
    if group is not None and group.residual.channel in joined["channel"].unique().to_list():
        channel = group.residual.channel
    named = group.covariate if group is not None else None
    own = joined.filter(pl.col("channel") == channel)
    before_own, after_own = own["input_residual"].to_numpy(), own["after"].to_numpy()
    runs, within = own["run"].to_numpy(), group is not None and group.within
    if within:
        before_own, after_own = (each - of_runs(each, runs) for each in (before_own, after_own))
    if named is not None and named.name in INPUTS.values() and "input_observed" in own.columns:
        followed = FollowedCovariate(numbers(own, "input_observed"), _label(named))
    else:
        followed = followed_covariate(own, before_own - after_own, named.name if named is not None else None)
    return before_after_figure(
        followed, before_own, after_own, runs.tolist(), channel, own["input_unit"][0], step,
        (floors or {}).get(channel), run_signs(before), within,
    )  # fmt: skip


def followed_covariate(own: pl.DataFrame, change: np.ndarray, named: str | None = None) -> FollowedCovariate:
    """Return the covariate that a change follows best, by the means of its levels; the row where it follows none.

    One that is named goes first where the table has it; time, along which everything changes, goes last.  Where the
    change over the input follows a covariate clearly better than the change itself follows any, that one is returned
    with the input: a change of the scale factor with temperature, in rows of both signs of the input.
    """
    stimulus = numbers(own, "input_observed")
    best, followed = _LEAST_SHARE, FollowedCovariate(np.arange(own.height, dtype=float), _BY_ROW)
    for covariate in shown():
        x = numbers(own, covariate.column)
        late = _TIME_LAST if covariate.si == "s" else 0.0
        shares = (_share(x, change) + (2.0 if covariate.column == named else 0.0), _share_of_ratio(x, change, stimulus))
        for share, over in ((shares[0], None), (shares[1] - _RATIO_LAST, stimulus)):
            if share - late > best:
                best, followed = share - late, FollowedCovariate(x, _label(covariate), over)
    return followed


def _share(x: np.ndarray, y: np.ndarray) -> float:
    """Return the share of the variance of y between levels of x, less what chance gives."""
    return _share_of_ratio(x, y, np.ones(len(y)))


def _share_of_ratio(x: np.ndarray, y: np.ndarray, stimulus: np.ndarray) -> float:
    """Return the share of the variance of y that a ratio y/stimulus by levels of x gives, less what chance gives.

    It is 0 where one ratio for all levels gives as much.
    """
    good = np.isfinite(x) & np.isfinite(stimulus)
    if good.sum() < 0.6 * len(x) or np.ptp(x[good]) == 0:
        return 0.0
    x, y, stimulus = x[good], y[good], stimulus[good]
    edges = np.unique(np.quantile(x, np.linspace(0, 1, min(_LEVELS, max(3, len(x) // 6)) + 1)))
    level = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    weight = np.bincount(level, stimulus**2, len(edges) - 1)
    product = np.bincount(level, stimulus * y, len(edges) - 1)
    whole, squares = float(np.sum((y - y.mean()) ** 2)), float(y @ y)
    rest = squares - float(np.sum(product**2 / np.where(weight > 0, weight, np.inf)))
    constant = squares - (float(product.sum() ** 2 / weight.sum()) if weight.sum() > 0 else 0.0)
    chance = (len(edges) - 2) * rest / max(len(x) - len(edges) + 1, 1)
    if whole <= 0 or constant - rest - chance <= _LEAST_SHARE * whole:
        return 0.0
    return 1 - (rest + chance) / whole


def added_variable(table: pl.DataFrame, added: str, residuals: pl.DataFrame | None = None) -> Picture | None:
    """Return the added-variable plot of an addition; None where it has no points.

    `residuals` of the same campaign tell the mountings and temperatures of its runs.
    """
    if not table.height:
        return None
    signs = None if residuals is None else run_signs(residuals)
    columns = (table["added"].to_numpy(), table["residual"].to_numpy(), table["run"].to_list())
    return added_variable_figure(*columns, added, signs)

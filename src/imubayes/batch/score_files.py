"""Scores of candidate effects of every fitted campaign of a batch, kept beside its parts.

They are computed from the estimates of the batch, a chunk of campaigns at a time; each file appears as a whole or not
at all, and a campaign that has scores is not computed again.
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import polars as pl

from imubayes.atomic_files import replacing
from imubayes.batch.fit_unit import bound_to
from imubayes.batch.posterior_table import MODEL_FILE, chosen_model, model_folder, read_units
from imubayes.batch.unit_scores import SCORES, unit_scores
from imubayes.batch.unit_sources import UnitSource
from imubayes.campaign_data import Campaign
from imubayes.errors import InputError, Issue, input_error
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.model_file import read_carried_model
from imubayes.model.model_spec import ModelSpec

_PREFIX, _CHUNK, _DIGITS = "scores-", 32, 16


def read_unit_scores(results: str | Path, model: str | None = None) -> pl.DataFrame:
    """Return the scores of a batch, schema `SCORES`; raises InputError where they are of another version."""
    folder = model_folder(results, chosen_model(results, model))
    tables = {file: pl.read_parquet(file) for file in sorted(folder.glob(f"{_PREFIX}*.parquet"))}
    for file, table in tables.items():
        if table.schema != SCORES:
            raise input_error(
                "the scores of the batch were written by another version of imubayes",
                str(file),
                "scores of this version",
                "run imubayes batch again, with --out of another folder",
            )
    return pl.concat([SCORES.to_frame(), *tables.values()])


def complete_scores(
    results: str | Path, model: str | None = None, progress: Callable[[int, int], None] | None = None
) -> list[Issue]:
    """Compute the scores of every fitted campaign that has none; return why some cannot have any.

    Parameters
    ----------
    results, model : the batch.
    progress : called with the numbers of campaigns done and to do.
    """
    units = read_units(results, model).filter(pl.col("status") == "fitted")
    key = chosen_model(results, model)
    folder = model_folder(results, key)
    spec, known = read_carried_model(folder / MODEL_FILE), set(read_unit_scores(results, key)["digest"])
    missing = [row for row in units.iter_rows(named=True) if row["digest"] not in known]
    issues: list[Issue] = []
    for start in range(0, len(missing), _CHUNK):
        rows = missing[start : start + _CHUNK]
        found = list(_scored(spec, rows, issues))
        if found:
            name = hashlib.sha256("\0".join(row["digest"] for row in rows).encode()).hexdigest()[:_DIGITS]
            with replacing(folder / f"{_PREFIX}{name}.parquet", durable=True) as scratch:
                pl.concat(found).write_parquet(scratch)
        if progress is not None:
            progress(min(start + _CHUNK, len(missing)), len(missing))
    return issues


def _scored(spec: ModelSpec, rows: Sequence[dict], issues: list[Issue]) -> Iterator[pl.DataFrame]:
    """Yield the scores of some campaigns; those that cannot be read or fitted again are added to the issues."""
    for row in rows:
        path = Path(row["file"])
        source = UnitSource(row["digest"], row["unit"], row["campaign"], row["file"], path.suffix == ".parquet")
        try:
            yield unit_scores(refitted(spec, source.read(), row), row["unit"], row["digest"])
        except InputError as error:
            issues.extend(error.issues)


def refitted(spec: ModelSpec, campaign: Campaign, row: dict) -> Fit:
    """Return the fit of a campaign from its row in the table of units.

    Raises
    ------
    InputError
        where the campaign is not the one that was fitted.
    """
    model = bound_to(spec, campaign)
    layouts = model.layout, model.hyper_layout
    means = dict(zip(row["names"], row["mean"], strict=True))
    start = [
        jnp.array([_start(parameter.z_at(means.get(parameter.name, np.nan))) for parameter in layout.parameters])
        for layout in layouts
    ]
    mode = find_mode(model.problem, *start)
    if not bool(mode.converged):
        raise InputError(
            Issue(
                f"unit {row['unit']}: the optimiser does not find the mode again",
                row["file"],
                "the campaign that was fitted",
                "run the batch again with --retry",
            )
        )
    return Fit(model, np.asarray(mode.z), np.asarray(mode.h), True)


def _start(z: float | None) -> float:
    return z if z is not None and np.isfinite(z) else 0.0

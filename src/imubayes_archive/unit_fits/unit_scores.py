"""Scores of all candidate effects in the fit of each unit (`imubayes.criticism.effect_scores`), and their files.

Scores are computed for every fitted campaign from the estimates of the batch, a chunk of campaigns at a time, and kept
beside its parts.  Each file appears as a whole or not at all, and a campaign that has scores is not computed again.
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from imubayes import Fit
from imubayes.criticism.effect_scores import EffectScores, effect_scores
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import InputError, Issue, input_error, kept_if_possible
from imubayes.foundations.files import new_folder
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.model_file import ModelSpec, read_carried_model
from imubayes.results.folder_files import seal
from imubayes_archive.unit_fits.batch_folder import UnitSource
from imubayes_archive.unit_fits.fit_unit import bound_to
from imubayes_archive.unit_fits.posterior_table import (
    chosen_model,
    kept_model,
    model_folder,
    packed,
    read_units,
    whole_parts,
)

SCORES = pl.Schema(
    {
        "digest": pl.String, "unit": pl.String, "effect": pl.String, "shape": pl.String, "scope": pl.String,
        "part": pl.String, "owners": pl.List(pl.String), "coefficients": pl.List(pl.String), "log_odds": pl.Float64,
        "widths": pl.List(pl.Float64), "measures": pl.List(pl.String), "sizes": pl.List(pl.Float64),
        "signs": pl.List(pl.Int8), "score": pl.List(pl.Float64), "information": pl.List(pl.Float64),
    }
)  # fmt: skip
"""One row per campaign and candidate, up to `widths`; one more per campaign, without an effect, with what follows of
all coefficients: units, largest typical sizes, signs, score, and the lower triangle of the information."""


def unit_scores(fit: Fit, unit: str, digest: str) -> pl.DataFrame:
    """Return the scores of every candidate effect of a converged fit, schema `SCORES`."""
    return table_of(effect_scores(fit), unit, digest)


def table_of(scores: EffectScores, unit: str, digest: str) -> pl.DataFrame:
    """Return the scores of a unit as a table, schema `SCORES`."""
    rows = [
        {
            **vars(each.key), "owners": list(each.owners), "log_odds": each.log_odds, "widths": list(each.widths),
            "coefficients": [scores.names[place] for place in each.places],
        }
        for each in scores.candidates
    ]  # fmt: skip
    together = {
        "coefficients": list(scores.names), "measures": list(scores.measures), "sizes": scores.sizes.tolist(),
        "signs": scores.signs.tolist(), "score": scores.score.tolist(), "information": packed(scores.information),
    }  # fmt: skip
    return pl.DataFrame([{"digest": digest, "unit": unit, **each} for each in (*rows, together)], schema=SCORES)


_PREFIX, _SCORES, _CHUNK, _DIGITS = "scores-", "scores.parquet", 32, 16


def read_unit_scores(results: str | Path, model: str | None = None) -> pl.DataFrame:
    """Return the scores of a batch, schema `SCORES`; raises InputError if they are of another version."""
    folder = model_folder(results, chosen_model(results, model))
    tables = {part: pl.read_parquet(part / _SCORES) for part in whole_parts(folder, _PREFIX)}
    for file, table in tables.items():
        if table.schema != SCORES:
            raise input_error(
                "the scores of the batch were written by another version of imubayes",
                str(file),
                "scores of this version",
                "run imubayes batch again, with --out of another folder",
            )
    return pl.concat([SCORES.to_frame(), *tables.values()])


@dataclass(frozen=True)
class ScoresOfUnits:
    """Scores of a batch, schema `SCORES`, and why some campaigns have none."""

    table: pl.DataFrame
    issues: tuple[Issue, ...]


def complete_scores(
    results: str | Path, model: str | None = None, progress: Callable[[int, int], None] | None = None
) -> ScoresOfUnits:
    """Return the scores of every fitted campaign; those that have none yet are computed, and kept if possible.

    Parameters
    ----------
    results, model : the batch.
    progress : called with the numbers of campaigns done and to do.

    Raises
    ------
    InputError
        for scores of another version, and effect files that are not trusted.
    """
    units = read_units(results, model).filter(pl.col("status") == "fitted")
    key = chosen_model(results, model)
    folder = model_folder(results, key)
    spec, tables = read_carried_model(kept_model(results, key)), [read_unit_scores(results, key)]
    known = set(tables[0]["digest"])
    missing = [row for row in units.iter_rows(named=True) if row["digest"] not in known]
    issues: list[Issue] = []
    for start in range(0, len(missing), _CHUNK):
        rows = missing[start : start + _CHUNK]
        found = pl.concat([SCORES.to_frame(), *_scored(spec, rows, issues)])
        tables.append(found)
        if len(found):
            name = hashlib.sha256("\0".join(row["digest"] for row in rows).encode()).hexdigest()[:_DIGITS]
            with kept_if_possible(folder), new_folder(folder / f"{_PREFIX}{name}", durable=True) as scratch:
                found.write_parquet(scratch / _SCORES)
                seal(scratch)
        if progress is not None:
            progress(min(start + _CHUNK, len(missing)), len(missing))
    return ScoresOfUnits(pl.concat(tables), tuple(issues))


def _scored(spec: ModelSpec, rows: Sequence[dict], issues: list[Issue]) -> Iterator[pl.DataFrame]:
    """Yield the scores of some campaigns; those that cannot be read or fitted again are added to the issues."""
    for row in rows:
        try:
            yield unit_scores(refitted(spec, UnitSource.of_row(row).read(), row), row["unit"], row["digest"])
        except InputError as error:
            issues.extend(error.issues)


def refitted(spec: ModelSpec, campaign: Campaign, row: dict) -> Fit:
    """Return the fit of a campaign from its row in the table of units.

    Raises
    ------
    InputError
        if the campaign is not the one that was fitted.
    """
    model = bound_to(spec, campaign)
    layouts = model.layout, model.hyper_layout
    means = dict(zip(row["names"], row["mean"], strict=True))
    start = [
        np.array([_start(parameter.z_at(means.get(parameter.name, np.nan))) for parameter in layout.parameters])
        for layout in layouts
    ]
    mode = find_mode(model.problem, *start)
    if not bool(mode.converged):
        raise input_error(
            f"unit {row['unit']}: the optimiser does not find the mode again",
            row["file"],
            "the campaign that was fitted",
            "run the batch again with --retry",
        )
    return Fit(model, np.asarray(mode.z), np.asarray(mode.h), True)


def _start(z: float | None) -> float:
    return z if z is not None and np.isfinite(z) else 0.0

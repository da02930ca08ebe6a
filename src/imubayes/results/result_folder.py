"""The result folder: its one writer and its one reader.

A result is written to a scratch folder and put in place as a whole, so that there is never half a result.
"""

import shutil
from pathlib import Path

import polars as pl
import tomlkit

from imubayes.atomic_files import replacing_files
from imubayes.errors import InputError, Issue
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_tree import posterior_tree
from imubayes.model.model_spec import ModelSpec
from imubayes.results.fit_file import fit_record
from imubayes.results.folder_state import (
    AGAIN,
    FIT,
    MODEL,
    POSTERIOR,
    RESIDUALS,
    SUMMARY,
    damaged,
    missing,
    read_record,
)
from imubayes.results.residuals import COLUMNS, Residuals
from imubayes.results.summary import Summary


def write_result(folder: Path, fit: Fit, summary: Summary, residuals: Residuals, seed: int = 0) -> None:
    """Write `summary.json`, `fit.json`, `posterior.nc`, `residuals.parquet`, `model.toml` and the user's effect files.

    What an earlier fit wrote is replaced; other files of the folder stay.
    """
    with replacing_files(folder, last=SUMMARY) as scratch:
        (scratch / SUMMARY).write_text(summary.json_text(), encoding="utf-8")
        (scratch / FIT).write_text(fit_record(fit, folder, seed).json_text(), encoding="utf-8")
        residuals.table.write_parquet(scratch / RESIDUALS)
        (scratch / MODEL).write_text(model_text(fit.model.spec), encoding="utf-8")
        for file in fit.model.spec.files:
            shutil.copyfile(file, scratch / Path(file).name)
        if fit.posterior is not None:
            posterior_tree(fit).to_netcdf(str(scratch / POSTERIOR), engine="h5netcdf")
        else:
            (folder / POSTERIOR).unlink(missing_ok=True)


def model_text(spec: ModelSpec) -> str:
    """Return a model as the text of a model file."""
    document = tomlkit.document()
    document["format"] = 1
    document["name"] = spec.name
    if spec.files:
        document["files"] = [Path(file).name for file in spec.files]
    if spec.delta_k_threshold is not None:
        document["delta_k_threshold_percent"] = 100 * spec.delta_k_threshold
    effects = tomlkit.aot()
    for effect in spec.effects:
        entry = tomlkit.table()
        entry["name"] = effect.name
        if effect.channels is not None:
            entry["channels"] = list(effect.channels)
        if effect.per is not None:
            entry["per"] = effect.per
        if effect.optional:
            entry["optional"] = True
        if effect.prior:
            prior = tomlkit.inline_table()
            prior.update(effect.prior)
            entry["prior"] = prior
        for key, value in effect.options.items():
            entry[key] = value
        effects.append(entry)
    document["effect"] = effects
    if spec.correlations:
        blocks = tomlkit.aot()
        for block in spec.correlations:
            entry = tomlkit.table()
            entry["parameters"] = list(block.parameters)
            entry["matrix"] = [list(row) for row in block.matrix]
            if block.optional:
                entry["optional"] = True
            blocks.append(entry)
        document["prior_correlation"] = blocks
    return tomlkit.dumps(document)


def read_summary_and_residuals(folder: Path) -> tuple[Summary, Residuals]:
    """Read what every result folder has.

    Raises
    ------
    InputError
        if it is missing, incomplete or damaged; every issue is in it.
    """
    issues = missing(folder)
    if issues:
        raise InputError(issues)
    try:
        summary = read_record(folder / SUMMARY, Summary)
    except InputError as error:
        summary, issues = None, [*error.issues]
    residuals = _read_residuals(folder / RESIDUALS, issues)
    if summary is not None and summary.sampled and not (folder / POSTERIOR).is_file():
        where = str(folder / POSTERIOR)
        issues.append(Issue("the posterior is missing", where, f"{POSTERIOR}, as written by the fit", AGAIN))
    if issues or summary is None or residuals is None:
        raise InputError(issues)
    return summary, residuals


def _read_residuals(file: Path, issues: list[Issue]) -> Residuals | None:
    try:
        frame = pl.read_parquet(file)
    except (OSError, pl.exceptions.PolarsError) as error:
        issues.append(damaged(file, error))
        return None
    absent = [name for name in COLUMNS if name not in frame.columns]
    if absent:
        issues.append(
            Issue(f"the residuals lack the columns {', '.join(absent)}", str(file), ", ".join(COLUMNS), AGAIN)
        )
        return None
    if frame.is_empty():
        issues.append(Issue("the residuals have no rows", str(file), "one row per run, row and channel", AGAIN))
        return None
    return Residuals(frame)

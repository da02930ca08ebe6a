"""The result folder: its one writer and its one reader.

A result is written to a scratch folder and put in place as a whole, so that there is never half a result.
"""

import shutil
from pathlib import Path

import tomlkit

from imubayes.atomic_files import replacing_files
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_groups import posterior_groups
from imubayes.model.model_spec import ModelSpec
from imubayes.results.fit_file import fit_record
from imubayes.results.posterior_file import write_posterior
from imubayes.results.record_names import FIT, MODEL, POSTERIOR, RESIDUALS, SUMMARY
from imubayes.results.residual_table import Residuals
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
            write_posterior(posterior_groups(fit), scratch / POSTERIOR)
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

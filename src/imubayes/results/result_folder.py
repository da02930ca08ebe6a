"""The result folder: written beside and put in place as a whole, so that there is never half a result."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tomlkit

from imubayes.errors import InputError, Issue
from imubayes.inference.checkpoint import steps_in
from imubayes.inference.joint_fit import JointFit
from imubayes.inference.posterior_tree import posterior_tree
from imubayes.model.model_spec import ModelSpec
from imubayes.results.fit_file import FIT, MODEL, fit_record, read_fit
from imubayes.results.residuals import Residuals
from imubayes.results.stored_result import CHECKPOINT, SUMMARY, way_back


def claim(folder: Path, resume: bool = False) -> None:
    """Make sure that a folder can take a result, before anything is computed.

    Raises
    ------
    InputError
        where it holds files but no result, or a sampling that was interrupted and is not to be resumed.
    """
    if folder.is_dir():
        held = [one for one in folder.iterdir() if not one.name.startswith(".")]
        if held and not any((folder / name).is_file() for name in (FIT, CHECKPOINT)):
            raise InputError(
                Issue(
                    f"the folder holds '{min(one.name for one in held)}' and no result",
                    str(folder),
                    "a folder that does not exist yet, an empty one, or one with a result, which is replaced",
                    "choose another --out",
                )
            )
        if not resume and _interrupted(folder):
            raise InputError(
                Issue(
                    "the folder holds a sampling that was interrupted",
                    str(folder / CHECKPOINT),
                    "the same fit with --resume, which goes on with it",
                    f"add --resume; to begin anew choose another --out, or remove {folder / CHECKPOINT}",
                )
            )
    if not resume:
        folder.mkdir(parents=True, exist_ok=True)


def _interrupted(folder: Path) -> bool:
    """Tell whether a folder holds a sampling that no result has come of."""
    checkpoint, summary = folder / CHECKPOINT, folder / SUMMARY
    if not steps_in(checkpoint):
        return False
    return not summary.is_file() or summary.stat().st_mtime_ns < checkpoint.stat().st_mtime_ns


def write_result(folder: Path, fit: JointFit, summary: dict[str, Any], residuals: Residuals, seed: int = 0) -> None:
    """Write `summary.json`, `fit.json`, `posterior.nc`, `residuals.parquet`, `model.toml` and the user's effect files.

    What an earlier fit wrote is replaced; other files of the folder stay.
    """
    folder.mkdir(parents=True, exist_ok=True)
    beside = folder / f".writing-{os.getpid()}"
    shutil.rmtree(beside, ignore_errors=True)
    beside.mkdir()
    try:
        (beside / SUMMARY).write_text(json.dumps(summary, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
        record = fit_record(fit.fitted, folder, seed)
        (beside / FIT).write_text(json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
        residuals.table.write_parquet(beside / "residuals.parquet")
        (beside / MODEL).write_text(model_text(fit.model.spec))
        for file in fit.model.spec.files:
            shutil.copyfile(file, beside / Path(file).name)
        if bool(fit.mode.converged):
            posterior_tree(fit).to_netcdf(str(beside / "posterior.nc"), engine="h5netcdf")
        else:
            (folder / "posterior.nc").unlink(missing_ok=True)
        # The summary comes last: where it stands, the rest stands too.
        for file in sorted(beside.iterdir(), key=lambda one: one.name == SUMMARY):
            os.replace(file, folder / file.name)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def refuse_taken(file: Path, but: Callable[[bytes], bool] = lambda content: False) -> None:
    """Raise InputError where a file or folder is there already, but for a file whose content may be replaced."""
    if not file.exists() or (file.is_file() and but(file.read_bytes())):
        return
    raise InputError(
        Issue(
            f"'{file.name}' is there already",
            str(file),
            "a file that does not exist yet",
            "choose another name, or remove it first",
        )
    )


def write_beside(file: Path, text: str) -> None:
    """Write a text file beside its place first, so that there is never half of it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    beside = file.with_name(f".{file.name}.{os.getpid()}.part")
    beside.write_text(text, encoding="utf-8")
    beside.replace(file)


def model_text(spec: ModelSpec) -> str:
    """Return a model as the text of a model file."""
    document = tomlkit.document()
    document["format"] = 1
    document["name"] = spec.name
    if spec.files:
        document["files"] = [Path(file).name for file in spec.files]
    effects = tomlkit.aot()
    for one in spec.effects:
        entry = tomlkit.table()
        entry["name"] = one.name
        if one.channels is not None:
            entry["channels"] = list(one.channels)
        if one.per is not None:
            entry["per"] = one.per
        if one.optional:
            entry["optional"] = True
        if one.prior:
            prior = tomlkit.inline_table()
            prior.update(one.prior)
            entry["prior"] = prior
        for key, value in one.options.items():
            entry[key] = value
        effects.append(entry)
    document["effect"] = effects
    return tomlkit.dumps(document)


def read_summary(folder: Path) -> dict[str, Any]:
    """Return the summary of a result folder; raises InputError where there is none or it is damaged."""
    file = folder / SUMMARY
    try:
        return json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise InputError(
            Issue(
                "this is not a result folder" if not file.is_file() else f"the summary is damaged ({error})",
                str(file),
                "a folder written by `imubayes fit … --out FOLDER`",
                way_back(folder),
            )
        ) from None


__all__ = [
    "CHECKPOINT",
    "SUMMARY",
    "claim",
    "model_text",
    "read_fit",
    "read_summary",
    "refuse_taken",
    "write_beside",
    "write_result",
]

"""Simulate a plan into a campaign folder with a truth file, written atomically.

The folder is written under a temporary name, validated by reading it back, and renamed.  Numbers are written with full
precision, so that the fit sees exactly the simulated values.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from imubayes.atomic_files import new_folder
from imubayes.campaign.campaign_reader import CAMPAIGN_FILE, inspect_campaign
from imubayes.campaign.convert.campaign_writer import refuse_occupied
from imubayes.campaign.servo_angle import ANGLE
from imubayes.errors import InputError
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import read_carried_model
from imubayes.procedures import PROCEDURES
from imubayes.simulation.planned_campaign import Plan, read_plan, recorded
from imubayes.simulation.simulate import Simulated, simulate

TRUTH_FILE = "truth.toml"


def simulate_plan(plan: Path, out: Path, seed: int | None = None) -> Path:
    """Simulate the runs of a plan and write the campaign folder; return the folder.

    Parameters
    ----------
    plan : the plan file.
    out : the folder; must not exist, or be empty.
    seed : of the random streams; replaces the seed of the plan.

    Raises
    ------
    InputError
        for every issue of plan and model, and if the folder is not empty.
    """
    refuse_occupied(out)
    read = read_plan(plan)
    model = bind(read_carried_model(read.model), read.campaign, single_runs=True)
    chosen = read.file.seed if seed is None else seed
    done = simulate(model, chosen, read.file.truth, f"{read.path}, [truth]")
    _write(out, read, model, done, chosen)
    return out


def _write(out: Path, plan: Plan, model: Model, done: Simulated, seed: int) -> None:
    with new_folder(out) as draft:
        (draft / "runs").mkdir()
        (draft / CAMPAIGN_FILE).write_text(tomlkit.dumps(_campaign_document(plan, seed)), encoding="utf-8")
        (draft / TRUTH_FILE).write_text(tomlkit.dumps(_truth_document(plan, model, done, seed)), encoding="utf-8")
        for place, entry in enumerate(plan.entries):
            (draft / entry.file).write_text(_table(plan, done, place), encoding="utf-8")
        issues = inspect_campaign(draft).issues
        if issues:
            raise InputError(replace(issue, where=issue.where.replace(str(draft), str(out))) for issue in issues)


def _campaign_document(plan: Plan, seed: int) -> dict[str, Any]:
    file = plan.file
    note = f"simulated from {plan.path.name} with seed {seed}; true values in {TRUTH_FILE}"
    document: dict[str, Any] = {"format": 1, "name": file.name, "notes": [*file.notes, note]}
    for section in ("site", "unit"):
        document[section] = getattr(file, section).model_dump(exclude_unset=True, exclude_none=True)
    for section, entries in (("channel", file.channel), ("table", file.table), ("mounting", file.mounting)):
        document[section] = [entry.model_dump(exclude_unset=True, exclude_none=True) for entry in entries]
    document["run"] = [entry.model_dump(exclude_defaults=True, exclude_none=True) for entry in plan.entries]
    return {key: value for key, value in document.items() if value}


def _truth_document(plan: Plan, model: Model, done: Simulated, seed: int) -> dict[str, Any]:
    scalars = (*model.layout.parameters, *model.hyper_layout.parameters)
    document: dict[str, Any] = {
        "format": 1,
        "campaign": plan.file.name,
        "seed": seed,
        "parameters": done.parameters,
        "derived": done.derived,
        "units": {f"{parameter.effect}.{parameter.field}": parameter.unit for parameter in scalars},
    }
    if done.offsets:
        document["nuisance"] = {f"run_offset[{channel},{run}]": v for (channel, run), v in done.offsets.items()}
    return document


def _table(plan: Plan, done: Simulated, place: int) -> str:
    """Return a run table as CSV text."""
    campaign = done.campaign
    names = [channel.name for channel in campaign.channels]
    columns: Mapping[str, np.ndarray] = plan.columns[place] | {
        name: campaign.runs[place].observed[:, names.index(name)]
        for name in recorded(plan.file.run[place], campaign.channels)
    }
    if PROCEDURES[plan.file.run[place].procedure].driven:
        columns = columns | {"table_angle_deg": campaign.runs[place].observed[:, names.index(ANGLE)]}
    rows = zip(*([_cell(value) for value in column.tolist()] for column in columns.values()), strict=True)
    return "".join(",".join(cells) + "\n" for cells in ([*columns], *rows))


def _cell(value: float | str) -> str:
    """Return a number with full precision, an integer without a decimal point, and NaN as an empty cell."""
    if isinstance(value, str):
        return value
    if math.isnan(value):
        return ""
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)

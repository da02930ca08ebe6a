"""From a plan to a campaign folder with a truth file, whole or not at all.

The folder is made beside its place, read back as any campaign would be, and renamed into place.  Numbers are written
with all their digits, so that what is fitted is what was simulated.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from imubayes.atomic_files import new_folder
from imubayes.campaign.campaign_reader import CAMPAIGN_FILE, inspect_campaign
from imubayes.campaign.convert.campaign_writer import refuse_occupied
from imubayes.errors import InputError, Issue
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import read_model
from imubayes.simulation.planned_campaign import Plan, read_plan, recorded
from imubayes.simulation.simulate import Simulated, simulate

TRUTH_FILE = "truth.toml"


def simulate_plan(plan: Path, out: Path, seed: int | None = None) -> Path:
    """Simulate the runs of a plan and write the campaign folder; return the folder.

    Parameters
    ----------
    plan : the plan file.
    out : the folder; must not exist or be empty.
    seed : of the random numbers, in the place of the plan's own.

    Raises
    ------
    InputError
        for anything in plan or model that cannot be used, and where the folder has something in it.
    """
    refuse_occupied(out)
    read = read_plan(plan)
    model = bind(read_model(read.model), read.campaign)
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
            raise InputError(Issue(p.what, p.where.replace(str(draft), str(out)), p.allowed, p.remedy) for p in issues)


def _campaign_document(plan: Plan, seed: int) -> dict[str, Any]:
    file = plan.file
    note = f"simulated from {plan.path.name} with seed {seed}; the true values stand in {TRUTH_FILE}"
    document: dict[str, Any] = {"format": 1, "name": file.name, "notes": [*file.notes, note]}
    for section in ("site", "unit"):
        document[section] = getattr(file, section).model_dump(exclude_unset=True, exclude_none=True)
    for section, given in (("channel", file.channel), ("table", file.table), ("mounting", file.mounting)):
        document[section] = [one.model_dump(exclude_unset=True, exclude_none=True) for one in given]
    document["run"] = [one.model_dump(exclude_defaults=True, exclude_none=True) for one in plan.entries]
    return {key: value for key, value in document.items() if value}


def _truth_document(plan: Plan, model: Model, done: Simulated, seed: int) -> dict[str, Any]:
    scalars = (*model.layout.parameters, *model.hyper_layout.parameters)
    document: dict[str, Any] = {
        "format": 1,
        "campaign": plan.file.name,
        "seed": seed,
        "parameters": done.parameters,
        "derived": done.derived,
        "units": {f"{one.effect}.{one.field}": one.unit for one in scalars},
    }
    if done.offsets:
        document["nuisance"] = {f"run_offset[{channel},{run}]": v for (channel, run), v in done.offsets.items()}
    return document


def _table(plan: Plan, done: Simulated, place: int) -> str:
    """Return a run table as CSV text."""
    campaign = done.campaign
    columns: Mapping[str, np.ndarray] = plan.columns[place] | {
        name: campaign.runs[place].observed[:, [one.name for one in campaign.channels].index(name)]
        for name in recorded(plan.file.run[place], campaign.channels)
    }
    rows = zip(*([_cell(value) for value in column.tolist()] for column in columns.values()), strict=True)
    return "".join(",".join(cells) + "\n" for cells in ([*columns], *rows))


def _cell(value: float) -> str:
    """Write a number with all its digits, a whole one without a point, and nothing where there is none."""
    if math.isnan(value):
        return ""
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)

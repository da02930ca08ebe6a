# pyright: reportMissingImports=false
"""Valid campaigns drawn at random, in other units and under other names than in `data/generators`."""

from dataclasses import replace
from pathlib import Path

import full_qualification
import numpy as np
import polar_tumble
import redundant_imu
import rotation_modulation
import tomlkit
import trihedral_imu
from campaign_files import Files
from plan import Plan
from random_plans import random_plan
from simulate import write_simulated

PLANS = ("table", "temperatures", "head", "cycle", "gyros", "converter", "converter_cycle")
SHIPPED = {
    "trihedral-imu": trihedral_imu, "redundant-imu": redundant_imu,
    "rotation-modulation": rotation_modulation, "full-qualification": full_qualification,
    "polar-tumble": polar_tumble,
}  # fmt: skip
KINDS = (*PLANS, *SHIPPED)
THERMAL = ("temperatures", "cycle", "gyros", "converter", "converter_cycle")


def valid_campaign(folder: Path, seed: int) -> str:
    """Write a valid campaign drawn at random, in units and under names of its own; return its kind.

    In every third the equipment is poor, and its errors are as large as the stated uncertainties allow: one to two and
    a half times as large.
    """
    generator = np.random.default_rng([seed, 1])
    kind = KINDS[seed % len(KINDS)]
    if kind in SHIPPED:
        plan = SHIPPED[kind].plan(seed)
    else:
        model = "hidden-effects-thermal" if kind in THERMAL else "hidden-effects"
        plan = random_plan(kind, generator, model)
    values = None
    if generator.random() < 1 / 3:
        plan = _poor(plan, generator)
        values = plan.draw(seed)
        for name, spread in plan.equipment.items():
            values[name] = float(generator.choice([-1, 1]) * generator.uniform(1, 2.5) * spread)
    write_simulated(folder, plan, seed, values=values)
    if generator.random() < 0.5:
        _expressed_otherwise(Files(folder), generator)
    return kind


def _poor(plan: Plan, generator: np.random.Generator) -> Plan:
    """Return a plan with less certain mountings and tables."""
    seats, axes = generator.choice([1.0, 3.0, 10.0], 2)
    return replace(
        plan,
        mountings=tuple(replace(each, uncertainty_arcmin=each.uncertainty_arcmin * seats) for each in plan.mountings),
        tables=tuple(
            replace(each, axis_uncertainty_arcsec=(each.axis_uncertainty_arcsec or 20.0) * axes) for each in plan.tables
        ),
    )


def _expressed_otherwise(files: Files, generator: np.random.Generator) -> None:
    """Write the outputs of some channels in mV about an offset, and give tables and mountings other names."""
    document = files.document
    gains = {str(channel["name"]): float(np.round(generator.uniform(0.01, 3), 3)) for channel in document["channel"]}
    offsets = {name: float(generator.choice([0.0, 2500.0])) for name in gains}
    drawn = {str(channel["name"]): float(channel["noise"]) for channel in document["channel"]}
    for channel in document["channel"]:
        name = str(channel["name"])
        channel["output_unit"] = "mV"
        for key in ("scale", "noise"):
            channel[key] = float(channel[key]) * gains[name]
        channel["offset"] = float(channel.get("offset", 0.0)) * gains[name] + offsets[name]
    for section, word in (("table", "stand"), ("mounting", "seat")):
        names = {str(entry["name"]): f"{word}-{number + 1}" for number, entry in enumerate(document[section])}
        for entry in document[section]:
            entry["name"] = names[str(entry["name"])]
        for run in document["run"]:
            if section in run:
                run[section] = names[str(run[section])]
    files.save()

    def change(columns: dict[str, list[str]]) -> None:
        for column in [*columns]:
            name, spread = column.removesuffix("_sd"), column.endswith("_sd")
            if name in gains:
                gain, offset = gains[name], 0.0 if spread else offsets[name]
                columns[column] = [f"{float(cell) * gain + offset:.9g}" if cell else "" for cell in columns[column]]

    for run in files.runs:
        files.edit(run, change)
    (files.folder / "drawn_noise.toml").write_text(tomlkit.dumps(drawn), encoding="utf-8")

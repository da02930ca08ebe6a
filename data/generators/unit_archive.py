"""Campaigns of many units of one type, calibrated over years on two tables: what an archive is made of.

Each unit is the accelerometer channel of `accel_channel`, with true values drawn from a population that is not the
prior of any model: bias 350 ± 120 µg, scale factor error −80 ± 60 ppm.  Every third unit is calibrated again after
a year, with the same true values but for a bias that has drifted.  An effect that the model lacks may be added to all
units, to a share of them, or to those on one table.
"""

import json
import sys
from dataclasses import dataclass, replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np

import accel_channel
from plan import Plan
from sensor import Values
from simulate import write_simulated

SEED = 20261123
POPULATION = {"accel_bias.bias[ax]": (350.0, 120.0), "accel_scale_factor.scale[ax]": (-80.0, 60.0)}
"""True mean and standard deviation over units."""
TABLES = ("plate-a", "plate-b")
FIRST_DAY = date(2023, 1, 9)
DRIFT_UG_PER_YEAR = 60.0
QUADRATIC = "converter_gain_drift_quadratic.curvature[ax]"


@dataclass(frozen=True)
class Hidden:
    """An effect that the model lacks.

    Attributes
    ----------
    parameter, size : its parameter and value; of either sign, at random, where `own`.
    share : of the units that have it.
    table : on which alone it acts; empty for all.
    own : whether its sign differs from unit to unit.
    """

    parameter: str = QUADRATIC
    size: float = 0.0
    share: float = 1.0
    table: str = ""
    own: bool = False


def generate(folder: Path, units: int, seed: int = SEED, hidden: Hidden | None = None) -> dict[str, dict]:
    """Write the campaigns below `folder`; return the truth of each unit: values, table and hidden effect."""
    random, truths = np.random.default_rng(seed), {}
    for place in range(units):
        serial, table = f"QA{201 + place}", TABLES[place % len(TABLES)]
        own = {name: float(random.normal(*spread)) for name, spread in POPULATION.items()}
        effect = _effect(hidden, table, random)
        truths[serial] = {"values": own, "table": table, "hidden": effect}
        day = FIRST_DAY + timedelta(days=int(1000 * place / units))
        values = {**unit_plan(serial, table, day).draw(seed + place), **own, **effect}
        write_unit(Path(folder), serial, table, day, seed + 2 * place, values)
        if place % 3 == 0:
            later = values | {"accel_bias.bias[ax]": values["accel_bias.bias[ax]"] + DRIFT_UG_PER_YEAR}
            write_unit(Path(folder), serial, table, day + timedelta(days=365), seed + 2 * place + 1, later)
    return truths


def _effect(hidden: Hidden | None, table: str, random: np.random.Generator) -> Values:
    """Return what a unit has of the hidden effect."""
    chosen, sign = random.uniform(), random.choice([-1.0, 1.0])
    if hidden is None or hidden.size == 0 or chosen >= hidden.share or hidden.table not in ("", table):
        return {}
    return {hidden.parameter: hidden.size * (float(sign) if hidden.own else 1.0)}


def write_unit(folder: Path, serial: str, table: str, day: date, seed: int, values: Values) -> None:
    """Write one campaign of a unit into its own folder below `folder`."""
    design = unit_plan(serial, table, day)
    scale = design.channels[0].scale
    write_simulated(
        folder / design.name, design, seed, lambda true: accel_channel.slope_differences(true, scale), values
    )


def unit_plan(serial: str, table: str, day: date) -> Plan:
    """Return the plan of `accel_channel` for one unit, on its table and day."""
    design = accel_channel.plan(SEED)
    runs = [
        replace(run, table=table if run.table else None, start=f"{day.isoformat()}{(run.start or '')[10:]}")
        for run in design.runs
    ]
    return replace(
        design,
        name=f"{serial}-{day.isoformat()}",
        model="accel-channel",
        purpose="One accelerometer channel: converter ramps at 1 g, at 1/sqrt(3) g and with 12 g injected.",
        serial=serial,
        tables=(replace(design.tables[0], name=table),),
        runs=tuple(runs),
    )


if __name__ == "__main__":
    place, number = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 30
    everything = generate(place, number, hidden=Hidden(size=0.06, table="plate-b"))
    (place / "truth.json").write_text(json.dumps(everything, indent=1) + "\n")

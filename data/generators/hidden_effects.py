"""Seven campaigns of a six-axis unit, six of them with something that their model lacks.

`hidden-effects.toml` is the model of all but `hidden-thermal`, which goes with `hidden-effects-thermal.toml`.  How
plainly each effect shows, S, stands in its truth file.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

import truth
from detectability import look
from hidden import OUTSIDE, Planted, planted, rivals
from kinematics import Site, Table
from plan import Plan, Row, Run, chamber, dividing_head_rows, rate_table_rows
from random_plans import ACCELEROMETERS, GYROS, RAW_RATE, mounting, thermal_rows
from simulate import write_simulated

SEED = 20260501
RATES = (300.0, 150.0, 60.0, 20.0, 10.0)
MANY_RATES = (200.0, 150.0, 120.0, 100.0, 80.0, 70.0, 60.0, 50.0, 40.0, 30.0, 20.0, 10.0)
SEATS = ("x-up", "y-up", "z-up")

Content = list[tuple[str, str, str, list[Row]]]
"""Procedure, table, mounting and rows of each run."""


def rates_and_head(seed: int, rates: tuple[float, ...] = RATES, positions: int = 24) -> Content:
    """Rate table in three mountings and the pyramid, dividing head in three."""
    content: Content = []
    for name in (*SEATS, "pyramid"):
        warmth = chamber(25.0, 2 + 2 * len(rates), truth.stream(seed, f"rate {name}"))
        content.append(("rate_table", "rate", name, rate_table_rows(rates, warmth, RAW_RATE)))
    return content + head_only(seed, SEATS, positions)


def head_only(seed: int, seats: tuple[str, ...], positions: int = 24) -> Content:
    """Dividing head, all positions in each seat."""
    return [
        (
            "dividing_head",
            "head",
            name,
            dividing_head_rows(positions, chamber(25.0, positions, truth.stream(seed, f"head {name}")), RAW_RATE),
        )
        for name in seats
    ]


def over_temperature(seed: int) -> Content:
    """A cycle of temperature in two mountings, two ramp rates in a third, then rates and the dividing head."""
    shapes = {"x-up": "cycle", "z-up": "cycle", "pyramid": "two rates"}
    content: Content = [
        ("thermal_ramp", "rate", name, thermal_rows(truth.stream(seed, f"thermal {name}"), 90, shape, 120.0))
        for name, shape in shapes.items()
    ]
    return content + rates_and_head(seed, (150.0, 60.0, 20.0), 12)


@dataclass(frozen=True)
class Design:
    """One campaign: what is measured, what is hidden, and what its model is."""

    purpose: str
    content: Callable[[int], Content]
    hidden: dict[str, dict[str, float]]
    model: str = "hidden-effects"


def channels(effect: str, parameter: str, **values: float) -> dict[str, float]:
    """One coefficient on several channels."""
    return {f"{effect}.{parameter}[{label}]": value for label, value in values.items()}


_HEAD_SEATS = (*SEATS, "x-down", "y-down", "z-down")
CAMPAIGNS: dict[str, Design] = {
    "hidden-none": Design("Nothing is hidden: the model is complete.", rates_and_head, {}),
    "hidden-gyro": Design(
        "The gyros hide something that grows with the rate.",
        rates_and_head,
        {"gyro_scale_asymmetry": channels("gyro_scale_asymmetry", "asymmetry", gx=9.0, gy=-6.0, gz=12.0)},
    ),
    "hidden-accelerometer": Design(
        "The accelerometers hide something that a tumble shows.",
        rates_and_head,
        {
            "accel_cross_coupling": channels("accel_cross_coupling", "k_ip", ax=30.0, ay=-18.0, az=22.0)
            | channels("accel_cross_coupling", "k_io", ax=-12.0, ay=25.0, az=16.0)
        },
    ),
    "hidden-thermal": Design(
        "The accelerometers hide something that two ramp rates and a cycle of temperature show.",
        over_temperature,
        {
            "accel_thermal_lag": channels("accel_thermal_lag", "coefficient", ax=0.5, ay=0.4, az=-0.6)
            | channels("accel_thermal_lag", "tau", ax=12.0, ay=12.0, az=12.0)
        },
        "hidden-effects-thermal",
    ),
    "hidden-kinematic": Design(
        "The dividing head hides something; the unit is innocent.",
        partial(head_only, seats=_HEAD_SEATS),
        {
            "encoder_harmonic": {
                "encoder_harmonic.sin_1[head]": 3.0,
                "encoder_harmonic.cos_1[head]": -2.0,
                "encoder_harmonic.sin_2[head]": 1.5,
                "encoder_harmonic.cos_2[head]": 1.0,
            }
        },
    ),
    "hidden-two": Design(
        "One gyro and one accelerometer hide something each.",
        rates_and_head,
        {
            "gyro_scale_asymmetry": channels("gyro_scale_asymmetry", "asymmetry", gz=9.0),
            "accel_cross_coupling": channels("accel_cross_coupling", "k_ip", ay=20.0)
            | channels("accel_cross_coupling", "k_io", ay=-15.0),
        },
    ),
    "hidden-outside": Design(
        "One gyro hides something that is in no catalogue.",
        partial(rates_and_head, rates=MANY_RATES, positions=12),
        {
            "outside_resonance": channels("outside_resonance", "amplitude", gy=12.0)
            | channels("outside_resonance", "centre", gy=60.0)
            | channels("outside_resonance", "width", gy=12.0)
        },
    ),
}


def plan(name: str, seed: int) -> Plan:
    """The plan of one campaign; the seed sets the temperatures that the chamber really held."""
    design = CAMPAIGNS[name]
    content = design.content(seed)
    runs = []
    for order, (procedure, stand, seat, rows) in enumerate(content):
        kind = {"rate_table": "rate", "dividing_head": "head", "thermal_ramp": "thermal"}[procedure]
        start = f"2026-05-{2 + order // 4:02d}T{8 + 4 * (order % 4):02d}:00:00+00:00"
        runs.append(Run(f"{kind}-{seat}", procedure, rows, stand, seat, start))
    stands = {run.table for run in runs}
    tables = (Table("rate", 0.0, 90.0, 20.0, 5.0), Table("head", 90.0, 0.0, 20.0))
    return Plan(
        name=name,
        purpose=design.purpose,
        serial="HE" + str(100 + list(CAMPAIGNS).index(name)),
        site=Site(34.25, 400.0),
        channels=(*GYROS, *ACCELEROMETERS),
        tables=tuple(table for table in tables if table.name in stands),
        mountings=tuple(mounting(seat) for seat in dict.fromkeys(run.mounting for run in runs)),
        runs=tuple(runs),
        model=design.model,
        script="hidden_effects",
    )


def generate(folder: Path, seed: int = SEED, name: str | None = None) -> dict[str, float]:
    """Write one campaign (by default the one that `folder` is called after) into `folder`; return its true values."""
    folder = Path(folder)
    name = name or folder.name
    design, made = CAMPAIGNS[name], plan(name, seed)
    values = made.draw(seed)
    sight = look(made, values)
    found: list[Planted] = []
    for effect, parameters in design.hidden.items():
        labels = tuple(dict.fromkeys(parameter.rstrip("]").split("[")[1] for parameter in parameters))
        closest = None
        if effect in OUTSIDE:
            shift = sight.shift(parameters)
            taken = rivals(sight, labels).values()
            closest = min(taken, key=lambda columns, shift=shift: float(np.sum(sight.left(shift, columns) ** 2)))
        found.append(planted(sight, effect, labels, parameters, closest))
    whole = {**values, **{key: value for one in found for key, value in one.parameters.items()}}
    hidden = {
        "model": f"models/{design.model}.toml",
        "effect": [asdict(one) | {"channels": list(one.channels)} for one in found],
    }
    return write_simulated(folder, made, seed, values=whole, hidden=hidden)


if __name__ == "__main__":
    for campaign in CAMPAIGNS:
        generate(Path(__file__).resolve().parents[1] / campaign)

"""A single-degree-of-freedom gyro with torque-rebalance readout, tumbled about the polar axis.

Two sweeps, output axis to the north and to the south pole, with the input axis in the plane of the table, and one with
the input axis along the pole, which splits the sum of coefficients that the two leave together.
"""

from pathlib import Path

import numpy as np

import truth
from kinematics import Mounting, Site, Table
from plan import Plan, Run, chamber, dividing_head_rows
from sensor import Channel
from simulate import write_simulated

SEED = 20260601
RAW_RATE, POSITIONS, LATITUDE = 1.0, 24, 34.25
GYRO = Channel("g", "gyro", (1.0, 0.0, 0.0), "mA", 0.01, "deg/h", 5e-4, (0.0, 1.0, 0.0))
# Columns are the gyro's input, output and spin axes in the axes of the table.
NORTH = Mounting("O-north", np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), 0.5)
SOUTH = Mounting("O-south", np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), 0.5)
ALONG = Mounting("I-north", np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), 0.5)


def plan(seed: int, seats: tuple[Mounting, ...] = (NORTH, SOUTH, ALONG), model: str | Path | None = None) -> Plan:
    """The plan; the seed sets the temperatures the chamber really held."""
    runs = []
    for order, seat in enumerate(seats):
        warmth = chamber(25.0, POSITIONS, truth.stream(seed, seat.name))
        rows = dividing_head_rows(POSITIONS, warmth, RAW_RATE, dwell=120.0)
        start = f"2026-06-{1 + order:02d}T08:00:00+00:00"
        runs.append(Run(f"tumble-{seat.name}", "polar_tumble", rows, "polar", seat.name, start))
    return Plan(
        name="polar-tumble",
        purpose="A single-degree-of-freedom gyro about the polar axis: output axis north, south, and input axis north.",
        serial="PT007",
        site=Site(LATITUDE, 400.0),
        channels=(GYRO,),
        tables=(Table("polar", 0.0, LATITUDE, 20.0),),
        mountings=seats,
        runs=tuple(runs),
        model=model,
    )


def generate(folder: Path, seed: int) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities."""
    return write_simulated(Path(folder), plan(seed), seed)


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "polar-tumble", SEED)

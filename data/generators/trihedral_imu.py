"""A six-axis unit of tactical grade on rate table (four mountings) and dividing head (three), over temperature.

The three mountings with a body axis along the table axis give scale factors to second order in the angles, the
dividing head squares the accelerometer triad by gravity alone, and both together fix the angles of the pyramid
mounting far below an arc second, which no run in the pyramid mounting could do by itself.
"""

from pathlib import Path

import truth
from kinematics import X_UP, Y_UP, Z_UP, Mounting, Site, Table, trihedral
from plan import Plan, Run, chamber, dividing_head_rows, rate_table_rows
from sensor import AXES, Channel
from simulate import write_simulated

SEED = 20260301
RAW_RATE = 20.0
RATES = (300.0, 150.0, 60.0, 20.0, 10.0, 1.0)
TEMPERATURES = {"minus10C": -10, "25C": 25, "55C": 55}
POSITIONS = 24


def gyro(letter, input_axis, output_axis) -> Channel:
    return Channel(f"g{letter}", "gyro", input_axis, "pulse/s", 1000.0, "deg/s", 8.0, output_axis)


def accelerometer(letter, input_axis, output_axis) -> Channel:
    return Channel(f"a{letter}", "accelerometer", input_axis, "pulse/s", 20000.0, "g", 2.0, output_axis)


def plan(seed: int) -> Plan:
    """The plan; the seed sets the temperatures the chamber really held."""
    mountings = (
        Mounting("x-up", X_UP, 5.0),
        Mounting("y-up", Y_UP, 5.0),
        Mounting("z-up", Z_UP, 5.0),
        Mounting("pyramid", trihedral(), 5.0, preset="trihedral"),
    )
    runs = []
    for label, temperature in TEMPERATURES.items():
        for mounting in mountings:
            name = f"rate-{mounting.name}-{label}"
            warmth = chamber(temperature, 2 + 2 * len(RATES), truth.stream(seed, name))
            rows = rate_table_rows(RATES, warmth, RAW_RATE)
            runs.append(Run(name, "rate_table", rows, "rate", mounting.name, _start(len(runs))))
        for mounting in mountings[:3]:
            name = f"head-{mounting.name}-{label}"
            warmth = chamber(temperature, POSITIONS, truth.stream(seed, name))
            rows = dividing_head_rows(POSITIONS, warmth, RAW_RATE)
            runs.append(Run(name, "dividing_head", rows, "head", mounting.name, _start(len(runs))))
    return Plan(
        name="trihedral-imu",
        purpose="Six-axis unit: rate table in four mountings, dividing head in three, at three temperatures.",
        serial="SN042",
        site=Site(34.25, 400.0),
        channels=(*(gyro(*axis) for axis in AXES), *(accelerometer(*axis) for axis in AXES)),
        tables=(Table("rate", 0.0, 90.0, 20.0, 5.0), Table("head", 90.0, 0.0, 20.0)),
        mountings=mountings,
        runs=tuple(runs),
    )


def _start(order: int) -> str:
    """Seven runs a day, one temperature a day."""
    return f"2026-03-{1 + order // 7:02d}T{8 + order % 7:02d}:00:00+00:00"


def generate(folder: Path, seed: int) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities."""
    return write_simulated(Path(folder), plan(seed), seed)


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "trihedral-imu", SEED)

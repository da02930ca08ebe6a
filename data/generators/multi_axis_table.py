"""A unit on a table of three axes: 24 positions, a tumble, rates about each axis, and all of them at once."""

from itertools import product
from pathlib import Path

import numpy as np

from kinematics import Mounting, Site
from plan import Plan
from sensor import AXES, Channel, Values
from serial_table import Pose, SerialRun, SerialTable, whole_turns, write_campaign

SEED = 20261101
RAW_RATE = 50.0
TABLE = SerialTable(
    "three-axis", 0.0, 90.0, 10.0, 5.0, None, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0),
    zero_uncertainty_arcsec=20.0, squareness_uncertainty_arcsec=10.0, intersection_uncertainty_um=100.0,
)  # fmt: skip
CHANNELS = (
    *(Channel(f"g{n}", "gyro", i, "LSB", 10.0, "deg/h", 20.0, o) for n, i, o in AXES),
    *(Channel(f"a{n}", "accelerometer", i, "LSB", 1e6, "g", 60.0, o) for n, i, o in AXES),
)
OUTER, MIDDLE, INNER = range(3)


def upright() -> list[Pose]:
    """Eight of the 24 positions: the inner axis up and down, with four headings each."""
    return [Pose((0.0, middle, inner)) for middle in (0.0, 180.0) for inner in (0.0, 90.0, 180.0, 270.0)]


def sideways() -> list[Pose]:
    """The other sixteen: the inner axis level, the other body axes up and down, with headings by the outer axis."""
    angles = product((0.0, 180.0), (90.0, 270.0), (0.0, 90.0, 180.0, 270.0))
    return [Pose(angle) for angle in angles]


def tumble() -> list[Pose]:
    """Inclined positions: the middle axis by 45°, the inner one by 45°, the outer one by the quarter."""
    steps = [(45.0 * k, 45.0 * ((3 * k) % 8) + 22.5 * (k % 2), 90.0 * (k % 4)) for k in range(24)]
    return [Pose((outer, middle % 360, inner % 360)) for middle, inner, outer in steps]


def alone(axis: int, rate: float, angle: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Pose:
    """Whole turns about one axis, the others held."""
    rates = [0.0, 0.0, 0.0]
    rates[axis] = rate
    return Pose(angle, tuple(rates), whole_turns(rate, 20.0), (axis,))


def turns(axis: int) -> list[Pose]:
    """Rates about one axis, in both directions, between records at rest."""
    rest = Pose((0.0, 0.0, 0.0), seconds=60.0)
    return [rest, *(alone(axis, sign * rate) for rate in (10.0, 100.0, 200.0) for sign in (1.0, -1.0)), rest]


def held() -> list[Pose]:
    """Fast turns about the outer and the middle axis in several positions of those that they carry."""
    found = []
    for middle, inner in product((0.0, 90.0), (0.0, 90.0, 180.0, 270.0)):
        found += [alone(OUTER, sign * 200.0, (0.0, middle, inner)) for sign in (1.0, -1.0)]
    return [*found, *(alone(MIDDLE, 200.0, (0.0, 0.0, inner)) for inner in (0.0, 90.0, 180.0, 270.0))]


def together() -> list[Pose]:
    """All axes turn at the same time, each row an arc at known angles."""
    found = []
    for k in range(24):
        rate = np.array([12.0, -20.0, 33.0]) * (1 if k % 2 else -1) * np.array([1, -1 if k % 3 else 1, 1])
        angle = (15.0 * k, 40.0 * k, 75.0 * k)
        found.append(Pose(tuple(a % 360 for a in angle), tuple(float(each) for each in rate), 4.0))
    return found


def runs() -> list[SerialRun]:
    """All runs, a day each."""
    made = {
        "upright": upright(), "sideways": sideways(), "tumble": tumble(), "inner": turns(INNER),
        "middle": turns(MIDDLE), "outer": turns(OUTER), "held": held(), "together": together(),
    }  # fmt: skip
    return [
        SerialRun(name, "multi_axis_table", TABLE.name, "plate", poses, f"2026-11-{order + 1:02d}T08:00:00+00:00")
        for order, (name, poses) in enumerate(made.items())
    ]


def plan(model: str | Path | None = None) -> Plan:
    """Unit and equipment."""
    return Plan(
        name="multi-axis-table",
        purpose="A unit on a table of three axes: 24 positions, a tumble, rates about each axis, and all at once.",
        serial="MA006",
        site=Site(55.75, 150.0),
        channels=CHANNELS,
        tables=(TABLE,),
        mountings=(Mounting("plate", np.eye(3), 2.0),),
        runs=(),
        model=model,
    )


def generate(folder: Path, seed: int, values: Values | None = None) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities."""
    return write_campaign(Path(folder), plan(), runs(), seed, RAW_RATE, values)


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "multi-axis-table", SEED)

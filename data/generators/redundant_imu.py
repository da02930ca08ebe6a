"""A redundant rate unit: four gyros on a square pyramid, two of them not at the nominal half angle.

Analogue outputs with a zero of 2.5 V.  No output axes are named, so the reader's rule for them is at work.
"""

from pathlib import Path

import truth
from kinematics import X_UP, Y_UP, Z_UP, Mounting, Site, Table
from plan import Plan, Run, chamber, rate_table_rows, square_pyramid_axis
from sensor import Channel
from simulate import write_simulated

SEED = 20260320
RAW_RATE = 20.0
RATES = (100.0, 50.0, 20.0, 10.0, 5.0)
FACES = (("g1", 54.7356, 0.0), ("g2", 54.7356, 90.0), ("g3", 50.0, 180.0), ("g4", 58.0, 270.0))
"""Name, half angle to body z and azimuth in degrees."""


def plan(seed: int) -> Plan:
    mountings = (Mounting("z-up", Z_UP, 5.0), Mounting("x-up", X_UP, 5.0), Mounting("y-up", Y_UP, 5.0))
    runs = []
    for day in (1, 2):
        for order, mounting in enumerate(mountings):
            name = f"rate-{mounting.name}-day{day}"
            warmth = chamber(25.0, 2 + 2 * len(RATES), truth.stream(seed, name))
            start = f"2026-03-{19 + day}T{9 + order:02d}:00:00+00:00"
            rows = rate_table_rows(RATES, warmth, RAW_RATE)
            runs.append(Run(name, "rate_table", rows, "rate", mounting.name, start))
    return Plan(
        name="redundant-imu",
        purpose="Four gyros on a square pyramid of unequal angles, on a rate table in three mountings.",
        serial="RD004",
        site=Site(34.25, 400.0),
        channels=tuple(
            Channel(name, "gyro", square_pyramid_axis(half, azimuth), "mV", 20.0, "deg/s", 0.2, offset=2500.0)
            for name, half, azimuth in FACES
        ),
        tables=(Table("rate", 0.0, 90.0, 20.0, 5.0),),
        mountings=mountings,
        runs=tuple(runs),
    )


def generate(folder: Path, seed: int) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities."""
    return write_simulated(Path(folder), plan(seed), seed)


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "redundant-imu", SEED)

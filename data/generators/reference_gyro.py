"""Three gyros beside a reference gyro on a table that does not hold its rate: turned about each axis, both ways."""

from pathlib import Path

import numpy as np

import truth
from kinematics import X_UP, Y_UP, Z_UP, Mounting, Site, Table
from plan import Plan, Run, chamber, turning_rows
from sensor import AXES, Channel
from simulate import write_simulated

SEED = 20260701
RAW_RATE, SECONDS, ROWS, SPEED, WANDER = 100.0, 2.0, 120, 40.0, 0.05
GYROS = tuple(Channel(f"g{n}", "gyro", i, "LSB", 1000.0, "deg/s", 10.0, o) for n, i, o in AXES)
SEATS = {"x-up": X_UP, "y-up": Y_UP, "z-up": Z_UP}


def wandering(rows: int, seconds: float, speed: float, wander: float, generator: np.random.Generator):
    """Mean rates of rows and their slopes: a speed that wanders by up to ± `wander` of itself, smoothly.

    Sums of sines with periods of some dozens of rows, so that the slope is exact.
    """
    time = seconds * (np.arange(rows) + 0.5)
    rate, rise = np.zeros(rows), np.zeros(rows)
    for _ in range(4):
        turn = 2 * np.pi / (seconds * generator.uniform(20, 80))
        phase, size = generator.uniform(0, 2 * np.pi), generator.uniform(0.5, 1.0)
        rate += size * np.sin(turn * time + phase)
        rise += size * turn * np.cos(turn * time + phase)
    largest = np.abs(rate).max()
    return speed * (1 + wander * rate / largest), speed * wander * rise / largest


def plan(seed: int, wander: float = WANDER, model: str | Path | None = None) -> Plan:
    """The plan; the seed sets how the table wanders and what the chamber held."""
    runs = []
    for order, seat in enumerate(SEATS):
        for sign, way in ((1.0, "forward"), (-1.0, "reverse")):
            generator = truth.stream(seed, f"{seat}/{way}")
            rate, rise = wandering(ROWS, SECONDS, SPEED, wander, generator)
            warmth = chamber(25.0, ROWS, generator)
            rows = turning_rows(sign * rate, sign * rise, SECONDS, RAW_RATE, warmth)
            start = f"2026-07-{1 + order:02d}T{'08' if sign > 0 else '10'}:00:00+00:00"
            runs.append(Run(f"{seat}-{way}", "reference_gyro", rows, "ordinary", seat, start))
    return Plan(
        name="reference-gyro",
        purpose="Three gyros beside a reference gyro, on a table that wanders by five percent.",
        serial="RG003",
        site=Site(55.75, 150.0),
        channels=GYROS,
        tables=(Table("ordinary", 0.0, 90.0, 20.0),),
        mountings=tuple(Mounting(name, seat, 3.0) for name, seat in SEATS.items()),
        runs=tuple(runs),
        model=model,
    )


def generate(folder: Path, seed: int) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities."""
    return write_simulated(Path(folder), plan(seed), seed)


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "reference-gyro", SEED)

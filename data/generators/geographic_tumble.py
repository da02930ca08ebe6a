"""A gyro at rest in positions named by direction: each axis up and down, the input axis east, west, north and south."""

from pathlib import Path

import truth
from kinematics import Site
from plan import Plan, Row, Run, chamber
from sensor import Channel
from simulate import write_simulated

SEED = 20260901
RAW_RATE, DWELL = 1.0, 180.0
GYRO = Channel("g", "gyro", (1.0, 0.0, 0.0), "mA", 0.01, "deg/h", 5e-4, (0.0, 1.0, 0.0))
# The input and the output axis; the spin axis is what is left.
POSITIONS = (
    ("E", "N"), ("E", "S"), ("E", "U"), ("E", "D"), ("W", "N"), ("W", "S"), ("W", "U"), ("W", "D"),
    ("U", "E"), ("U", "W"), ("D", "E"), ("D", "W"), ("N", "E"), ("N", "W"), ("S", "U"), ("S", "D"),
)  # fmt: skip


def plan(seed: int, positions=POSITIONS, series: int = 2, model: str | Path | None = None) -> Plan:
    """The plan: all positions in turn, `series` times."""
    runs = []
    for number in range(series):
        warmth = chamber(25.0, len(positions), truth.stream(seed, f"series {number}"))
        rows = [
            Row((DWELL + 60) * k + DWELL / 2, round(DWELL * RAW_RATE), float(warmth[k]), axes=axes)
            for k, axes in enumerate(positions)
        ]
        start = f"2026-09-{1 + number:02d}T08:00:00+00:00"
        runs.append(Run(f"series-{number + 1}", "geographic_tumble", rows, start=start))
    return Plan(
        name="geographic-tumble",
        purpose="A gyro at rest in positions named by direction.",
        serial="GT004",
        site=Site(55.75, 150.0),
        channels=(GYRO,),
        tables=(),
        mountings=(),
        runs=tuple(runs),
        model=model,
    )


def generate(folder: Path, seed: int) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities."""
    return write_simulated(Path(folder), plan(seed), seed)


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "geographic-tumble", SEED)

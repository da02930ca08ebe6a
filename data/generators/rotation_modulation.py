"""A pyramid unit turned forward and reverse without a stop: three gyros and three accelerometers at 54.7 degrees."""

from pathlib import Path

import numpy as np

import truth
from kinematics import Mounting, Site, Table, trihedral
from plan import Plan, Run, chamber, turning_rows
from sensor import AXES, Channel
from simulate import write_simulated

SEED = 20260801
RAW_RATE, RATE, ARC = 50.0, 6.0, 15.0
CHANNELS = (
    *(Channel(f"g{n}", "gyro", i, "LSB", 10.0, "deg/h", 20.0, o) for n, i, o in AXES),
    *(Channel(f"a{n}", "accelerometer", i, "LSB", 1e6, "g", 60.0, o) for n, i, o in AXES),
)
TURNS = {"pyramid-forward": 10.0, "pyramid-reverse": -10.0, "pyramid-unfinished": 2.5}


def plan(seed: int, uncertainty_arcmin: float = 2.0, model: str | Path | None = None) -> Plan:
    """The plan; the seed sets the temperatures the chamber really held."""
    runs = []
    for order, (name, turns) in enumerate(TURNS.items()):
        sign, count = (1.0 if turns > 0 else -1.0), round(abs(turns) * 360 / ARC)
        warmth = chamber(25.0, count, truth.stream(seed, name))
        rows = turning_rows(np.full(count, sign * RATE), np.zeros(count), ARC / RATE, RAW_RATE, warmth)
        runs.append(
            Run(name, "rotation_modulation", rows, "rotary", "pyramid", f"2026-08-01T{8 + order:02d}:00:00+00:00")
        )
    return Plan(
        name="rotation-modulation",
        purpose="A pyramid unit turned forward and reverse without a stop, and once without finishing the turn.",
        serial="RM002",
        site=Site(34.25, 400.0),
        channels=CHANNELS,
        tables=(Table("rotary", 0.0, 90.0, 20.0, 20.0),),
        mountings=(Mounting("pyramid", trihedral(), uncertainty_arcmin, "trihedral"),),
        runs=tuple(runs),
        model=model,
    )


def generate(folder: Path, seed: int) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities."""
    return write_simulated(Path(folder), plan(seed), seed)


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "rotation-modulation", SEED)

"""A pyramid unit turned forward and reverse without a stop: three gyros and three accelerometers at 54.7 degrees."""

from pathlib import Path

import truth
from kinematics import Mounting, Site, Table, trihedral
from plan import Plan, Row, Run, chamber
from sensor import Channel
from simulate import write_simulated

SEED = 20260801
RAW_RATE, RATE, ARC = 50.0, 6.0, 15.0
CHANNELS = (
    *(
        Channel(name, "gyro", axis, "LSB", 10.0, "deg/h", 20.0, output)
        for name, axis, output in (
            ("gx", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
            ("gy", (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
            ("gz", (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
        )
    ),
    *(
        Channel(name, "accelerometer", axis, "LSB", 1e6, "g", 60.0, output)
        for name, axis, output in (
            ("ax", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
            ("ay", (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
            ("az", (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
        )
    ),
)
TURNS = {"pyramid-forward": 10.0, "pyramid-reverse": -10.0, "pyramid-unfinished": 2.5}


def plan(seed: int, uncertainty_arcmin: float = 2.0, model: str | Path | None = None) -> Plan:
    """The plan; the seed sets the temperatures the chamber really held."""
    runs = []
    for order, (name, turns) in enumerate(TURNS.items()):
        sign, count = (1.0 if turns > 0 else -1.0), round(abs(turns) * 360 / ARC)
        seconds = ARC / RATE
        warmth = chamber(25.0, count, truth.stream(seed, name))
        rows = [
            Row(
                seconds * (k + 0.5), round(seconds * RAW_RATE), float(warmth[k]), sign * RATE,
                float(sign * ARC * (k + 0.5) % 360.0), span=ARC,
            )
            for k in range(count)
        ]  # fmt: skip
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

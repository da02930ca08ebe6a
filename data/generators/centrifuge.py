"""An accelerometer and a gyro on a centrifuge of 1 m: to 20 g at four angles of the platform, and counter-rotated."""

from pathlib import Path

from kinematics import X_UP, Y_UP, Z_UP, Mounting, Site
from plan import Plan
from sensor import Channel, Values
from serial_table import Pose, SerialRun, SerialTable, whole_turns, write_campaign

SEED = 20261115
RAW_RATE = 50.0
TABLE = SerialTable(
    "centrifuge", 0.0, 90.0, 5.0, 2.0, None, (0.0, 0.0, 1.0), None, 1.0,
    zero_uncertainty_arcsec=10.0, squareness_uncertainty_arcsec=5.0, arm_uncertainty_um=50.0, stretch_um_per_g=5.0,
)  # fmt: skip
CHANNELS = (
    Channel("a", "accelerometer", (1.0, 0.0, 0.0), "LSB", 1e5, "g", 5.0, (0.0, 1.0, 0.0)),
    Channel("g", "gyro", (1.0, 0.0, 0.0), "mA", 0.01, "deg/h", 5e-4, (0.0, 1.0, 0.0)),
)
RATES = (0.0, 180.0, 255.0, 400.0, 570.0, 700.0, 800.0, 0.0)  # about 1, 2, 5, 10, 15 and 20 g
SEATS = {"z-up": Z_UP, "x-up": X_UP, "y-up": Y_UP}


def level(rate: float, angle: float, counter: bool) -> Pose:
    """One level: whole turns of the arm, with the platform fixed at an angle or turning against it."""
    if rate == 0:
        return Pose((0.0, 0.0, angle), seconds=40.0)
    turning = (rate, 0.0, -rate if counter else 0.0)
    return Pose((0.0, 0.0, angle), turning, float(whole_turns(rate, 40.0)), (0,))


def runs() -> list[SerialRun]:
    """The accelerometer alone at four angles, then both counter-rotated in three seats."""
    made = [
        SerialRun(
            f"fixed-{angle}", "centrifuge", TABLE.name, "z-up", [level(rate, float(angle), False) for rate in RATES],
            f"2026-11-{15 + order}T08:00:00+00:00", recorded=("a",),
        )
        for order, angle in enumerate((0, 180, 90, 270))
    ]  # fmt: skip
    made += [
        SerialRun(
            f"counter-{seat}", "centrifuge", TABLE.name, seat,
            [level(rate, angle, True) for angle in (0.0, 90.0) for rate in RATES],
            f"2026-11-{20 + order}T08:00:00+00:00",
        )
        for order, seat in enumerate(SEATS)
    ]  # fmt: skip
    return made


def plan(model: str | Path | None = None) -> Plan:
    """Unit and equipment."""
    return Plan(
        name="centrifuge",
        purpose="An accelerometer and a gyro on a precision centrifuge, its platform fixed or counter-rotated.",
        serial="CF001",
        site=Site(55.75, 150.0),
        channels=CHANNELS,
        tables=(TABLE,),
        mountings=tuple(Mounting(name, seat, 0.5) for name, seat in SEATS.items()),
        runs=(),
        model=model,
    )


def generate(folder: Path, seed: int, values: Values | None = None) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities."""
    return write_campaign(Path(folder), plan(), runs(), seed, RAW_RATE, values)


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "centrifuge", SEED)

"""One unit through a whole qualification: rate table, dividing head, polar tumble, converter ramps, reference gyro."""

from pathlib import Path

import accel_channel
import reference_gyro
import truth
from kinematics import Mounting, Site, Table, trihedral
from plan import Plan, Row, Run, chamber, dividing_head_rows, rate_table_rows, turning_rows
from sensor import AXES, Channel
from simulate import write_simulated

SEED = 20261101
RATES, RAW_RATE, POSITIONS = (300.0, 60.0, 20.0, 1.0), 50.0, 12
SITE = Site(34.25, 400.0)
CHANNELS = (
    *(Channel(f"g{name}", "gyro", axis, "pulse/s", 1000.0, "deg/s", 1.0, output) for name, axis, output in AXES),
    *(
        Channel(f"a{name}", "accelerometer", axis, "pulse/s", 20000.0, "g", 2.0, output, current_mA_per_g=1.2)
        for name, axis, output in AXES
    ),
)
RAMP_ROWS, COLDEST, WARMEST, INJECTED_G = 40, 20.0, 60.0, 12.0


def converter_ramp(seed: int, name: str, current: float | None = None) -> list[Row]:
    """Rows of two minutes while the converter warms and the sensor is held."""
    rise = (WARMEST - COLDEST) / RAMP_ROWS
    held = chamber(25.0, RAMP_ROWS, truth.stream(seed, name))
    return [
        Row(
            time=(k + 0.5) * 120.0, samples=round(120 * RAW_RATE), temperature=float(held[k]),
            converter_temperature=COLDEST + (k + 0.5) * rise, converter_rise=rise, current=current,
        )
        for k in range(RAMP_ROWS)
    ]  # fmt: skip


def plan(seed: int) -> Plan:
    """The plan; the seed sets temperatures and how the ordinary table wanders."""
    runs: list[Run] = []

    def run(name: str, procedure: str, rows: list[Row], table: str | None = None, seat: str | None = None) -> None:
        day, minute = 1 + len(runs) // 6, 90 * (len(runs) % 6)  # a ramp takes 80 minutes
        start = f"2026-11-{day:02d}T{8 + minute // 60:02d}:{minute % 60:02d}:00+00:00"
        runs.append(Run(name, procedure, rows, table, seat, start))

    def warmth(name: str, rows: int, nominal: float = 25.0):
        return chamber(nominal, rows, truth.stream(seed, name))

    turning = 2 + 2 * len(RATES)
    for seat in (*reference_gyro.SEATS, "pyramid"):
        run(f"rate-{seat}", "rate_table", rate_table_rows(RATES, warmth(f"r{seat}", turning), RAW_RATE), "rate", seat)
    for label, nominal in (("cold", 0.0), ("hot", 50.0)):
        rows = rate_table_rows(RATES, warmth(f"r{label}", turning, nominal), RAW_RATE)
        run(f"rate-pyramid-{label}", "rate_table", rows, "rate", "pyramid")
    for seat in reference_gyro.SEATS:
        run(
            f"head-{seat}",
            "dividing_head",
            dividing_head_rows(POSITIONS, warmth(f"h{seat}", POSITIONS), RAW_RATE),
            "head",
            seat,
        )
    for seat in reference_gyro.SEATS:
        rows = dividing_head_rows(POSITIONS, warmth(f"p{seat}", POSITIONS), RAW_RATE, dwell=120.0)
        run(f"polar-{seat}", "polar_tumble", rows, "polar", seat)
    for seat in ("x-up", "y-up", "z-up", "pyramid"):
        run(f"ramp-{seat}", "thermal_ramp", converter_ramp(seed, f"t{seat}"), "rate", seat)
    run("inject-12g", "current_injection", converter_ramp(seed, "inject", INJECTED_G * accel_channel.CURRENT_PER_G))
    for seat in reference_gyro.SEATS:
        for sign, way in ((1.0, "forward"), (-1.0, "reverse")):
            random = truth.stream(seed, f"{seat}/{way}")
            rate, rise = reference_gyro.wandering(60, 2.0, 40.0, 0.05, random)
            held = chamber(25.0, 60, random)
            rows = turning_rows(sign * rate, sign * rise, 2.0, RAW_RATE, held)
            run(f"beside-{seat}-{way}", "reference_gyro", rows, "ordinary", seat)
    return Plan(
        name="full-qualification",
        purpose="One unit through rate table, dividing head, polar tumble, ramps and a day beside a reference gyro.",
        serial="FQ001",
        site=SITE,
        channels=CHANNELS,
        tables=(
            Table("rate", 0.0, 90.0, 20.0, 20.0),
            Table("head", 90.0, 0.0, 20.0),
            Table("polar", 0.0, SITE.latitude_deg, 20.0),
            Table("ordinary", 0.0, 90.0, 60.0),
        ),
        mountings=(
            *(Mounting(name, seat, 5.0) for name, seat in reference_gyro.SEATS.items()),
            Mounting("pyramid", trihedral(), 5.0, "trihedral"),
        ),
        runs=tuple(runs),
    )  # fmt: skip


def generate(folder: Path, seed: int) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities."""
    return write_simulated(Path(folder), plan(seed), seed)


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "full-qualification", SEED)

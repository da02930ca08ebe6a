"""A gyro that drives a table about the polar axis: its angle over a day, and over a quarter of one.

The angle is integrated from the balance of the gyro's signal alone; the encoder adds white noise.
"""

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import truth
import write
from kinematics import Mounting, Site, Table, experienced
from plan import Plan, Run
from sensor import ARCSEC, Channel, Surroundings, Values, gyro_signal

SEED = 20261001
SITE = Site(34.25, 400.0)
GYRO = Channel("g", "gyro", (1.0, 0.0, 0.0), "mA", 0.01, "deg/h", 5e-4, (0.0, 1.0, 0.0))
# Columns are the gyro's input, output and spin axes in the axes of the table: the input axis along the pole.
ALONG = Mounting("I-north", np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), 0.5)
POLAR = Table("polar", 0.0, SITE.latitude_deg, 5.0, None, 1.0)
HOURS, SECONDS = {"day": 24.0, "quarter": 6.0}, 10.0
PROBE = 1e-7  # rad/s


def plan(seed: int, hours: dict[str, float] | None = None, model: str | Path | None = None) -> Plan:
    """The plan: one record for each of some lengths, without rows, since what is read is the table itself."""
    records = HOURS if hours is None else hours
    runs = tuple(
        Run(f"servo-{name}", "servo_table", [], "polar", "I-north", f"2026-10-{1 + order:02d}T08:00:00+00:00")
        for order, name in enumerate(records)
    )
    return Plan(
        name="servo-table", purpose="A gyro that drives a table about the polar axis, for a day and for six hours.",
        serial="ST005", site=SITE, channels=(GYRO,), tables=(POLAR,), mountings=(ALONG,), runs=runs, model=model,
    )  # fmt: skip


def turning(values: Values, hours_before: float):
    """The rate of the table, rad/s, at which the gyro reads nothing, for time in s and angle in rad."""
    stand = POLAR.stand([values.get(f"table_axis_tilt.{axis}[polar]", 0.0) * ARCSEC for axis in "xy"])
    seat = truth.true_seat(ALONG, values)

    def rate(time, angle):
        around = Surroundings(hours=hours_before + time / 3600)
        read = []
        for turn in (0.0, PROBE):
            felt, force, _ = experienced(SITE, stand, None, np.atleast_1d(angle), np.array([turn]), seat)
            read.append(gyro_signal(GYRO, values, SITE, felt, force, around)[0])
        return -PROBE * read[0] / (read[1] - read[0])

    return rate


def record(values: Values, hours: float, hours_before: float, start: float) -> tuple[np.ndarray, np.ndarray]:
    """Times in s and true angles in rad."""
    time = np.arange(0.0, hours * 3600 + 0.5, SECONDS)
    rate = turning(values, hours_before)
    solved = solve_ivp(
        lambda t, y: [rate(t, y[0])], (0.0, time[-1]), [start], "DOP853", time, rtol=1e-11, atol=1e-12, max_step=900.0
    )
    return time, solved.y[0]


def write_records(folder: Path, drawn: Plan, seed: int, hours: dict[str, float], values: Values | None = None):
    """Write the campaign into `folder`; return the true parameters and derived quantities."""
    values = dict(drawn.draw(seed) if values is None else values)
    folder = Path(folder)
    write.write_campaign_file(folder, drawn, seed, [write.run_entry(run) for run in drawn.runs])
    (folder / "runs").mkdir(exist_ok=True)
    nuisance = {}
    for order, (run, length) in enumerate(zip(drawn.runs, hours.values(), strict=True)):
        random = truth.stream(seed, run.name)
        time, angle = record(values, length, 24.0 * order, random.uniform(0, 2 * np.pi))
        read = np.degrees(angle) + values["white_noise.sigma[table_angle]"] * random.normal(size=len(time))
        nuisance[f"servo_start.angle[{run.name}]"] = float((np.degrees(angle[0]) - read[0]) * 3600)
        lines = ["time_s,table_angle_deg,temperature_degC,samples"]
        lines += [f"{t:.1f},{a % 360:.7f},25.0,1" for t, a in zip(time, read, strict=True)]
        (folder / "runs" / f"{run.name}.csv").write_text("\n".join(lines) + "\n")
    derived = truth.mounting_angles(drawn.channels, drawn.mountings, values)
    write.write_truth(folder, drawn, seed, values, derived, nuisance)
    return values | derived


def values_of(seed: int, model: str | Path | None = None) -> Values:
    """The true values, with the noise of the encoder."""
    drawn = plan(seed, model=model).draw(seed)
    return drawn | {"white_noise.sigma[table_angle]": 1.0 / 3600}


def generate(folder: Path, seed: int) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities."""
    return write_records(Path(folder), plan(seed), seed, HOURS, values_of(seed))


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "servo-table", SEED)

"""Simulated logs of a table that moves throughout: ramps, sinusoids and swept sines, with the angle of its encoder.

The motion is a closed form of time. Rates and forces are integrated and filtered in steps of a quarter millisecond. The
simulator shares no code with the models: it writes files.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import polars as pl
from scipy.signal import lfilter

STEP, RATE_HZ = 2.5e-4, 200.0
LATITUDE, GRAVITY = np.deg2rad(48.0), 9.80884
EARTH = np.deg2rad(15.041067 / 3600)
DEGREE, G = np.pi / 180, GRAVITY


@dataclass
class Unit:
    """Six channels along body axes, and the table; all in SI.

    Attributes
    ----------
    gyro_bias, accel_bias : rad/s, m/s².
    gyro_scale, accel_scale : relative.
    gyro_lag, accel_lag : time constants, s.
    asymmetry : of the scale factors of the gyros, relative.
    sensitivity : of the gyros to specific force along their input axes, rad/s per m/s².
    arm : (3, 3), place of each accelerometer, m.
    skew : how much later than the angle the outputs are sampled, s.
    gyro_noise, accel_noise : of a sample, rad/s and m/s².
    encoder : noise of a reading of the angle, and its step, arcsec.
    vibration : amplitude of the accelerations of the floor at 70 Hz, m/s².
    """

    gyro_bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    accel_bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    gyro_scale: np.ndarray = field(default_factory=lambda: np.zeros(3))
    accel_scale: np.ndarray = field(default_factory=lambda: np.zeros(3))
    gyro_lag: np.ndarray = field(default_factory=lambda: np.zeros(3))
    accel_lag: np.ndarray = field(default_factory=lambda: np.zeros(3))
    asymmetry: np.ndarray = field(default_factory=lambda: np.zeros(3))
    sensitivity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    arm: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    skew: float = 0.0
    gyro_noise: float = 0.05 * DEGREE
    accel_noise: float = 1e-3 * GRAVITY
    encoder: tuple[float, float] = (0.3, 0.5)
    vibration: float = 2e-3 * GRAVITY


def s_curve(time: np.ndarray, start: float, lasting: float) -> np.ndarray:
    """Return a change from 0 to 1 whose first two derivatives are continuous."""
    u = np.clip((time - start) / lasting, 0.0, 1.0)
    return u**3 * (10 - 15 * u + 6 * u**2)


def levels(time: np.ndarray, rates: list[float], hold: float, change: float) -> np.ndarray:
    """Return rates that are held one after another, with smooth changes between them."""
    rate, last = np.zeros(len(time)), 0.0
    for place, level in enumerate(rates):
        rate = rate + (level - last) * s_curve(time, place * (hold + change), change)
        last = level
    return rate


def swept(time: np.ndarray, start: float, lasting: float, hz: tuple[float, float], size: float) -> np.ndarray:
    """Return a sine of rising frequency, in and out within a second."""
    u = np.clip(time - start, 0.0, lasting)
    phase = 2 * np.pi * (hz[0] * u + (hz[1] - hz[0]) * u**2 / (2 * lasting))
    return size * np.sin(phase) * s_curve(time, start, 1.0) * (1 - s_curve(time, start + lasting - 1.0, 1.0))


def motion(seconds: float, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Return time and rate of the table, deg/s: `mixed` has levels, slow sinusoids and a sweep, `swept` the latter."""
    time = np.arange(0.0, seconds, STEP)
    if kind == "levels":
        return time, levels(time, [0, 40, -40, 80, -80, 0], seconds / 6 - 1.0, 1.0)
    first = 0.0 if kind == "swept" else 0.5 * seconds
    rate = swept(time, first, seconds - first, (0.2, 8.0), 40.0)
    if kind == "mixed":
        hold = first / 5 - 1.2
        rate = rate + levels(time, [0, 50, -50, 20, 0], hold, 1.0)
        part = (time > 0.8 * first) & (time < first)
        rate = rate + np.where(part, 60 * np.sin(2 * np.pi * 0.4 * (time - 0.8 * first)), 0.0) * s_curve(
            time, 0.8 * first, 0.5
        ) * (1 - s_curve(time, first - 0.5, 0.5))
    return time, rate


def lagged(values: np.ndarray, tau: float) -> np.ndarray:
    """Return the output of a first-order lag by the trapezoidal rule, from the steady state, (n,)."""
    if tau == 0:
        return values
    a = 2 * tau / STEP
    start = [values[0] * (1 - 1 / (1 + a))]
    return lfilter([1 / (1 + a), 1 / (1 + a)], [1.0, (1 - a) / (1 + a)], values, zi=start)[0]


def recorded(
    unit: Unit, mounting: np.ndarray, elevation: float, seconds: float, kind: str, rng: np.random.Generator
) -> pl.DataFrame:
    """Return the log of a run on a table whose axis points North, raised by an elevation in rad."""
    time, rate = motion(seconds, kind)
    angle = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * STEP)]) * DEGREE
    rate = rate * DEGREE
    faster = np.gradient(rate, STEP)
    # Axes of the table at angle 0 in East, North, Up; at angle φ they turn about the third.
    east = np.array([1.0, 0.0, 0.0])
    axis = np.array([0.0, np.cos(elevation), np.sin(elevation)])
    frame = np.stack([east, np.cross(axis, east), axis])
    earth = frame @ (EARTH * np.array([0.0, np.cos(LATITUDE), np.sin(LATITUDE)]))
    up = frame @ np.array([0.0, 0.0, GRAVITY])
    c, s = np.cos(angle), np.sin(angle)

    def turned(vector: np.ndarray) -> np.ndarray:
        x, y, z = vector
        return np.stack([c * x + s * y, c * y - s * x, np.full_like(c, z)])

    body = mounting.T  # from table axes to body axes
    spin = body @ np.array([0.0, 0.0, 1.0])
    turning = (body @ turned(earth)).T + rate[:, None] * spin
    force = (body @ turned(up)).T
    shake = unit.vibration * np.sin(2 * np.pi * 70.3 * time + 0.4)
    every = round(1 / (RATE_HZ * STEP))
    inside = np.arange(round(0.1 / STEP), len(time) - round(0.1 / STEP), every)
    late = inside + round(unit.skew / STEP)
    columns: dict[str, np.ndarray] = {"time_s": time[inside]}
    noise, step = unit.encoder
    reading = angle[inside] / DEGREE + noise / 3600 * rng.standard_normal(len(inside))
    columns["table_angle_deg"] = np.round(np.round(reading * 3600 / step) * step / 3600 % 360.0, 7)
    for k, name in enumerate(("gx", "gy", "gz")):
        felt = turning[:, k] + unit.sensitivity[k] * force[:, k] + unit.gyro_bias[k]
        felt = felt + unit.asymmetry[k] * np.abs(turning[:, k])
        out = (1 + unit.gyro_scale[k]) * lagged(felt, unit.gyro_lag[k])[late]
        columns[name] = (out + unit.gyro_noise * rng.standard_normal(len(late))) / DEGREE
    for k, name in enumerate(("ax", "ay", "az")):
        arm = unit.arm[k]
        across = np.cross(spin, np.cross(spin, arm))[k]
        own = force[:, k] + rate**2 * across + faster * np.cross(spin, arm)[k]
        coriolis = 2 * np.cross(turning - rate[:, None] * spin, np.cross(rate[:, None] * spin, arm))[:, k]
        out = (1 + unit.accel_scale[k]) * lagged(own + coriolis + shake + unit.accel_bias[k], unit.accel_lag[k])[late]
        columns[name] = (out + unit.accel_noise * rng.standard_normal(len(late))) / GRAVITY
    return pl.DataFrame(columns)


TRIHEDRAL = np.array(
    [
        [np.sqrt(2 / 3), -np.sqrt(1 / 6), -np.sqrt(1 / 6)],
        [0.0, np.sqrt(1 / 2), -np.sqrt(1 / 2)],
        [np.sqrt(1 / 3)] * 3,
    ]
)
UPRIGHT = np.eye(3)
ON_SIDE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
SEATS = {"trihedral": TRIHEDRAL, "upright": UPRIGHT, "side": ON_SIDE}
HEAD = f"""
format = 1
name = "motion"

[site]
latitude_deg = 48.0
gravity_m_s2 = {GRAVITY}

[unit]
serial = "T1"
"""
CHANNEL = """
[[channel]]
name = "{name}"
kind = "{kind}"
input_axis = {axis}
output_unit = "{unit}"
scale = 1.0
per = "{unit}"
"""
RUN = """
[[run]]
name = "{name}"
procedure = "rate_table"
file = "{name}.csv"
table = "{table}"
mounting = "{seat}"
temperature_degC = 25.0
{key}
"""


def write_campaign(
    folder: Path,
    unit: Unit,
    rng: np.random.Generator,
    runs: dict[str, tuple[str, float, float, str]],
    key: str = "transitions = true",
) -> Path:
    """Write a campaign.

    Parameters
    ----------
    runs : name → seat, elevation of the table in deg, seconds, kind of motion.
    """
    folder.mkdir(parents=True, exist_ok=True)
    text = HEAD
    for k, letter in enumerate("xyz"):
        axis = [float(k == place) for place in range(3)]
        text += CHANNEL.format(name=f"g{letter}", kind="gyro", axis=axis, unit="deg/s")
        text += CHANNEL.format(name=f"a{letter}", kind="accelerometer", axis=axis, unit="g")
    for elevation in dict.fromkeys(each[1] for each in runs.values()):
        text += f'\n[[table]]\nname = "table-{elevation:g}"\nazimuth_deg = 0.0\nelevation_deg = {elevation}\n'
        text += "angle_uncertainty_arcsec = 1.0\n"
    for seat in dict.fromkeys(each[0] for each in runs.values()):
        text += f'\n[[mounting]]\nname = "{seat}"\nbody_to_table = {SEATS[seat].round(15).tolist()}\n'
    for name, (seat, elevation, seconds, kind) in runs.items():
        text += RUN.format(name=name, table=f"table-{elevation:g}", seat=seat, key=key)
        recorded(unit, SEATS[seat], np.deg2rad(elevation), seconds, kind, rng).write_csv(folder / f"{name}.csv")
    (folder / "campaign.toml").write_text(text)
    return folder

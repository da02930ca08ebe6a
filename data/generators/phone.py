"""Recordings of a phone on a bicycle wheel and in the hand, as an app writes them: one file for each sensor.

The sensors have clocks of their own: 100 Hz accelerometers, 104 Hz gyros, times that jitter by half a millisecond.  The
axle of the wheel is level within some degrees, the wheel slows down and shakes; the hand waves the phone through all
attitudes.  Attitudes and places come as functions of time, finely sampled: rates and forces are their differences.

    python data/generators/phone.py FOLDER
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kinematics import Site

SEED = 20261130
SITE = Site(48.0, 520.0)
RATES = {"Accelerometer": 100.0, "Gyroscope": 104.0}  # Hz
UNITS = {"Accelerometer": "m/s^2", "Gyroscope": "rad/s"}
NOISE = {"Accelerometer": 0.02, "Gyroscope": 0.0017}
JITTER = 0.0005  # s
FINE = 1000.0  # Hz of the attitudes
WHEEL_SECONDS, HAND_SECONDS = 6.0, 30.0
LEVER = 0.06  # m, of the phone about the axle

Motion = tuple[Callable[[np.ndarray], Rotation], Callable[[np.ndarray], np.ndarray]]


@dataclass(frozen=True)
class Phone:
    """Errors of a phone: reading = (1 + scale)·((I + tilt)·input + bias), SI, rows are channels."""

    bias: dict[str, np.ndarray]
    scale: dict[str, np.ndarray]
    tilt: dict[str, np.ndarray]


def draw(rng: np.random.Generator) -> Phone:
    """Return a phone whose first accelerometer defines x, and the second the plane of x and y."""
    lower = np.zeros((3, 3))
    lower[1, 0], lower[2, 0], lower[2, 1] = rng.normal(0, 0.004, 3)
    return Phone(
        {"Accelerometer": rng.normal(0, 0.1, 3), "Gyroscope": np.radians(rng.normal(0, 0.5, 3))},
        {"Accelerometer": rng.normal(0, 0.004, 3), "Gyroscope": rng.normal(0, 0.006, 3)},
        {"Accelerometer": lower, "Gyroscope": rng.normal(0, 0.004, (3, 3)) * (1 - np.eye(3))},
    )


def wander(rng: np.random.Generator, time: np.ndarray, low: float, high: float, terms: int = 10) -> np.ndarray:
    """Return a smooth random function of unit variance with frequencies between two, Hz."""
    frequency, phase = rng.uniform(low, high, terms), rng.uniform(0, 2 * np.pi, terms)
    return np.sqrt(2 / terms) * np.sin(2 * np.pi * np.outer(time, frequency) + phase).sum(axis=1)


def _motion(time: np.ndarray, attitude: Rotation, place: np.ndarray) -> Motion:
    quaternion = attitude.as_quat()
    sign = np.sign(np.sum(quaternion[1:] * quaternion[:-1], axis=1))
    quaternion *= np.cumprod(np.concatenate([[1.0], sign]))[:, None]

    def at(values: np.ndarray, when: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(when, time, column) for column in values.T], axis=1)

    return lambda when: Rotation.from_quat(at(quaternion, when)), lambda when: at(place, when)


def wheel(rng: np.random.Generator, axis: int, sense: float, upright: bool = False) -> Motion:
    """Return a phone on a wheel that turns about one of its axes; the axle is level, or upright."""
    time = np.arange(-1.0, WHEEL_SECONDS + 1.0, 1 / FINE)
    rate = sense * 2 * np.pi * 0.5 * (1 - 0.15 * time / WHEEL_SECONDS + 0.02 * wander(rng, time, 0.1, 0.6))
    phase = np.cumsum(rate) / FINE
    seat = Rotation.from_rotvec(rng.normal(0, np.radians(3.0), 3))
    to_axle = Rotation.from_matrix(np.roll(np.eye(3), axis, axis=1))
    lying = Rotation.from_euler("zy", [rng.uniform(0, 6.0), -np.pi / 2 if upright else rng.normal(0, np.radians(3))])
    play = np.radians(0.2) * np.stack([np.zeros(len(time)), np.cos(phase), np.sin(2 * phase)], axis=1)
    body = lying * Rotation.from_rotvec(play) * Rotation.from_rotvec(np.outer(phase, [1, 0, 0])) * to_axle * seat
    shake = np.stack([2e-5 * wander(rng, time, 1.0, 12.0) for _ in range(3)], axis=1)
    return _motion(time, body, body.apply(LEVER * rng.normal(0, 0.6, 3)) + shake)


def hand(rng: np.random.Generator) -> Motion:
    """Return a phone that is waved slowly through all attitudes."""
    time = np.arange(-1.0, HAND_SECONDS + 1.0, 1 / FINE)
    speed = rng.uniform(0.2, 0.45, 3)
    angles = np.stack([time * each + 1.2 * wander(rng, time, 0.02, 0.15) for each in speed], axis=1)
    path = np.stack([0.03 * wander(rng, time, 0.1, 0.8) for _ in range(3)], axis=1)
    return _motion(time, Rotation.from_euler("xyz", angles), path)


def readings(phone: Phone, sensor: str, motion: Motion, seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Return times and readings of a sensor, (N, 4): means over the sampling interval."""
    attitude, place = motion
    interval = 1 / RATES[sensor]
    start = rng.uniform(0, interval)
    time = start + interval * np.arange(int((seconds - start) * RATES[sensor]))
    parts = []
    for share in (np.arange(8) + 0.5) / 8 - 0.5:
        when, step = time + share * interval, 1 / FINE
        before, after = attitude(when - step), attitude(when + step)
        if sensor == "Gyroscope":
            parts.append((before.inv() * after).as_rotvec() / (2 * step) + attitude(when).inv().apply(SITE.earth_rate))
            continue
        moved = (place(when - 20 * step) - 2 * place(when) + place(when + 20 * step)) / (20 * step) ** 2
        parts.append(attitude(when).inv().apply(moved + SITE.upward_force))
    felt = np.mean(parts, axis=0) @ (np.eye(3) + phone.tilt[sensor]).T
    read = (1 + phone.scale[sensor]) * (felt + phone.bias[sensor])
    stamped = time + JITTER * rng.uniform(-1, 1, len(time))
    return np.column_stack([stamped, read + rng.normal(0, NOISE[sensor], read.shape)])


def record(folder: Path, phone: Phone, motion: Motion, seconds: float, rng: np.random.Generator) -> None:
    """Write the files of one recording."""
    folder.mkdir(parents=True)
    for sensor, unit in UNITS.items():
        header = ",".join(['"Time (s)"', *(f'"{axis} ({unit})"' for axis in "XYZ")])
        rows = readings(phone, sensor, motion, seconds, rng)
        np.savetxt(folder / f"{sensor}.csv", rows, fmt="%.6f", delimiter=",", header=header, comments="")


def generate(folder: Path, seed: int = SEED) -> Phone:
    """Write recordings of a phone on a wheel, each axis both ways, and in the hand; return its errors."""
    rng = np.random.default_rng(seed)
    phone = draw(rng)
    for axis, name in enumerate("xyz"):
        for sense, word in ((1.0, "forward"), (-1.0, "reverse")):
            record(folder / f"{name}-{word}", phone, wheel(rng, axis, sense), WHEEL_SECONDS, rng)
    record(folder / "hand", phone, hand(rng), HAND_SECONDS, rng)
    return phone


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("phone"))

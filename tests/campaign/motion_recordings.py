"""Recordings of a unit in motion: waved by hand, or turned on an axis that wobbles and drags; physics of their own.

Attitudes come as functions of time, finely sampled; rates and forces are their differences.  Nothing is shared with the
models.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

GRAVITY = 9.80875
LATITUDE = 48.0
EARTH = 7.292115e-5 * np.array([0.0, np.cos(np.radians(LATITUDE)), np.sin(np.radians(LATITUDE))])
NAMES = ("ax", "ay", "az", "gx", "gy", "gz")
FINE = 8  # steps per sample


@dataclass(frozen=True)
class UnitErrors:
    """Errors of a unit: reading = (1 + scale)·(axis · input) + bias; `tilt` moves the axes, rows of I + tilt.

    Accelerometers in m/s², gyros in rad/s; `drag` is the g-sensitivity of the gyros, (rad/s)/(m/s²).
    """

    accel_bias: np.ndarray
    accel_scale: np.ndarray
    accel_tilt: np.ndarray
    gyro_bias: np.ndarray
    gyro_scale: np.ndarray
    gyro_tilt: np.ndarray
    drag: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    asymmetry: np.ndarray = field(default_factory=lambda: np.zeros(3))
    noise: tuple[float, float] = (0.02, 0.0017)


@dataclass(frozen=True)
class SetUp:
    """What is not as the campaign states it: local gravity, m/s², relative error of the clock, times by ± `jitter`, s.

    `lag` is the delay of the gyros against the accelerometers, s.
    """

    gravity: float = GRAVITY
    clock: float = 0.0
    jitter: float = 0.0
    lag: float = 0.0


def _delayed(values: np.ndarray, samples: float) -> np.ndarray:
    """Return values (n, 3) delayed by a number of samples."""
    place = np.arange(len(values))
    return np.stack([np.interp(place - samples, place, column) for column in values.T], axis=1)


def random_unit(rng: np.random.Generator, **more) -> UnitErrors:
    """Return a consumer unit whose first accelerometer defines x, and the second the plane of x and y."""
    tilt = np.zeros((3, 3))
    tilt[1, 0], tilt[2, 0], tilt[2, 1] = rng.normal(0, 0.008, 3)
    return UnitErrors(
        rng.normal(0, 0.2, 3), rng.normal(0, 0.008, 3), tilt,
        np.radians(rng.normal(0, 0.8, 3)), rng.normal(0, 0.01, 3),
        rng.normal(0, 0.008, (3, 3)) * (1 - np.eye(3)), **more,
    )  # fmt: skip


def smooth(rng: np.random.Generator, time: np.ndarray, low: float, high: float, terms: int = 12) -> np.ndarray:
    """Return a smooth random function of unit variance with frequencies between two, Hz."""
    frequency, phase = rng.uniform(low, high, terms), rng.uniform(0, 2 * np.pi, terms)
    return np.sqrt(2 / terms) * np.sum(np.cos(2 * np.pi * frequency[:, None] * time + phase[:, None]), axis=0)


def shaken(rng: np.random.Generator, time: np.ndarray, size: float = 0.1, terms: int = 80) -> np.ndarray:
    """Return a displacement, m, whose acceleration has this standard deviation, m/s², alike from 0.3 to 15 Hz."""
    frequency, phase = rng.uniform(0.3, 15.0, terms), rng.uniform(0, 2 * np.pi, terms)
    found = np.zeros(len(time))
    for omega, begins in zip(2 * np.pi * frequency, phase, strict=True):
        found += np.cos(omega * time + begins) / omega**2
    return size * np.sqrt(2 / terms) * found


def read(
    errors: UnitErrors, rng: np.random.Generator, attitude: Callable[[np.ndarray], Rotation],
    place: Callable[[np.ndarray], np.ndarray], seconds: float, hz: float, walk: float = 0.0,
    setup: "SetUp | None" = None,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Return the columns that a unit reads, each sample a mean over the sampling interval.

    Parameters
    ----------
    attitude : body → local level, at times.
    place : of the accelerometers in the local level, m, shape (n, 3), at times.
    walk : random walk of the rate of the gyros, rad/s per √s.
    setup : what else is not as the campaign states it.
    """
    setup = setup or SetUp()
    step = 1 / (hz * FINE)
    time = (np.arange(round(seconds * hz) * FINE + 2) - 0.5) * step
    turned, here = attitude(time), place(time)
    rate = (turned[:-1].inv() * turned[1:]).as_rotvec() / step
    middle = attitude(time[:-1] + step / 2)
    rate = rate + middle.inv().apply(EARTH)
    before, after = place(time - step), place(time + step)
    moved = (before - 2 * here + after) / step**2
    force = turned.inv().apply(moved + np.array([0, 0, setup.gravity]))
    force = 0.5 * (force[:-1] + force[1:])
    whole = round(seconds * hz)
    force, rate = (each[: whole * FINE].reshape(whole, FINE, 3).mean(axis=1) for each in (force, rate))
    if setup.lag:
        rate = _delayed(rate, setup.lag * hz)
    felt = force @ (np.eye(3) + errors.accel_tilt).T
    seen = rate @ (np.eye(3) + errors.gyro_tilt).T
    drift = np.cumsum(rng.normal(0, walk / np.sqrt(hz), (whole, 3)), axis=0)
    read_force = (1 + errors.accel_scale) * (felt + errors.accel_bias)
    driven = seen + errors.asymmetry * np.abs(seen) + force @ errors.drag.T
    read_rate = (1 + errors.gyro_scale) * (driven + errors.gyro_bias) + drift
    read_force = read_force + rng.normal(0, errors.noise[0], read_force.shape)
    read_rate = read_rate + rng.normal(0, errors.noise[1], read_rate.shape)
    clock = (np.arange(whole) + 0.5) / hz * (1 + setup.clock)
    clock = clock + setup.jitter * rng.uniform(-1, 1, whole)
    return {"time_s": clock} | dict(zip(NAMES, np.hstack([read_force, read_rate]).T, strict=True))


def waved(
    errors: UnitErrors,
    seed: int,
    seconds: float = 180.0,
    hz: float = 100.0,
    reach: float = 0.04,
    knocks: int = 0,
    setup: SetUp | None = None,
) -> dict[str, np.ndarray]:
    """Return a unit that is waved slowly through all attitudes by a hand that moves by `reach` m meanwhile."""
    rng = np.random.default_rng(seed)
    fine = np.arange(-1.0, seconds + 1.0, 1 / (hz * FINE))
    angles = np.stack([fine * w + 1.2 * smooth(rng, fine, 0.02, 0.15) for w in rng.uniform(0.15, 0.4, 3)], axis=1)
    path = np.stack([reach * smooth(rng, fine, 0.1, 0.8) for _ in range(3)], axis=1)
    for start in rng.uniform(0, seconds, knocks):
        bump = np.exp(-0.5 * ((fine - start) / 0.05) ** 2)
        path = path + 0.02 * bump[:, None] * rng.normal(size=3)

    def at(time: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(time, fine, column) for column in values.T], axis=1)

    return read(
        errors,
        rng,
        lambda t: Rotation.from_euler("xyz", at(t, angles)),
        lambda t: at(t, path),
        seconds,
        hz,
        setup=setup,
    )


def drilled(
    errors: UnitErrors, seed: int, axis: int, sense: float, seconds: float = 20.0, hz: float = 100.0,
    turns_per_second: float = 1.0, lean: float = 0.0, setup: SetUp | None = None,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Return a unit that is turned about one of its axes, which lies level within some degrees and wobbles.

    The rate drags by some percent and varies; the unit sits some centimetres off the axis, and the drill shakes.

    Parameters
    ----------
    axis, sense : of the body, and ±1.
    lean : elevation of the axis, rad.
    """
    rng = np.random.default_rng(seed)
    fine = np.arange(-1.0, seconds + 1.0, 1 / (hz * FINE))
    share = 1 - rng.uniform(0, 0.1) * fine / seconds + 0.03 * smooth(rng, fine, 0.1, 0.6)
    phase = 2 * np.pi * sense * turns_per_second * np.cumsum(share) / (hz * FINE) + rng.uniform(0, 2 * np.pi)
    seat = Rotation.from_rotvec(rng.normal(0, np.radians(3), 3))  # of the body on the chuck
    wobble = np.radians(0.4) * np.stack([np.cos(phase + 0.7), np.sin(2 * phase), np.zeros(len(phase))], axis=1)
    wander = np.radians(0.5) * np.stack([smooth(rng, fine, 0.05, 0.5) for _ in range(3)], axis=1)
    lying = Rotation.from_euler("zy", [rng.uniform(0, 2 * np.pi), lean + rng.normal(0, np.radians(4))])
    to_axis = Rotation.from_matrix(np.roll(np.eye(3), axis, axis=1))  # body → chuck, x along the axis
    spun = Rotation.from_rotvec(np.outer(phase, [1, 0, 0]))
    body = (
        lying * Rotation.from_rotvec(wander) * Rotation.from_rotvec(np.roll(wobble, 1, axis=1)) * spun * to_axis * seat
    )
    quaternion = body.as_quat()
    quaternion *= np.cumprod(np.concatenate([[1.0], np.sign(np.sum(quaternion[1:] * quaternion[:-1], axis=1))]))[
        :, None
    ]
    off = body.apply(rng.normal(0, 0.015, 3))
    shake = np.stack([shaken(rng, fine) for _ in range(3)], axis=1)

    def at(time: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(time, fine, column) for column in values.T], axis=1)

    return read(
        errors,
        rng,
        lambda t: Rotation.from_quat(at(t, quaternion)),
        lambda t: at(t, off + shake),
        seconds,
        hz,
        setup=setup,
    )


def drilled_all(errors: UnitErrors, seed: int, **more) -> dict[str, dict[str, np.ndarray]]:
    """Return six runs: each axis of the body, both ways."""
    found = {}
    for axis, name in enumerate("xyz"):
        for sense, word in ((1.0, "forward"), (-1.0, "reverse")):
            found[f"{name}-{word}"] = drilled(errors, 6 * seed + 2 * axis + (sense < 0), axis, sense, **more)
    return found

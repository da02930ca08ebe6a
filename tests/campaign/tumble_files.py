"""A free tumble whose motion is known exactly."""

import numpy as np
from scipy.spatial.transform import Rotation
from small_files import GRAVITY

from imubayes.campaign.equipment import complete_axes
from imubayes.foundations.campaign_data import Channel

NAMES = ("ax", "ay", "az", "gx", "gy", "gz")
HZ = 100.0
UP = np.array([0.0, 0.0, 1.0])


def channels() -> tuple[Channel, ...]:
    parts = []
    for index, name in enumerate(NAMES):
        kind, per = ("gyro", "rad/s") if name.startswith("g") else ("accelerometer", "m/s^2")
        parts.append(Channel(name, kind, complete_axes(np.eye(3)[index % 3], None), per, 1.0, per, 1.0))
    return tuple(parts)


def integrate(rate: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return C_nb at every sample, the rate interpolated linearly."""
    small = 0.5 * (rate[1:] + rate[:-1]) / HZ + np.cross(rate[:-1], rate[1:]) / HZ**2 / 12
    attitude = [start]
    for turn in Rotation.from_rotvec(small).as_matrix():
        attitude.append(attitude[-1] @ turn)
    return np.array(attitude)


def tumble_log(poses: int = 16, seed: int = 0, noise: bool = True, twist_in: int | None = None):
    """Return rests of 4 s and rotations of 1.5 s about random axes: columns, and C_nb at every sample.

    In pose `twist_in` the unit rotates about the vertical by a quarter of a radian, invisible to the accelerometers.
    """
    rng = np.random.default_rng(seed)
    attitude = [Rotation.align_vectors(UP, np.array([0.3, -0.2, 0.9]))[0].as_matrix()[None]]
    rates = [np.zeros((1, 3))]
    shaking = [np.zeros(1)]
    for pose in range(poses):
        if pose:
            shape = np.sin(np.linspace(0, np.pi, round(1.5 * HZ))) ** 2
            other = np.sin(np.linspace(0, 2 * np.pi, round(1.5 * HZ)))
            axis, side = rng.normal(size=3), rng.normal(size=3)
            turn = np.outer(shape, axis / np.linalg.norm(axis)) * rng.uniform(1.5, 3.5) + 0.8 * np.outer(other, side)
            rates.append(turn)
            shaking.append(np.linalg.norm(turn, axis=1))
            attitude.append(integrate(np.vstack([rates[-2][-1:], turn]), attitude[-1][-1])[1:])
        rest = np.zeros((round((4 if pose else 10) * HZ), 3))
        if pose == twist_in:
            rest[150:200] = 0.5 * attitude[-1][-1].T @ UP
        rates.append(rest)
        shaking.append(np.zeros(len(rest)))
        attitude.append(integrate(np.vstack([rates[-2][-1:], rest]), attitude[-1][-1])[1:])
    rate, attitudes, shake = np.concatenate(rates), np.concatenate(attitude), np.concatenate(shaking)[:, None]
    force = attitudes.transpose(0, 2, 1) @ (GRAVITY * UP)
    force = force + rng.normal(size=force.shape) * (0.02 + 0.5 * shake) * noise
    gyro = rate + 0.01 + rng.normal(size=rate.shape) * 0.001 * noise
    columns = {"time_s": np.arange(len(rate)) / HZ} | dict(zip(NAMES, np.hstack([force, gyro]).T, strict=True))
    return columns, attitudes

"""Recordings of a unit with errors, held still in random attitudes and turned between them: physics of their own."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation
from tumble_files import HZ, NAMES

GRAVITY = 9.80875
EARTH = 7.292115e-5 * np.array([0.0, np.cos(np.radians(48)), np.sin(np.radians(48))])
FINE = 4  # steps per sample


class Recording:
    """A path of attitudes at `FINE`·`HZ`, with what disturbs it; `columns` makes the readings."""

    def __init__(self, seed: int, attitude: Rotation | None = None, first: float = 12.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.attitude = Rotation.random(rng=self.rng) if attitude is None else attitude
        self.path: list[np.ndarray] = []
        self.added: list[np.ndarray] = []  # acceleration, body axes
        self.rests: list[tuple[float, float]] = []
        self.rest(first)

    @property
    def now(self) -> float:
        return sum(map(len, self.path)) / (FINE * HZ)

    def rest(self, seconds: float = 4.0, sink: np.ndarray | None = None, acceleration: Sequence[float] = (0, 0, 0)):
        """Stay; `sink` is a rotation vector that is passed within the rest, at its middle half."""
        start, share = self.now, np.linspace(0, 1, round(seconds * FINE * HZ))
        way = np.clip(2 * share - 0.5, 0, 1)
        vectors = np.outer(way - np.sin(2 * np.pi * way) / (2 * np.pi), np.zeros(3) if sink is None else sink)
        self.path.append((self.attitude * Rotation.from_rotvec(vectors)).as_quat())
        self.added.append(np.tile(acceleration, (len(share), 1)).astype(float))
        self.attitude = self.attitude * Rotation.from_rotvec(vectors[-1])
        self.rests.append((start, self.now))

    def turn(self, vector: np.ndarray, seconds: float = 2.0) -> None:
        """Turn about an axis of the body, smoothly at both ends."""
        share = np.arange(1, round(seconds * FINE * HZ) + 1) / round(seconds * FINE * HZ)
        way = share - np.sin(2 * np.pi * share) / (2 * np.pi)
        self.path.append((self.attitude * Rotation.from_rotvec(np.outer(way, vector))).as_quat())
        self.added.append(np.zeros((len(share), 3)))
        self.attitude = self.attitude * Rotation.from_rotvec(vector)

    def to(self, attitude: Rotation) -> None:
        self.turn((self.attitude.inv() * attitude).as_rotvec())

    def columns(self, noise: tuple[float, float] = (0.02, 0.0017), errors: bool = True) -> dict[str, np.ndarray]:
        """Return means over the samples of what a unit with scale factor errors, misalignments and biases reads."""
        rotation = Rotation.from_quat(np.concatenate(self.path))
        rate = np.zeros((len(rotation), 3))
        rate[:-1] = (rotation[:-1].inv() * rotation[1:]).as_rotvec() * FINE * HZ
        force = rotation.inv().apply([0, 0, GRAVITY]) + np.concatenate(self.added)
        rate += rotation.inv().apply(EARTH)
        whole = len(rate) // FINE * FINE
        force, rate = (each[:whole].reshape(-1, FINE, 3).mean(1) for each in (force, rate))
        if errors:
            lower = np.tril(self.rng.normal(0, 0.005, (3, 3)), -1)
            force = force @ (np.diag(self.rng.normal(1, 0.008, 3)) + lower).T + self.rng.normal(0, 0.2, 3)
            rate = rate @ (np.eye(3) + self.rng.normal(0, 0.006, (3, 3))).T + self.rng.normal(0, 0.008, 3)
        force = force + self.rng.normal(0, noise[0], force.shape)
        rate = rate + self.rng.normal(0, noise[1], rate.shape)
        values = dict(zip(NAMES, np.hstack([force, rate]).T, strict=True))
        return {"time_s": (np.arange(len(rate)) + 0.5) / HZ} | values


def random_attitudes(seed: int, rests: int, **disturbed) -> Recording:
    """Return a recording of some rests in random attitudes; the rest in the middle may be disturbed, as `rest` does."""
    made = Recording(seed)
    for number in range(1, rests):
        made.to(Rotation.random(rng=made.rng))
        made.rest(**(disturbed if number == rests // 2 else {}))
    return made


def six_faces_and_turns(seed: int, seconds: float = 6.0, axes: Sequence[int] = (0, 1, 2)) -> Recording:
    """Return six faces, then a full turn about each axis of the body, z of which is vertical."""
    faces = [Rotation.identity(), *(Rotation.from_euler("x", a, degrees=True) for a in (90, 180, 270))]
    faces += [Rotation.from_euler("y", a, degrees=True) for a in (90, -90)]
    made = Recording(seed, faces[0])
    for face in (1, 2, 3, 4, 5, 0):
        made.to(faces[face])
        made.rest()
    for axis in axes:
        made.turn(2 * np.pi * np.eye(3)[axis], seconds)
        made.rest()
    return made

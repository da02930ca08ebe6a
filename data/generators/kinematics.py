"""What a unit on a single-axis table experiences: rotations, the Earth, gravity, the table and the seat.

Local level is East-North-Up.  A unit at rest feels the specific force (0, 0, +g) and turns with the Earth,
(0, cos L, sin L) times 15.041067 deg/h.  A table turns right-handed about its own z axis; a mounting gives the
body axes in table axes.  Errors are small right-multiplied rotations: the tilt of the table's axis in table axes,
the error of the seat in body axes.  SI and radians inside.
"""

from dataclasses import dataclass
from functools import cached_property
from math import cos, pi, radians, sin, sqrt

import numpy as np

ARCSEC = pi / 648000
EARTH_RATE = radians(15.041067) / 3600

# WGS 84
SEMI_MAJOR = 6378137.0
FLATTENING = 1 / 298.257223563
SEMI_MINOR = SEMI_MAJOR * (1 - FLATTENING)
ECCENTRICITY_SQUARED = FLATTENING * (2 - FLATTENING)
GM = 3.986004418e14
SPIN = 7.292115e-5
GRAVITY_EQUATOR = 9.7803253359
GRAVITY_POLE = 9.8321849379


def normal_gravity(latitude: float, height: float) -> float:
    """Somigliana's normal gravity at `latitude` (rad), continued to `height` (m) to second order."""
    square = sin(latitude) ** 2
    somigliana = SEMI_MINOR * GRAVITY_POLE / (SEMI_MAJOR * GRAVITY_EQUATOR) - 1
    surface = GRAVITY_EQUATOR * (1 + somigliana * square) / sqrt(1 - ECCENTRICITY_SQUARED * square)
    m = SPIN**2 * SEMI_MAJOR**2 * SEMI_MINOR / GM
    slope = 2 / SEMI_MAJOR * (1 + FLATTENING + m - 2 * FLATTENING * square)
    return surface * (1 - slope * height + 3 * height**2 / SEMI_MAJOR**2)


@dataclass(frozen=True)
class Site:
    latitude_deg: float
    height_m: float

    @cached_property
    def gravity(self) -> float:
        return normal_gravity(radians(self.latitude_deg), self.height_m)

    @cached_property
    def earth_rate(self) -> np.ndarray:
        latitude = radians(self.latitude_deg)
        return EARTH_RATE * np.array([0.0, cos(latitude), sin(latitude)])

    @cached_property
    def upward_force(self) -> np.ndarray:
        return np.array([0.0, 0.0, self.gravity])


def rotation(vector) -> np.ndarray:
    """Rodrigues' formula: rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    vector = np.asarray(vector, dtype=float)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vector.shape[:-1], 3, 3)
    # np.sinc(t) is sin(πt)/(πt): both factors stay exact at angle 0
    first = np.sinc(angle / pi)
    second = 0.5 * np.sinc(angle / (2 * pi)) ** 2
    return np.eye(3) + first * cross + second * cross @ cross


def about(axis: int, angle) -> np.ndarray:
    """Rotation matrices about coordinate axis 0, 1 or 2."""
    return rotation(np.asarray(angle, dtype=float)[..., None] * np.eye(3)[axis])


@dataclass(frozen=True)
class Table:
    name: str
    azimuth_deg: float
    elevation_deg: float
    axis_uncertainty_arcsec: float | None = None
    rate_uncertainty_ppm: float | None = None
    angle_uncertainty_arcsec: float | None = None

    def stand(self, tilt) -> np.ndarray:
        """Table at angle 0 to local level; `tilt` is (x, y) in rad."""
        level = about(2, -radians(self.azimuth_deg)) @ about(0, -radians(90 - self.elevation_deg))
        return level @ rotation([tilt[0], tilt[1], 0.0])


@dataclass(frozen=True)
class Mounting:
    name: str
    body_to_table: np.ndarray
    uncertainty_arcmin: float
    preset: str | None = None


def trihedral() -> np.ndarray:
    """Three body axes at arccos(1/√3) to the table axis, 120 degrees apart: columns are the body axes."""
    azimuth = np.radians([0.0, 120.0, 240.0])
    return np.array([sqrt(2 / 3) * np.cos(azimuth), sqrt(2 / 3) * np.sin(azimuth), np.full(3, 1 / sqrt(3))])


X_UP = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
Y_UP = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
Z_UP = np.eye(3)


def turned_back(vector: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Components (K, 3) of a vector (3,) or (K, 3) in axes turned by `angle` (K,) about z."""
    x, y, z = np.moveaxis(np.broadcast_to(vector, (len(angle), 3)), -1, 0)
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=-1)


def named_attitude(i_axis: str, o_axis: str, axes: np.ndarray) -> np.ndarray:
    """Body to local level of a gyro with these axes (rows I, O, S) whose I and O point in named directions."""
    toward = {"E": (1, 0, 0), "W": (-1, 0, 0), "N": (0, 1, 0), "S": (0, -1, 0), "U": (0, 0, 1), "D": (0, 0, -1)}
    i, o = np.array(toward[i_axis], dtype=float), np.array(toward[o_axis], dtype=float)
    return np.column_stack([i, o, np.cross(i, o)]) @ axes


def experienced(site: Site, stand: np.ndarray, wobble: np.ndarray | None, angle, rate, seat: np.ndarray):
    """Body rate, specific force and the table's own rotation, each (K, 3) in body axes.

    Parameters
    ----------
    stand : table at angle 0 to local level, with its tilt.
    wobble : small rotation vectors (K, 3) of the axis about the table's axes at angle 0, or None.
    angle, rate : true table angle and rate (K,), rad and rad/s.
    seat : true body to table.
    """
    felt = []
    for vector in (site.earth_rate, site.upward_force):
        at_table = vector @ stand
        if wobble is not None:
            at_table = np.einsum("j,kji->ki", at_table, rotation(wobble))
        felt.append(turned_back(at_table, angle) @ seat)
    table_rate = rate[:, None] * seat[2]
    return felt[0] + table_rate, felt[1], table_rate

"""Normal gravity, Earth rotation and the orientation of a table axis in the local level frame.  NumPy only."""

import math
from collections.abc import Sequence

import numpy as np

EARTH_RATE = math.radians(15.041067) / 3600.0  # rad/s, sidereal

# WGS 84 (NIMA TR8350.2, 3rd ed.): equatorial and polar normal gravity, semi-axes, m = ω²a²b/GM
_GRAVITY_EQUATOR, _GRAVITY_POLE = 9.7803253359, 9.8321849378
_SEMI_MAJOR, _SEMI_MINOR, _FLATTENING, _M = 6378137.0, 6356752.3142, 1 / 298.257223563, 0.00344978650684


def normal_gravity(latitude: float, height: float) -> float:
    """Return WGS 84 normal gravity in m/s² (Somigliana, with the second-order height formula).

    Parameters
    ----------
    latitude : geodetic latitude, rad.
    height : height above the ellipsoid, m.
    """
    sin2 = math.sin(latitude) ** 2
    k = _SEMI_MINOR * _GRAVITY_POLE / (_SEMI_MAJOR * _GRAVITY_EQUATOR) - 1
    e2 = 1 - (_SEMI_MINOR / _SEMI_MAJOR) ** 2
    surface = _GRAVITY_EQUATOR * (1 + k * sin2) / math.sqrt(1 - e2 * sin2)
    linear = 2 * (1 + _FLATTENING + _M - 2 * _FLATTENING * sin2) * height / _SEMI_MAJOR
    return surface * (1 - linear + 3 * (height / _SEMI_MAJOR) ** 2)


def earth_rate(latitude: float) -> np.ndarray:
    """Return the Earth rotation vector in the local level frame n, shape (3,), rad/s; latitude in rad."""
    return EARTH_RATE * np.array([0.0, math.cos(latitude), math.sin(latitude)])


def table_to_local(azimuth: float, elevation: float) -> np.ndarray:
    """Return C_nt at table angle 0, shape (3, 3): Rz(−A)·Rx(−(90° − E)); azimuth A and elevation E in rad."""
    tilt = -(math.pi / 2 - elevation)
    ca, sa, ct, st = math.cos(-azimuth), math.sin(-azimuth), math.cos(tilt), math.sin(tilt)
    about_z = np.array([[ca, -sa, 0.0], [sa, ca, 0.0], [0.0, 0.0, 1.0]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, ct, -st], [0.0, st, ct]])
    return about_z @ about_x


def towards(axis: Sequence[float]) -> np.ndarray:
    """Return the smallest rotation that takes z to a unit vector, shape (3, 3); about x if the vector is −z."""
    x, y, z = axis
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula about z × axis: I + [v]× + [v]×²/(1 + cos), v = (−y, x, 0).
    factor = 1 / (1 + z)
    return np.array([[1 - factor * x * x, -factor * x * y, x], [-factor * x * y, 1 - factor * y * y, y], [-x, -y, z]])

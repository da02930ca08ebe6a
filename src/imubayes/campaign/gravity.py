"""Normal gravity of the WGS 84 ellipsoid: what a plumb line feels where nobody has measured it.

Somigliana's closed formula gives gravity on the ellipsoid; the free-air series to second order carries it to
the height of the laboratory.  Real gravity differs by some 1e-5 of it (local anomaly).
"""

import math

EQUATOR = 9.7803253359  # m/s², normal gravity at the equator (NIMA TR8350.2)
SOMIGLIANA = 0.00193185265241
ECCENTRICITY_SQUARED = 0.00669437999014
FLATTENING = 1 / 298.257223563
SEMI_MAJOR_AXIS = 6378137.0  # m
RATE_RATIO = 0.00344978650684  # ω²a²b/GM


def normal_gravity(latitude: float, height: float) -> float:
    """Return normal gravity in m/s² at a latitude in rad and a height in m (NIMA TR8350.2, eq. 4-1 and 4-3)."""
    square = math.sin(latitude) ** 2
    surface = EQUATOR * (1 + SOMIGLIANA * square) / math.sqrt(1 - ECCENTRICITY_SQUARED * square)
    ratio = height / SEMI_MAJOR_AXIS
    slope = 1 + FLATTENING + RATE_RATIO - 2 * FLATTENING * square
    return surface * (1 - 2 * ratio * slope + 3 * ratio**2)

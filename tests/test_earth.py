"""Gravity against published values and the closed formula, and how a table stands on the Earth."""

import math

import numpy as np
import pytest

from imubayes.foundations.earth import EARTH_RATE, earth_rate, normal_gravity, table_to_local

# NIMA TR8350.2, 3rd edition: defining and derived constants of WGS 84
A, B, GM, OMEGA = 6378137.0, 6356752.3142, 3986004.418e8, 7292115e-11


def exact_gravity(latitude: float, height: float) -> float:
    """Normal gravity above the ellipsoid without a series: NIMA TR8350.2, eq. 4-5 to 4-14."""
    e = math.sqrt(A**2 - B**2)
    n = A / math.sqrt(1 - (e / A) ** 2 * math.sin(latitude) ** 2)
    p, z = (n + height) * math.cos(latitude), (n * (B / A) ** 2 + height) * math.sin(latitude)
    r2 = p**2 + z**2 - e**2
    u = math.sqrt(0.5 * r2 * (1 + math.sqrt(1 + 4 * e**2 * z**2 / r2**2)))
    beta = math.atan2(z * math.sqrt(u**2 + e**2), u * p)

    def q(t: float) -> float:
        return 0.5 * ((1 + 3 * t**2 / e**2) * math.atan(e / t) - 3 * t / e)

    slope = 3 * (1 + u**2 / e**2) * (1 - u / e * math.atan(e / u)) - 1
    w = math.sqrt((u**2 + e**2 * math.sin(beta) ** 2) / (u**2 + e**2))
    far = u**2 + e**2
    rotation = OMEGA**2 * A**2
    along_u = GM / far + rotation * e / far * slope / q(B) * (0.5 * math.sin(beta) ** 2 - 1 / 6)
    along_u -= OMEGA**2 * u * math.cos(beta) ** 2
    along_b = (rotation / math.sqrt(far) * q(u) / q(B) - OMEGA**2 * math.sqrt(far)) * math.sin(beta) * math.cos(beta)
    return math.hypot(along_u, along_b) / w


@pytest.mark.parametrize(
    ("degrees", "published"),
    [(0.0, 9.7803253359), (90.0, 9.8321849378), (-90.0, 9.8321849378), (45.0, 9.8061977694)],
)
def test_gravity_on_the_ellipsoid_is_as_published(degrees, published):
    assert normal_gravity(math.radians(degrees), 0.0) == pytest.approx(published, abs=2e-10)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 34.25, -45.0, 60.0, 89.0])
@pytest.mark.parametrize("height", [0.0, 400.0, 3000.0])
def test_gravity_above_it_follows_the_closed_formula(degrees, height):
    latitude = math.radians(degrees)
    # The published second-order formula is short of the closed one by the square of the flattening times height; a
    # twentieth of a µg at 3 km is below what any accelerometer resolves.
    tolerance = 1e-9 + 0.05e-6 * 9.8 * height / 3000
    assert normal_gravity(latitude, height) == pytest.approx(exact_gravity(latitude, height), abs=tolerance)


def test_the_earth_turns_at_fifteen_degrees_an_hour_about_the_pole():
    assert math.degrees(EARTH_RATE) * 3600 == pytest.approx(15.041067, rel=1e-9)
    np.testing.assert_allclose(earth_rate(0.0), [0, EARTH_RATE, 0])
    np.testing.assert_allclose(earth_rate(math.pi / 2), [0, 0, EARTH_RATE], atol=1e-20)


def test_a_polar_axis_table_has_its_axis_at_the_pole():
    latitude = math.radians(40.0)
    x, y, z = table_to_local(0.0, latitude).T
    np.testing.assert_allclose(x, [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(y, [0, math.sin(latitude), -math.cos(latitude)], atol=1e-15)
    np.testing.assert_allclose(z, earth_rate(latitude) / EARTH_RATE, atol=1e-15)


def test_a_vertical_table_has_x_east_and_y_north():
    np.testing.assert_allclose(table_to_local(0.0, math.pi / 2), np.eye(3), atol=1e-15)


@pytest.mark.parametrize("azimuth", [0.0, 0.7, 2.0, -2.9])
@pytest.mark.parametrize("elevation", [-0.6, 0.0, 0.5, 1.4])
def test_the_axis_points_to_azimuth_from_north_and_elevation(azimuth, elevation):
    found = table_to_local(azimuth, elevation)
    ce, se = math.cos(elevation), math.sin(elevation)
    np.testing.assert_allclose(found[:, 2], [ce * math.sin(azimuth), ce * math.cos(azimuth), se], atol=1e-15)
    np.testing.assert_allclose(found.T @ found, np.eye(3), atol=1e-15)
    assert np.linalg.det(found) == pytest.approx(1.0)

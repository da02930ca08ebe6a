"""The unit table against constants from elsewhere."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import constants

from imubayes.foundations.errors import InputError
from imubayes.foundations.units import dimension, same_dimension, to_si, with_output_unit

SITE = 9.7966
EXPECTED = {
    "1": 1.0,
    "%": 1e-2,
    "ppm": 1e-6,
    "ppb": 1e-9,
    "rad": 1.0,
    "mrad": 1e-3,
    "urad": 1e-6,
    "deg": constants.degree,
    "arcmin": constants.arcminute,
    "arcsec": constants.arcsecond,
    "s": 1.0,
    "ms": 1e-3,
    "min": constants.minute,
    "h": constants.hour,
    "m": 1.0,
    "cm": constants.centi,
    "mm": constants.milli,
    "g": SITE,
    "mg": 1e-3 * SITE,
    "ug": 1e-6 * SITE,
    "degC": 1.0,
    "K": 1.0,
    "A": 1.0,
    "mA": 1e-3,
    "uA": 1e-6,
    "output": 1.0,
    "deg/h": constants.degree / constants.hour,
    "deg/s": constants.degree,
    "deg/h/g": constants.degree / constants.hour / SITE,
    "deg/h/g^2": constants.degree / constants.hour / SITE**2,
    "ug/g^2": 1e-6 / SITE,
    "m/s^2": 1.0,
    "ppm/degC": 1e-6,
    "ug/degC": 1e-6 * SITE,
    "mA/g": 1e-3 / SITE,
    "m^2/s": 1.0,
    "cm^3": 1e-6,
    "T": 1.0,
    "mT": 1e-3,
    "uT": 1e-6,
    "gauss": 1e-4,
    "ppm/(deg/s)": 1e-6 / constants.degree,
    "ppm/(deg/s)^2": 1e-6 / constants.degree**2,
    "deg/h/(degC/min)": constants.degree / 60,
    "ug/(degC/min)": 60e-6 * SITE,
}


@pytest.mark.parametrize(("unit", "expected"), EXPECTED.items())
def test_a_unit_has_its_value_in_si(unit, expected):
    assert to_si(unit, SITE) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("spelling", "unit"),
    [
        ("µg", "ug"),
        ("μg", "ug"),
        ("°/s", "deg/s"),
        ("dps", "deg/s"),
        ("m/s²", "m/s^2"),
        ("″", "arcsec"),
        ("ppm/°C", "ppm/degC"),
        ("ppm/(dps)²", "ppm/(deg/s)^2"),
        ("deg / h", "deg/h"),
    ],
)
def test_other_spellings_mean_the_same(spelling, unit):
    assert to_si(spelling, SITE) == to_si(unit, SITE)
    assert dimension(spelling) == dimension(unit)


def test_own_units_of_a_channel():
    own = {"noise": 3.0, "scale": 7.0}
    assert to_si("noise", own=own) == 3.0
    assert to_si("scale/degC", own=own) == 7.0
    assert same_dimension("noise", "output")


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("mg", "m/s^2", True),
        ("deg/h", "rad/s", True),
        ("ppm", "%", True),
        ("ppm", "1", True),
        ("deg", "1", False),
        ("mg", "deg/h", False),
        ("ug/g^2", "s^2/m", True),
        ("degC", "K", True),
        ("ppm/(deg/s)", "s/rad", True),
        ("deg/h/(degC/min)", "rad/K", True),
    ],
)
def test_dimensions(one, other, same):
    assert same_dimension(one, other) is same


@pytest.mark.parametrize(
    ("unit", "closest"),
    [
        ("dge/h", "deg"),
        ("arcsecond", "arcsec"),
        ("mgal", "mg"),
        ("pppm", "ppm"),
        ("deg/g^x", "g"),
        ("", ""),
        ("deg//h", ""),
        ("ppm/(dge/s)", "deg"),
        ("ppm/(deg/s", "deg"),
    ],
)
def test_an_unknown_unit_is_refused_with_the_closest(unit, closest):
    with pytest.raises(InputError) as caught:
        to_si(unit, where="model.toml, line 3")
    (problem,) = caught.value.issues
    assert problem.where == "model.toml, line 3"
    assert problem.allowed.startswith(closest)
    assert problem.remedy


@given(st.sampled_from(sorted(EXPECTED)), st.sampled_from(sorted(EXPECTED)), st.floats(9.7, 9.9))
def test_a_quotient_of_units_is_the_quotient_of_their_values(one, other, gravity):
    if "/" not in other and "^" not in other:
        quotient = to_si(f"{one}/{other}", gravity)
        assert math.isclose(quotient, to_si(one, gravity) / to_si(other, gravity), rel_tol=1e-14)


def test_output_is_shown_as_the_unit_of_the_channel():
    shown = {
        ("output", "mV"): "mV",
        ("output/degC", "counts/s"): "counts/s/degC",
        ("output/(degC/min)", "V"): "V/(degC/min)",
        ("ppm/output", "counts/s"): "ppm/(counts/s)",
        ("ppm/output^2", "counts/s"): "ppm/(counts/s)^2",
        ("ppm/output^2", "V"): "ppm/V^2",
        ("output", ""): "output",
        ("deg/h", "V"): "deg/h",
    }
    assert {key: with_output_unit(*key) for key in shown} == shown

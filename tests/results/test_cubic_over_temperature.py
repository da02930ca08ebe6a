"""A bias over a range of temperatures has every power of the temperature that the catalogue has."""

import numpy as np
import pytest

from imubayes.model.effect_registry import Registry
from imubayes.results.temperature_range import FAMILIES, ThermalModel, over_range


def test_a_cubic_bias_acts_over_a_range() -> None:
    draws = {"accel_bias.bias[ax]": np.array([100.0]), "accel_bias_temperature_cubic.coefficient[ax]": np.array([0.1])}
    units = {"accel_bias_temperature_cubic.coefficient[ax]": "ug/degC^3"}
    found = over_range("accel_bias.bias[ax]", "ug", draws, ThermalModel({}, units, 25.0), (-40.0, 85.0))[0]
    assert found[0] == pytest.approx(100 - 0.1 * 65**3)
    assert found[-1] == pytest.approx(100 + 0.1 * 60**3)


def test_every_thermal_effect_of_a_bias_or_scale_factor_is_listed() -> None:
    known = {effect for family in FAMILIES.values() for effect, _, _ in family.terms}
    begins = tuple(f"{sensor}_{what}_temperature" for sensor in ("gyro", "accel") for what in ("bias", "scale"))
    thermal = {name for name in Registry().effects if name.startswith(begins) and not name.endswith("_rate")}
    assert thermal == known

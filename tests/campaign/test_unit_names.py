"""Names of mistaken units of outputs: the factor by which an output is too large is that of the unit that it is in."""

import math

import pytest

from imubayes.foundations.wrong_records import GAINS

PER_UNIT = {
    "rad/s": 1.0, "deg/s": 180 / math.pi, "mdeg/s": 180_000 / math.pi, "deg/h": 3600 * 180 / math.pi,
    "rpm": 60 / (2 * math.pi), "m/s²": 1.0, "cm/s²": 100.0, "g": 1 / 9.80665, "mg": 1000 / 9.80665, "ft/s²": 1 / 0.3048,
}  # fmt: skip


@pytest.mark.parametrize("kind", ["gyro", "accelerometer"])
def test_a_factor_is_the_ratio_of_the_units_in_its_name(kind: str) -> None:
    named = {name: factor for name, factor in GAINS[kind].items() if " instead of " in name}
    assert len(named) > 5
    for name, factor in named.items():
        is_in, stated = name.split(" instead of ")
        assert factor == pytest.approx(PER_UNIT[is_in] / PER_UNIT[stated], rel=1e-4), name

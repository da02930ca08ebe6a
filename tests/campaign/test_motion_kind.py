"""How `new` and `convert` read a unit that moves: its procedure, and the unit of its gyros."""

import numpy as np
import pytest
from motion_recordings import NAMES, drilled, random_unit, waved
from tumble_recordings import random_attitudes

from imubayes_recordings.convert.motion_kind import per_radian_in_motion, procedure_in_motion


def rates(columns: dict[str, np.ndarray]) -> np.ndarray:
    return np.stack([columns[name] for name in NAMES[3:]], axis=1)


@pytest.fixture(scope="module")
def unit():
    return random_unit(np.random.default_rng(3))


def test_a_unit_that_is_waved_is_slow_motion(unit) -> None:
    columns = waved(unit, 4, seconds=40.0)
    procedure, why = procedure_in_motion(columns, rates(columns))
    assert procedure == "slow_motion"
    assert "about all axes" in why


def test_accelerometers_alone_that_are_waved_are_in_slow_motion(unit) -> None:
    columns = {name: values for name, values in waved(unit, 4, seconds=40.0).items() if name[0] != "g"}
    procedure, why = procedure_in_motion(columns, np.zeros((len(columns["time_s"]), 0)))
    assert procedure == "slow_motion"
    assert "no gyros" in why


def test_accelerometers_alone_with_rests_stay_a_free_tumble() -> None:
    columns = {name: values for name, values in random_attitudes(6, 12).columns().items() if name[0] != "g"}
    assert procedure_in_motion(columns, np.zeros((len(columns["time_s"]), 0))) == ("free_tumble", "")


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_unit_on_a_drill_is_free_rotation(unit, axis) -> None:
    columns = drilled(unit, 5, axis, -1.0)
    procedure, why = procedure_in_motion(columns, rates(columns))
    assert procedure == "free_rotation"
    assert "about one axis" in why


def test_a_unit_with_rests_stays_a_free_tumble() -> None:
    columns = random_attitudes(6, 12).columns()
    assert procedure_in_motion(columns, rates(columns)) == ("free_tumble", "")


@pytest.mark.parametrize("factor", [1.0, 57.29578, 1000.0])
def test_gravity_tells_the_unit_of_the_gyros(unit, factor) -> None:
    columns = waved(unit, 4, seconds=40.0)
    scaled = columns | {name: factor * columns[name] for name in NAMES[3:]}
    assert per_radian_in_motion(scaled) == pytest.approx(factor, rel=0.1)


def test_a_force_that_does_not_follow_tells_nothing(unit) -> None:
    columns = waved(unit, 4, seconds=40.0)
    other = waved(unit, 8, seconds=40.0)
    assert per_radian_in_motion(columns | {name: other[name] for name in NAMES[3:]}) == 0.0

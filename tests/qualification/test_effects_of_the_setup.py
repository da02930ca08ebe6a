"""The place of a unit on a wheel is another in each run: constants of the unit do not have it."""

from imubayes.model.bound_effects import BoundEffect
from imubayes.model.effect_registry import Registry
from imubayes_qualification.onboard import unexpressed_effects


def belongs(name: str) -> bool:
    effect = object.__new__(BoundEffect)
    object.__setattr__(effect, "effect_class", Registry().effects[name])
    return unexpressed_effects._of_the_unit(effect)


def test_the_place_on_a_wheel_is_not_of_the_unit_and_a_lever_arm_is() -> None:
    assert not belongs("rotation_centre")
    assert belongs("lever_arm")
    assert belongs("gyro_scale_factor")

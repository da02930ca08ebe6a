"""Lever arm: an accelerometer off the rotation axis feels the table's own motion."""

from dataclasses import replace

from imubayes.effects.base import PlaceEffect, Stage
from imubayes.frames import cross
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Experience
from imubayes.types import Scalar, vector3


class LeverArm(PlaceEffect):
    """Centripetal and tangential acceleration Ω×(Ω×r) + Ω̇×r at r, body axes, from the rotation axis.

    1 cm at 100 °/s is 3.1 mg.  The component of r along the axis has no effect.
    """

    name = "lever_arm"
    stage = Stage.PLACE
    kinds = ("accelerometer",)
    needs = ("turning",)
    confused_with = "accelerometer terms quadratic in rate"
    reference = "IEEE Std 1293, centrifuge geometry; Groves § 6.3.1.3"

    x: Scalar = parameter("mm", "normal(0, 20 mm)", (1, 50), "the sensor's place along body x")
    y: Scalar = parameter("mm", "normal(0, 20 mm)", (1, 50), "the sensor's place along body y")
    z: Scalar = parameter("mm", "normal(0, 20 mm)", (1, 50), "the sensor's place along body z")

    def apply(self, experience: Experience) -> Experience:
        place = vector3(self.x, self.y, self.z)
        rate = experience.table_rate
        centripetal = cross(rate, cross(rate, place))
        tangential = cross(experience.table_acceleration, place)
        return replace(experience, force=experience.force + centripetal + tangential)

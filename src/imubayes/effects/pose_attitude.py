"""Pose attitude: the unknown attitude of each static pose of a free tumble."""

from dataclasses import replace

from imubayes.effects.base import MotionEffect, Stage
from imubayes.frames import compose, exponential
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Ambient, Motion
from imubayes.types import Scalar, vector3


class PoseAttitude(MotionEffect):
    """Rotation of each pose from its first estimate, C_nb = C_nb,estimated · exp([δ]×): a mounting of unknown rotation.

    The prior, 10°, is an order of magnitude wider than the error of the first estimate, which rests on nominal
    sensors good to some percent.
    """

    name = "pose_attitude"
    stage = Stage.STAND
    per = ("run", "pose")
    nuisance = True
    reference = "Tedaldi et al., ICRA 2014"

    x: Scalar = parameter("arcsec", "normal(0, 10 deg)", (1, 36000), "the turn of the pose about body x")
    y: Scalar = parameter("arcsec", "normal(0, 10 deg)", (1, 36000), "the turn of the pose about body y")
    z: Scalar = parameter("arcsec", "normal(0, 10 deg)", (1, 36000), "the turn of the pose about body z")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        turn = exponential(vector3(self.x, self.y, self.z))
        return replace(motion, mounting=compose(motion.mounting, turn))

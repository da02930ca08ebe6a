"""Effects of a reference gyro mounted beside the unit."""

from dataclasses import replace

from imubayes.array_shapes import Scalar, vector3
from imubayes.effects.base import MotionEffect, Order, Stage
from imubayes.parameters.parameter_declarations import parameter
from imubayes.rotations import exponential, rotate
from imubayes.signal_path_state import Ambient, Motion


class ReferenceBias(MotionEffect):
    """Reading of each axis of the reference = true rate + b.

    It acts in runs with a reference gyro only.
    """

    name = "reference_bias"
    stage, order = Stage.TABLE, -5
    per = ()
    needs = ("reference",)
    confused_with = "the bias of the gyro along the same axis: exactly, unless other runs determine the latter"
    reference = "IEEE Std 952, bias; of the reference, its certificate"
    x: Scalar = parameter("deg/h", "normal(0, 0.1 deg/h)", (0.001, 10), "the bias of the reference about body x")
    y: Scalar = parameter("deg/h", "normal(0, 0.1 deg/h)", (0.001, 10), "the bias of the reference about body y")
    z: Scalar = parameter("deg/h", "normal(0, 0.1 deg/h)", (0.001, 10), "the bias of the reference about body z")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return replace(motion, reference_rate=motion.reference_rate - vector3(self.x, self.y, self.z))


class ReferenceScaleFactor(MotionEffect):
    """Reading of each axis of the reference = (1 + s) · true rate."""

    name = "reference_scale_factor"
    stage = Stage.TABLE
    per = ()
    needs = ("reference",)
    confused_with = "a scale factor of the gyro along the same axis: exactly, except through the priors"
    reference = "IEEE Std 952, scale factor error; of the reference, its certificate"
    x: Scalar = parameter("ppm", "normal(0, 10 ppm)", (1, 100), "the relative error of the reference about body x")
    y: Scalar = parameter("ppm", "normal(0, 10 ppm)", (1, 100), "the relative error of the reference about body y")
    z: Scalar = parameter("ppm", "normal(0, 10 ppm)", (1, 100), "the relative error of the reference about body z")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        factor = 1 + vector3(self.x, self.y, self.z)
        return replace(
            motion,
            reference_rate=motion.reference_rate / factor,
            reference_acceleration=motion.reference_acceleration / factor,
        )


class ReferenceAlignment(MotionEffect):
    """Rate in body axes = exp([δ]×) · rate in the axes of the reference."""

    name = "reference_alignment"
    stage, order = Stage.TABLE, Order.AXIS
    per = ()
    needs = ("reference",)
    confused_with = "misalignments of all gyros together, unless runs without the reference determine them"
    reference = "physics of a rigid fixture; Titterton and Weston § 3.6"
    x: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (10, 1000), "the rotation of the reference about body x")
    y: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (10, 1000), "the rotation of the reference about body y")
    z: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (10, 1000), "the rotation of the reference about body z")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        rotation = exponential(vector3(self.x, self.y, self.z))
        return replace(
            motion,
            reference_rate=rotate(rotation, motion.reference_rate),
            reference_acceleration=rotate(rotation, motion.reference_acceleration),
        )

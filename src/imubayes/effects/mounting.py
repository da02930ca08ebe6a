"""Effects of attitude and position: mounting, pose, heading, lever arms, and a reference gyro beside the unit.

They say how the unit is mounted or posed, where it starts, where its sensors sit, and how a reference gyro that is
mounted beside it errs.
"""

from dataclasses import replace

import jax.numpy as jnp

from imubayes.effects.base import MotionEffect, Order, PlaceEffect, Stage
from imubayes.effects.shared_formulas import BodyRotation
from imubayes.foundations.arrays import Scalar, Vector3, compose, cross, exponential, rotate, vector3
from imubayes.foundations.earth import EARTH_RATE
from imubayes.foundations.signal_path_state import Ambient, Experience, Motion
from imubayes.parameters.declarations import parameter


class TumbleHeading(MotionEffect):
    """Heading ψ of the whole run, C_nb = Rz(ψ) · estimated C_nb; only the Earth's rotation depends on it."""

    name = "tumble_heading"
    stage = Stage.STAND
    per = ("run",)
    needs = ("posed",)
    nuisance = True
    confused_with = "gyro biases, unless the gyros resolve the Earth rate"
    reference = "Groves, Principles of GNSS, Inertial and Multisensor Navigation, § 5.6.2 (gyrocompassing)"
    heading: Scalar = parameter("deg", "uniform(-180, 180 deg)", (1, 180), "the heading of the first pose")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        zero = jnp.zeros_like(self.heading)
        return replace(motion, base=compose(exponential(vector3(zero, zero, self.heading)), motion.base))


class UnknownHeading(MotionEffect):
    """Direction of north that is not stated: level Earth rate Ω cos L · (e, 1 + n), of the nominal (0, 1).

    The components have the mean and the covariance of a uniformly distributed direction, ½ each. Terms that are linear
    in them have correct first and second moments for every direction, without a search over an angle of ±180°.
    """

    name = "unknown_heading"
    stage = Stage.STAND
    per = ("stand",)
    kinds = ("gyro",)
    needs = ("unknown_heading",)
    nuisance = True
    confused_with = "gyro biases, unless the gyros resolve the Earth rate"
    reference = "moments of the uniform distribution on a circle (Mardia and Jupp, Directional Statistics, § 3.5)"
    east: Scalar = parameter("1", "normal(0, 0.70711)", (0.1, 1), "the share of the level Earth rate along east")
    north: Scalar = parameter("1", "normal(-1, 0.70711)", (0.1, 1), "the share along north, less the nominal 1")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        level = motion.earth_rate[1]
        added = vector3(self.east * level, self.north * level, jnp.zeros_like(self.east))
        return replace(motion, earth_rate=motion.earth_rate + added)


class UnknownLevel(MotionEffect):
    """Level of a bench that is not stated: gravity g · (e, n, 1 + d); Earth rate Ω sin L · (e, n, d) + m Ω cos L up.

    d and m are the second-order terms of tilts e, n of standard deviation σ: −(e² + n²)/2, of mean −σ² and standard
    deviation σ², and the part of the level Earth rate of any heading along the tilted vertical, of standard deviation
    σ. All terms are linear. In a rotation, the tilt would act along the vertical only by its square.
    """

    name = "unknown_level"
    stage = Stage.STAND
    per = ("stand",)
    needs = ("unknown_level",)
    nuisance = True
    confused_with = "accelerometer biases, in one attitude"
    reference = "moments of a quadratic form of normal variables; σ = 1° by convention"
    east: Scalar = parameter("deg", "normal(0, 1 deg)", (0.05, 3), "the tilt of the vertical toward east")
    north: Scalar = parameter("deg", "normal(0, 1 deg)", (0.05, 3), "the tilt of the vertical toward north")
    drop: Scalar = parameter("ppm", "normal(-305 ppm, 305 ppm)", (1, 3000), "the change of the vertical by tilt")
    mixed: Scalar = parameter("1", "normal(0, 0.01745)", (0.001, 0.05), "the share of the level Earth rate upwards")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        tilt = vector3(self.east, self.north, self.drop)
        upward = motion.earth_rate[2]
        level = jnp.sqrt(EARTH_RATE**2 - upward**2)  # its direction is not known, its size is
        mixed = vector3(jnp.zeros_like(self.mixed), jnp.zeros_like(self.mixed), self.mixed * level)
        rate = motion.earth_rate + upward * tilt + mixed
        return replace(motion, gravity=motion.gravity + motion.gravity[2] * tilt, earth_rate=rate)


class StationHeading(MotionEffect):
    """Error ψ of the station's north: C_nb = Rz(ψ) · nominal C_nb, in positions set by directions.

    5 arcmin of it change the Earth rate along an axis that points east by 0.0013 · Ω cos L, 0.012 deg/h at 56°.
    """

    name = "station_heading"
    stage = Stage.STAND
    per = ()
    needs = ("directions",)
    confused_with = "gyro_misalignment if the axis always points east with the same axis up"
    reference = "IEEE Std 517, alignment of the test station to north; 5 arcsec … 5 arcmin"
    heading: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (1, 600), "the rotation about the vertical")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        zero = jnp.zeros_like(self.heading)
        return replace(motion, base=compose(exponential(vector3(zero, zero, self.heading)), motion.base))


class StationLevel(MotionEffect):
    """Error of the station's level: C_nb = exp([east, north, 0]×) · nominal C_nb, in positions set by directions.

    It tilts the Earth rate and gravity alike: 1 arcmin is 0.0003 · Ω along a horizontal axis.
    """

    name = "station_level"
    stage = Stage.STAND
    per = ()
    needs = ("directions",)
    confused_with = "station_heading if the axis is never vertical; gyro_misalignment, in few positions"
    reference = "IEEE Std 517, levelling of the test station; 1 arcsec … 5 arcmin"
    east: Scalar = parameter("arcsec", "normal(0, 1 arcmin)", (1, 300), "the rotation about east")
    north: Scalar = parameter("arcsec", "normal(0, 1 arcmin)", (1, 300), "the rotation about north")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        tilt = exponential(vector3(self.east, self.north, jnp.zeros_like(self.east)))
        return replace(motion, base=compose(tilt, motion.base))


class MountingError(BodyRotation):
    """Small rotation of the body in its fixture: C_tb = nominal C_tb · exp([δ]×), δ in body axes.

    At the trihedral angle 1 arcsec changes cos θ, and with it the apparent scale factor, by tan θ = √2 per
    radian, which is 6.86 ppm.
    """

    name = "mounting_error"
    per = ("mounting",)
    confused_with = "scale factor and table rate error if only one mounting is tested"
    reference = "first-order attitude error, body axes; IEEE Std 952, mounting misalignment"
    x: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (1, 600), "the rotation about body x", "seat")
    y: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (1, 600), "the rotation about body y", "seat")
    z: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (1, 600), "the rotation about body z", "seat")


class PoseAttitude(BodyRotation):
    """Rotation of each pose from its first estimate, C_nb = estimated C_nb · exp([δ]×): a mounting of unknown rotation.

    The prior, 10°, is an order of magnitude wider than the error of the first estimate, which rests on nominal
    sensors good to a few percent.
    """

    name = "pose_attitude"
    per = ("run", "pose")
    nuisance = True
    reference = "Tedaldi et al., ICRA 2014"
    x: Scalar = parameter("arcsec", "normal(0, 10 deg)", (1, 36000), "the rotation of the pose about body x")
    y: Scalar = parameter("arcsec", "normal(0, 10 deg)", (1, 36000), "the rotation of the pose about body y")
    z: Scalar = parameter("arcsec", "normal(0, 10 deg)", (1, 36000), "the rotation of the pose about body z")


class ServoStart(MotionEffect):
    """True angle at the first row = indicated angle + δ; every servo-table run has one, listed in the model or not."""

    name = "servo_start"
    stage = Stage.STAND
    per = ("run",)
    needs = ("driven",)
    nuisance = True
    reference = "initial condition of the differential equation"
    angle: Scalar = parameter("arcsec", "normal(0, 5 arcmin)", (0.1, 60), "the error of the first indicated angle")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return replace(motion, table_angle=motion.table_angle + self.angle)


class LeverArm(PlaceEffect):
    """Acceleration Ω×(Ω×r) + dΩ/dt×r + 2 ω_E×(Ω×r) at r, body axes, from the rotation axis.

    1 cm at 100 °/s is 3.1 mg; the Earth's rotation ω_E contributes 83 ppm of it. The component of r along the rotation
    axis has no effect on the first two terms.
    """

    name = "lever_arm"
    stage = Stage.PLACE
    kinds = ("accelerometer",)
    confused_with = "accelerometer terms quadratic in rate"
    reference = "IEEE Std 1293, centrifuge geometry; Groves § 6.3.1.3"
    x: Scalar = parameter("mm", "normal(0, 20 mm)", (1, 50), "the sensor's position along body x")
    y: Scalar = parameter("mm", "normal(0, 20 mm)", (1, 50), "the sensor's position along body y")
    z: Scalar = parameter("mm", "normal(0, 20 mm)", (1, 50), "the sensor's position along body z")

    def apply(self, experience: Experience) -> Experience:
        return off_axis(experience, vector3(self.x, self.y, self.z))


class RotationCentre(PlaceEffect):
    """Acceleration Ω×(Ω×r) + dΩ/dt×r + 2 ω_E×(Ω×r) at r, body axes, from the axis of a drill or a wheel.

    r is common to all accelerometers, and differs between runs: the place of the unit on the wheel is unknown.  The
    component of r along the axis has no effect.  At one turn a second, 1 cm is 40 mg.
    """

    name = "rotation_centre"
    stage = Stage.PLACE
    per = ("run",)
    kinds = ("accelerometer",)
    needs = ("carried",)
    confused_with = "lever_arm if all runs have the same mounting"
    reference = "IEEE Std 1293, centrifuge geometry; Groves § 6.3.1.3"
    x: Scalar = parameter("mm", "normal(0, 100 mm)", (1, 300), "the unit's position along body x")
    y: Scalar = parameter("mm", "normal(0, 100 mm)", (1, 300), "the unit's position along body y")
    z: Scalar = parameter("mm", "normal(0, 100 mm)", (1, 300), "the unit's position along body z")

    def apply(self, experience: Experience) -> Experience:
        return off_axis(experience, vector3(self.x, self.y, self.z))


def off_axis(experience: Experience, place: Vector3) -> Experience:
    """Return what acts at a place off the axis, body axes, m."""
    rate = experience.table_rate
    velocity = cross(rate, place)
    tangential = cross(experience.table_acceleration, place)
    coriolis = 2 * cross(experience.rate - rate, velocity)
    return replace(experience, force=experience.force + cross(rate, velocity) + tangential + coriolis)


class ReferenceGyroEffect(MotionEffect):
    """An effect of the reference gyro beside the unit; it acts only in runs that have one."""

    stage = Stage.TABLE
    per = ()
    needs = ("reference",)


class ReferenceBias(ReferenceGyroEffect):
    """Reading of each axis of the reference = true rate + b.

    It acts in runs with a reference gyro only.
    """

    name = "reference_bias"
    order = -5
    confused_with = "the bias of the gyro along the same axis (exactly, unless other runs determine that bias)"
    reference = "IEEE Std 952, bias; of the reference, its certificate"
    x: Scalar = parameter("deg/h", "normal(0, 0.1 deg/h)", (0.001, 10), "the bias of the reference about body x")
    y: Scalar = parameter("deg/h", "normal(0, 0.1 deg/h)", (0.001, 10), "the bias of the reference about body y")
    z: Scalar = parameter("deg/h", "normal(0, 0.1 deg/h)", (0.001, 10), "the bias of the reference about body z")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return replace(motion, reference_rate=motion.reference_rate - vector3(self.x, self.y, self.z))


class ReferenceScaleFactor(ReferenceGyroEffect):
    """Reading of each axis of the reference = (1 + s) · true rate."""

    name = "reference_scale_factor"
    confused_with = "a scale factor of the gyro along the same axis (exactly, except for the priors)"
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


class ReferenceAlignment(ReferenceGyroEffect):
    """Rate in body axes = exp([δ]×) · rate in the axes of the reference."""

    name = "reference_alignment"
    order = Order.AXIS
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

"""Effects of tables of several axes and of centrifuges: zero, squareness and intersection of the axes, and the arm."""

from dataclasses import replace

import jax.numpy as jnp

from imubayes.array_shapes import Matrix3, Scalar, Vector3, vector3
from imubayes.effects.base import MotionEffect, Order, Stage
from imubayes.parameters.parameter_declarations import parameter
from imubayes.rotations import compose, exponential
from imubayes.signal_path_state import Ambient, Motion, OuterAxes

_OUTER, _MIDDLE = 0, 1
# The common normal of axes closer to parallel than this has no direction.  Numerical.
_PARALLEL = 1e-3


def _axes(motion: Motion) -> OuterAxes:
    assert motion.outer is not None
    return motion.outer


def _normal(link: Matrix3) -> Vector3:
    """Return the unit normal z × n of an axis and the next one, n; 0 where they are parallel."""
    normal = vector3(-link[1, 2], link[0, 2], jnp.zeros_like(link[0, 2]))
    square = jnp.sum(normal * normal)
    apart = square > _PARALLEL**2
    return jnp.where(apart, normal / jnp.sqrt(jnp.where(apart, square, 1.0)), 0.0)


def _turned(motion: Motion, place: int, zero: Scalar) -> Motion:
    axes = _axes(motion)
    return replace(motion, outer=replace(axes, angle=jnp.asarray(axes.angle).at[place].add(zero)))


def _relinked(motion: Motion, place: int, link: Matrix3) -> Motion:
    axes = _axes(motion)
    return replace(motion, outer=replace(axes, link=jnp.asarray(axes.link).at[place].set(link)))


def _moved(motion: Motion, place: int, arm: Vector3) -> Motion:
    axes = _axes(motion)
    return replace(motion, outer=replace(axes, arm=jnp.asarray(axes.arm).at[place].add(arm)))


class OuterAxisZero(MotionEffect):
    """True angle of the outer axis = φ_o + δ."""

    name = "outer_axis_zero"
    stage, order = Stage.TABLE, Order.ANGLE
    per = ("table",)
    needs = ("outer_angle",)
    confused_with = "the azimuth of the table: about a vertical outer axis only the Earth rate shows it"
    reference = "IEEE Std 1293, angle reference of multi-axis tables; 1 … 60 arcsec"
    zero: Scalar = parameter("arcsec", "normal(0, 30 arcsec)", (1, 60), "the error of the outer axis' zero", "zero")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return _turned(motion, _OUTER, self.zero)


class MiddleAxisZero(MotionEffect):
    """True angle of the middle axis = φ_m + δ."""

    name = "middle_axis_zero"
    stage, order = Stage.TABLE, Order.ANGLE
    per = ("table",)
    needs = ("middle_angle",)
    confused_with = "mounting error, where the inner axis is never turned; table_axis_tilt, where the outer is not"
    reference = "IEEE Std 1293, angle reference of multi-axis tables; 1 … 60 arcsec"
    zero: Scalar = parameter("arcsec", "normal(0, 30 arcsec)", (1, 60), "the error of the middle axis' zero", "zero")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return _turned(motion, _MIDDLE, self.zero)


class InnerAxisZero(MotionEffect):
    """True angle of the inner axis = φ + δ: of a table of one axis that axis, of a centrifuge the platform."""

    name = "inner_axis_zero"
    stage, order = Stage.TABLE, Order.ANGLE
    per = ("table",)
    needs = ("table_angle",)
    confused_with = "mounting error about the inner axis: exactly, in one mounting"
    reference = "IEEE Std 1293, angle reference of multi-axis tables; 1 … 60 arcsec"
    zero: Scalar = parameter("arcsec", "normal(0, 30 arcsec)", (1, 60), "the error of the inner axis' zero", "zero")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return replace(motion, table_angle=motion.table_angle + self.zero)


class OuterAxisSquareness(MotionEffect):
    """The angle between the outer and the next axis is the nominal one + ε, by a turn about their common normal."""

    name = "outer_axis_squareness"
    stage, order = Stage.TABLE, Order.AXIS
    per = ("table",)
    needs = ("outer_angle",)
    confused_with = "table_axis_tilt, where the outer axis is not turned"
    reference = "IEEE Std 1293, orthogonality of the axes of multi-axis tables; 0.5 … 30 arcsec"
    angle: Scalar = parameter(
        "arcsec", "normal(0, 10 arcsec)", (0.5, 30), "the excess of the angle between the axes", "squareness"
    )

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        link = _axes(motion).link[_OUTER]
        return _relinked(motion, _OUTER, compose(exponential(self.angle * _normal(link)), link))


class MiddleAxisSquareness(MotionEffect):
    """The angle between the middle and the inner axis is the nominal one + ε, by a turn about their common normal."""

    name = "middle_axis_squareness"
    stage, order = Stage.TABLE, Order.AXIS
    per = ("table",)
    needs = ("middle_angle",)
    confused_with = "mounting error, where the inner axis is not turned; outer_axis_squareness, where the middle is not"
    reference = "IEEE Std 1293, orthogonality of the axes of multi-axis tables; 0.5 … 30 arcsec"
    angle: Scalar = parameter(
        "arcsec", "normal(0, 10 arcsec)", (0.5, 30), "the excess of the angle between the axes", "squareness"
    )

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        link = _axes(motion).link[_MIDDLE]
        return _relinked(motion, _MIDDLE, compose(exponential(self.angle * _normal(link)), link))


class OuterAxisIntersection(MotionEffect):
    """The next axis passes the outer one at d along their common normal: d adds Ω×(Ω×d) + Ω̇×d, turning with it.

    10 µm at 100 °/s are 3 µg.
    """

    name = "outer_axis_intersection"
    stage, order = Stage.TABLE, Order.AXIS
    per = ("table",)
    needs = ("outer_angle",)
    confused_with = "lever_arm, where the next axis is not turned"
    reference = "IEEE Std 1293, intersection of the axes of multi-axis tables; 10 … 500 µm"
    distance: Scalar = parameter(
        "um", "normal(0, 100 um)", (10, 1000), "the distance of the axes along z × n", "intersection"
    )

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return _moved(motion, _OUTER, self.distance * _normal(_axes(motion).link[_OUTER]))


class MiddleAxisIntersection(MotionEffect):
    """The inner axis passes the middle one at d along their common normal, and the outer one at e along the middle one.

    d and e add Ω×(Ω×r) + Ω̇×r with the turning of the middle axis, r = d·(z × n) + e·z in its frame.
    """

    name = "middle_axis_intersection"
    stage, order = Stage.TABLE, Order.AXIS
    per = ("table",)
    needs = ("middle_angle",)
    confused_with = "lever_arm, where the inner axis is not turned"
    reference = "IEEE Std 1293, intersection of the axes of multi-axis tables; 10 … 500 µm"
    distance: Scalar = parameter(
        "um", "normal(0, 100 um)", (10, 1000), "the distance of the axes along z × n", "intersection"
    )
    along: Scalar = parameter(
        "um", "normal(0, 100 um)", (10, 1000), "the distance of inner and outer axis along the middle one",
        "intersection",
    )  # fmt: skip

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        zero = jnp.zeros_like(self.along)
        arm = self.distance * _normal(_axes(motion).link[_MIDDLE]) + vector3(zero, zero, self.along)
        return _moved(motion, _MIDDLE, arm)


class PlatformTilt(MotionEffect):
    """Tilt of the platform of a centrifuge, whose axis is nominally parallel to the arm's: C · exp([x, y, 0]×).

    x and y are about the platform's axes at angle 0.  Between axes that are not parallel squareness and zeros say the
    same, and the tilt is 0.
    """

    name = "platform_tilt"
    stage, order = Stage.TABLE, Order.AXIS
    per = ("table",)
    needs = ("outer_angle",)
    confused_with = "mounting error, where the platform is not turned"
    reference = "IEEE Std 836, alignment of the counter-rotating platform; 1 … 60 arcsec"
    x: Scalar = parameter("arcsec", "normal(0, 20 arcsec)", (1, 60), "the tilt about platform x", "squareness")
    y: Scalar = parameter("arcsec", "normal(0, 20 arcsec)", (1, 60), "the tilt about platform y", "squareness")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        link = _axes(motion).link[_OUTER]
        parallel = jnp.where(jnp.sum(_normal(link) ** 2) > 0.5, 0.0, 1.0)
        tilt = exponential(parallel * vector3(self.x, self.y, jnp.zeros_like(self.x)))
        return _relinked(motion, _OUTER, compose(link, tilt))


class ArmError(MotionEffect):
    """True radius of a centrifuge R = R₀ + δ + s·Ω²R₀: its error at rest, and its stretch with the centripetal load.

    100 µm of 1 m are 100 ppm of the centripetal acceleration.
    """

    name = "arm_error"
    stage, order = Stage.TABLE, Order.AXIS
    per = ("table",)
    needs = ("outer_angle",)
    confused_with = (
        "the radius: exactly with the scale factor of accelerometers where the centrifuge is their only input; the "
        "stretch: with K_oq, and with K2 where the input axis points one way only"
    )
    reference = "IEEE Std 836, radius and stretch of the arm; 1 … 500 µm, 0.1 … 20 µm/g"
    radius: Scalar = parameter("um", "normal(0, 100 um)", (1, 500), "the error of the radius at rest", "arm")
    stretch: Scalar = parameter("um/g", "normal(0, 5 um/g)", (0.1, 20), "the growth of the radius per g")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        axes = _axes(motion)
        arm = axes.arm[_OUTER]
        square = jnp.sum(arm * arm)
        there = square > 0
        length = jnp.sqrt(jnp.where(there, square, 1.0))
        longer = self.radius + self.stretch * axes.rate[_OUTER] ** 2 * length
        return _moved(motion, _OUTER, jnp.where(there, longer / length, 0.0) * arm)

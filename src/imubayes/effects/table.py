"""Effects of the table and the site: axes, angle, rate and timing of tables and centrifuges; local gravity.

A rotary table errs in its axis, angle, rate and timing.  Tables of several axes and centrifuges add the zero,
squareness and intersection of their axes, and the arm.
"""

from dataclasses import replace
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from imubayes.effects.base import MotionEffect, Order, Stage
from imubayes.foundations.arrays import Matrix3, Scalar, Vector3, compose, exponential, vector3
from imubayes.foundations.covariates import HIGHER_DERIVATIVES
from imubayes.foundations.signal_path_state import Ambient, Motion, OuterAxes
from imubayes.parameters.declarations import GRAVITY_ERROR, parameter

_OUTER, _MIDDLE = 0, 1
_HIGHER = tuple(f"table_angle_d{order}" for order in HIGHER_DERIVATIVES)
# The common normal of axes closer to parallel than this has no direction.  Numerical.
_PARALLEL = 1e-3


class TableEffect(MotionEffect):
    """An effect of the table's own motion."""

    stage = Stage.TABLE
    per = ("table",)


class OuterAxisEffect(TableEffect):
    """An effect of one of the axes outside the inner one, by its place in `OuterAxes`."""

    order = Order.AXIS
    needs = ("outer_angle",)
    place: ClassVar[int] = _OUTER

    def link(self, motion: Motion) -> Matrix3:
        """Return the rotation from this axis to the next one."""
        return _axes(motion).link[self.place]

    def normal(self, motion: Motion) -> Vector3:
        """Return the unit normal z × n of this axis and the next one, n; 0 if they are parallel."""
        link = self.link(motion)
        normal = vector3(-link[1, 2], link[0, 2], jnp.zeros_like(link[0, 2]))
        square = jnp.sum(normal * normal)
        apart = square > _PARALLEL**2
        return jnp.where(apart, normal / jnp.sqrt(jnp.where(apart, square, 1.0)), 0.0)

    def relinked(self, motion: Motion, link: Matrix3) -> Motion:
        """Return the motion with another rotation from this axis to the next one."""
        axes = _axes(motion)
        return replace(motion, outer=replace(axes, link=jnp.asarray(axes.link).at[self.place].set(link)))

    def moved(self, motion: Motion, arm: Vector3) -> Motion:
        """Return the motion with an arm from this axis to the next one that is longer by a vector."""
        axes = _axes(motion)
        return replace(motion, outer=replace(axes, arm=jnp.asarray(axes.arm).at[self.place].add(arm)))


def _axes(motion: Motion) -> OuterAxes:
    assert motion.outer is not None
    return motion.outer


def _zero_of(axis: str) -> Any:
    return parameter("arcsec", "normal(0, 30 arcsec)", (1, 60), f"the error of the {axis} axis' zero", "zero")


class AxisAngleZero(OuterAxisEffect):
    """True angle of an axis = φ + δ."""

    order = Order.ANGLE
    reference = "IEEE Std 1293, angle reference of multi-axis tables; 1 … 60 arcsec"
    zero: eqx.AbstractVar[Scalar]

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        axes = _axes(motion)
        return replace(motion, outer=replace(axes, angle=jnp.asarray(axes.angle).at[self.place].add(self.zero)))


class OuterAxisZero(AxisAngleZero):
    """True angle of the outer axis = φ_o + δ."""

    name = "outer_axis_zero"
    confused_with = "the azimuth of the table: about a vertical outer axis only the Earth rate shows it"
    zero: Scalar = _zero_of("outer")


class MiddleAxisZero(AxisAngleZero):
    """True angle of the middle axis = φ_m + δ."""

    name = "middle_axis_zero"
    place = _MIDDLE
    needs = ("middle_angle",)
    confused_with = "mounting error if the inner axis is never turned; table_axis_tilt if the outer is not"
    zero: Scalar = _zero_of("middle")


class InnerAxisZero(AxisAngleZero):
    """True angle of the inner axis = φ + δ: the only axis of a one-axis table, or the platform of a centrifuge."""

    name = "inner_axis_zero"
    needs = ("table_angle",)
    confused_with = "mounting error about the inner axis (exactly, in one mounting)"
    zero: Scalar = _zero_of("inner")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return replace(motion, table_angle=motion.table_angle + self.zero)


class AxisSquareness(OuterAxisEffect):
    """The angle between an axis and the next one is the nominal one + ε, by a turn about their common normal."""

    reference = "IEEE Std 1293, orthogonality of the axes of multi-axis tables; 0.5 … 30 arcsec"
    angle: Scalar = parameter(
        "arcsec", "normal(0, 10 arcsec)", (0.5, 30), "the excess of the angle between the axes", "squareness"
    )

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return self.relinked(motion, compose(exponential(self.angle * self.normal(motion)), self.link(motion)))


class OuterAxisSquareness(AxisSquareness):
    """The angle between the outer and the next axis is the nominal one + ε, by a turn about their common normal."""

    name = "outer_axis_squareness"
    confused_with = "table_axis_tilt if the outer axis is not turned"


class MiddleAxisSquareness(AxisSquareness):
    """The angle between the middle and the inner axis is the nominal one + ε, by a turn about their common normal."""

    name = "middle_axis_squareness"
    place = _MIDDLE
    needs = ("middle_angle",)
    confused_with = "mounting error if the inner axis is not turned; outer_axis_squareness if the middle is not"


class OuterAxisIntersection(OuterAxisEffect):
    """The next axis passes the outer one at d along their common normal: d adds Ω×(Ω×d) + dΩ/dt×d, turning with it.

    10 µm at 100 °/s are 3 µg.
    """

    name = "outer_axis_intersection"
    confused_with = "lever_arm if the next axis is not turned"
    reference = "IEEE Std 1293, intersection of the axes of multi-axis tables; 10 … 500 µm"
    distance: Scalar = parameter(
        "um", "normal(0, 100 um)", (10, 1000), "the distance of the axes along z × n", "intersection"
    )

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        return self.moved(motion, self.distance * self.normal(motion))


class MiddleAxisIntersection(OuterAxisIntersection):
    """The inner axis passes the middle one at d along their common normal, and the outer one at e along the middle one.

    d and e add Ω×(Ω×r) + dΩ/dt×r with the turning of the middle axis, r = d·(z × n) + e·z in its frame.
    """

    name = "middle_axis_intersection"
    place = _MIDDLE
    needs = ("middle_angle",)
    confused_with = "lever_arm if the inner axis is not turned"
    along: Scalar = parameter(
        "um", "normal(0, 100 um)", (10, 1000), "the distance of inner and outer axis along the middle one",
        "intersection",
    )  # fmt: skip

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        zero = jnp.zeros_like(self.along)
        return self.moved(motion, self.distance * self.normal(motion) + vector3(zero, zero, self.along))


class PlatformTilt(OuterAxisEffect):
    """Tilt of the platform of a centrifuge, whose axis is nominally parallel to the arm's: C · exp([x, y, 0]×).

    x and y are about the platform's axes at angle 0.  If the two axes are not parallel, squareness and zeros describe
    the same error, and the tilt is 0.
    """

    name = "platform_tilt"
    confused_with = "mounting error if the platform is not turned"
    reference = "IEEE Std 836, alignment of the counter-rotating platform; 1 … 60 arcsec"
    x: Scalar = parameter("arcsec", "normal(0, 20 arcsec)", (1, 60), "the tilt about platform x", "squareness")
    y: Scalar = parameter("arcsec", "normal(0, 20 arcsec)", (1, 60), "the tilt about platform y", "squareness")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        parallel = jnp.where(jnp.sum(self.normal(motion) ** 2) > 0.5, 0.0, 1.0)
        tilt = exponential(parallel * vector3(self.x, self.y, jnp.zeros_like(self.x)))
        return self.relinked(motion, compose(self.link(motion), tilt))


class ArmError(OuterAxisEffect):
    """True radius of a centrifuge R = R₀ + δ + s·Ω²R₀: its error at rest, and its stretch with the centripetal load.

    100 µm of 1 m are 100 ppm of the centripetal acceleration.
    """

    name = "arm_error"
    confused_with = (
        "of the radius, the scale factor of accelerometers (exactly, if the centrifuge is their only input); of the "
        "stretch, K_oq, and K2 if the input axis points one way only"
    )
    reference = "IEEE Std 836, radius and stretch of the arm; 1 … 500 µm, 0.1 … 20 µm/g"
    radius: Scalar = parameter("um", "normal(0, 100 um)", (1, 500), "the error of the radius at rest", "arm")
    stretch: Scalar = parameter("um/g", "normal(0, 5 um/g)", (0.1, 20), "the growth of the radius per g")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        axes = _axes(motion)
        arm = axes.arm[self.place]
        square = jnp.sum(arm * arm)
        there = square > 0
        length = jnp.sqrt(jnp.where(there, square, 1.0))
        longer = self.radius + self.stretch * axes.rate[self.place] ** 2 * length
        return self.moved(motion, jnp.where(there, longer / length, 0.0) * arm)


class TableAxisTilt(MotionEffect):
    """Small rotation of the whole table about its own x and y: C_nt0 = nominal C_nt0 · exp([x, y, 0]×).

    A table of several axes has that of its outer axis, relative to the vertical and north.
    """

    name = "table_axis_tilt"
    stage = Stage.STAND
    per = ("table",)
    confused_with = "g-sensitivity of gyros; accelerometer misalignment if few mountings are tested"
    reference = "IEEE Std 1293, axis of rotation levelling error"
    x: Scalar = parameter("arcsec", "normal(0, 60 arcsec)", (1, 120), "the tilt about table x", "axis_x")
    y: Scalar = parameter("arcsec", "normal(0, 60 arcsec)", (1, 120), "the tilt about table y", "axis_y")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        tilt = exponential(vector3(self.x, self.y, jnp.zeros_like(self.x)))
        return replace(motion, base=compose(motion.base, tilt))


class GravityAnomaly(MotionEffect):
    """True gravity = stated gravity + δg, along the vertical.

    Normal gravity of WGS 84 typically errs by 10 µg, in mountains by 300 µg; a measured value needs no anomaly.
    """

    name = "gravity_anomaly"
    stage = Stage.STAND
    per = ()
    confused_with = "a scale factor common to all accelerometers (exactly, if gravity is the only input)"
    reference = "Hofmann-Wellenhof and Moritz, Physical Geodesy, gravity anomalies; 1 … 300 µg"
    anomaly: Scalar = parameter(
        "ug", "normal(0, 50 ug)", (1, 300), "the excess of true over stated gravity", "gravity", domain=GRAVITY_ERROR
    )

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        zero = jnp.zeros_like(self.anomaly)
        return replace(motion, gravity=motion.gravity + vector3(zero, zero, self.anomaly))


def _taylor(derivatives: list[Scalar], step: Scalar) -> Scalar:
    """Return the value a step further of a polynomial with these derivatives, from the zeroth on."""
    found = derivatives[-1]
    for order in range(len(derivatives) - 1, 0, -1):
        found = derivatives[order - 1] + found * step / order
    return found


class TimeSkew(TableEffect):
    """True angle = φ + Ω·δ + ½ dΩ/dt·δ² + …, of every axis, true rate its slope: the unit is sampled δ after the table.

    At a constant rate over whole turns it has no effect; rotating rows of known angle or a changing rate determine it.
    In rows that follow the angle of the table the series goes to the eighth power, beyond the row itself: up to a fifth
    of its length it is exact to 1e-5.
    """

    name = "time_skew"
    order = Order.TIME
    confused_with = "an error of the table's angle if all runs rotate at one rate in one direction"
    reference = "first-order clock offset between table and unit; 0.01 … 50 ms"
    skew: Scalar = parameter("ms", "normal(0, 5 ms)", (0.01, 100), "the delay of the unit's samples")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        rate, acceleration, outer = motion.table_rate, motion.table_acceleration, motion.outer
        if outer is not None:
            angle = outer.angle + outer.rate * self.skew + 0.5 * outer.acceleration * self.skew**2
            outer = replace(outer, angle=angle, rate=outer.rate + outer.acceleration * self.skew)
        derivatives = [motion.table_angle, rate, acceleration, *(getattr(ambient, name) for name in _HIGHER)]
        return replace(
            motion,
            outer=outer,
            table_angle=_taylor(derivatives, self.skew),
            table_rate=_taylor(derivatives[1:], self.skew),
            table_acceleration=_taylor(derivatives[2:], self.skew),
            reference_rate=motion.reference_rate + motion.reference_acceleration * self.skew,
        )


class EncoderHarmonic(TableEffect):
    """True angle = φ + Σ_n (s_n sin nφ + c_n cos nφ), n = 1, 2: eccentricity and ellipticity of the graduation.

    The indicated rate comes from the same encoder and has the error's slope, which averages to zero over whole turns.
    """

    name = "encoder_harmonic"
    order = Order.ANGLE
    needs = ("table_angle",)
    confused_with = "misalignment and bias (n = 1), K2 and cross-coupling (n = 2) of accelerometers in one mounting"
    reference = "IEEE Std 1293, dividing head angle errors; 0.1 … 10 arcsec"
    sin_1: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 60), "the sine of one period per turn")
    cos_1: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 60), "the cosine of one period per turn")
    sin_2: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 60), "the sine of two periods per turn")
    cos_2: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 60), "the cosine of two periods per turn")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        one, two = motion.table_angle, 2 * motion.table_angle
        first = self.sin_1 * jnp.sin(one) + self.cos_1 * jnp.cos(one)
        second = self.sin_2 * jnp.sin(two) + self.cos_2 * jnp.cos(two)
        first_slope = self.sin_1 * jnp.cos(one) - self.cos_1 * jnp.sin(one)
        second_slope = 2 * (self.sin_2 * jnp.cos(two) - self.cos_2 * jnp.sin(two))
        return replace(
            motion,
            table_angle=motion.table_angle + first + second,
            table_rate=motion.table_rate * (1 + first_slope + second_slope),
        )


class TableRateError(TableEffect):
    """Actual rate = indicated rate · (1 + e), of every axis: an error of the clock that they share."""

    name = "table_rate_error"
    confused_with = "a scale factor common to all gyros (exactly, unless a reference gyro is mounted beside the unit)"
    reference = "IEEE Std 952, rate table accuracy"
    rate_error: Scalar = parameter("ppm", "normal(0, 10 ppm)", (1, 50), "the relative error of the rate", "rate")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        factor, outer = 1 + self.rate_error, motion.outer
        if outer is not None:
            outer = replace(outer, rate=outer.rate * factor, acceleration=outer.acceleration * factor)
        return replace(
            motion,
            outer=outer,
            table_rate=motion.table_rate * factor,
            table_acceleration=motion.table_acceleration * factor,
        )


class TableWobble(TableEffect):
    """C_nt = C_nt0 · W(φ) · Rz(φ), W = exp([x, y, 0]×), x = Σ_n (x_cos_n cos nφ + x_sin_n sin nφ), y alike, n = 1, 2.

    x and y are about the table's axes at angle 0.  Wobble that rotates with the table (x_cos_1 = y_sin_1,
    x_sin_1 = −y_cos_1) is equivalent to a mounting error.  The angular rate of the wobble itself, 1 arcsec
    times the table's rate, is neglected.
    """

    name = "table_wobble"
    order = Order.AXIS
    needs = ("table_angle",)
    confused_with = "mounting error if it rotates with the table; table_axis_tilt if few angles are used"
    reference = "IEEE Std 1293, axis wobble of rotary tables; 0.1 … 10 arcsec"
    x_cos_1: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about x with cos φ")
    x_sin_1: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about x with sin φ")
    y_cos_1: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about y with cos φ")
    y_sin_1: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about y with sin φ")
    x_cos_2: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about x with cos 2φ")
    x_sin_2: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about x with sin 2φ")
    y_cos_2: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about y with cos 2φ")
    y_sin_2: Scalar = parameter("arcsec", "normal(0, 5 arcsec)", (0.1, 30), "the tilt about y with sin 2φ")

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        one, two = motion.table_angle, 2 * motion.table_angle
        cos_1, sin_1, cos_2, sin_2 = jnp.cos(one), jnp.sin(one), jnp.cos(two), jnp.sin(two)
        x = self.x_cos_1 * cos_1 + self.x_sin_1 * sin_1 + self.x_cos_2 * cos_2 + self.x_sin_2 * sin_2
        y = self.y_cos_1 * cos_1 + self.y_sin_1 * sin_1 + self.y_cos_2 * cos_2 + self.y_sin_2 * sin_2
        wobble, outer = exponential(vector3(x, y, jnp.zeros_like(x))), motion.outer
        if outer is None:
            return replace(motion, base=compose(motion.base, wobble))
        # Of several axes it is the inner one that wobbles.
        return replace(
            motion, outer=replace(outer, link=jnp.asarray(outer.link).at[1].set(compose(outer.link[1], wobble)))
        )

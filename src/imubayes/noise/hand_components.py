"""The noise of a unit that nobody put on a table: what its gyros wander from pose to pose, what carries it accelerates.

Rows in motion are windows of a unit that its own gyros follow.
"""

import jax.numpy as jnp

from imubayes.foundations.arrays import Scalar, Scalars
from imubayes.noise.components import Entry, EntryNoise, RowSpan, SlowNoise, StateCovariance
from imubayes.parameters.declarations import parameter


class RotationClosure(EntryNoise):
    """Variance σ² of each component of the closing rotation of a free tumble: angle random walk, bandwidth, timing.

    The closing rotation is the difference between the attitude of a pose and the attitude that the gyros propagate to
    it from the pose before.
    """

    name = "rotation_closure"
    per = ("run",)
    needs = ("posed",)
    kinds = ("closure",)
    nuisance = True
    reference = "definition; Tedaldi et al., ICRA 2014, eq. (16) takes it as equal for all transitions"

    sigma: Scalar = parameter(
        "arcsec", "lognormal(0.05 deg, 1.5)", (1, 3600), "the standard deviation of the closing rotation"
    )

    def variance(self, entry: Entry) -> Scalars:
        return self.sigma**2


class CarriedClosure(EntryNoise):
    """Variance σ² of each component of the closing rotation of a unit in motion, from pose to pose.

    It is that of `rotation_closure`, over stretches of equal length, in all runs alike: few of them are in one run.
    """

    name = "carried_closure"
    per = ()
    needs = ("carried",)
    kinds = ("closure",)
    nuisance = True
    reference = "definition; IEEE Std 952, angle random walk over about ten seconds"

    sigma: Scalar = parameter(
        "arcsec", "lognormal(0.03 deg, 1)", (1, 3600), "the standard deviation of the closing rotation"
    )

    def variance(self, entry: Entry) -> Scalars:
        return self.sigma**2


class HandAcceleration(EntryNoise):
    """Acceleration of the hand, the drill or the wheel that carries the unit: variance σ² of a row in motion.

    It is stated as a specific force, whatever the number of samples: its mean over a row does not depend on the
    sampling rate.
    """

    name = "hand_acceleration"
    per = ()
    needs = ("hand",)
    kinds = ("accelerometer",)
    of_motion = True
    confused_with = "white_noise if no other run determines it"
    reference = "definition; specific force is that of gravity and of the motion"

    sigma: Scalar = parameter(
        "output", "lognormal(0.003 scale, 1.5)", (1e-9, 0.1), "the standard deviation of a row in motion"
    )

    def variance(self, entry: Entry) -> Scalars:
        return self.sigma**2


class HandVelocity(SlowNoise):
    """Mean acceleration (v₂ − v₁)/T of a row of T s, of a velocity with autocovariance v² e^(−t/τ) (cos t/τ − sin t/τ).

    The mean acceleration of a hand, a drill or a wheel over a row is the change of its velocity over T.  The hand is
    bounded in velocity and in position: it moves as a damped oscillator that is driven at random (damping ratio 1/√2).
    Its acceleration has hardly any power at the slow rates at which the unit turns.  Velocities that are independent
    from row to row, the limit of τ ≪ T, overstate this power: rows that resolve a stroke of the hand have errors that
    are opposite two rows later, not in the next one.  The covariance is that of each channel by itself, on average over
    the attitudes; the remainder due to the rotation of the body is `hand_acceleration`.
    """

    name = "hand_velocity"
    per = ()
    needs = ("carried",)
    kinds = ("accelerometer",)
    of_motion = True
    excludes = ("correlated_noise", "outliers")
    confused_with = "hand_acceleration if velocities last longer than a row"
    reference = (
        "kinematics: the mean of a derivative; damped oscillator: Foreman-Mackey et al., Astron. J. 154 (2017), 220"
    )

    v: Scalar = parameter(
        "output", "lognormal(0.005 scale, 1.5)", (1e-9, 0.1), "the standard deviation of the velocity, times 1 s"
    )
    time: Scalar = parameter("s", "lognormal(0.4 s, 1)", (0.05, 5), "the correlation time τ of the velocity")

    def states(self, row: RowSpan) -> StateCovariance:
        """Return the covariance by two states, real and imaginary part: R(t) = Re[v² (1 − i) exp(−(1 + i) t/τ)]."""
        x, begin, end = row.length / self.time, row.start / self.time, (row.start + row.length) / self.time
        kept = jnp.exp(-x)
        gone, turned = 1 - kept * jnp.cos(x), kept * jnp.sin(x)  # of 1 − exp(−(1 + i) x)
        size, follows = self.v**2 / row.length, jnp.isfinite(row.gap)
        over_gap = jnp.where(follows, jnp.exp(-jnp.where(follows, row.gap, 0.0) / self.time), 0.0)
        cosine, sine = jnp.cos(begin), jnp.sin(begin)
        mean = jnp.stack([-gone * cosine - turned * sine, turned * cosine - gone * sine]) / row.length
        along, across, cosine, sine = gone + turned, turned - gone, jnp.cos(end), jnp.sin(end)
        return StateCovariance(
            2 * size * along / row.length,
            mean,
            size * jnp.stack([along * cosine - across * sine, along * sine + across * cosine]),
            over_gap * jnp.ones(2),
            kept * jnp.ones(2),
        )

"""The noise of a unit that nobody put on a table: what its gyros wander from pose to pose, what carries it accelerates.

Rows in motion are windows of a unit that its own gyros follow.
"""

from imubayes.foundations.arrays import Scalar, Scalars
from imubayes.noise.components import Entry, EntryNoise, RowSpan, SlowNoise, StateCovariance, of_shared_ends
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
    """Variance 2 v²/T² of a row of T s in motion, covariance −v²/(T₁T₂) of rows that follow one another.

    The mean acceleration of a hand, a drill or a wheel over a row is the change of its velocity over T. The velocities
    at the ends of rows have the standard deviation v, so that the errors of successive rows are opposite. This holds in
    body axes as well, because successive rows share the velocity between them; the remainder due to the rotation of the
    body is `hand_acceleration`.
    """

    name = "hand_velocity"
    per = ()
    needs = ("carried",)
    kinds = ("accelerometer",)
    of_motion = True
    excludes = ("correlated_noise", "outliers")
    confused_with = "hand_acceleration if velocities last longer than a row"
    reference = "kinematics: the mean of a derivative; spectrum of IEEE Std 952, annex C, quantization noise"

    v: Scalar = parameter(
        "output", "lognormal(0.005 scale, 1.5)", (1e-9, 0.1), "the standard deviation of the velocity, times 1 s"
    )

    def states(self, row: RowSpan) -> StateCovariance:
        return of_shared_ends(self.v, row)

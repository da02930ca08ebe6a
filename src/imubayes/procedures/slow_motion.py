"""Slow motion: a unit that is waved through all attitudes and never rests.

Every window of the log is a weak pose: the mean force is gravity plus the acceleration of the hand. The gyros carry the
attitude from window to window, so that gravity is known to be the same vector in all of them, and not only of the same
magnitude. This determines biases, scale factors and misalignments of accelerometers and gyros. The acceleration of the
hand is noise (`hand_acceleration`, `hand_velocity`): it is estimated, and stated with the result.

Accelerometers alone are calibrated by |f| = g: each window is a pose of unknown attitude, and the acceleration of the
hand is the scatter of |f|.

The textbook estimate is that of a multi-position test, an ellipsoid fitted to |f| = g, which neglects the acceleration
of the hand.
"""

from collections.abc import Sequence
from dataclasses import replace

from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.carried import carried_stimulus, pose_stimulus
from imubayes.procedures.kinematics import CarriedNodes, Stimulus
from imubayes.procedures.magnitude_estimate import of_accelerometers
from imubayes.procedures.textbook import TextbookResult


def ellipsoid_fit(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return scale factors and biases of the accelerometers by |f| = g in each window, run by run."""
    return [result for run in runs for result in of_accelerometers(run, campaign)]


def _stimulus(run: Run, campaign: Campaign) -> Stimulus:
    """Return windows that the gyros carry, or, without gyros, poses of a unit that a hand accelerates."""
    if run.tumble is None or run.tumble.carried:
        return carried_stimulus(run, campaign)
    return replace(pose_stimulus(run, campaign), hand=CarriedNodes.none(run.rows))


SLOW_MOTION = Procedure(
    name="slow_motion",
    reference="Groves, Principles of GNSS, Inertial and Multisensor Navigation, § 5.6.1; Skog and Händel, IMEKO 2006",
    columns=(("time_s",),),
    reduction=Reduction.CARRIED,
    abscissae=("time", "row"),
    row_name="window",
    without_gyros=True,
    kinematics=_stimulus,
    evaluate=ellipsoid_fit,
)

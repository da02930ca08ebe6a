"""Free tumble: static poses of unknown attitude, with the gyros integrated between them (P10).

In each pose |f| = g, which determines the accelerometers.  The rotation integrated from the gyros between two poses
must map the first attitude to the second, which determines gyro scale factors and misalignments.  A pose is a mounting
of unknown rotation: its three angles are parameters (`pose_attitude`).

Source: Tedaldi, Pretto, Menegatti, "A robust and easy to implement method for IMU calibration without external
equipments", ICRA 2014.
"""

import numpy as np

from imubayes.campaign_data import Campaign, Run
from imubayes.errors import input_error
from imubayes.procedures.ambient import ambient_of
from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.nominal_stimulus import Stimulus


def _stimulus(run: Run, campaign: Campaign) -> Stimulus:
    if run.tumble is None:
        raise input_error(
            "the free tumble has no rotations between its poses",
            f"run '{run.name}'",
            "a raw log of all channels with time_s",
            "give the raw log, not means; the poses are found in it",
        )
    rows = np.arange(run.rows)
    zero = np.zeros(run.rows)
    return Stimulus(
        row=rows,
        weight=np.ones(run.rows),
        base=np.broadcast_to(np.eye(3), (run.rows, 3, 3)),
        mounting=run.tumble.attitude[run.tumble.pose],
        table_angle=zero,
        table_rate=zero,
        table_acceleration=zero,
        reference_rate=np.zeros((run.rows, 3)),
        reference_acceleration=np.zeros((run.rows, 3)),
        ambient=ambient_of(run, rows, campaign),
        injected=False,
        pose=run.tumble.pose,
    )


FREE_TUMBLE = Procedure(
    name="free_tumble",
    reference="Tedaldi et al., ICRA 2014",
    columns=(("time_s",),),
    reduction=Reduction.POSES,
    abscissae=("row",),
    row_name="pose",
    kinematics=_stimulus,
)

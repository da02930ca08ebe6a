"""Free tumble: static poses of unknown attitude, with the gyros integrated between them (P10).

In each pose |f| = g, which determines the accelerometers.  The rotation integrated from the gyros between two poses
must map the first attitude to the second, which determines gyro scale factors and misalignments.  A pose is a mounting
of unknown rotation: its three angles are parameters (`pose_attitude`).

Source: Tedaldi, Pretto, Menegatti, "A robust and easy to implement method for IMU calibration without external
equipments", ICRA 2014.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.procedures.base import PlannedRows, PlannedSteps, PlanRules, Procedure, Reduction
from imubayes.procedures.carried import pose_stimulus
from imubayes.procedures.kinematics import Stimulus, rotation_matrices, table_stimulus
from imubayes.procedures.magnitude_estimate import of_accelerometers
from imubayes.procedures.textbook import DEGREE_PER_HOUR, Evaluation, TextbookResult, measured

_SAMPLING, _FIRST_REST, _REST, _MOVE = 100.0, 15.0, 4.0, 2.0  # Hz and s
_AXES = ("reference_x", "reference_y", "reference_z")


def _planned_rows(steps: PlannedSteps) -> PlannedRows:
    """Return raw samples of a unit that rests in poses spread over the sphere and is turned from one to the next."""
    poses = steps.poses or 1
    generator = np.random.default_rng(poses)
    attitude = [np.eye(3)]
    blocks, rates = [np.repeat(attitude[0][None], round(_FIRST_REST * _SAMPLING), axis=0)], []
    rates.append(np.zeros((len(blocks[0]), 3)))
    share = (np.arange(round(_MOVE * _SAMPLING)) + 0.5) / round(_MOVE * _SAMPLING)
    # The smoothest course from rest to rest: third derivative of least mean square.
    course, speed = 10 * share**3 - 15 * share**4 + 6 * share**5, 30 * share**2 * (1 - share) ** 2 / _MOVE
    for _ in range(poses - 1):
        axis = generator.normal(size=3)
        turn = generator.uniform(np.pi / 3, np.pi) * axis / np.linalg.norm(axis)
        moving = attitude[-1] @ rotation_matrices(course[:, None] * turn)
        attitude.append(attitude[-1] @ rotation_matrices(turn[None])[0])
        blocks += [moving, np.repeat(attitude[-1][None], round(_REST * _SAMPLING), axis=0)]
        rates += [speed[:, None] * turn, np.zeros((len(blocks[-1]), 3))]
    rate = np.degrees(np.concatenate(rates))
    motion = {f"{name}_deg_s": rate[:, place] for place, name in enumerate(_AXES)}
    return PlannedRows(np.full(len(rate), 1 / _SAMPLING), {}, np.concatenate(blocks), motion, sampled=True)


def _in_motion(run: Run, campaign: Campaign) -> Stimulus:
    """Return the stimulus of a planned tumble, whose motion is known at every sample."""
    assert run.attitude is not None
    still = table_stimulus(run, campaign)
    rate = np.stack([run.covariates[name] for name in _AXES], axis=1)
    zero = np.zeros_like(still.table_angle)
    return replace(still, base=run.attitude[still.row], table_angle=zero, reference_rate=rate[still.row])


def _stimulus(run: Run, campaign: Campaign) -> Stimulus:
    if run.attitude is not None:
        return _in_motion(run, campaign)
    return pose_stimulus(run, campaign)


def tumble_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return scale factors and biases of the accelerometers by |f| = g in each pose, and the gyros' mean at rest.

    Least squares of |u| − g over the poses, u = L⁻¹((r − K0)/(1 + ε)) the force along the nominal input axes, which are
    taken as orthogonal.  L is lower triangular with rows of length 1; the identity if the poses do not determine it, as
    faces do not.
    Source: Skog and Händel, "Calibration of a MEMS inertial measurement unit", IMEKO 2006; of six faces that is
    K0 = (r₊ + r₋)/2 and 1 + ε = (r₊ − r₋)/2g.
    """
    found: list[TextbookResult] = []
    for run in runs:
        found += of_accelerometers(run, campaign)
        for channel, output in measured(run, campaign, "gyro"):
            rate = output / channel.scale_si / DEGREE_PER_HOUR
            sd = float(np.std(rate, ddof=1) / np.sqrt(len(rate))) if len(rate) > 1 else float("nan")
            of = Evaluation(channel.name, run.name, "mean at rest, the Earth rate of 15 deg/h neglected")
            found.append(
                of.estimate("gyro_bias.bias", np.mean(rate), sd, "deg/h", uncertainty="type A: means of poses")
            )
    return found


FREE_TUMBLE = Procedure(
    name="free_tumble",
    reference="Tedaldi et al., ICRA 2014",
    columns=(("time_s",),),
    reduction=Reduction.POSES,
    abscissae=("row",),
    row_name="pose",
    plan=PlanRules(("poses",), (), 0.0, _planned_rows),
    kinematics=_stimulus,
    evaluate=tumble_test,
)

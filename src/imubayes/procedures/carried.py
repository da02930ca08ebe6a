"""A unit in motion that its own gyros follow: its stimulus, windows between poses, and which motion they can follow.

The nominal motion is that of the nominal gyros: it shows which effects a run can show.  The model replaces it by the
motion that its own coefficients of the gyros give (`imubayes.model.carried_motion`).
"""

from dataclasses import replace

import numpy as np

from imubayes.foundations.body_axes import body_vector
from imubayes.foundations.campaign_data import Campaign, Run, Tumble
from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import running_products
from imubayes.procedures.kinematics import CarriedNodes, Stimulus, at_rest, rotation_matrices

LEAST_SECONDS = 5.0
"""Least seconds of motion in a log."""
STEP_ANGLE = 0.2
"""Largest rotation, rad, from one instant of known attitude to the next."""
ONE_AXIS = 0.95
"""Share of the mean square rate along one axis of the body from which a unit turns about it."""


def about_one_axis(rate: np.ndarray) -> bool:
    """Return whether a unit turns about one axis of its body, by its rates (N, 3), and keeps turning."""
    squares = np.linalg.eigvalsh(rate.T @ rate / len(rate))
    return bool(squares[-1] > ONE_AXIS * squares.sum())


def fastest_rate(interval: float) -> float:
    """Return the largest rate, rad/s, that samples at an interval, s, can follow."""
    return STEP_ANGLE / interval


def carried_stimulus(run: Run, campaign: Campaign) -> Stimulus:
    """Return the stimulus of a run in motion, at the ends of the steps of its windows.

    Raises
    ------
    InputError
        if the run is no reduced log.
    """
    tumble = run.tumble
    if tumble is None or not tumble.carried:
        raise input_error(
            f"run '{run.name}' of {run.procedure} has no motion between its windows",
            f"run '{run.name}'",
            "a raw log of all channels with time_s",
            "give the raw log, not means; the windows are found in it",
        )
    weights = np.split(tumble.carried_weight, np.flatnonzero(np.diff(tumble.carried_row)) + 1)
    pose = tumble.pose[tumble.carried_row]
    still = at_rest(run, campaign, weights, np.eye(3), tumble.attitude[pose])
    return replace(still, pose=pose, hand=_nominal_motion(tumble, campaign), unstated=frozenset({"unknown_heading"}))


def pose_stimulus(run: Run, campaign: Campaign) -> Stimulus:
    """Return the stimulus of a run whose rows are poses of unknown attitude, one node each.

    Raises
    ------
    InputError
        if the run has no poses.
    """
    if run.tumble is None:
        raise input_error(
            f"run '{run.name}' of {run.procedure} has no poses",
            f"run '{run.name}'",
            "a raw log of all channels with time_s",
            "give the raw log; its poses are found in it",
        )
    attitude = run.tumble.attitude[run.tumble.pose]
    return replace(at_rest(run, campaign, [np.ones(1)] * run.rows, np.eye(3), attitude), pose=run.tumble.pose)


def _nominal_motion(tumble: Tumble, campaign: Campaign) -> CarriedNodes:
    """Return the motion of every node since its pose by the nominal gyros."""
    rate = nominal_rates(tumble, campaign)
    turned = _since_start(rate * tumble.step[..., None] + tumble.coning)
    turn, step, back = tumble.carried_turn, tumble.carried_step, tumble.carried_back
    last = np.maximum(np.sum(tumble.step > 0, axis=1) - 1, 0)[turn]
    before, after = np.maximum(step - 1, 0), np.minimum(step, last)
    early, late = rate[turn, before], rate[turn, after]
    apart = 0.5 * (tumble.step[turn, before] + tumble.step[turn, after])
    total = np.concatenate([np.zeros((len(tumble.step), 1)), np.cumsum(tumble.step, axis=1)], axis=1)
    behind = np.einsum("nji,njk->nik", turned[turn, -1], turned[turn, step])
    return CarriedNodes(
        turn=np.where(back[:, None, None], behind, turned[turn, step]),
        elapsed=total[turn, step] - np.where(back, total[turn, -1], 0.0),
        rate=0.5 * (early + late),
        acceleration=np.where(before == after, 0.0, 1 / apart)[:, None] * (late - early),
        carried=np.ones(len(turn)),
        transition=turn,
        step=step,
        back=back,
    )


def nominal_rates(tumble: Tumble, campaign: Campaign) -> np.ndarray:
    """Return the mean rate of every step by the nominal gyros, (T, K, 3), rad/s, body axes."""
    return body_vector(tumble.readings, campaign.channels, "gyro")


def _since_start(vectors: np.ndarray) -> np.ndarray:
    """Return the products of the first 0, 1, … K rotations by vectors (T, K, 3), shape (T, K + 1, 3, 3)."""
    return running_products(rotation_matrices(vectors.reshape(-1, 3)).reshape(*vectors.shape, 3))

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
import scipy  # loads its parts when they are first used

from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.errors import input_error
from imubayes.foundations.units import to_si
from imubayes.procedures.base import PlannedRows, PlannedSteps, PlanRules, Procedure, Reduction
from imubayes.procedures.kinematics import Stimulus, at_rest, table_stimulus
from imubayes.procedures.textbook import DEGREE_PER_HOUR, Evaluation, TextbookResult, Undetermined, measured

_SAMPLING, _FIRST_REST, _REST, _MOVE = 100.0, 15.0, 4.0, 2.0  # Hz and s
_AXES = ("reference_x", "reference_y", "reference_z")
METHOD = "multi-position test, |f| = g"
_DIAGONAL, _ALL = 6, 9  # parameters without and with misalignments
_LEAST_TOLD = 1e-3  # of the best told combination


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


def rotation_matrices(vectors: np.ndarray) -> np.ndarray:
    """Return the rotations by vectors, (n, 3) rad → (n, 3, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=1)
    x, y, z = (vectors / np.where(angle == 0, 1.0, angle)[:, None]).T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    sine, rest = np.sin(angle)[:, None, None], 1 - np.cos(angle)[:, None, None]
    return np.eye(3) + sine * cross + rest * (cross @ cross)


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
    if run.tumble is None:
        raise input_error(
            "the free tumble has no rotations between its poses",
            f"run '{run.name}'",
            "a raw log of all channels with time_s",
            "give the raw log, not means; the poses are found in it",
        )
    attitude = run.tumble.attitude[run.tumble.pose]
    return replace(at_rest(run, campaign, [np.ones(1)] * run.rows, np.eye(3), attitude), pose=run.tumble.pose)


def tumble_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return scale factors and biases of the accelerometers by |f| = g in each pose, and the gyros' mean at rest.

    Least squares of |u| − g over the poses, u = L⁻¹((r − K0)/(1 + ε)) the force along the nominal input axes, which are
    taken as orthogonal.  L is lower triangular with rows of length 1; the identity where the poses do not tell it, as
    faces do not.
    Source: Skog and Händel, "Calibration of a MEMS inertial measurement unit", IMEKO 2006; of six faces that is
    K0 = (r₊ + r₋)/2 and 1 + ε = (r₊ − r₋)/2g.
    """
    found: list[TextbookResult] = []
    for run in runs:
        found += _of_accelerometers(run, campaign)
        for channel, output in measured(run, campaign, "gyro"):
            rate = output / channel.scale_si / DEGREE_PER_HOUR
            sd = float(np.std(rate, ddof=1) / np.sqrt(len(rate))) if len(rate) > 1 else float("nan")
            of = Evaluation(channel.name, run.name, "mean at rest, the Earth rate of 15 deg/h neglected")
            found.append(
                of.estimate("gyro_bias.bias", np.mean(rate), sd, "deg/h", uncertainty="type A: means of poses")
            )
    return found


def _of_accelerometers(run: Run, campaign: Campaign) -> list[TextbookResult]:
    channels = measured(run, campaign, "accelerometer")
    if not channels:
        return []
    names, poses, gravity = ", ".join(c.name for c, _ in channels), run.rows, campaign.site.gravity
    axes = np.array([channel.axes[0] for channel, _ in channels])
    if axes.shape != (3, 3) or np.abs(axes @ axes.T - np.eye(3)).max() > 0.01:
        return [Undetermined(run.name, f"{names}: three accelerometers along orthogonal axes would be evaluated")]
    solved = _solved(np.stack([output / channel.scale_si for channel, output in channels], axis=1), gravity)
    if solved is None:
        what = f"{poses} poses do not determine {_DIAGONAL} parameters; six faces determine scale factor and bias"
        return [Undetermined(run.name, f"{names}: {what}")]
    values, covariance, residual = solved
    count, freedom = len(values), poses - len(values)
    known = _within_poses(run, campaign, [channel for channel, _ in channels])
    variance = max(float(residual @ residual) / freedom, known) if freedom else known or float("nan")
    sd = np.sqrt(variance * np.diag(covariance))
    how = f"{poses} poses, {count} parameters" + ("" if count == _ALL else ", misalignments taken as zero")
    estimates = zip((channel for channel, _ in channels), values[:3], sd[:3], values[3:6], sd[3:6], strict=True)
    return [result for each in estimates for result in _of_channel(run, gravity, how, *each)]


def _solved(reading: np.ndarray, gravity: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the parameters that the poses determine, nine or six, their covariance for unit variance, and |u| − g."""
    for count in (_ALL, _DIAGONAL):
        found = scipy.optimize.least_squares(
            lambda x: _misfit(x, reading, gravity), np.zeros(count), xtol=1e-13, ftol=1e-15, gtol=1e-15
        )
        squares = np.linalg.svd(found.jac / np.maximum(np.linalg.norm(found.jac, axis=0), 1e-300), compute_uv=False)
        enough = len(reading) > count or len(reading) == count == _DIAGONAL
        if enough and squares[-1] > _LEAST_TOLD * squares[0]:
            return found.x, np.linalg.inv(found.jac.T @ found.jac), found.fun
    return None


def _within_poses(run: Run, campaign: Campaign, channels: Sequence[Channel]) -> float:
    """Return the variance of a pose mean by the scatter within poses, in g²: few residuals may vanish by chance."""
    places = [campaign.channels.index(channel) for channel in channels]
    sd = run.sample_sd[:, places] / [channel.scale_si * campaign.site.gravity for channel in channels]
    return float(np.nanmean(sd**2 / run.samples[:, None])) if np.isfinite(sd).any() else 0.0


def _of_channel(
    run: Run, gravity: float, how: str, channel: Channel, error: float, error_sd: float, bias: float, bias_sd: float
) -> list[TextbookResult]:
    per, unit = channel.scale_si * to_si(channel.per, gravity), f"{channel.output_unit} per {channel.per}"
    of = Evaluation(channel.name, run.name, METHOD, f"type A: residuals of |f| or scatter within poses, {how}")
    return [
        of.estimate("scale_factor", (1 + error) * per, error_sd * abs(per), unit, how),
        of.estimate("accel_bias.bias", 1e6 * bias, 1e6 * bias_sd, "ug", how),
    ]


def _misfit(values: np.ndarray, reading: np.ndarray, gravity: float) -> np.ndarray:
    """Return |u| − g of each pose, in g, for ε, K0/(1 + ε) in g, and the tilts of the second and third axis."""
    along = reading / (1 + values[:3]) - gravity * values[3:6]
    if len(values) == _ALL:
        tilt = np.zeros((3, 3))
        tilt[[1, 2, 2], [0, 0, 1]] = values[6:]
        lower = tilt + np.diag(np.sqrt(1 - np.sum(tilt**2, axis=1)))
        along = np.linalg.solve(lower, along.T).T
    return np.linalg.norm(along, axis=1) / gravity - 1


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

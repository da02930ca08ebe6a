"""Free rotation: a unit that is turned about an unknown axis, at an unknown rate.

On a screwdriver, a bicycle wheel or an office chair that lies on its side, gravity turns in body axes: its turns are
counted to a degree, even if the axis wobbles or moves.  The scale factor of a gyro along the axis is the ratio of the
angle that it measured to the angle counted by gravity; no rate table is needed.  Forward and reverse turns separate the
bias.  Turns about several body axes, in both directions each, determine all three gyros.  The accelerometers measure
gravity and the centripetal acceleration at the unit, whose distance from the axis is unknown (`rotation_centre`).
About a vertical axis gravity does not turn, and the scale factor is not determined.

The textbook estimate counts the turns by the phase of the rotating force: a line through the angle of the gyro against
the phase of gravity.
"""

from collections.abc import Sequence

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.carried import carried_stimulus, nominal_rates
from imubayes.procedures.textbook import DEGREE_PER_HOUR, Evaluation, TextbookResult, Undetermined, measured

METHOD = "turns counted by the phase of gravity"
_ALONG = 0.9  # of the rate, along the input axis, for a gyro to be evaluated
LEAST_TURNING = 0.3  # of g across the axis: with less the phase is noise


def counted_turns(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return scale factor and bias of each gyro along whose axis runs turned, by turns that gravity counts.

    For each run the mean rate that a gyro saw is Ω_r; times the slope of the phase of the force across the axis,
    against the angle of the gyro, it is the true rate Ω.  Over the runs along a gyro Ω_r = (1 + s)(Ω + b): least
    squares of two runs and more.
    """
    found: list[TextbookResult] = []
    axes = {channel.name: channel for channel in campaign.channels if channel.kind == "gyro"}
    seen: dict[str, list[tuple[float, float]]] = {name: [] for name in axes}
    for run in runs:
        rate, true = _rates(run, campaign)
        size = float(np.linalg.norm(rate))
        for name, channel in axes.items():
            along = float(channel.axes[0] @ rate)
            if np.isfinite(true) and abs(along) > _ALONG * size:
                seen[name].append((along, np.sign(along) * true))
    for name, pairs in seen.items():
        found += _of_gyro(axes[name], np.array(pairs).reshape(-1, 2))
    return found


def _rates(run: Run, campaign: Campaign) -> tuple[np.ndarray, float]:
    """Return the mean rate by the nominal gyros, (3,), and that by the phase of gravity, rad/s; NaN if it has none."""
    tumble = run.tumble
    assert tumble is not None
    step = nominal_rates(tumble, campaign)
    length = tumble.step[..., None]
    mean = (step * length).sum(axis=(0, 1)) / length.sum()
    axis = mean / np.linalg.norm(mean)
    channels = measured(run, campaign, "accelerometer")
    signal = np.stack([output / channel.scale_si for channel, output in channels], axis=1)
    force = signal @ np.linalg.pinv(np.array([channel.axes[0] for channel, _ in channels])).T
    across = np.linalg.svd(axis[None])[2][1:]
    across[1] = np.cross(axis, across[0])
    u, v = across @ (force - force.mean(axis=0)).T
    if np.median(np.hypot(u, v)) < LEAST_TURNING * campaign.site.gravity:
        return mean, float("nan")
    # The gyro says how many turns there are between two windows, gravity the rest.
    along = np.concatenate([[0.0], np.cumsum((step @ axis) * tumble.step)])
    ends = tumble.carried_turn * tumble.step.shape[1] + tumble.carried_step
    angle = np.bincount(tumble.carried_row, tumble.carried_weight * along[ends])
    turned = angle + np.unwrap(-np.arctan2(v, u) - angle)
    return mean, float(np.linalg.norm(mean) * np.polyfit(angle, turned, 1)[0])


def _of_gyro(channel: Channel, pairs: np.ndarray) -> list[TextbookResult]:
    name = channel.name
    if len(pairs) < 2 or np.ptp(pairs[:, 1]) < 0.5 * np.abs(pairs[:, 1]).max():
        what = f"{len(pairs)} runs along {name} at one rate do not separate scale factor and bias; turn it both ways"
        return [Undetermined(name, what)]
    matrix = np.column_stack([pairs[:, 1], np.ones(len(pairs))])
    (slope, offset), _, _, _ = np.linalg.lstsq(matrix, pairs[:, 0], rcond=None)
    left, freedom = pairs[:, 0] - matrix @ [slope, offset], len(pairs) - 2
    variance = float(left @ left) / freedom if freedom else float("nan")
    sd = np.sqrt(variance * np.diag(np.linalg.inv(matrix.T @ matrix)))
    of = Evaluation(name, "", METHOD, f"type A: residuals of {len(pairs)} runs")
    to_degrees, bias = np.pi / 180, offset / slope / DEGREE_PER_HOUR
    per = channel.scale_si * to_degrees
    unit = f"{channel.output_unit} per deg/s"
    return [
        of.estimate("scale_factor", slope * per, sd[0] * abs(per), unit, f"{len(pairs)} runs"),
        of.estimate("gyro_bias.bias", bias, sd[1] / slope / DEGREE_PER_HOUR, "deg/h", f"{len(pairs)} runs"),
    ]


FREE_ROTATION = Procedure(
    name="free_rotation",
    reference="Sensors 23(2):1045 (2023); Sensors 25(13):3998 (2025)",
    columns=(("time_s",),),
    needs_gyro=True,
    reduction=Reduction.CARRIED,
    abscissae=("time", "row"),
    row_name="window",
    kinematics=carried_stimulus,
    evaluate=counted_turns,
    purposes=("rotation_centre",),
)

"""Consistency of the gyro and accelerometer axes in a free tumble: finds reversed or exchanged axes."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from imubayes.campaign.findings import Finding
from imubayes.campaign.free_tumble.calibrated_recording import (
    Recording,
    angle_between,
    body_vectors,
    initial_mean,
    pose_means,
    rotation_between,
)
from imubayes.campaign.free_tumble.pose_transitions import step_edges
from imubayes.campaign.free_tumble.static_detection import Pose
from imubayes.campaign_data import Channel

# Nominal biases and scale factors propagate gravity to within a few degrees; a reversed axis misses by tens.
_INCONSISTENT = np.deg2rad(20.0)
# A reversed axis is named if reversing it reduces the angle to this fraction.
_BETTER = 0.3


def check_axes(recording: Recording, poses: Sequence[Pose], channels: Sequence[Channel], file: Path) -> list[Finding]:
    """Compare gravity propagated by the gyros from pose to pose with the accelerometer observations.

    A reversed accelerometer is invisible in |f| = g, and a fit would absorb it in other parameters.
    """
    angle = propagation_error(recording, poses)
    if not angle > _INCONSISTENT:
        return []
    gyros = [index for index, channel in enumerate(channels) if channel.kind == "gyro"]
    inertial = [index for index, channel in enumerate(channels) if channel.kind in ("gyro", "accelerometer")]
    trials = [*([index] for index in inertial), gyros]
    angles = [propagation_error(_with_reversed(recording, channels, trial, file), poses) for trial in trials]
    best = int(np.argmin(angles))
    what = (
        f"gravity propagated by the gyros from pose to pose is {np.rad2deg(angle):.3g} deg from the direction that the "
        "accelerometers observe"
    )
    allowed = "axes of one right-handed system, for gyros and accelerometers alike"
    if angles[best] < _BETTER * angle:
        names = ", ".join(f"'{channels[index].name}'" for index in trials[best])
        what += f"; with {names} reversed it is {np.rad2deg(angles[best]):.2g} deg"
        remedy = f"check the sign of input_axis of {names}"
        return [Finding("sign_reversed", "warning", "", what, str(file), allowed, remedy)]
    remedy = "check input_axis of all channels: axes may be exchanged, or more than one reversed"
    return [Finding("axes_do_not_fit", "warning", "", what, str(file), allowed, remedy)]


def propagation_error(recording: Recording, poses: Sequence[Pose]) -> float:
    """Return the angle between propagated and observed gravity, rad, averaged over all transitions."""
    means = pose_means(recording.force, poses)
    angles = []
    for (before, f), (after, h) in pairwise(zip(poses, means, strict=True)):
        edges = step_edges(recording.time, recording.rate, before.stop - 1, after.start)
        angles.append(angle_between(rotation_between(recording, edges)[0].T @ f, h))
    return float(np.mean(angles)) if angles else 0.0


def _with_reversed(recording: Recording, channels: Sequence[Channel], indices: Sequence[int], file: Path) -> Recording:
    sign = np.ones(len(channels))
    sign[list(indices)] = -1.0
    force, rate = body_vectors(recording.readings, channels, file, sign)
    return replace(recording, force=force, rate=rate - initial_mean(rate, recording.initial))

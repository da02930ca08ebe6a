"""Whether gyros and accelerometers of a free tumble turn together: what is reversed, by nominal numbers alone."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from imubayes.campaign.findings import Finding
from imubayes.campaign.free_tumble.body_vectors import Recording, body_vectors, initial_mean, pose_means, turned_over
from imubayes.campaign.free_tumble.pose_transitions import step_edges
from imubayes.campaign.free_tumble.static_detection import Pose
from imubayes.run import Channel

# Nominal biases and scale factors carry gravity to within a few degrees; a reversed axis misses by tens.
_APART = np.deg2rad(20.0)
# What is reversed is named where putting it right brings the two so much closer.
_BETTER = 0.3


def check_axes(recording: Recording, poses: Sequence[Pose], channels: Sequence[Channel], file: Path) -> list[Finding]:
    """Compare gravity as the gyros carry it from pose to pose with what the accelerometers read there.

    A reversed accelerometer goes unseen in |f| = g, and a fit finds some other way to live with it.
    """
    apart = carried_apart(recording, poses)
    if not apart > _APART:
        return []
    gyros = [place for place, channel in enumerate(channels) if channel.kind == "gyro"]
    trials = [*([place] for place, one in enumerate(channels) if one.kind in ("gyro", "accelerometer")), gyros]
    left = [carried_apart(_with_reversed(recording, channels, trial, file), poses) for trial in trials]
    best = int(np.argmin(left))
    what = (
        f"carried from pose to pose by the gyros, gravity ends {np.rad2deg(apart):.3g} deg from where the "
        "accelerometers see it"
    )
    allowed = "axes of one right-handed system, gyros and accelerometers alike"
    if left[best] < _BETTER * apart:
        names = ", ".join(f"'{channels[place].name}'" for place in trials[best])
        what += f"; with {names} reversed it is {np.rad2deg(left[best]):.2g} deg"
        remedy = f"check the sign of input_axis of {names}"
        return [Finding("sign_reversed", "warning", "", what, str(file), allowed, remedy)]
    remedy = "check input_axis of all channels: axes exchanged, or more than one reversed?"
    return [Finding("axes_do_not_fit", "warning", "", what, str(file), allowed, remedy)]


def carried_apart(recording: Recording, poses: Sequence[Pose]) -> float:
    """Return the angle between gravity as carried and as read, rad, the mean over all transitions."""
    means = pose_means(recording.force, poses)
    angles = []
    for (before, f), (after, h) in pairwise(zip(poses, means, strict=True)):
        edges = step_edges(recording.time, recording.rate, before.stop - 1, after.start)
        carried = turned_over(recording, edges)[0].T @ f
        cosine = carried @ h / np.linalg.norm(carried) / np.linalg.norm(h)
        angles.append(np.arccos(np.clip(cosine, -1, 1)))
    return float(np.mean(angles)) if angles else 0.0


def _with_reversed(recording: Recording, channels: Sequence[Channel], places: Sequence[int], file: Path) -> Recording:
    sign = np.ones(len(channels))
    sign[list(places)] = -1.0
    force, rate = body_vectors(recording.readings, channels, file, sign)
    return replace(recording, force=force, rate=rate - initial_mean(rate, recording.initial))

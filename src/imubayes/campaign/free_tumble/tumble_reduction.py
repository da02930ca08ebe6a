"""A free tumble: from the raw log of a hand-held unit to static poses and the motion between them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from imubayes.campaign.findings import Finding
from imubayes.campaign.free_tumble.axis_signs import check_axes
from imubayes.campaign.free_tumble.body_vectors import Recording, pose_means, record, turned_over
from imubayes.campaign.free_tumble.magnitude_calibration import MagnitudeFit, fit_magnitude
from imubayes.campaign.free_tumble.pose_transitions import mean_readings, padded, step_edges
from imubayes.campaign.free_tumble.rotation import shortest
from imubayes.campaign.free_tumble.static_detection import Pose, find_rests, join_rests, unrest
from imubayes.covariates import recorded_columns
from imubayes.errors import InputError, Issue
from imubayes.run import Channel, Tumble

MULTIPLES = (2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 15.0, 20.0)  # of the variance at rest, tried in turn
TURNED = np.deg2rad(2.0)  # a static pose in which the gyros turn further was disturbed
LEAST_POSES = 4
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class ReducedTumble:
    """Rows of the good poses by column, the moving part, what was done, and what is odd."""

    numbers: dict[str, np.ndarray]
    tumble: Tumble
    notes: tuple[str, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class Detection:
    """The poses found, the multiple of the variance at rest that found them, and how well |f| = g holds."""

    poses: tuple[Pose, ...]
    multiple: float
    fit: MagnitudeFit


def reduce_tumble(
    numbers: Mapping[str, np.ndarray],
    channels: Sequence[Channel],
    gravity: float,
    initial_seconds: float | None,
    file: Path,
) -> ReducedTumble:
    """Reduce a raw log.

    Parameters
    ----------
    numbers : column → shape (N,), in the units of the file.
    channels : all channels of the campaign; three accelerometers in different directions at least.
    gravity : of the site, m/s².
    initial_seconds : length of the rest at the beginning, where it is known.
    file : named in errors.

    Raises
    ------
    InputError
        where accelerometers are missing, or fewer than four static poses are found.
    """
    recording = record(numbers, channels, initial_seconds, file)
    detection = detect_poses(recording, gravity)
    if len(detection.poses) < LEAST_POSES:
        raise InputError(
            Issue(
                f"{len(detection.poses)} static poses were found in the recording",
                str(file),
                f"{LEAST_POSES} or more poses, each held still for two seconds; 20 serve well",
                "record more poses, or state the length of the first rest as initial_rest_s",
            )
        )
    turned = np.array([turned_within(recording, pose) for pose in detection.poses])
    flagged = (turned > TURNED) | detection.fit.outliers
    tumble = _tumble(recording, detection, flagged)
    rows = _rows(numbers, channels, [p for p, bad in zip(detection.poses, flagged, strict=True) if not bad])
    notes = _notes(recording, detection, flagged, turned, tumble)
    found = _findings(recording, detection, gravity, file)
    if not found:
        good = [pose for pose, bad in zip(detection.poses, flagged, strict=True) if not bad]
        found = check_axes(recording, good, channels, file)
    return ReducedTumble(rows, tumble, notes, tuple(found))


def detect_poses(recording: Recording, gravity: float) -> Detection:
    """Try every multiple of the variance at rest, and keep the poses whose force has length g best."""
    ratio = unrest(recording.force, recording.interval, recording.initial)
    best: Detection | None = None
    for multiple in MULTIPLES:
        poses = tuple(join_rests(find_rests(ratio < multiple, recording.interval), recording.force, recording.interval))
        fit = fit_magnitude(pose_means(recording.force, poses), gravity)
        found = Detection(poses, multiple, fit)
        if best is None or _rank(found) > _rank(best):
            best = found
    assert best is not None
    return best


def turned_within(recording: Recording, pose: Pose) -> float:
    """Return how far the gyros say that the unit turned during a pose, rad, the constant part taken off."""
    worst = 0.0
    for rest in pose.rests:
        rate = recording.rate[rest.start : rest.stop]
        turned = np.cumsum(rate - np.median(rate, axis=0), axis=0) * recording.interval
        worst = max(worst, float(np.max(np.abs(turned))))
    return worst


def _rank(found: Detection) -> tuple[int, float]:
    """Enough poses for the full fit first, then the smallest scatter of |f|."""
    return found.fit.parameters, -found.fit.spread


def _tumble(recording: Recording, detection: Detection, flagged: np.ndarray) -> Tumble:
    good = np.flatnonzero(~flagged)
    level = detection.fit.apply(pose_means(recording.force, detection.poses))
    attitude = np.array([shortest(force, UP) for force in level])
    lengths, readings, corrections = [], [], []
    for before, after in pairwise(good):
        edges = step_edges(
            recording.time, recording.rate, detection.poses[before].stop - 1, detection.poses[after].start
        )
        length, mean = mean_readings(recording.time, recording.readings, edges)
        rotation, correction = turned_over(recording, edges)
        carried = attitude[before] @ rotation
        attitude[after] = shortest(carried @ level[after], UP) @ carried
        lengths.append(length)
        readings.append(mean)
        corrections.append(correction)
    return Tumble(good, attitude, good[:-1], good[1:], padded(lengths), padded(readings), padded(corrections), flagged)


def _rows(
    numbers: Mapping[str, np.ndarray], channels: Sequence[Channel], poses: Sequence[Pose]
) -> dict[str, np.ndarray]:
    present = np.stack([np.isfinite(numbers[c.name]) for c in channels if c.name in numbers]).all(axis=0)
    complete = {name: values[present] for name, values in numbers.items()}
    rows = {"samples": np.array([float(len(pose.indices())) for pose in poses])}
    for name in recorded_columns():
        if name in complete and not name.startswith("table_"):
            rows[name] = np.array([np.nanmean(complete[name][pose.indices()]) for pose in poses])
    for channel in channels:
        rows[channel.name] = np.array([complete[channel.name][pose.indices()].mean() for pose in poses])
        rows[f"{channel.name}_sd"] = np.array([complete[channel.name][pose.indices()].std(ddof=1) for pose in poses])
    return rows


def _notes(
    recording: Recording,
    detection: Detection,
    flagged: np.ndarray,
    turned: np.ndarray,
    tumble: Tumble,
) -> tuple[str, ...]:
    seconds = recording.time[recording.initial.stop - 1] - recording.time[recording.initial.start]
    fit = detection.fit
    notes = [
        f"{len(flagged)} static poses found ({detection.multiple:g} times the accelerometers' variance during the "
        f"first {seconds:.3g} s), {len(tumble.start)} transitions between the {int((~flagged).sum())} good ones",
        f"quick fit of {fit.parameters} numbers to |f| = g: scatter {fit.spread:.2g} m/s²",
    ]
    for pose in np.flatnonzero(flagged):
        begin = recording.time[detection.poses[pose].start]
        why = (
            f"the gyros turn by {np.rad2deg(turned[pose]):.2g} deg in it"
            if turned[pose] > TURNED
            else f"|f| is off by {fit.residual[pose]:.2g} m/s²"
        )
        notes.append(f"pose {pose} (from {begin:.4g} s) was disturbed and is left out: {why}")
    return tuple(notes)


def _findings(recording: Recording, detection: Detection, gravity: float, file: Path) -> list[Finding]:
    """Name a wrong unit: forces that are not g long, rotations that do not carry gravity from pose to pose."""
    means = pose_means(recording.force, detection.poses)
    slope = float(np.median(np.linalg.norm(means, axis=1))) / gravity
    found = []
    if not 0.6 < slope < 1.6:
        found.append(
            Finding(
                "acceleration_unit", "error", "",
                f"in the static poses the accelerometers read {slope:.4g} g by their nominal scale",
                f"{file}, accelerometer columns", "about 1 g", "correct scale, per or offset of the accelerometers",
            )
        )  # fmt: skip
    shares = []
    for (before, f), (after, h) in pairwise(zip(detection.poses, means, strict=True)):
        angle = np.arccos(np.clip(f @ h / np.linalg.norm(f) / np.linalg.norm(h), -1, 1))
        if angle > 0.3:
            shares.append(_path(recording, before, after) / angle)
    share = float(np.median(shares)) if shares else 1.0
    if not 0.3 < share < 20.0:
        found.append(
            Finding(
                "rate_unit", "error", "",
                f"between poses the gyros turn by {share:.3g} times the change of the direction of gravity",
                f"{file}, gyro columns", "at least as far, and a few times as far at most",
                "correct scale or per of the gyros: rad/s for deg/s makes a factor of 57.3",
            )
        )  # fmt: skip
    return found


def _path(recording: Recording, before: Pose, after: Pose) -> float:
    """Return by how much the gyros turn between two poses, rad, without regard to direction."""
    moving = slice(before.stop - 1, after.start + 1)
    speed = np.linalg.norm(recording.rate[moving], axis=1)
    return float(np.sum(0.5 * (speed[1:] + speed[:-1]) * np.diff(recording.time[moving])))

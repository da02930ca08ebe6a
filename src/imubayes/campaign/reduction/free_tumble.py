"""Reduction of a free tumble: raw log of a hand-held unit → static poses, transitions between them, and axis checks.

In a free tumble a unit is moved by hand through static poses, without a table.  `rests` finds the rests,
`static_poses` condenses the motion between them, and `magnitude_calibration` checks the rests by |f| = g; from these
the rows of the run are built.  The gyro and accelerometer axes are checked for consistency, which finds reversed or
exchanged axes.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.campaign.reduction import static_poses as static
from imubayes.campaign.reduction.axis_senses import ALLOWED, AxisChange, axis_changes, best_change, finding_of
from imubayes.campaign.reduction.log_reduction import Limits, clipped_samples, clipping_note
from imubayes.campaign.reduction.magnitude_calibration import LEAST_TO_JUDGE, MagnitudeFit, fit_magnitude
from imubayes.campaign.reduction.rests import (
    MOST_ROTATION,
    Pose,
    divide_rests,
    find_rests,
    join_rests,
    reads_gravity,
    trim_rests,
    turning,
    variance_ratio,
)
from imubayes.campaign.stream_checks import Finding
from imubayes.foundations.campaign_data import Channel, Tumble
from imubayes.foundations.covariates import recorded_columns
from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import angle_between
from imubayes.foundations.wrong_records import GAINS

# Nominal biases and scale factors propagate gravity to within a few degrees; a reversed axis misses by tens.
_INCONSISTENT = np.deg2rad(20.0)
# A change of axes or of a factor is named if it reduces the angle to this fraction.
_BETTER = 0.3
# Of the rates, as close as several full turns need; findings of a wrong unit come before.
_FACTORS = np.geomspace(0.25, 4.0, 61)
# What a gyro has of scale factor error, which full turns add up, and beyond what it is another range.
_USUAL, _OTHER_RANGE = 1.1, 1.5


def check_axes(
    recording: static.Recording, poses: Sequence[Pose], channels: Sequence[Channel], file: str
) -> list[Finding]:
    """Compare gravity propagated by the gyros from pose to pose with the accelerometer observations."""
    if not recording.turns:
        return []
    angle = propagation_error(recording, poses)
    if not angle > _INCONSISTENT:
        return []

    def left(change: AxisChange) -> float:
        force, rate = recording.force @ change.force.T, recording.rate @ change.rate.T
        return propagation_error(replace(recording, force=force, rate=rate), poses)

    best = best_change(axis_changes(channels), left, _BETTER * angle)
    what = (
        f"gravity propagated by the gyros from pose to pose is {np.rad2deg(angle):.3g} deg from the direction that the "
        "accelerometers observe"
    )
    if best is not None:
        change, rest = best
        return [finding_of(change, f"{what}; with {change.words} it is {np.rad2deg(rest):.2g} deg", file)]
    factor, rest = _common_factor(recording, poses)
    if rest < _BETTER * angle:
        what += f"; with the rates {factor:.3g} times as large it is {np.rad2deg(rest):.2g} deg"
        allowed = "gyros that read the turns by their nominal scale, within a few percent"
        remedy = f"correct unit, range or scale of the gyros; or the times, which may be {factor:.3g} times as long"
        far = max(factor, 1 / factor)
        severity = "error" if far > _OTHER_RANGE else "warning"
        named = Finding("scale_far_from_nominal", severity, "", what, file, allowed, remedy)
        return [named] if far > _USUAL else []
    remedy = "check input_axis of all channels: several axes may be reversed"
    return [Finding("axes_do_not_fit", "warning", "", what, file, ALLOWED, remedy)]


def _common_factor(recording: static.Recording, poses: Sequence[Pose]) -> tuple[float, float]:
    """Return the factor to all rates with which they propagate gravity best, and the angle that is left, rad."""

    def left(factor: float) -> float:
        return propagation_error(replace(recording, rate=factor * recording.rate), poses)

    best = min(_FACTORS, key=left)
    found = scipy.optimize.minimize_scalar(left, bounds=(0.95 * best, 1.05 * best), method="bounded")
    return float(found.x), float(found.fun)


def propagation_error(recording: static.Recording, poses: Sequence[Pose]) -> float:
    """Return the angle between propagated and observed gravity, rad, averaged over all transitions."""
    means = static.pose_means(recording.force, poses)
    angles = []
    for (before, f), (after, h) in pairwise(zip(poses, means, strict=True)):
        if static.broken_turn(recording, before.stop - 1, after.start):
            continue
        edges = static.step_edges(recording.time, recording.rate, before.stop - 1, after.start)
        angles.append(angle_between(static.rotation_between(recording, edges)[0].T @ f, h))
    return float(np.mean(angles)) if angles else 0.0


MULTIPLES = (2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 15.0, 20.0)  # candidate thresholds, in variances at rest
ROTATION_SECONDS = 5.0  # for longer, the drift of a bias may be a rotation
LEAST_POSES = 4
_MOST_NAMED = 5  # turns that are left out, one by one
_ONE_AXIS = 0.01  # mean square of f along an axis, relative to g²: with less it is never up
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class ReducedTumble:
    """A reduced free tumble: rows of the undisturbed poses by column, the transitions, notes and findings."""

    numbers: dict[str, np.ndarray]
    tumble: Tumble
    notes: tuple[str, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class Detection:
    """Detected poses, the threshold as a multiple of the variance at rest, and the fit of |f| = g to them."""

    poses: tuple[Pose, ...]
    multiple: float
    fit: MagnitudeFit


def reduce_tumble(
    numbers: Mapping[str, np.ndarray],
    channels: Sequence[Channel],
    gravity: float,
    initial_seconds: float | None,
    file: str,
    limits: Limits | None = None,
) -> ReducedTumble:
    """Reduce the raw log of a free tumble.

    Parameters
    ----------
    numbers : column → shape (N,), in the units of the file.
    channels : all channels of the campaign, with at least three accelerometers; turns need three gyros.
    gravity : local gravity, m/s².
    initial_seconds : length of the initial rest, if stated.
    file : named in errors.
    limits : channel → values at which it is clipped; transitions and poses that hold such samples are left out.

    Raises
    ------
    InputError
        if channels are missing, fewer than four static poses are found, or a gyro is clipped in every transition.
    """
    recording = static.record(numbers, channels, initial_seconds, file)
    detection = detect_poses(recording, gravity)
    if len(detection.poses) < LEAST_POSES:
        raise input_error(
            f"{len(detection.poses)} static poses were found in the recording",
            file,
            f"{LEAST_POSES} or more poses, each held still for two seconds; 20 are recommended",
            "record more poses, or state the length of the initial rest as initial_rest_s",
        )
    rotated = np.array([rotation_within(recording, pose) for pose in detection.poses])
    flagged = (rotated > MOST_ROTATION) | detection.fit.outliers
    good = [pose for pose, bad in zip(detection.poses, flagged, strict=True) if not bad]
    clipped = clipped_samples(recording.readings, channels, limits or {})
    whole, untold = _tumble(recording, detection, flagged)
    tumble, lost = _without_clipped(whole, recording, detection.poses, channels, clipped, limits or {}, file)
    notes = (*_notes(recording, detection, flagged, rotated, whole), *untold, *lost)
    findings = _findings(recording, detection, gravity, channels, file) or check_axes(recording, good, channels, file)
    rows = _rows(numbers, channels, good)
    for index, channel in enumerate(channels):
        spoilt = np.array([clipped[pose.indices(), index].any() for pose in good])
        if spoilt.any():
            rows[channel.name] = np.where(spoilt, np.nan, rows[channel.name])
            rows[f"{channel.name}_sd"] = np.where(spoilt, np.nan, rows[f"{channel.name}_sd"])
            notes = (
                *notes,
                clipping_note(channel.name, (limits or {})[channel.name], int(spoilt.sum()), len(good), "poses"),
            )
    return ReducedTumble(rows, tumble, notes, tuple(findings))


def _without_clipped(
    tumble: Tumble,
    recording: static.Recording,
    poses: Sequence[Pose],
    channels: Sequence[Channel],
    clipped: np.ndarray,
    limits: Limits,
    file: str,
) -> tuple[Tumble, tuple[str, ...]]:
    """Return the tumble without the transitions in which a gyro is clipped, and notes on these.

    The heading of a pose beyond such a transition is known by its first estimate alone.
    """
    spans = [slice(poses[a].stop - 1, poses[b].start + 1) for a, b in zip(tumble.start, tumble.stop, strict=True)]
    gyros = [index for index, channel in enumerate(channels) if channel.kind == "gyro"]
    spoilt = np.array([clipped[span].any(axis=0) for span in spans]).reshape(len(spans), len(channels))
    kept = ~spoilt[:, gyros].any(axis=1)
    if len(kept) and not kept.any():
        names = ", ".join(f"'{channels[index].name}'" for index in gyros if spoilt[:, index].any())
        raise input_error(
            f"{names}: clipped in every transition between the poses",
            file,
            "turns within the range of the gyros",
            "turn more slowly, or choose a larger range",
        )
    notes = tuple(
        clipping_note(channels[i].name, limits[channels[i].name], int(spoilt[:, i].sum()), len(spans), "transitions")
        for i in gyros
        if spoilt[:, i].any()
    )
    left = {name: getattr(tumble, name)[kept] for name in ("start", "stop", "step", "readings", "coning")}
    return replace(tumble, **left), notes


def detect_poses(recording: static.Recording, gravity: float) -> Detection:
    """Return the detection, over all candidate thresholds, whose poses satisfy |f| = g best."""
    ratio = variance_ratio(recording.force, recording.interval, recording.initial)
    turns = turning(recording.rate, recording.interval)
    candidates = []
    for multiple in MULTIPLES:
        rests = divide_rests(find_rests(ratio < multiple, recording.interval), turns, recording.interval)
        rests = trim_rests(rests, recording.rate, recording.interval)
        poses = tuple(join_rests(rests, recording.force, recording.interval, turns))
        scatter = static.magnitude_scatter(recording.force, poses)
        fit = fit_magnitude(static.pose_means(recording.force, poses), gravity, scatter)
        candidates.append(Detection(poses, multiple, fit))
    # Enough poses for the full fit come first, then the smallest scatter of |f|.
    return max(candidates, key=lambda detection: (detection.fit.parameters, -detection.fit.spread))


def rotation_within(recording: static.Recording, pose: Pose) -> float:
    """Return the largest rotation by the gyros in `ROTATION_SECONDS` of a pose, rad, their median rate removed."""
    worst, span = 0.0, round(ROTATION_SECONDS / recording.interval)
    for rest in pose.rests:
        rate = recording.rate[rest.start : rest.stop]
        angle = np.cumsum(rate - np.median(rate, axis=0), axis=0) * recording.interval
        before = np.concatenate([np.zeros((min(span, len(angle)), 3)), angle[:-span]])
        worst = max(worst, float(np.max(np.abs(angle - before))))
    return worst


def _tumble(recording: static.Recording, detection: Detection, flagged: np.ndarray) -> tuple[Tumble, tuple[str, ...]]:
    """Return the poses and the turns between them, and notes on turns that are left out."""
    good = np.flatnonzero(~flagged)
    level = detection.fit.apply(static.pose_means(recording.force, detection.poses))
    tumble = unturned(good, level, flagged, recording.readings.shape[1])
    if not recording.turns:
        return tumble, ("no gyros about three axes: the poses are related by |f| = g alone",)
    attitude, kept, broken = tumble.attitude, [], []
    lengths, readings, corrections = [], [], []
    for before, after in pairwise(good):
        begin, end = detection.poses[before].stop - 1, detection.poses[after].start
        if why := static.broken_turn(recording, begin, end):
            broken.append((before, after, why))
            continue
        kept.append((before, after))
        edges = static.step_edges(recording.time, recording.rate, begin, end)
        length, mean = static.step_means(recording.time, recording.readings, edges)
        rotation, correction = static.rotation_between(recording, edges)
        propagated = attitude[before] @ rotation
        attitude[after] = levelling(propagated @ level[after]) @ propagated
        lengths.append(length)
        readings.append(mean)
        corrections.append(correction)
    notes = tuple(
        f"the turn from pose {before} to pose {after} is left out: {why}" for before, after, why in broken[:_MOST_NAMED]
    )
    if len(broken) > _MOST_NAMED:
        notes += (f"{len(broken)} of {len(broken) + len(kept)} turns are left out in all",)
    if not kept:
        return tumble, notes
    start, stop = np.array(kept).T
    return replace(
        tumble,
        start=start,
        stop=stop,
        step=static.padded(lengths),
        readings=static.padded(readings),
        coning=static.padded(corrections),
    ), notes


def unturned(good: np.ndarray, level: np.ndarray, flagged: np.ndarray, channels: int) -> Tumble:
    """Return poses without turns between them, each levelled by its force.

    Parameters
    ----------
    good : shape (R,), the poses that are rows.
    level : calibrated force of every pose, shape (poses, 3).
    """
    attitude = np.array([levelling(force) for force in level])
    none = np.zeros(0, dtype=int)
    return Tumble(
        good, attitude, none, none, np.zeros((0, 1)), np.zeros((0, 1, channels)), np.zeros((0, 1, 3)), flagged
    )


def levelling(force: np.ndarray) -> np.ndarray:
    """Return the smallest rotation that makes a force point up, shape (3, 3)."""
    return scipy.spatial.transform.Rotation.align_vectors(UP, force)[0].as_matrix()


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
    recording: static.Recording, detection: Detection, flagged: np.ndarray, rotated: np.ndarray, tumble: Tumble
) -> tuple[str, ...]:
    seconds = recording.time[recording.initial.stop - 1] - recording.time[recording.initial.start]
    fit = detection.fit
    notes = [
        f"{len(flagged)} static poses found (threshold {detection.multiple:g} times the accelerometer variance of the "
        f"first {seconds:.3g} s), {len(tumble.start)} transitions between the {int((~flagged).sum())} undisturbed ones",
        f"calibration of {fit.parameters} parameters by |f| = g: scatter {fit.spread:.2g} m/s²"
        if fit.judges
        else f"too few poses ({len(flagged)}) to recognise a disturbed one by |f| = g: {LEAST_TO_JUDGE} are needed",
    ]
    notes += one_axis_note(static.pose_means(recording.force, detection.poses))
    for pose in np.flatnonzero(flagged):
        begin = recording.time[detection.poses[pose].start]
        why = (
            f"the gyros show a rotation by {np.rad2deg(rotated[pose]):.2g} deg"
            if rotated[pose] > MOST_ROTATION
            else f"|f| − g is {fit.residual[pose]:.2g} m/s²"
        )
        notes.append(f"pose {pose} (from {begin:.4g} s) excluded as disturbed: {why}")
    return tuple(notes)


def one_axis_note(means: np.ndarray) -> list[str]:
    """Return a note if static poses, (n, 3), differ by turns about one axis of the body, with what stays open."""
    ups = means / np.linalg.norm(means, axis=1, keepdims=True)
    squares, axes = np.linalg.eigh(ups.T @ ups / len(ups))
    if squares[0] > _ONE_AXIS:
        return []
    axis = axes[:, 0] * np.sign(axes[np.argmax(np.abs(axes[:, 0])), 0])
    along = ", ".join(f"{part:.2f}" for part in axis + 0.0)
    return [
        f"all poses differ by turns about one axis of the body, ({along}): bias, scale factor and misalignments along "
        "it remain undetermined; add poses with this axis up and down"
    ]


def wrong_acceleration_unit(means: np.ndarray, gravity: float, file: str) -> list[Finding]:
    """Return a finding if |f| of static poses, shape (n, 3) in m/s², is far from g."""
    slope = float(np.median(np.linalg.norm(means, axis=1))) / gravity
    if reads_gravity(slope, 1.0):
        return []
    return [
        Finding(
            "acceleration_unit", "error", "",
            f"in the static poses the accelerometers indicate {slope:.4g} g by their nominal scale",
            f"{file}, accelerometer columns", "about 1 g", "correct scale, per or offset of the accelerometers",
        )
    ]  # fmt: skip


_LEAST_ELLIPSOID = 9
_CLOSED = 0.05
"""Poses from which an ellipsoid with its axes along those of the body is determined, by three more than it has numbers,
and the share of g² that it may leave."""
_SAME_FACTOR = 0.05


def wrong_channel_unit(means: np.ndarray, gravity: float, channels: Sequence[Channel], file: str) -> list[Finding]:
    """Return a finding for each accelerometer whose outputs of static poses, (n, 3) in m/s², are of another size.

    |f| = g makes them an ellipsoid, whose semi-axes are g times what each responds with.
    """
    if len(means) < _LEAST_ELLIPSOID:
        return []
    unit = means / gravity
    quadratic, *_ = np.linalg.lstsq(np.concatenate([unit**2, unit], axis=1), np.ones(len(unit)), rcond=None)
    square, linear = quadratic[:3], quadratic[3:]
    if np.any(square <= 0):
        return []
    size = 1 + float(np.sum(linear**2 / square)) / 4
    left = float(np.sqrt(np.mean((unit**2 @ square + unit @ linear - 1) ** 2))) / size
    found = list[Finding]()
    for channel in channels if left < _CLOSED else ():
        along = np.abs(channel.axes[0])
        factor = math.sqrt(size / square[int(np.argmax(along))])
        if channel.kind != "accelerometer" or along.max() < 1 - _CLOSED or 1 / _OTHER_RANGE < factor < _OTHER_RANGE:
            continue
        named = [name for name, gain in GAINS["accelerometer"].items() if abs(factor / gain - 1) < _SAME_FACTOR]
        found.append(
            Finding(
                "acceleration_unit", "error", "",
                f"channel '{channel.name}' responds with {factor:.4g} times its nominal scale factor, by |f| = g in "
                "the static poses" + (f": {named[0]}?" if named else ""),
                f"{file}, column '{channel.name}'", "outputs in 'output_unit', 'scale' of them per 'per'",
                f"write scale = {channel.scale * factor:.4g} for '{channel.name}', or correct 'per'",
            )
        )  # fmt: skip
    return found


def _findings(
    recording: static.Recording, detection: Detection, gravity: float, channels: Sequence[Channel], file: str
) -> list[Finding]:
    """Return findings of a wrong unit: |f| far from g, or gyro angles far from the changes of attitude."""
    means = static.pose_means(recording.force, detection.poses)
    found, shares = wrong_channel_unit(means, gravity, channels, file), []
    if found and len(found) < sum(channel.kind == "accelerometer" for channel in channels):
        return found
    found = wrong_acceleration_unit(means, gravity, file)
    for (before, f), (after, h) in pairwise(zip(detection.poses, means, strict=True)):
        angle = angle_between(f, h)
        if recording.turns and angle > 0.3 and not static.broken_turn(recording, before.stop - 1, after.start):
            shares.append(_path(recording, before, after) / angle)
    share = float(np.median(shares)) if shares else 1.0
    if not 0.3 < share < 20.0:
        found.append(
            Finding(
                "rate_unit", "error", "",
                f"between poses the gyros rotate by {share:.3g} times the change in the direction of gravity",
                f"{file}, gyro columns", "a ratio between 1 and a few",
                "correct scale or per of the gyros: rad/s in place of deg/s is a factor of 57.3",
            )
        )  # fmt: skip
    return found


def _path(recording: static.Recording, before: Pose, after: Pose) -> float:
    """Return the integral of |rate| between two poses, rad."""
    moving = slice(before.stop - 1, after.start + 1)
    speed = np.linalg.norm(recording.rate[moving], axis=1)
    return float(np.sum(0.5 * (speed[1:] + speed[:-1]) * np.diff(recording.time[moving])))

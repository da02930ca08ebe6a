"""Reduction of a log without rests: short windows of a unit in motion, and the rotations from pose to pose.

A unit that is waved slowly, or turned on a drill, a wheel or a record player, never rests.  Every window of its log is
a weak pose: the mean force is that of gravity and of the motion, and the gyros carry the attitude on from window to
window.  Poses stand at the ends of stretches of some seconds; each window belongs to the nearer one.

The first estimate of the poses takes the gyros with biases and scale factors that carry gravity best: nominal ones
would be off by a turn after half a minute.  Windows whose force, so carried, is far from gravity are left out: a unit
that was knocked says nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.campaign.reduction import static_poses as static
from imubayes.campaign.reduction.axis_senses import axis_changes, best_change, finding_of
from imubayes.campaign.reduction.free_tumble import ReducedTumble, levelling, wrong_acceleration_unit
from imubayes.campaign.reduction.log_reduction import Limits, clipped_samples
from imubayes.campaign.reduction.motion_windows import (
    Division,
    contiguous,
    divide,
    stretches,
    window_weights,
)
from imubayes.campaign.stream_checks import Finding
from imubayes.foundations.campaign_data import Channel, Tumble
from imubayes.foundations.covariates import recorded_columns
from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import running_products, scatter_of_samples
from imubayes.foundations.wording import counted
from imubayes.procedures.carried import LEAST_SECONDS, about_one_axis

MOST_ROWS, MOST_ABOUT_ONE_AXIS = 250, 120  # effort; about one axis there are several runs
KNOCKED = 6.0  # robust standard deviations of the force of all windows
_ROUNDS, _SCATTER = 12, 0.05  # steps, and scatter of the force of a window over g
_LEAST_TOGETHER = 6  # windows
_BIAS, _SCALE = np.radians(20.0), 0.2  # a priori, of the first estimate
# Gravity and all hand accelerations leave |f| of this share of g on average.
_INCONSISTENT = np.deg2rad(30.0)
# A change of axes is named if it reduces the change of gravity from window to window to this fraction, with such odds
# by as many pairs of windows.  It was 0.32 of a recorded unit whose gyros were 180 deg off about one axis, and 0.53 of
# one reversed gyro.
_BETTER, _LEAST_ODDS = 0.7, 5.0


@dataclass(frozen=True)
class MotionLog:
    """A raw log in motion with nominal calibration, divided.

    Attributes
    ----------
    time, readings, force, rate : shapes (N,), (N, C), (N, 3) and (N, 3), as those of a `static_poses.Recording`.
    division : of the samples.
    first : shape (T,), first sample of each stretch.
    follows : shape (T,), whether a stretch begins where the one before it ends.
    """

    time: np.ndarray
    readings: np.ndarray
    force: np.ndarray
    rate: np.ndarray
    division: Division
    first: np.ndarray
    follows: np.ndarray

    @property
    def poses(self) -> tuple[np.ndarray, np.ndarray]:
        """The pose at the start and at the end of each stretch, (T,) each."""
        start = np.cumsum(~self.follows) - 1 + np.arange(len(self.first))
        return start, start + 1

    def edges(self) -> np.ndarray:
        """Return the sample at every end of a step, shape (T, K + 1)."""
        return self.first[:, None] + self.division.step * np.arange(self.division.steps + 1)


@dataclass(frozen=True)
class Windows:
    """The windows of a log (T·L of them).

    Attributes
    ----------
    readings, force : means, shapes (T, L, C) and (T, L, 3).
    weight : shape (W + 1,), of the ends of steps within a window.
    """

    readings: np.ndarray
    force: np.ndarray
    weight: np.ndarray


def reduce_motion(
    numbers: Mapping[str, np.ndarray],
    channels: Sequence[Channel],
    gravity: float,
    file: str,
    limits: Limits | None = None,
) -> ReducedTumble:
    """Reduce the raw log of a unit in motion.

    Parameters
    ----------
    numbers : column → shape (N,), in the units of the file.
    channels : all channels of the campaign, with three accelerometers and three gyros.
    gravity : local gravity, m/s².
    file : named in errors.
    limits : channel → values at which it is clipped; stretches that hold such samples are left out.

    Raises
    ------
    InputError
        if channels are missing, or the log is too short.
    """
    log, notes = _divided(numbers, channels, file, limits or {})
    windows = _windows(log)
    findings = wrong_acceleration_unit(windows.force.reshape(-1, 3), gravity, file)
    length, readings = _steps(log)
    rates = _rates_of(readings, channels)
    coning = _coning(log)
    estimate = _gyros_by_gravity(windows, rates, length, coning, gravity)
    carried = _carried_force(windows, rates, length, coning, estimate)
    attitude, misfit = _attitudes(log, carried, rates, length, coning, estimate, gravity)
    findings += _changed_axes(log, windows, rates, length, coning, channels, file) or _inconsistent(
        misfit, gravity, file
    )
    kept, left = _kept_windows(misfit, MOST_ABOUT_ONE_AXIS if about_one_axis(log.rate) else MOST_ROWS)
    tumble = replace(
        _tumble(log, windows, attitude, kept, (length, readings, coning)),
        first_gyros=np.vstack([[*estimate.bias, *estimate.scale], estimate.information]),
    )
    rows = _rows(numbers, log, windows, channels, kept)
    notes = (*notes, *_notes(log, kept, left, misfit, estimate))
    return ReducedTumble(rows, tumble, notes, tuple(findings))


def _divided(
    numbers: Mapping[str, np.ndarray], channels: Sequence[Channel], file: str, limits: Limits
) -> tuple[MotionLog, tuple[str, ...]]:
    """Return the log, divided into stretches without gaps and clipped samples, and notes on what is left out."""
    recording = static.record(numbers, channels, None, file)
    _, rate = static.body_vectors(recording.readings, channels, file)
    clipped = clipped_samples(recording.readings, channels, limits)
    unusable = clipped.any(axis=1)
    whole = contiguous(recording.time, recording.interval, 1, unusable)
    if not whole:
        refuse_short(0.0, file)
    division = divide(rate, recording.interval, whole)
    parts = contiguous(recording.time, recording.interval, division.samples, unusable)
    series, left = stretches(parts, division)
    first = np.array([start + place * division.samples for start, count in series for place in range(count)])
    follows = np.array([place > 0 for _, count in series for place in range(count)])
    seconds = division.samples * recording.interval
    refuse_short(len(first) * seconds, file)
    log = MotionLog(recording.time, recording.readings, recording.force, rate, division, first, follows)
    notes = (f"{left} stretches of {seconds:.3g} s are left out, evenly, to bound the effort of the fit",) * (left > 0)
    if unusable.any():
        named = ", ".join(channel.name for channel, own in zip(channels, clipped.T, strict=True) if own.any())
        notes += (f"{named}: clipped; {counted(int(unusable.sum()), 'sample')} left out, which divide the log",)
    return log, notes


def refuse_short(seconds: float, file: str) -> None:
    """Raise InputError if a log holds less than `LEAST_SECONDS` of motion."""
    if seconds < LEAST_SECONDS:
        raise input_error(
            f"the log holds {seconds:.3g} s of motion without gaps and clipped samples",
            file, f"{LEAST_SECONDS:g} s or more in all; some minutes in all attitudes are recommended",
            "record for longer, within the ranges of all channels",
        )  # fmt: skip


def _windows(log: MotionLog) -> Windows:
    """Return the means over all windows; times are taken as equally spaced within a window."""
    per = log.division.per_window
    time = np.arange(per + 1.0)
    samples, ends = window_weights(time, log.division)
    start = log.first[:, None] + per * np.arange(log.division.stretch)
    readings, force = (
        sum(weight * values[start + place] for place, weight in enumerate(samples))
        for values in (log.readings, log.force)
    )
    return Windows(np.asarray(readings), np.asarray(force), ends)


def _steps(log: MotionLog) -> tuple[np.ndarray, np.ndarray]:
    """Return duration and mean readings of every step, (T, K) and (T, K, C)."""
    found = [static.step_means(log.time, log.readings, edges) for edges in log.edges()]
    return np.array([length for length, _ in found]), np.array([mean for _, mean in found])


def _coning(log: MotionLog) -> np.ndarray:
    return np.array([static.coning(log.time, log.rate, edges) for edges in log.edges()])


def _rates_of(readings: np.ndarray, channels: Sequence[Channel]) -> np.ndarray:
    """Return the mean rate of every step by the nominal gyros, (T, K, 3), rad/s, body axes."""
    _, rate = static.body_vectors(readings.reshape(-1, readings.shape[-1]), channels, "")
    return rate.reshape(*readings.shape[:-1], 3)


@dataclass(frozen=True)
class GyroEstimate:
    """First estimate of the gyros: true rate = (rate − bias)/(1 + scale), shape (3,) each, body axes.

    `information`, (6, 6), is that of bias and scale by the data, without the prior that the estimate is held by.
    """

    bias: np.ndarray
    scale: np.ndarray
    information: np.ndarray

    def corrected(self, rate: np.ndarray) -> np.ndarray:
        """Return true rates, (…, 3)."""
        return (rate - self.bias) / (1 + self.scale)


def _since_start(rates: np.ndarray, length: np.ndarray, coning: np.ndarray, gyros: GyroEstimate) -> np.ndarray:
    """Return the rotation of every end of a step since the start of its stretch, (T, K + 1, 3, 3)."""
    vectors = gyros.corrected(rates) * length[..., None] + coning
    each = scipy.spatial.transform.Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix()
    return running_products(each.reshape(*length.shape, 3, 3))


def _carried_force(
    windows: Windows, rates: np.ndarray, length: np.ndarray, coning: np.ndarray, gyros: GyroEstimate
) -> np.ndarray:
    """Return the force of every window in axes of the body at the start of its stretch, (T, L, 3).

    The mean over a window in body axes is shorter than the force by what the unit turns: M, the weighted mean of the
    rotations back, is inverted.
    """
    turned = _since_start(rates, length, coning, gyros)
    width, count = len(windows.weight) - 1, windows.force.shape[1]
    place = width * np.arange(count)[:, None] + np.arange(width + 1)
    mean = np.einsum("w,tlwji->tlij", windows.weight, turned[:, place])
    return np.linalg.solve(mean, windows.force[..., None])[..., 0]


def _gyros_by_gravity(
    windows: Windows, rates: np.ndarray, length: np.ndarray, coning: np.ndarray, gravity: float
) -> GyroEstimate:
    """Return the biases and scale factors of the gyros with which gravity keeps its direction in every stretch.

    Robust least squares of the scatter of carried forces, by differences: first within some windows, then within twice
    as many, up to a stretch.  The remaining error of the scale factor would be more than a turn at once.
    """
    count = windows.force.shape[1]
    sizes = [count // parts for parts in (32, 16, 8, 4, 2, 1) if count // parts >= _LEAST_TOGETHER] or [count]

    def misfit(values: np.ndarray, size: int) -> np.ndarray:
        held = GyroEstimate(values[:3] * _BIAS, values[3:] * _SCALE, nothing)
        force = _carried_force(windows, rates, length, coning, held)[:, : count // size * size] / gravity
        grouped = force.reshape(len(force), -1, size, 3)
        scatter = grouped - grouped.mean(axis=2, keepdims=True)
        return np.concatenate([scatter.ravel(), values])

    values, nothing, jacobian = np.zeros(6), np.zeros((6, 6)), np.zeros((1, 6))
    for size in sizes:
        found = scipy.optimize.least_squares(
            misfit, values, loss="soft_l1", f_scale=_SCATTER, max_nfev=_ROUNDS, diff_step=1e-4, args=(size,), xtol=1e-5
        )
        values, jacobian = found.x, found.jac[:-6]
    wide = np.repeat([_BIAS, _SCALE], 3)
    information = jacobian.T @ jacobian / np.outer(wide, wide) / _SCATTER**2
    return GyroEstimate(values[:3] * _BIAS, values[3:] * _SCALE, information)


def _attitudes(
    log: MotionLog,
    carried: np.ndarray,
    rates: np.ndarray,
    length: np.ndarray,
    coning: np.ndarray,
    gyros: GyroEstimate,
    gravity: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the first estimate of every pose, (poses, 3, 3), and the force of every window beyond gravity, (T, L, 3).

    The direction of gravity at a pose is the median over the windows that belong to it.
    """
    start, stop = log.poses
    total = _since_start(rates, length, coning, gyros)[:, -1]
    half = carried.shape[1] // 2
    ahead, behind = carried[:, :half], np.einsum("tji,tlj->tli", total, carried[:, half:])
    attitude = np.empty((int(stop[-1]) + 1, 3, 3))
    up = np.zeros((len(attitude), 3))
    for pose in range(len(attitude)):
        own = [*ahead[start == pose], *behind[stop == pose]]
        up[pose] = np.median(np.concatenate(own), axis=0)
    for place, (before, after) in enumerate(zip(start, stop, strict=True)):
        if place == 0 or not log.follows[place]:
            attitude[before] = levelling(up[before])
        reached = attitude[before] @ total[place]
        attitude[after] = levelling(reached @ up[after]) @ reached
    local = np.concatenate(
        [np.einsum("tij,tlj->tli", attitude[start], ahead), np.einsum("tij,tlj->tli", attitude[stop], behind)], axis=1
    )
    return attitude, local - np.array([0.0, 0.0, gravity])


def _kept_windows(misfit: np.ndarray, most: int) -> tuple[np.ndarray, int]:
    """Return which windows are used, (T, L), and how many were knocked."""
    deviation = np.linalg.norm(misfit - np.median(misfit.reshape(-1, 3), axis=0), axis=2)
    # The median length of a normal vector in space is 1.538 standard deviations of a component.
    good = deviation < KNOCKED * max(float(np.median(deviation)) / 1.538, 1e-6)
    kept, places = np.zeros(good.shape, dtype=bool), np.flatnonzero(good)
    if len(places) > most:
        places = places[np.unique(np.linspace(0, len(places) - 1, most).round().astype(int))]
    kept.ravel()[places] = True
    return kept, int(np.sum(~good))


def _tumble(
    log: MotionLog,
    windows: Windows,
    attitude: np.ndarray,
    kept: np.ndarray,
    steps: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> Tumble:
    start, stop = log.poses
    length, readings, coning = steps
    turn, place = np.nonzero(kept)
    width, half = log.division.window, kept.shape[1] // 2
    back, count = place >= half, width + 1
    return Tumble(
        pose=np.where(back, stop[turn], start[turn]),
        attitude=attitude,
        start=start,
        stop=stop,
        step=length,
        readings=readings,
        coning=coning,
        flagged=np.zeros(len(attitude), dtype=bool),
        carried_row=np.repeat(np.arange(len(turn)), count),
        carried_weight=np.tile(windows.weight, len(turn)),
        carried_turn=np.repeat(turn, count),
        carried_step=(width * place[:, None] + np.arange(count)).ravel(),
        carried_back=np.repeat(back, count),
    )


def _rows(
    numbers: Mapping[str, np.ndarray], log: MotionLog, windows: Windows, channels: Sequence[Channel], kept: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the columns of the windows that are kept, (T, L)."""
    turn, place = np.nonzero(kept)
    per = log.division.per_window
    inside = (log.first[turn] + per * place)[:, None] + np.arange(per + 1)
    return columns_of_windows(numbers, channels, log.readings, inside, windows.readings[turn, place], float(per))


def columns_of_windows(
    numbers: Mapping[str, np.ndarray],
    channels: Sequence[Channel],
    readings: np.ndarray,
    inside: np.ndarray,
    values: np.ndarray,
    samples: float,
) -> dict[str, np.ndarray]:
    """Return the columns of n windows in motion; the gyros have none, since the unit turns.

    Parameters
    ----------
    numbers : column → shape (N,), in the units of the file; rows that lack a channel are not counted below.
    channels : all channels of the campaign (C).
    readings : shape (N, C), output units.
    inside : shape (n, S), the samples of each window.
    values : shape (n, C), the reading of each window.
    samples : the number of samples whose mean is as uncertain as that reading.
    """
    present = np.stack([np.isfinite(numbers[c.name]) for c in channels if c.name in numbers]).all(axis=0)
    rows = {"samples": np.full(len(inside), samples)}
    for name in recorded_columns():
        if name in numbers and not name.startswith("table_"):
            rows[name] = np.nanmean(numbers[name][present][inside], axis=1)
    for index, channel in enumerate(channels):
        if channel.kind == "accelerometer":
            rows[channel.name] = values[:, index]
            rows[f"{channel.name}_sd"] = scatter_of_samples(readings[:, index][inside])
        else:
            rows[channel.name] = rows[f"{channel.name}_sd"] = np.full(len(inside), np.nan)
    return rows


def _changed_axes(
    log: MotionLog,
    windows: Windows,
    rates: np.ndarray,
    length: np.ndarray,
    coning: np.ndarray,
    channels: Sequence[Channel],
    file: str,
) -> list[Finding]:
    """Return a finding if gravity keeps its direction from window to window much better with other axes."""
    nominal = GyroEstimate(np.zeros(3), np.zeros(3), np.zeros((6, 6)))

    def left(force: np.ndarray, rate: np.ndarray) -> float:
        # The coning correction is a vector product of two rates.
        turned = np.linalg.det(rate) * np.linalg.inv(rate).T
        held = replace(windows, force=windows.force @ force.T)
        carried = _carried_force(held, rates @ rate.T, length, coning @ turned.T, nominal)
        pairs = carried[:, : carried.shape[1] // 2 * 2].reshape(len(carried), -1, 2, 3)
        size = np.linalg.norm(carried, axis=-1).mean()
        apart = np.linalg.norm(pairs[:, :, 1] - pairs[:, :, 0], axis=-1)
        return float(np.median(apart) / size)

    now, count = left(np.eye(3), np.eye(3)), len(log.first) * (log.division.stretch // 2)
    largest = min(_BETTER, float(np.exp(-_LEAST_ODDS / max(count, 1)))) * now
    best = best_change(axis_changes(channels), lambda each: left(each.force, each.rate), largest)
    if best is None:
        return []
    change, rest = best
    before, after = (float(np.degrees(2 * np.arcsin(min(0.5 * size, 1)))) for size in (now, rest))
    what = (
        f"gravity carried by the gyros from one window to the next is {before:.3g} deg from the direction that the "
        f"accelerometers observe; with {change.words} it is {after:.2g} deg"
    )
    return [finding_of(change, what, file)]


def _inconsistent(misfit: np.ndarray, gravity: float, file: str) -> list[Finding]:
    """Return a finding if gravity, carried by the gyros, has no one direction: axes reversed or exchanged."""
    angle = float(np.median(np.linalg.norm(misfit[..., :2], axis=-1))) / gravity
    if not angle > np.sin(_INCONSISTENT):
        return []
    return [
        Finding(
            "axes_do_not_fit", "warning", "",
            "gravity propagated by the gyros from window to window is off by "
            f"{np.degrees(np.arcsin(min(angle, 1))):.3g} deg or more in half of the windows",
            file, "axes of one right-handed system, for gyros and accelerometers alike; scales within a few percent",
            "check input_axis, scale and per of all channels",
        )
    ]  # fmt: skip


def _notes(log: MotionLog, kept: np.ndarray, knocked: int, misfit: np.ndarray, gyros: GyroEstimate) -> tuple[str, ...]:
    interval = float(np.median(np.diff(log.time)))
    window, stretch = log.division.per_window * interval, log.division.samples * interval
    poses = int(log.poses[1][-1]) + 1
    size = float(np.sqrt(np.mean(misfit[kept] ** 2)))
    notes = [
        f"no rests: {int(kept.sum())} windows of {window:.3g} s in motion, of {kept.size}; {len(kept)} stretches of "
        f"{stretch:.3g} s between {poses} poses, over which the gyros carry the attitude",
        f"the force of a window differs from gravity by {1e3 * size / 9.80665:.3g} mg (rms of a component), due to the "
        "acceleration of the hand and errors of the nominal calibration",
    ]
    if knocked:
        notes.append(f"{knocked} windows left out: their force is more than {KNOCKED:g} standard deviations off")
    bias = ", ".join(f"{value:.3g}" for value in np.degrees(gyros.bias))
    notes.append(f"first estimate of the gyro biases from gravity: ({bias}) deg/s")
    return tuple(notes)

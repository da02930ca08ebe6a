"""Reduction of a log of accelerometers alone, waved without rests: short windows as poses with |f| = g.

Without gyros nothing carries the attitude from window to window, so that each window is a pose of its own.  Its reading
is that at the centre of the window, by a parabola in time fitted to the samples: the mean of a rotating vector is
shorter than the vector, by a thousandth at 0.16 rad, while the parabola is right to 10 ppm up to half a radian.  What
the hand accelerates is noise of the pose (`hand_acceleration`).

Source: the ellipsoid fit of magnetometers and accelerometers in motion; Skog and Händel, IMEKO 2006.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.campaign.reduction import static_poses as static
from imubayes.campaign.reduction.carried_rows import columns_of_windows, refuse_short
from imubayes.campaign.reduction.free_tumble import ReducedTumble, one_axis_note, unturned, wrong_acceleration_unit
from imubayes.campaign.reduction.log_reduction import Limits, clipped_samples
from imubayes.campaign.reduction.magnitude_calibration import LEAST_TO_JUDGE, fit_magnitude
from imubayes.campaign.reduction.motion_windows import contiguous
from imubayes.campaign.reduction.pose_table import MOST_POSES, refuse_one_attitude, spread_over_the_sphere
from imubayes.foundations.campaign_data import Channel
from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import angle_between
from imubayes.foundations.wording import counted

LONGEST, WINDOW_ANGLE = 0.8, 0.5  # s, and rad by which the force turns within a window
LEAST_SAMPLES = 8  # of a window: three coefficients, and a scatter that is known to a third
_BLOCK, _FAST = 0.2, 0.95  # s over which the rate of turning is seen, and its quantile that counts
_DEGREE = 2
_MILLI_G = 9.80665e-3  # m/s²


@dataclass(frozen=True)
class _Windows:
    """First sample of each window, (n,), samples in a window, and the weights of these at its centre, (S,)."""

    first: np.ndarray
    samples: int
    weight: np.ndarray

    @property
    def places(self) -> np.ndarray:
        """The samples of each window, (n, S)."""
        return self.first[:, None] + np.arange(self.samples)

    @property
    def worth(self) -> float:
        """The samples whose mean is as uncertain as a reading at the centre: 4/9 of them, by a parabola."""
        return float(max(1, int(1 / np.sum(self.weight**2))))

    def at_centre(self, values: np.ndarray) -> np.ndarray:
        """Return the values, (N, …), at the centre of each window, (n, …)."""
        return np.einsum("s,ns...->n...", self.weight, values[self.places])


def reduce_waved(
    numbers: Mapping[str, np.ndarray],
    channels: Sequence[Channel],
    gravity: float,
    file: str,
    limits: Limits | None = None,
) -> ReducedTumble:
    """Reduce the raw log of accelerometers that are waved slowly through all attitudes.

    Parameters
    ----------
    numbers : column → shape (N,), in the units of the file.
    channels : all channels of the campaign, with at least three accelerometers.
    gravity : local gravity, m/s².
    file : named in errors.
    limits : channel → values at which it is clipped; windows that hold such samples are left out.

    Raises
    ------
    InputError
        if channels are missing, the log is too short, or all of it is of one attitude.
    """
    recording = static.record(numbers, channels, None, file)
    windows, turned = _windows(recording, channels, limits or {}, file)
    readings, force = windows.at_centre(recording.readings), windows.at_centre(recording.force)
    refuse_one_attitude(force, file, "windows")
    fit = fit_magnitude(force, gravity)
    level, good = fit.apply(force), np.flatnonzero(~fit.outliers)
    chosen = good[spread_over_the_sphere(level[good], MOST_POSES)] if len(good) > MOST_POSES else good
    poses = unturned(np.arange(len(chosen)), level[chosen], np.zeros(len(chosen), dtype=bool), len(channels))
    seconds = windows.samples * recording.interval
    notes = [
        f"no rests, and no gyros about three axes: {len(chosen)} windows of {seconds:.3g} s in motion, of "
        f"{len(windows.first)}; each has |f| = g, its attitude is unknown",
        f"the force turns by {np.degrees(turned * seconds):.2g} deg in a window of the fastest twentieth",
        *one_axis_note(force),
    ]
    if fit.judges:
        size = fit.spread / _MILLI_G
        notes.append(f"|f| of the windows scatters by {size:.3g} mg, due to the acceleration of the hand")
    if knocked := int(fit.outliers.sum()):
        notes.append(f"{counted(knocked, 'window')} left out: |f| is far from g, the unit was knocked")
    if left := len(good) - len(chosen):
        notes.append(
            f"{counted(left, 'window')} left out, evenly over directions, to limit unknown attitudes: "
            f"standard uncertainties are about {np.sqrt(len(good) / len(chosen)):.2g} times as large as with all"
        )
    return ReducedTumble(
        columns_of_windows(
            numbers, channels, recording.readings, windows.places[chosen], readings[chosen], windows.worth
        ),
        replace(poses, waved=np.ones(len(chosen), dtype=bool)),
        tuple(notes),
        tuple(wrong_acceleration_unit(force, gravity, file)),
    )


def _windows(
    recording: static.Recording, channels: Sequence[Channel], limits: Limits, file: str
) -> tuple[_Windows, float]:
    """Return the windows of a record, and the rate at which the force turns in the fastest of it, rad/s."""
    parts = contiguous(recording.time, recording.interval, LEAST_SAMPLES)
    refuse_short(sum(recording.time[stop] - recording.time[start] for start, stop in parts), file)
    turned = _turning(recording, parts)
    seconds = min(LONGEST, WINDOW_ANGLE / max(turned, 1e-3))
    samples = int(seconds / recording.interval)
    if samples < LEAST_SAMPLES:
        raise input_error(
            f"the force turns by {np.degrees(turned):.3g} deg/s, and the log has {1 / recording.interval:.3g} Hz",
            file,
            f"{LEAST_SAMPLES} samples or more while the force turns by {np.degrees(WINDOW_ANGLE):.2g} deg",
            "turn the unit more slowly, or record faster",
        )
    clipped = clipped_samples(recording.readings, channels, limits).any(axis=1)
    first = np.concatenate([np.arange(start, stop + 2 - samples, samples) for start, stop in parts])
    whole = np.array([not clipped[start : start + samples].any() for start in first], dtype=bool)
    if int(whole.sum()) < LEAST_TO_JUDGE:
        raise input_error(
            f"the log holds {int(whole.sum())} windows of {seconds:.3g} s without gaps and clipped samples",
            file,
            f"{LEAST_TO_JUDGE} or more; some minutes in all attitudes are recommended",
            "record for longer, within the ranges of all channels",
        )
    place = np.linspace(-1, 1, samples)
    weight = np.linalg.pinv(np.vander(place, _DEGREE + 1, increasing=True))[0]
    return _Windows(first[whole], samples, weight), turned


def _turning(recording: static.Recording, parts: Sequence[tuple[int, int]]) -> float:
    """Return how fast the direction of the force turns, rad/s, by what 5 % of the record exceeds."""
    size = max(2, round(_BLOCK / recording.interval))
    found = []
    for start, stop in parts:
        count = (stop + 1 - start) // size
        mean = recording.force[start : start + count * size].reshape(count, size, 3).mean(axis=1)
        found.append(angle_between(mean[1:], mean[:-1]) / (size * recording.interval))
    angles = np.concatenate(found)
    return float(np.quantile(angles, _FAST)) if len(angles) else 0.0

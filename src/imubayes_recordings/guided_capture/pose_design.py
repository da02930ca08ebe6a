"""What the poses and turns of a hand-held unit determine so far, and which attitude would determine most next.

Everything is linear about the nominal calibration.  |f| = g in each pose determines the accelerometers
(`magnitude_calibration`).  A turn carries the direction of gravity from one pose to the next, which errors of the
gyros about any horizontal axis displace.  The scatter is that within the poses, or what is left of |f| − g if the
poses are enough to determine it.  Correlation between gyros and accelerometers is left to the fit.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.campaign.reduction.magnitude_calibration import fit_magnitude, magnitude_jacobian
from imubayes.foundations.body_axes import body_vector, spans_space
from imubayes.foundations.campaign_data import Campaign, Tumble


class Coefficients(NamedTuple):
    """Where the coefficients of an effect stand, of which kind of channel, and a usual unit.

    Matrix and offset of the accelerometers; rows of a 3 × 3 matrix, then biases of the gyros.
    """

    kind: str
    places: list[int]
    unit: str


COEFFICIENTS = {
    "accel_bias": Coefficients("accelerometer", [6, 7, 8], "g"),
    "accel_scale_factor": Coefficients("accelerometer", [0, 1, 2], "ppm"),
    "accel_misalignment": Coefficients("accelerometer", [3, 4, 5], "arcmin"),
    "gyro_bias": Coefficients("gyro", [9, 10, 11], "deg/h"),
    "gyro_scale_factor": Coefficients("gyro", [0, 4, 8], "ppm"),
    "gyro_misalignment": Coefficients("gyro", [1, 2, 3, 5, 6, 7], "arcmin"),
}
# Standard deviations before the first pose: 0.1 g, 10 %, 6 deg; gyro biases 6 deg/s.
_BEFORE = {"accelerometer": np.array([0.1] * 6 + [1.0] * 3), "gyro": np.full(12, 0.1)}
_DIRECTIONS = np.array([way for way in product((0, 1, -1), repeat=3) if any(way)], dtype=float)
DIRECTIONS = _DIRECTIONS[np.argsort(np.abs(_DIRECTIONS).sum(axis=1), kind="stable")]
"""Directions of the body that may point up, (26, 3), not normalised: faces, then edges, then corners."""
_STEPS = 12  # of a turn that is planned
_LEAST_ACROSS = 0.2  # sine of its angle, for its axis to be reported


@dataclass(frozen=True)
class PoseDesign:
    """The information of the poses and turns so far.

    Attributes
    ----------
    information : kind of channel → precision of its coefficients, SI.
    poses : number of undisturbed poses.
    up : direction of the last one, body axes, shape (3,).
    force_sd, turn_sd : standard deviations of |f| of one pose, m/s², and of gravity carried over a turn, rad.
    gravity : m/s².
    """

    information: Mapping[str, np.ndarray]
    poses: int
    up: np.ndarray
    force_sd: float
    turn_sd: float
    gravity: float

    def deviations(self, effect: str) -> np.ndarray:
        """Return the standard deviations of the coefficients of an effect, SI."""
        own = COEFFICIENTS[effect]
        return np.sqrt(np.diag(np.linalg.inv(self.information[own.kind]))[own.places])

    def next_up(self, wanted: Mapping[str, float]) -> np.ndarray:
        """Return the direction to point up next: the one that leaves least of what is wanted, effect → sd, open."""
        costs = [self._after(way / np.linalg.norm(way), wanted) for way in DIRECTIONS]
        return DIRECTIONS[int(np.argmin(costs))]

    def _after(self, up: np.ndarray, wanted: Mapping[str, float]) -> float:
        row = magnitude_jacobian(np.zeros(9), self.gravity * up[None]) / self.force_sd
        after = {"accelerometer": self.information["accelerometer"] + row.T @ row}
        if "gyro" in self.information:
            turn = _carried(self.up, *_shortest(self.up, up)) / self.turn_sd
            after["gyro"] = self.information["gyro"] + turn.T @ turn
        variance = {kind: np.diag(np.linalg.inv(matrix)) for kind, matrix in after.items()}
        left = [
            variance[own.kind][own.places] / wanted[effect] ** 2
            for effect, own in COEFFICIENTS.items()
            if effect in wanted and own.kind in after
        ]
        return float(np.concatenate(left).sum())


def design_of(campaign: Campaign, interval: float) -> PoseDesign:
    """Return what the only run of a campaign, a free tumble sampled every `interval` seconds, determines so far."""
    run, gravity = campaign.runs[0], campaign.site.gravity
    tumble = run.tumble
    assert tumble is not None
    force = body_vector(run.observed, campaign.channels, "accelerometer")
    sd = run.sample_sd / [abs(channel.scale_si) for channel in campaign.channels]
    by_kind = {
        kind: np.sqrt(np.mean(sd[:, [channel.kind == kind for channel in campaign.channels]] ** 2, axis=1))
        for kind in ("accelerometer", "gyro")
        if spans_space(campaign.channels, kind)
    }
    within = by_kind["accelerometer"] / np.sqrt(run.samples)
    fit = fit_magnitude(force, gravity, within)
    force_sd = np.maximum(within, fit.spread if fit.judges else 0.0)
    rows = magnitude_jacobian(np.zeros(9), force) / force_sd[:, None]
    information = {"accelerometer": np.diag(_BEFORE["accelerometer"] ** -2) + rows.T @ rows}
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    one, turn_sd = float(np.median(force_sd)), float(np.sqrt(2) * np.median(force_sd) / gravity)
    if "gyro" in by_kind:
        noise = float(np.median(by_kind["gyro"])) * np.sqrt(interval)  # rad/√s
        rate = body_vector(run.observed, campaign.channels, "gyro")
        information["gyro"] = np.diag(_BEFORE["gyro"] ** -2)
        scatter = np.maximum(rate.std(axis=0) if len(rate) > 1 else 0.0, 1e-9)
        information["gyro"][9:, 9:] += np.diag(len(rate) / scatter**2)
        for vectors, seconds, before in _turns(tumble, campaign, rate.mean(axis=0), up):
            turn_sd = np.hypot(np.sqrt(2) * one / gravity, noise * np.sqrt(seconds.sum()))
            carried = _carried(before, vectors, seconds) / turn_sd
            information["gyro"] += carried.T @ carried
    return PoseDesign(information, run.rows, up[-1], one, float(turn_sd), gravity)


def _turns(tumble: Tumble, campaign: Campaign, bias: np.ndarray, up: np.ndarray):
    """Yield rotation vectors (K, 3) and lengths (K,) of the steps of each turn, and the direction of up before it."""
    row = {int(pose): place for place, pose in enumerate(tumble.pose)}
    for start, step, readings in zip(tumble.start, tumble.step, tumble.readings, strict=True):
        used = step > 0
        rate = body_vector(readings[used], campaign.channels, "gyro")
        yield (rate - bias) * step[used, None], step[used], up[row[int(start)]]


def _carried(up: np.ndarray, vectors: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """Return how the direction of gravity after a turn responds to the twelve coefficients of the gyros, (3, 12)."""
    total, turned = np.zeros((3, 12)), scipy.spatial.transform.Rotation.identity()
    for vector, length in zip(vectors, seconds, strict=True):
        half = scipy.spatial.transform.Rotation.from_rotvec(0.5 * vector)
        matrix = (turned * half).as_matrix()
        total[:, :9] += np.einsum("ia,b->iab", matrix, vector).reshape(3, 9)
        total[:, 9:] += matrix * length
        turned = turned * half * half
    return np.cross(total, up, axis=0)


def _shortest(up: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps of the shortest turn that points another direction of the body up, in two seconds."""
    axis, angle = np.cross(after, up), np.arccos(np.clip(up @ after, -1.0, 1.0))
    size = np.linalg.norm(axis)
    # Half a turn may be about any horizontal axis: nothing is expected of it.
    vector = angle * axis / size if size > _LEAST_ACROSS else np.zeros(3)
    return np.tile(vector / _STEPS, (_STEPS, 1)), np.full(_STEPS, 2.0 / _STEPS)

"""What the motions that a capture asks for are expected to determine, before anything moves.

A nominal unit with the noise of the recording makes the planned motion; its samples are reduced, and its information
taken, as those of any campaign (`proposed_effects`).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used

import imubayes
from imubayes.foundations.numerics import scatter_of_samples
from imubayes_recordings.convert.column_names import SIX, TIME
from imubayes_recordings.convert.proposed_effects import ExpectedUncertainty, propose_effects

PROCEDURE = {"drill": "free_rotation", "wave": "slow_motion"}
SECONDS = {"drill": 20.0, "wave": 60.0}
"""Seconds of a turn, and of a motion by hand."""
TURNS = tuple((axis, sense) for axis in "xyz" for sense in ("forward", "reverse"))
_RATE = 2 * np.pi * 0.75  # rad/s of a drill
_TUMBLE = (0.31, 0.23, 0.17)  # rad/s by which a hand turns the unit about three axes, on the whole
_SWAY = ((0.07, 0.9), (0.05, 2.0), (0.09, 0.0))  # Hz and phase of what it turns besides, by a radian
HAND = 0.03
"""Acceleration of hand or drill that is assumed, m/s²: 3 mg, as the prior of `hand_acceleration`."""


def expected_of_plan(
    motion: str, seconds: float, interval: float, noise: Mapping[str, float], document: Mapping[str, Any]
) -> tuple[ExpectedUncertainty, ...]:
    """Return what the planned motions are expected to determine.

    Parameters
    ----------
    seconds, interval : of each motion, and between samples, s.
    noise : channel → standard deviation of a sample, SI.
    document : of the campaign that the recording so far makes: its site is that of the plan.
    """
    gravity = float(document["site"].get("gravity_m_s2") or 9.81)
    names = [name for name in SIX if name in noise]
    time = interval * np.arange(round(seconds / interval))
    planned = _drilled(time) if motion == "drill" else {"waved": _waved(time)}
    stream, runs = np.random.default_rng(1), {}
    for name, attitude in planned.items():
        values = _readings(attitude, interval, gravity)
        runs[name] = {TIME: time} | {
            channel: values[:, SIX.index(channel)] + noise[channel] * stream.standard_normal(len(time))
            for channel in names
        }
    content = {
        "format": 1, "name": "plan", "site": dict(document["site"]), "unit": {"serial": "plan"},
        "channel": [_channel(name) for name in names],
        "run": [{"name": name, "procedure": PROCEDURE[motion]} for name in runs],
    }  # fmt: skip
    return propose_effects(imubayes.build_campaign(content, runs)).expected


def noise_of(values: np.ndarray, names: Sequence[str]) -> dict[str, float]:
    """Return the standard deviation of single samples, (n, C), of a unit at rest or in motion."""
    sd = np.nan_to_num(scatter_of_samples(values.T))
    return {name: max(float(own), 1e-6) for name, own in zip(names, sd, strict=True)}


def _channel(name: str) -> dict[str, Any]:
    unit = "m/s^2" if name[0] == "a" else "rad/s"
    axis = [float(name[1] == each) for each in "xyz"]
    kind = "accelerometer" if name[0] == "a" else "gyro"
    return {"name": name, "kind": kind, "input_axis": axis, "output_unit": unit, "scale": 1.0, "per": unit}


def _drilled(time: np.ndarray) -> dict[str, Any]:
    """Return the attitude, body → local level, of turns about each axis of the body, level, both ways."""
    found = {}
    for axis, sense in TURNS:
        angle = (1 if sense == "forward" else -1) * _RATE * time
        level = np.roll(np.eye(3), "xyz".index(axis), axis=1)  # that axis of the body is east
        spun = scipy.spatial.transform.Rotation.from_rotvec(np.outer(angle, [1.0, 0.0, 0.0]))
        found[f"{axis}-{sense}"] = spun * scipy.spatial.transform.Rotation.from_matrix(level)
    return found


def _waved(time: np.ndarray) -> Any:
    """Return the attitude of a unit that a hand turns through all attitudes."""
    angles = [w * time + np.sin(2 * np.pi * f * time + p) for w, (f, p) in zip(_TUMBLE, _SWAY, strict=True)]
    return scipy.spatial.transform.Rotation.from_euler("xyz", np.stack(angles, axis=1))


def _readings(attitude: Any, interval: float, gravity: float) -> np.ndarray:
    """Return the readings of a nominal unit, (n, 6), SI, with the acceleration of what carries it."""
    turned = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / interval
    rate = np.vstack([turned, turned[-1:]])
    force = attitude.inv().apply([0.0, 0.0, gravity])
    slow = np.random.default_rng(2).standard_normal((len(force) // 25 + 2, 3))
    place = np.arange(len(force)) / 25
    moved = np.stack([np.interp(place, np.arange(len(slow)), column) for column in slow.T], axis=1)
    return np.hstack([force + HAND * moved, rate])

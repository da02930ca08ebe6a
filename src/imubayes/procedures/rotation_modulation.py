"""Rotation modulation: the unit turned forward and reverse without a stop, the table angle recorded (P3).

A bias ε of a channel at the angle θ from the axis of rotation keeps its part ε cos θ along the axis.  The rest,
ε sin θ, turns with the unit: after the angle Φ its mean is ε sin θ · |sin(Φ/2)|/(Φ/2), nothing after whole turns.  The
bias comes from the readings at table angles φ and rates Ω, forward and reverse, by least squares,

    E/K = ε + w_a cos θ + s Ω cos θ + A cos φ + B sin φ,

w_a being the Earth's rate (for accelerometers the specific force) along the axis; A and B take up what lies across it.
θ is nominal and taken as exact.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.earth import earth_rate
from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.textbook import (
    Estimate,
    TextbookResult,
    Undetermined,
    along_table,
    axial,
    least_squares,
    measured,
)
from imubayes.run import Campaign, Channel, Run

METHOD = "rotation modulation"
_UNITS = {"gyro": ("gyro_bias.bias", "deg/h", np.pi / 180 / 3600), "accelerometer": ("accel_bias.bias", "ug", None)}
_TURN = 2 * np.pi
# Readings may cover so little of a turn that what turns and what does not are one.
_LEAST_ARC = np.pi
_REST = 1e-9
_ROUNDING = 1e-12


def modulation_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return the bias of every channel from all runs of one mounting, and its modulated and unmodulated parts.

    `left_in_plane` is what is left of all biases of a kind across the axis after the angle that a run has swept.
    """
    found: list[TextbookResult] = []
    for seat in dict.fromkeys(run.mounting for run in runs):
        own = [run for run in runs if run.mounting == seat]
        for kind in ("gyro", "accelerometer"):
            found += _of_kind(campaign, own, kind)
    return found


def _of_kind(campaign: Campaign, runs: Sequence[Run], kind: str) -> list[TextbookResult]:
    name, unit, factor = _UNITS[kind]
    factor = factor or 1e-6 * campaign.site.gravity
    names = ", ".join(run.name for run in runs)
    found: list[TextbookResult] = []
    known: list[tuple[Channel, float]] = []
    for channel in (one for one in campaign.channels if one.kind == kind):
        bias, sd = _bias(campaign, runs, channel)
        if not np.isfinite(bias):
            found.append(Undetermined(names, f"{channel.name}: the turns do not tell its bias from what it measures"))
            continue
        cosine = float(along_table(runs[0], campaign, channel.axes[0])[2])
        known.append((channel, bias))
        parts = ((name, 1.0), ("modulated", np.sqrt(1 - cosine**2)), ("unmodulated", cosine))
        found += [
            Estimate(f"{part}[{channel.name}]", names, bias * share / factor, sd * abs(share) / factor, unit, METHOD)
            for part, share in parts
        ]
    return found + [one for run in runs for one in _left(campaign, run, known, kind, unit, factor)]


def _bias(campaign: Campaign, runs: Sequence[Run], channel: Channel) -> tuple[float, float]:
    """Return the bias of a channel and its standard deviation, SI; NaN where the runs do not determine it."""
    designs, outputs = [], []
    for run in runs:
        output = {one.name: values for one, values in measured(run, campaign, channel.kind)}.get(channel.name)
        if output is None:
            continue
        cosine = float(along_table(run, campaign, channel.axes[0])[2])
        angle, rate, mean = run.covariates["table_angle"], run.covariates["table_rate"], attenuation(run)
        designs.append(
            np.stack(
                [np.ones_like(angle), rate * cosine, mean * np.cos(angle), mean * np.sin(angle)], axis=1
            )
        )  # fmt: skip
        outputs.append(output / channel.scale_si - _axial(campaign, run, channel.kind) * cosine)
    if not designs:
        return float("nan"), float("nan")
    design, output = np.concatenate(designs), np.concatenate(outputs)
    # An accelerometer sees no rate; forward alone, a gyro's scale factor and its bias are one.
    design = design if channel.kind == "gyro" else design[:, [0, 2, 3]]
    length = np.linalg.norm(design, axis=0)
    design = design[:, length > _REST * length.max()]
    if np.linalg.cond(design / np.linalg.norm(design, axis=0)) > 1e6 or len(output) <= design.shape[1]:
        return float("nan"), float("nan")
    value, covariance, _ = least_squares(design, output)
    return float(value[0]), float(np.sqrt(covariance[0, 0]))


def attenuation(run: Run) -> np.ndarray:
    """Return how much a mean over the arc of each row shortens what turns: sin(s/2)/(s/2), shape (R,)."""
    return np.sinc(run.covariates["table_angle_span"] / _TURN)


def _axial(campaign: Campaign, run: Run, kind: str) -> float:
    """Return the Earth's rate or gravity's specific force along the table's axis, SI."""
    gravity = np.array([0.0, 0.0, campaign.site.gravity])
    return axial(run, campaign, earth_rate(campaign.site.latitude) if kind == "gyro" else gravity)


def swept(run: Run) -> float:
    """Return the angle that a run has turned by, rad: the arcs of its rows."""
    return float(np.sum(np.abs(run.covariates["table_angle_span"])))


def left_after(angle: float) -> float:
    """Return the share that is left of a turning vector in its mean over an angle, rad."""
    share = abs(float(np.sinc(angle / _TURN)))
    return share if share > _ROUNDING else 0.0


def _left(
    campaign: Campaign, run: Run, known: Sequence[tuple[Channel, float]], kind: str, unit: str, factor: float
) -> list[TextbookResult]:
    angle = swept(run)
    if len(known) < 3 or angle < _LEAST_ARC or run.mounting is None:
        return []
    bias = campaign.mountings[run.mounting].body_to_table @ bias_vector(known)
    in_plane, along = float(np.hypot(bias[0], bias[1])), abs(float(bias[2]))
    turns = angle / _TURN
    whole = np.floor(turns + 1e-6)
    nan = float("nan")
    return [
        Estimate(f"{name}[{kind}]", run.name, value / factor, nan, unit, f"{METHOD}: {said}")
        for name, value, said in (
            ("left_in_plane", in_plane * left_after(angle), f"across the axis, after {turns:.2f} turns"),
            ("left_in_plane_whole", in_plane * left_after(_TURN * whole), f"across the axis, after {whole:.0f} turns"),
            ("left_along_axis", along, "along the axis, after any number of turns"),
        )
    ]


def bias_vector(known: Sequence[tuple[Channel, float]]) -> np.ndarray:
    """Return the vector, body axes, that the biases of three channels or more amount to, (3,)."""
    axes = np.stack([channel.axes[0] for channel, _ in known])
    return np.linalg.pinv(axes) @ np.array([bias for _, bias in known])


@dataclass(frozen=True)
class Carrier:
    """The motion of the carrier, the rotation in it taken out: table axes at angle 0.

    Attributes
    ----------
    time : shape (R,), s; the number of the row where the run has no time.
    angle : shape (R,), table angle, rad.
    rate, force : shape (R, 3), rad/s and m/s², NaN where the unit has too few channels of a kind.
    """

    time: np.ndarray
    angle: np.ndarray
    rate: np.ndarray
    force: np.ndarray


def carrier(campaign: Campaign, run: Run, biases: Mapping[str, float] | None = None) -> Carrier:
    """Return the rate and specific force of the carrier, with the measured table angle and rate taken out.

    Parameters
    ----------
    biases : channel → bias that is subtracted first, rad/s or m/s²; none where None.
    """
    assert run.mounting is not None
    seat = campaign.mountings[run.mounting].body_to_table
    angle = run.covariates["table_angle"]
    found = {kind: _vector(campaign, run, kind, biases or {}) @ seat.T for kind in ("gyro", "accelerometer")}
    found["gyro"][:, 2] -= run.covariates["table_rate"]
    c, s, mean = np.cos(angle), np.sin(angle), attenuation(run)
    for vector in found.values():
        x, y = vector[:, 0] / mean, vector[:, 1] / mean
        vector[:, 0], vector[:, 1] = c * x - s * y, s * x + c * y
    time = run.covariates.get("time", np.arange(run.rows, dtype=float))
    return Carrier(time, angle, found["gyro"], found["accelerometer"])


def _vector(campaign: Campaign, run: Run, kind: str, biases: Mapping[str, float]) -> np.ndarray:
    """Return the vector that the channels of a kind measure, body axes, (R, 3)."""
    channels = measured(run, campaign, kind)
    if len(channels) < 3:
        return np.full((run.rows, 3), np.nan)
    signal = [output / channel.scale_si - biases.get(channel.name, 0.0) for channel, output in channels]
    return np.stack(signal, axis=1) @ np.linalg.pinv(np.stack([channel.axes[0] for channel, _ in channels])).T


ROTATION_MODULATION = Procedure(
    name="rotation_modulation",
    reference="Levinson and Majure, accuracy enhancement by rotation, AGARD 1987; Groves § 5",
    columns=(("table_rate_deg_s", "table_angle_deg"),),
    needs_table=True,
    reduction=Reduction.FOLLOWED,
    abscissae=("table_angle", "table_rate", "time"),
    evaluate=modulation_test,
)

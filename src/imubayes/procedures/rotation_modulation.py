"""Rotation modulation: continuous forward and reverse rotation with recorded table angle (P3).

Of the bias ε of a channel at the angle θ from the axis of rotation, the component ε cos θ along the axis is not
modulated.  The component ε sin θ turns with the unit: over the angle Φ its mean is ε sin θ · |sin(Φ/2)|/(Φ/2), zero
over whole turns.  The bias is estimated by least squares from the outputs at table angles φ and rates Ω, forward and
reverse,

    E/K = ε + w_a cos θ + s Ω cos θ + A cos φ + B sin φ,

with w_a the Earth rate (for accelerometers the specific force) along the axis; A and B absorb its components
perpendicular to the axis.  θ is nominal and taken as exact.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.campaign_data import Campaign, Channel, Run
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

METHOD = "rotation modulation"
_UNITS = {"gyro": ("gyro_bias.bias", "deg/h", np.pi / 180 / 3600), "accelerometer": ("accel_bias.bias", "ug", None)}
_TURN = 2 * np.pi
# Over shorter arcs modulated and unmodulated components are not separable.
_LEAST_ARC = np.pi
_REST = 1e-9
_ROUNDING = 1e-12


def modulation_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return the bias of every channel per mounting, with its modulated and unmodulated components.

    `left_in_plane` is the residual of the modulated biases of a kind after the angle that a run has swept.
    """
    found: list[TextbookResult] = []
    for mounting in dict.fromkeys(run.mounting for run in runs):
        mounted = [run for run in runs if run.mounting == mounting]
        for kind in ("gyro", "accelerometer"):
            found += _of_kind(campaign, mounted, kind)
    return found


def _of_kind(campaign: Campaign, runs: Sequence[Run], kind: str) -> list[TextbookResult]:
    name, unit, factor = _UNITS[kind]
    factor = factor or 1e-6 * campaign.site.gravity
    names = ", ".join(run.name for run in runs)
    found: list[TextbookResult] = []
    biases: list[tuple[Channel, float]] = []
    for channel in campaign.of_kind(kind):
        bias, sd = _bias(campaign, runs, channel)
        if not np.isfinite(bias):
            found.append(Undetermined(names, f"{channel.name}: its bias is not separable from its input"))
            continue
        cosine = float(along_table(runs[0], campaign, channel.axes[0])[2])
        biases.append((channel, bias))
        parts = ((name, 1.0), ("modulated", np.sqrt(1 - cosine**2)), ("unmodulated", cosine))
        found += [
            Estimate(f"{part}[{channel.name}]", names, bias * share / factor, sd * abs(share) / factor, unit, METHOD)
            for part, share in parts
        ]
    return found + [estimate for run in runs for estimate in _left(campaign, run, biases, kind, unit, factor)]


def _bias(campaign: Campaign, runs: Sequence[Run], channel: Channel) -> tuple[float, float]:
    """Return the bias of a channel and its standard deviation, SI; NaN where the runs do not determine it."""
    designs, outputs = [], []
    for run in runs:
        outputs_of = {other.name: values for other, values in measured(run, campaign, channel.kind)}
        output = outputs_of.get(channel.name)
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
    # Accelerometers do not respond to rate.  One direction alone does not separate gyro bias from scale factor.
    design = design if channel.kind == "gyro" else design[:, [0, 2, 3]]
    length = np.linalg.norm(design, axis=0)
    design = design[:, length > _REST * length.max()]
    if np.linalg.cond(design / np.linalg.norm(design, axis=0)) > 1e6 or len(output) <= design.shape[1]:
        return float("nan"), float("nan")
    value, covariance, _ = least_squares(design, output)
    return float(value[0]), float(np.sqrt(covariance[0, 0]))


def attenuation(run: Run) -> np.ndarray:
    """Return the attenuation of a rotating vector in its mean over the arc s of each row, sin(s/2)/(s/2), (R,)."""
    return np.sinc(run.covariates["table_angle_span"] / _TURN)


def _axial(campaign: Campaign, run: Run, kind: str) -> float:
    """Return the Earth rate or the specific force at rest along the table axis, SI."""
    gravity = np.array([0.0, 0.0, campaign.site.gravity])
    return axial(run, campaign, earth_rate(campaign.site.latitude) if kind == "gyro" else gravity)


def swept(run: Run) -> float:
    """Return the total angle swept in a run, rad: the sum of the arcs of its rows."""
    return float(np.sum(np.abs(run.covariates["table_angle_span"])))


def left_after(angle: float) -> float:
    """Return the fraction of a rotating vector that remains in its mean over an angle in rad."""
    share = abs(float(np.sinc(angle / _TURN)))
    return share if share > _ROUNDING else 0.0


def _left(
    campaign: Campaign, run: Run, biases: Sequence[tuple[Channel, float]], kind: str, unit: str, factor: float
) -> list[TextbookResult]:
    angle = swept(run)
    if len(biases) < 3 or angle < _LEAST_ARC or run.mounting is None:
        return []
    bias = campaign.mountings[run.mounting].body_to_table @ bias_vector(biases)
    in_plane, along = float(np.hypot(bias[0], bias[1])), abs(float(bias[2]))
    turns = angle / _TURN
    whole = np.floor(turns + 1e-6)
    nan = float("nan")
    return [
        Estimate(f"{name}[{kind}]", run.name, value / factor, nan, unit, f"{METHOD}: {condition}")
        for name, value, condition in (
            ("left_in_plane", in_plane * left_after(angle), f"across the axis, after {turns:.2f} turns"),
            ("left_in_plane_whole", in_plane * left_after(_TURN * whole), f"across the axis, after {whole:.0f} turns"),
            ("left_along_axis", along, "along the axis, after any number of turns"),
        )
    ]


def bias_vector(biases: Sequence[tuple[Channel, float]]) -> np.ndarray:
    """Return the bias vector in body axes from the biases of three or more channels, shape (3,)."""
    axes = np.stack([channel.axes[0] for channel, _ in biases])
    return np.linalg.pinv(axes) @ np.array([bias for _, bias in biases])


@dataclass(frozen=True)
class Carrier:
    """The motion of the carrier, demodulated: in table axes at angle 0.

    Attributes
    ----------
    time : shape (R,), s; the row index if the run has no time.
    angle : shape (R,), table angle, rad.
    rate, force : shape (R, 3), rad/s and m/s²; NaN if the unit has fewer than three channels of the kind.
    """

    time: np.ndarray
    angle: np.ndarray
    rate: np.ndarray
    force: np.ndarray


def carrier(campaign: Campaign, run: Run, biases: Mapping[str, float] | None = None) -> Carrier:
    """Return the rate and specific force of the carrier, demodulated by the recorded table angle and rate.

    Parameters
    ----------
    biases : channel → bias to subtract first, rad/s or m/s².
    """
    assert run.mounting is not None
    body_to_table = campaign.mountings[run.mounting].body_to_table
    angle = run.covariates["table_angle"]
    found = {kind: _vector(campaign, run, kind, biases or {}) @ body_to_table.T for kind in ("gyro", "accelerometer")}
    found["gyro"][:, 2] -= run.covariates["table_rate"]
    c, s, mean = np.cos(angle), np.sin(angle), attenuation(run)
    for vector in found.values():
        x, y = vector[:, 0] / mean, vector[:, 1] / mean
        vector[:, 0], vector[:, 1] = c * x - s * y, s * x + c * y
    time = run.covariates.get("time", np.arange(run.rows, dtype=float))
    return Carrier(time, angle, found["gyro"], found["accelerometer"])


def _vector(campaign: Campaign, run: Run, kind: str, biases: Mapping[str, float]) -> np.ndarray:
    """Return the vector measured by the channels of a kind, body axes, (R, 3); NaN for fewer than three."""
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

"""Polar-axis tumble: a gyro in static positions about an axis parallel to the Earth's axis (P4).

The textbook treats a single-degree-of-freedom gyro with torque-rebalance readout.  With the output axis along (O→Np)
or against (O→Sp) the table axis and the input axis in the plane of the table, the Earth rate along the input axis is
zero, and the output over the torquer scale factor is the drift

    d = D_F + D_I f_I + D_O f_O + D_S f_S + D_II f_I² + D_OO f_O² + D_SS f_S²
            + D_IO f_I f_O + D_OS f_O f_S + D_SI f_S f_I.

At the table angle φ gravity is (0, −cos L, sin L) in the table's axes at φ = 0.  With ψ = φ + φ0 such that
f_I = −cos L sin ψ, the spin axis S = I × O sees f_S = ±cos L cos ψ and the output axis f_O = ±sin L, + for O→Np.
So the five Fourier coefficients of the two sweeps are, + for N and − for S,

    B0 = D_F ± D_O sin L + D_OO sin² L + ½(D_II + D_SS) cos² L
    S1 = −D_I cos L ∓ ½ D_IO sin 2L        C1 = ±D_S cos L + ½ D_OS sin 2L
    C2 = ½(D_SS − D_II) cos² L             S2 = ∓½ D_SI cos² L

(IEEE Std 517).  The ten coefficients are not all separable: D_F + D_OO sin² L + ½(D_II + D_SS) cos² L is determined
only as a sum and D_II − D_SS as a difference.  A sweep with the input axis along the pole adds f_I = sin L and leaves
only D_F and D_II + D_OO + D_SS inseparable, since f_I² + f_O² + f_S² = 1 g² in every static position.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imubayes.campaign_data import Campaign, Channel, Run
from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.textbook import (
    Estimate,
    TextbookResult,
    Undetermined,
    along_table,
    components,
    harmonics,
    measured,
)

METHOD = "IEEE Std 517 polar-axis tumble"
_ALONG = 0.999
_DEGREE_PER_HOUR = np.pi / 180 / 3600


@dataclass(frozen=True)
class Sweep:
    """Fourier coefficients B0, C1, S1, C2, S2 of one sweep, rad/s, with standard deviations."""

    run: Run
    value: np.ndarray
    sd: np.ndarray


def combined(north: Sequence[Any], south: Sequence[Any], c: Any, s: Any) -> dict[str, Any]:
    """Return the drift coefficients of two sweeps, and the sum that they do not separate.

    Parameters
    ----------
    north, south : B0, C1, S1, C2, S2 with the output axis to the north and to the south pole: numbers or symbols.
    c, s : cosine and sine of the latitude.
    """
    both = 2 * s * c
    (b_n, c1_n, s1_n, c2_n, s2_n), (b_s, c1_s, s1_s, c2_s, s2_s) = north, south
    return {
        "D_I": -(s1_n + s1_s) / (2 * c),
        "D_O": (b_n - b_s) / (2 * s),
        "D_S": (c1_n - c1_s) / (2 * c),
        "D_IO": -(s1_n - s1_s) / both,
        "D_OS": (c1_n + c1_s) / both,
        "D_SI": -(s2_n - s2_s) / c**2,
        "D_II-D_SS": -(c2_n + c2_s) / c**2,
        "D_F+D_OO·sin²L+½(D_II+D_SS)·cos²L": (b_n + b_s) / 2,
    }


_UNITS = {"D_I": "deg/h/g", "D_O": "deg/h/g", "D_S": "deg/h/g", "D_F+D_OO·sin²L+½(D_II+D_SS)·cos²L": "deg/h"}
_JOINT = {
    "D_I": "gyro_g_sensitivity.d_i", "D_O": "gyro_g_sensitivity.d_o", "D_S": "gyro_g_sensitivity.d_s",
    "D_IO": "gyro_g2_sensitivity.d_io", "D_OS": "gyro_g2_sensitivity.d_os", "D_SI": "gyro_g2_sensitivity.d_si",
}  # fmt: skip
"""Textbook symbol → parameter of the joint fit."""


def polar_tumble_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return the drift coefficients of every gyro with sweeps for both directions of its output axis."""
    found: list[TextbookResult] = []
    for channel in campaign.of_kind("gyro"):
        sweeps: dict[bool, Sweep] = {}
        for run in runs:
            outputs = {gyro.name: output for gyro, output in measured(run, campaign, "gyro")}
            toward_pole = float(along_table(run, campaign, channel.axes[1])[2])
            if channel.name not in outputs or abs(toward_pole) < _ALONG:
                continue
            if len(run.covariates["table_angle"]) % 4:
                found.append(Undetermined(run.name, "the number of positions is not a multiple of 4"))
                continue
            sweeps[toward_pole > 0] = _sweep(run, campaign, channel, outputs[channel.name])
        if len(sweeps) < 2:
            if sweeps:
                only = next(iter(sweeps.values())).run.name
                missing = f"{channel.name}: a sweep with its output axis to the other pole is needed"
                found.append(Undetermined(only, missing))
            continue
        found += _of_channel(campaign, channel.name, sweeps[True], sweeps[False])
    return found


def _sweep(run: Run, campaign: Campaign, channel: Channel, output: np.ndarray) -> Sweep:
    force = components(run, campaign, channel)
    north = along_table(run, campaign, channel.axes[1])[2] > 0
    psi = np.arctan2(-force[0], force[2] if north else -force[2])
    value, covariance = harmonics(psi, output / channel.scale_si, 2)
    return Sweep(run, value, np.sqrt(np.diag(covariance)))


def _of_channel(campaign: Campaign, name: str, north: Sweep, south: Sweep) -> list[TextbookResult]:
    latitude = float(np.cos(campaign.site.latitude)), float(np.sin(campaign.site.latitude))
    values = combined(north.value.tolist(), south.value.tolist(), *latitude)
    # The combinations are linear: propagate the standard deviation of each Fourier coefficient by itself.
    zero = [0.0] * 5
    errors = [combined(error, zero, *latitude) for error in np.diag(north.sd).tolist()]
    errors += [combined(zero, error, *latitude) for error in np.diag(south.sd).tolist()]
    sd = {key: float(np.sqrt(sum(each[key] ** 2 for each in errors))) for key in values}
    runs = f"{north.run.name}, {south.run.name}"
    found: list[TextbookResult] = [
        Estimate(
            f"{_JOINT.get(key, key)}[{name}]", runs, value / _DEGREE_PER_HOUR,
            sd[key] / _DEGREE_PER_HOUR, _UNITS.get(key, "deg/h/g^2"), METHOD,
        )
        for key, value in values.items()
    ]  # fmt: skip
    found.append(
        Undetermined(
            runs,
            f"{name}: D_F, D_OO and D_II + D_SS apart from each other; a sweep with the input axis along the pole "
            "separates them, except D_F from D_II + D_OO + D_SS (|f| = 1 g in every static position)",
        )
    )
    return found


POLAR_TUMBLE = Procedure(
    name="polar_tumble",
    reference="IEEE Std 517, tumble test with the output axis parallel to the Earth's axis",
    columns=(("table_angle_deg",),),
    needs_table=True,
    reduction=Reduction.AT_REST,
    abscissae=("table_angle", "time"),
    evaluate=polar_tumble_test,
)

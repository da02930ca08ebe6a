"""Dividing head: multipoint tumble in static positions about a horizontal axis (P7).

The textbook derives the model coefficients from harmonics of the output.  The output or the pendulous axis lies along
the horizontal axis; ψ is the angle from a_i = +1 g, so that a_i = cos ψ and a_x = sin ψ, x the other axis in the plane
of rotation.  By the power-to-multiple-angle identities

    E/K1 = K0 + a_i + K2 a_i² + K3 a_i³ + K_oq a_i|a_i| + K_xx a_x² + δ a_x + K_ix a_i a_x

has the harmonics (over K1)

    B0 = K0 + (K2 + K_xx)/2           C1 = 1 + 3/4 K3 + 8/(3π) K_oq      S1 = δ
    C2 = (K2 − K_xx)/2                S2 = K_ix/2
    C3 = K3/4 + 8/(15π) K_oq          C5 = −8/(105π) K_oq

(IEEE Std 1293, multipoint tumble).  As sin² + cos² = 1, K_xx is not separable; like the textbook, assume K_xx = 0.
"""

from collections.abc import Sequence

import numpy as np

from imubayes.campaign_data import Campaign, Channel, Run
from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.planned_steps import PlannedRows, PlannedSteps, PlanRules
from imubayes.procedures.textbook import (
    Estimate,
    TextbookResult,
    Undetermined,
    along_table,
    components,
    harmonics,
    measured,
    order_of,
)
from imubayes.units import to_si

METHOD = "IEEE Std 1293 tumble test"
_ACROSS = 0.05


def tumble_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return the model coefficients of every accelerometer whose input axis turns in the vertical plane."""
    found: list[TextbookResult] = []
    for run in runs:
        angle = run.covariates["table_angle"] % (2 * np.pi)
        positions = len(np.unique(np.round(angle, 9)))
        gaps = np.diff(np.sort(angle), append=np.sort(angle)[0] + 2 * np.pi)
        if positions < 4 or gaps.max() > 1.5 * 2 * np.pi / positions:
            found.append(Undetermined(run.name, f"{positions} positions are not evenly spaced over the circle"))
            continue
        for channel, output in measured(run, campaign, "accelerometer"):
            found += _of_channel(run, campaign, channel, output, positions)
    return found


def _of_channel(
    run: Run, campaign: Campaign, channel: Channel, output: np.ndarray, positions: int
) -> list[TextbookResult]:
    axes = [along_table(run, campaign, axis) for axis in channel.axes]
    if abs(axes[0][2]) > _ACROSS:
        return []  # along the axis of rotation, or oblique to it: not a tumble of this channel
    other = next((place for place in (1, 2) if abs(axes[place][2]) < _ACROSS), None)
    if other is None:
        return [Undetermined(run.name, f"{channel.name}: neither its output nor its pendulous axis lies in the plane")]
    force = components(run, campaign, channel)
    # ψ is measured from the position with the input axis up, in the table's sense of rotation.
    psi = np.arctan2(force[other], force[0])
    letter = "o" if other == 1 else "p"
    b, covariance = harmonics(psi, output, order_of(positions))
    sd = np.sqrt(np.diag(covariance))
    gravity, per = campaign.site.gravity, to_si(channel.per, campaign.site.gravity)
    third = positions > 6
    k1 = b[1] - 3 * b[5] if third else b[1]
    scale = abs(k1)
    unit = f"{channel.output_unit} per {channel.per}"
    micro = 1e6 / scale

    def estimate(name: str, value: float, uncertainty: float, of: str) -> Estimate:
        return Estimate(f"{name}[{channel.name}]", run.name, float(value), float(uncertainty), of, METHOD)

    k1_sd = float(np.hypot(sd[1], 3 * sd[5])) if third else float(sd[1])
    found: list[TextbookResult] = [
        estimate("scale_factor", k1 / gravity * per, k1_sd / gravity * per, unit),
        estimate("accel_bias.bias", (b[0] - b[3]) * micro, np.hypot(sd[0], sd[3]) * micro, "ug"),
        estimate(f"accel_misalignment.toward_{letter}", _arcsec(b[2] / k1), _arcsec(sd[2] / scale), "arcsec"),
        estimate("accel_quadratic.quadratic", 2 * b[3] * micro, 2 * sd[3] * micro, "ug/g^2"),
    ]
    if len(b) > 4:
        found.append(estimate(f"accel_cross_coupling.k_i{letter}", 2 * b[4] * micro, 2 * sd[4] * micro, "ug/g^2"))
    if third:
        found.append(estimate("accel_cubic.cubic", 4 * b[5] * micro, 4 * sd[5] * micro, "ug/g^3"))
    else:
        found.append(Undetermined(run.name, f"{channel.name}: {positions} points do not separate K3 from K1"))
    found.append(
        Undetermined(
            run.name,
            f"{channel.name}: K_{letter}{letter} apart from K0 and K2 (sin² + cos² = 1); the textbook assumes zero",
        )
    )
    return found


def _arcsec(angle: float) -> float:
    return float(np.degrees(angle) * 3600)


def _planned_rows(steps: PlannedSteps) -> PlannedRows:
    angle = np.array(steps.angles_deg or 360.0 * np.arange(steps.positions or 0) / (steps.positions or 1))
    return PlannedRows(np.full(len(angle), steps.duration), {"table_angle_deg": angle})


DIVIDING_HEAD = Procedure(
    name="dividing_head",
    reference="IEEE Std 1293, multipoint tumble test",
    columns=(("table_angle_deg",),),
    needs_table=True,
    reduction=Reduction.AT_REST,
    abscissae=("table_angle", "time"),
    plan=PlanRules(("positions", "angles_deg"), ("converter_temperature_degC",), 10.0, _planned_rows),
    evaluate=tumble_test,
)

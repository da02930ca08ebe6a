"""Servo table: the gyro's own output drives the table, so that it always reads nothing (P6).

What is recorded is the table's angle, over hours.  It follows the differential equation that the balance of the gyro's
output gives: about the pole, dφ/dt = −ω_E·IA − d(f(φ)).

The textbook takes the drift from the table's own rate.  The gyro holds its input axis still, so that with IA along the
axis of the table (c = ±1 the cosine between them) the table turns at

    c dφ/dt = −ω_a c − d(f(φ)),

ω_a being the Earth's rate along the axis.  Over blocks of the record −c Δφ/Δt − ω_a c is fitted by least squares with

    D + (D_O + D_IO f_I) f_O + (D_S + D_SI f_I) f_S + ½(D_OO − D_SS)(f_O² − f_S²) + D_OS f_O f_S + r (t − t̄),

f_I being constant.  D is all that does not turn: D_F + D_I f_I + D_II f_I² + ½(D_OO + D_SS)(f_O² + f_S²).  In less than
one turn the terms are not told apart, and the mean drift over the arc is all there is.
"""

import math
from collections.abc import Sequence

import numpy as np

from imubayes.earth import earth_rate
from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.textbook import (
    Estimate,
    TextbookResult,
    Undetermined,
    along_table,
    axial,
    components,
    least_squares,
)
from imubayes.run import Campaign, Channel, Run

METHOD = "IEEE Std 517 servo table test"
_DEGREE_PER_HOUR = np.pi / 180 / 3600
_HOUR = 3600.0
_BLOCKS_PER_TURN, _FEWEST_BLOCKS = 96, 24
_ALONG = 0.99


def servo_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return the drift of the driving gyro from every record, with its harmonics where the record holds a turn."""
    gyros = [channel for channel in campaign.channels if channel.kind == "gyro"]
    found: list[TextbookResult] = []
    for run in runs:
        channel = gyros[driving_channel(campaign, run)]
        cosine = float(along_table(run, campaign, channel.axes[0])[2])
        if abs(cosine) < _ALONG:
            found.append(Undetermined(run.name, f"{channel.name}: its input axis is not along the axis of the table"))
        else:
            found += _of_run(campaign, run, channel, float(np.sign(cosine)))
    return found


def _of_run(campaign: Campaign, run: Run, channel: Channel, cosine: float) -> list[TextbookResult]:
    time, angle = run.covariates["time"], run.covariates["table_angle"]
    turns = turns_of(run)
    count = min(max(_FEWEST_BLOCKS, int(_BLOCKS_PER_TURN * turns)), len(time) // 2)
    edges = np.linspace(0, len(time) - 1, count + 1).astype(int)
    rate = np.diff(angle[edges]) / np.diff(time[edges])
    drift = (-cosine * rate - cosine * axial(run, campaign, earth_rate(campaign.site.latitude))) / _DEGREE_PER_HOUR
    whole, half = drift.mean(), float(np.std(drift, ddof=1)) / np.sqrt(count)
    if turns < 1.0:
        return [
            Estimate(f"mean_drift[{channel.name}]", run.name, float(whole), half, "deg/h", METHOD),
            Undetermined(run.name, f"{channel.name}: {turns:.2f} turns do not tell what turns from what does not"),
        ]
    middle, when = (angle[edges[1:]] + angle[edges[:-1]]) / 2, (time[edges[1:]] + time[edges[:-1]]) / 2
    _, f_o, f_s = components(run, campaign, channel, middle)
    hours = (when - when.mean()) / _HOUR
    design = np.stack([np.ones_like(middle), f_o, f_s, (f_o**2 - f_s**2) / 2, f_o * f_s, hours], axis=1)
    value, covariance, _ = least_squares(design, drift)
    sd = np.sqrt(np.diag(covariance))
    names = ("D", "D_O+D_IO·f_I", "D_S+D_SI·f_I", "D_OO-D_SS", "gyro_g2_sensitivity.d_os", "gyro_bias_drift.slope")
    units = ("deg/h", "deg/h/g", "deg/h/g", "deg/h/g^2", "deg/h/g^2", "deg/h/h")
    return [
        Estimate(f"{name}[{channel.name}]", run.name, float(one), float(error), unit, METHOD)
        for name, unit, one, error in zip(names, units, value, sd, strict=True)
    ]


def driving_channel(campaign: Campaign, run: Run) -> int:
    """Return the place among the gyros of the one that drives the table: the one most along its axis."""
    assert run.mounting is not None
    axis = campaign.mountings[run.mounting].body_to_table[2]
    gyros = [channel for channel in campaign.channels if channel.kind == "gyro"]
    return int(np.argmax([abs(float(channel.axes[0] @ axis)) for channel in gyros])) if gyros else 0


def turns_of(run: Run) -> float:
    """Return the angle that a table has been driven through, in turns."""
    return float(np.ptp(run.covariates["table_angle"])) / (2 * math.pi)


SERVO_TABLE = Procedure(
    name="servo_table",
    reference="IEEE Std 517, servo table test",
    columns=(("time_s",), ("table_angle_deg",)),
    needs_table=True,
    needs_gyro=True,
    reduction=Reduction.FOLLOWED,
    driven=True,
    abscissae=("time", "table_angle"),
    evaluate=servo_test,
)

"""Servo table: a closed loop nulls the gyro output by driving the table (P6).

The table angle is recorded over hours.  It follows the differential equation of the nulled output: about the polar
axis, dφ/dt = −ω_E·IA − d(f(φ)).

The textbook derives the drift from the table rate.  With IA along the table axis (c = ±1 the cosine between them) the
table turns at

    c dφ/dt = −ω_a c − d(f(φ)),

with ω_a the Earth rate along the axis.  Over blocks of the record −c Δφ/Δt − ω_a c is fitted by least squares with

    D + (D_O + D_IO f_I) f_O + (D_S + D_SI f_I) f_S + ½(D_OO − D_SS)(f_O² − f_S²) + D_OS f_O f_S + r (t − t̄),

f_I being constant.  D holds the constant terms: D_F + D_I f_I + D_II f_I² + ½(D_OO + D_SS)(f_O² + f_S²).  In less than
one turn the terms are not separable; only the mean drift over the arc is returned.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.foundations.earth import earth_rate
from imubayes.procedures import textbook
from imubayes.procedures.ambient import ambient_of
from imubayes.procedures.base import PlannedRows, PlannedSteps, PlanRules, Procedure, Reduction
from imubayes.procedures.fitted_terms import LinearCombination, StandardCombination, of_drift, turn_mean_drift
from imubayes.procedures.textbook import DEGREE_PER_HOUR, Evaluation, TextbookResult, Undetermined

METHOD = "IEEE Std 517 servo table test"
_HOUR = 3600.0
_BLOCKS_PER_TURN, _FEWEST_BLOCKS = 96, 24
_ALONG = 0.99


def servo_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return the drift of the driving gyro from every record, with its harmonics if the record covers a turn."""
    gyros = campaign.of_kind("gyro")
    found: list[TextbookResult] = []
    for run in runs:
        channel = gyros[driving_channel(campaign, run)]
        cosine = float(textbook.along_table(run, campaign, channel.axes[0])[2])
        if abs(cosine) < _ALONG:
            found.append(Undetermined(run.name, f"{channel.name}: its input axis is not along the axis of the table"))
        else:
            found += _of_run(campaign, run, channel, float(np.sign(cosine)), _total_drift(runs, run, channel))
    return found


def _of_run(campaign: Campaign, run: Run, channel: Channel, cosine: float, total: str) -> list[TextbookResult]:
    time, angle = run.covariates["time"], run.covariates["table_angle"]
    turns = turns_of(run)
    count = min(max(_FEWEST_BLOCKS, int(_BLOCKS_PER_TURN * turns)), len(time) // 2)
    edges = np.linspace(0, len(time) - 1, count + 1).astype(int)
    rate = np.diff(angle[edges]) / np.diff(time[edges])
    drift = (
        -cosine * rate - cosine * textbook.axial(run, campaign, earth_rate(campaign.site.latitude))
    ) / DEGREE_PER_HOUR
    whole, half = drift.mean(), float(np.std(drift, ddof=1)) / np.sqrt(count)
    tested = Evaluation(channel.name, run.name, METHOD)
    if turns < 1.0:
        left = f"{channel.name}: in {turns:.2f} turns constant and rotating terms are not separable"
        return [tested.estimate("mean_drift", whole, half, "deg/h"), Undetermined(run.name, left)]
    middle, when = (angle[edges[1:]] + angle[edges[:-1]]) / 2, (time[edges[1:]] + time[edges[:-1]]) / 2
    _, f_o, f_s = textbook.components(run, campaign, channel, middle)
    hours = (when - when.mean()) / _HOUR
    design = np.stack([np.ones_like(middle), f_o, f_s, (f_o**2 - f_s**2) / 2, f_o * f_s, hours], axis=1)
    value, covariance, _ = textbook.least_squares(design, drift)
    sd = np.sqrt(np.diag(covariance))
    units = {
        "D_O+D_IO·f_I": "deg/h/g", "D_S+D_SI·f_I": "deg/h/g", "D_OO-D_SS": "deg/h/g^2",
        "gyro_g2_sensitivity.d_os": "deg/h/g^2", "gyro_bias_drift.slope": "deg/h/h",
    }  # fmt: skip
    middle_drift = replace(tested, of=total).estimate("D", value[0], sd[0], "deg/h", "in the middle of the record")
    rest = zip(units.items(), value[1:], sd[1:], strict=True)
    return [middle_drift, *(tested.estimate(name, size, error, unit) for (name, unit), size, error in rest)]


def _total_drift(runs: Sequence[Run], run: Run, channel: Channel) -> str:
    """Return of what the total drift is: also of its run if several records cover a turn, as it drifts with time."""
    whole = [other for other in runs if turns_of(other) >= 1.0]
    return channel.name if len(whole) < 2 else f"{channel.name},{run.name}"


def combinations(campaign: Campaign, runs: Sequence[Run]) -> list[StandardCombination]:
    """Return the total drift D in the middle of each record, and the harmonics that the records determine."""
    gyros = campaign.of_kind("gyro")
    found: list[StandardCombination] = []
    # A joint fit may separate the terms from somewhat less than a turn as well.
    for run in [run for run in runs if turns_of(run) >= 1.0] or [max(runs, key=turns_of)]:
        channel = gyros[driving_channel(campaign, run)]
        if abs(float(textbook.along_table(run, campaign, channel.axes[0])[2])) < _ALONG:
            continue
        constant = turn_mean_drift(campaign, run, channel)
        total = of_drift("D", channel.name, "deg/h", constant, total=True)
        time = ambient_of(run, np.arange(run.rows), campaign).get("campaign_time")
        later = {} if time is None else {f"gyro_bias_drift.slope[{channel.name}]": float(np.mean(time)) / _HOUR}
        name = f"D[{_total_drift(runs, run, channel)}]"
        found.append(LinearCombination(name, "deg/h", {**total.weights, **later}, total=True, middle_of=run.name))
        along = constant.get("D_I", 0.0)
        found += [
            of_drift("D_O+D_IO·f_I", channel.name, "deg/h/g", {"D_O": 1.0, "D_IO": along}),
            of_drift("D_S+D_SI·f_I", channel.name, "deg/h/g", {"D_S": 1.0, "D_SI": along}),
            of_drift("D_OO-D_SS", channel.name, "deg/h/g^2", {"D_OO": 1.0, "D_SS": -1.0}),
        ]
    return found


def driving_channel(campaign: Campaign, run: Run) -> int:
    """Return the index, among the gyros, of the one that drives the table: the one best aligned with its axis."""
    assert run.mounting is not None
    axis = campaign.mountings[run.mounting].body_to_table[2]
    gyros = campaign.of_kind("gyro")
    return int(np.argmax([abs(float(channel.axes[0] @ axis)) for channel in gyros])) if gyros else 0


def turns_of(run: Run) -> float:
    """Return the range of the table angle, in turns."""
    return float(np.ptp(run.covariates["table_angle"])) / (2 * math.pi)


_SECONDS_PER_READING = 60.0


def _planned_rows(steps: PlannedSteps) -> PlannedRows:
    """Return readings of the angle at equal intervals; the angle itself is simulated."""
    seconds = steps.seconds_per_row or _SECONDS_PER_READING
    rows = max(2, round((steps.hours or 1.0) * _HOUR / seconds))
    return PlannedRows(np.full(rows, seconds), {"table_angle_deg": np.zeros(rows)})


def _nominal_columns(
    columns: dict[str, np.ndarray], site: Site, table: Table, _mounting: Mounting
) -> dict[str, np.ndarray]:
    """Return the angle of a table that keeps the nulled gyro from turning with the Earth: dφ/dt = −ω_a."""
    along = float(table.to_local[:, 2] @ earth_rate(site.latitude))
    return {"table_angle_deg": -np.degrees(along) * columns["time_s"]}


SERVO_TABLE = Procedure(
    name="servo_table",
    reference="IEEE Std 517, servo table test",
    columns=(("time_s",), ("table_angle_deg",)),
    needs_table=True,
    needs_gyro=True,
    reduction=Reduction.FOLLOWED,
    driven=True,
    abscissae=("time", "table_angle"),
    plan=PlanRules(("hours",), (), 0.0, _planned_rows, _nominal_columns),
    evaluate=servo_test,
    combinations=combinations,
)

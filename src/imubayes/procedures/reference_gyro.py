"""Comparison with a reference gyro: the table need not hold a constant rate (P9).

The reference gyro turns with the unit and measures the inertial rate in body axes, including the Earth rate. Its output
is used as the true rate: its noise is `reference_noise`; its scale factor, bias, alignment and time delay are effects,
and its certificate states their priors, which belong in the model file. The table gives the attitude to gravity.

The textbook matches the speeds of forward and reverse rotation.  Both reach a speed v of the table, each at an instant
of its own; between two rows speed and output are taken as linear.  There, with the outputs E₊ and E₋ of a channel and
r₊, r₋ of the reference along the channel's input axis,

    K = (E₊ − E₋)/(r₊ − r₋),   bias = (E₊ + E₋)/(2K) − (r₊ + r₋)/2,

and for a channel perpendicular to the axis of rotation ((E₊ − E₋)/K − (r₊ − r₋))/(2v) is its inclination towards that
axis, K being nominal.  All forward and reverse runs of a mounting at one temperature are matched together, and every
row takes part in one match at most, so that matches are independent.  The reference, its clock and its mounting are
taken as exact.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.foundations.earth import earth_rate
from imubayes.foundations.units import to_si
from imubayes.procedures import textbook
from imubayes.procedures.base import PlannedRows, PlannedSteps, PlanRules, Procedure, Reduction
from imubayes.procedures.kinematics import Stimulus, table_stimulus, turned_back
from imubayes.procedures.textbook import ARCSEC, DEGREE_PER_HOUR, Evaluation, TextbookResult, Undetermined

AXES = ("reference_x", "reference_y", "reference_z")

METHOD = "matched speeds beside a reference gyro"
_SCATTER = "type A: scatter over the instants"
_ALONG, _ACROSS = 0.5, 0.05
# Speeds within a part in a thousand are the same: the estimates contain the rates of both runs, not their mean.
_SAME_SPEED = 1e-3


def reference_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return scale factor and bias of gyros along an axis of rotation, and the inclination of perpendicular ones."""
    by_mounting: dict[str, list[Run]] = defaultdict(list)
    for run in runs:
        if run.mounting is not None:
            by_mounting[run.mounting].append(run)
    found: list[TextbookResult] = []
    for mounted in by_mounting.values():
        for group in textbook.by_temperature(mounted):
            found += _of_group(campaign, group)
    return found


def _speed(run: Run, campaign: Campaign) -> np.ndarray:
    """Return the rate of the table from the reference, less the Earth rate along the axis, rad/s, shape (R,)."""
    assert run.mounting is not None
    inertial = reference_rate(run) @ campaign.mountings[run.mounting].body_to_table[2]
    return inertial - (
        textbook.axial(run, campaign, earth_rate(campaign.site.latitude)) if run.table is not None else 0.0
    )


@dataclass(frozen=True)
class Steps:
    """Pairs of successive rows in one sense of rotation, each row in one pair at most.

    Attributes
    ----------
    speed : shape (n, 2), rad/s, positive.
    reference : shape (n, 2, 3), rate measured by the reference, body axes, rad/s.
    output : shape (n, 2, C), channel outputs less the nominal offset.
    """

    speed: np.ndarray
    reference: np.ndarray
    output: np.ndarray

    def at(self, values: np.ndarray, step: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Return what was recorded at a speed within each of the named steps, by linear interpolation."""
        first, last = self.speed[step, 0], self.speed[step, 1]
        flat = first == last
        part = np.clip(np.where(flat, 0.5, (speed - first) / np.where(flat, 1.0, last - first)), 0.0, 1.0)
        part = part.reshape(-1, *[1] * (values.ndim - 2))
        return values[step, 0] * (1 - part) + values[step, 1] * part


def steps_of(campaign: Campaign, runs: Sequence[Run], sign: float) -> Steps:
    """Return the steps of runs that rotate in a sense, +1 forward or −1 reverse."""
    speed, reference, output = [], [], []
    offset = np.array([channel.offset for channel in campaign.channels])
    for run in runs:
        order = np.argsort(run.covariates["time"], kind="stable")
        turning = sign * _speed(run, campaign)[order]
        pairs = np.arange(run.rows // 2 * 2).reshape(-1, 2)
        pairs = pairs[(turning[pairs] > 0).all(axis=1)]
        speed.append(turning[pairs])
        reference.append(reference_rate(run)[order][pairs])
        output.append((run.observed - offset)[order][pairs])
    return Steps(np.concatenate(speed), np.concatenate(reference), np.concatenate(output))


def matched(forward: np.ndarray, reverse: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return steps forward and reverse that pass the same speed, and that speed, (m,) each.

    Parameters
    ----------
    forward, reverse : speeds at both ends of every step, (n, 2).
    """
    ends = [np.sort(speeds, axis=1) for speeds in (forward, reverse)]
    ranked = [np.argsort(each.sum(axis=1), kind="stable").tolist() for each in ends]
    found: list[tuple[int, int, float]] = []
    i = j = 0
    while i < len(ranked[0]) and j < len(ranked[1]):
        one, other = ranked[0][i], ranked[1][j]
        low = max(ends[0][one, 0], ends[1][other, 0])
        high = min(ends[0][one, 1], ends[1][other, 1])
        together = low <= high + _SAME_SPEED * abs(high)
        if together:
            found.append((one, other, (low + high) / 2))
        lower = ends[0][one, 1] < ends[1][other, 0]
        i, j = i + (together or lower), j + (together or not lower)
    table = np.array(found, dtype=float).reshape(-1, 3)
    return table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2]


def _of_group(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    names = textbook.names_of(runs)
    forward, reverse = (steps_of(campaign, runs, sign) for sign in (1.0, -1.0))
    if not len(forward.speed) or not len(reverse.speed):
        return [Undetermined(names, "one direction of rotation only: no speeds to match")]
    ahead, back, speed = matched(forward.speed, reverse.speed)
    if not len(speed):
        spans = [np.degrees([steps.speed.min(), steps.speed.max()]) for steps in (forward, reverse)]
        text = ", ".join(
            f"{way} {span[0]:.4g} … {span[1]:.4g} °/s" for way, span in zip(("forward", "reverse"), spans, strict=True)
        )
        return [Undetermined(names, f"no speed is common to both directions: {text}")]
    found: list[TextbookResult] = []
    outputs = forward.at(forward.output, ahead, speed), reverse.at(reverse.output, back, speed)
    rates = forward.at(forward.reference, ahead, speed), reverse.at(reverse.reference, back, speed)
    for place, channel in enumerate(campaign.channels):
        there = np.isfinite(outputs[0][:, place]) & np.isfinite(outputs[1][:, place])
        if channel.kind != "gyro" or not there.any():
            continue
        plus, minus = (each[there, place] for each in outputs)
        r_plus, r_minus = (each[there] @ channel.axes[0] for each in rates)
        cosine = float(textbook.along_table(runs[0], campaign, channel.axes[0])[2])
        if abs(cosine) > _ALONG:
            found += _along(channel, names, plus, minus, r_plus, r_minus)
        elif abs(cosine) < _ACROSS:
            inclination = ((plus - minus) / channel.scale_si - (r_plus - r_minus)) / (2 * speed[there])
            found += _across(campaign, runs[0], channel, names, inclination)
    return found


def _mean(values: np.ndarray) -> tuple[float, float]:
    """Return the mean and its standard deviation, NaN for a single value."""
    sd = float(np.std(values, ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else float("nan")
    return float(np.mean(values)), sd


def _along(
    channel: Channel, names: str, plus: np.ndarray, minus: np.ndarray, forward: np.ndarray, reverse: np.ndarray
) -> list[TextbookResult]:
    per, unit = to_si(channel.per), f"{channel.output_unit} per {channel.per}"
    scale, scale_sd = _mean((plus - minus) / (forward - reverse))
    bias, bias_sd = _mean(((plus + minus) / (2 * scale) - (forward + reverse) / 2) / DEGREE_PER_HOUR)
    tested = Evaluation(channel.name, names, f"{METHOD}: {len(plus)} instants", _SCATTER)
    return [
        tested.estimate("scale_factor", scale * per, scale_sd * per, unit),
        tested.estimate("gyro_bias.bias", bias, bias_sd, "deg/h"),
    ]


def _across(
    campaign: Campaign, run: Run, channel: Channel, names: str, inclination: np.ndarray
) -> list[TextbookResult]:
    """Return the inclination of an input axis towards an axis of rotation that lies along its O or S axis."""
    cosines = [textbook.along_table(run, campaign, axis)[2] for axis in channel.axes]
    place = next((place for place in (1, 2) if abs(cosines[place]) > 1 - _ACROSS), None)
    if place is None:
        return []
    value, sd = _mean(np.sign(cosines[place]) * inclination)
    tested = Evaluation(channel.name, names, f"{METHOD}: {len(inclination)} instants", _SCATTER)
    name = f"gyro_misalignment.toward_{'o' if place == 1 else 's'}"
    return [tested.estimate(name, value / ARCSEC, sd / ARCSEC, "arcsec")]


def reference_rate(run: Run) -> np.ndarray:
    """Return the rate measured by the reference, body axes, rad/s, shape (R, 3)."""
    return np.stack([run.covariates[name] for name in AXES], axis=1)


def _axis(run: Run, campaign: Campaign) -> np.ndarray:
    """Return the table axis in body axes, shape (3,)."""
    return campaign.mountings[run.mounting].body_to_table[2] if run.mounting is not None else np.array([0.0, 0.0, 1.0])


def _acceleration(time: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the slope of a cubic spline through the rates, (R, 3); finite differences would smooth fast changes."""
    order = np.argsort(time, kind="stable")
    found = np.zeros_like(rate)
    if len(time) > 3 and np.all(np.diff(time[order]) > 0):
        found[order] = scipy.interpolate.CubicSpline(time[order], rate[order]).derivative()(time[order])
    return found


def _stimulus(run: Run, campaign: Campaign) -> Stimulus:
    rate = reference_rate(run)
    nominal = table_stimulus(run, campaign)
    return replace(
        nominal,
        # The reference replaces the table as the source of the rate.
        table_rate=np.zeros_like(nominal.table_rate),
        table_acceleration=np.zeros_like(nominal.table_acceleration),
        reference_rate=rate[nominal.row],
        reference_acceleration=_acceleration(run.covariates["time"], rate)[nominal.row],
        ambient=nominal.ambient | {"table_rate": (rate @ _axis(run, campaign))[nominal.row]},
    )


def _nominal_input(
    run: Run, channel: Channel, _site: Site, _table: Table | None, _mounting: Mounting | None
) -> np.ndarray | None:
    """Return the rate measured by the reference along the channel; None for accelerometers."""
    return reference_rate(run) @ channel.axes[0] if channel.kind == "gyro" else None


_SECONDS_PER_ROW = 2.0


def _planned_rows(steps: PlannedSteps) -> PlannedRows:
    """Return rows whose speeds pass the planned rates in turn, linearly; one rate is held."""
    rows, rates = steps.rows or 1, steps.rates_deg_s or []
    seconds = steps.seconds_per_row or _SECONDS_PER_ROW
    place = (np.arange(rows) + 0.5) / rows * (len(rates) - 1)
    rate = np.interp(place, np.arange(len(rates)), rates)
    span = rate * seconds
    columns = {"table_angle_deg": (np.cumsum(span) - span / 2) % 360.0, "table_angle_span_deg": span}
    return PlannedRows(np.full(rows, seconds), columns)


def _nominal_columns(
    columns: dict[str, np.ndarray], site: Site, table: Table, mounting: Mounting
) -> dict[str, np.ndarray]:
    """Return what an ideal reference measures: the rotation of the table and the Earth rate, mean over each row."""
    angle, span = np.radians(columns["table_angle_deg"]), np.radians(columns["table_angle_span_deg"])
    seconds = np.gradient(columns["time_s"]) if len(angle) > 1 else np.full(len(angle), _SECONDS_PER_ROW)
    turning = turned_back(table.to_local.T @ earth_rate(site.latitude), angle, np.sinc(span / (2 * np.pi)))
    turning[2] += span / seconds
    felt = np.degrees(turning.T @ mounting.body_to_table)
    return {f"{name}_deg_s": felt[:, place] for place, name in enumerate(AXES)}


REFERENCE_GYRO = Procedure(
    name="reference_gyro",
    reference="IEEE Std 952, comparison with a reference gyro; errors in variables: Fuller (1987)",
    columns=(("time_s",), *((f"{axis}_deg_s",) for axis in AXES)),
    needs_table=True,
    needs_gyro=True,
    reduction=Reduction.FOLLOWED,
    rate_recorded=False,
    abscissae=("time",),
    kinematics=_stimulus,
    nominal_input=_nominal_input,
    plan=PlanRules(("rates_deg_s",), ("rows",), 0.0, _planned_rows, _nominal_columns),
    evaluate=reference_test,
)

"""Comparison with a reference gyro: the table need not hold a constant rate (P9).

The reference gyro turns with the unit and measures the inertial rate in body axes, including the Earth rate.  Its
output is used as the true rate: its noise is `reference_noise`; its scale factor, bias, alignment and time delay are
effects.  The table gives the attitude to gravity.

The textbook matches the speeds of a forward and a reverse run.  At some instants both runs have the same speed v.
There, with the outputs E₊ and E₋ of a channel and r₊, r₋ of the reference along the channel's input axis,

    K = (E₊ − E₋)/(r₊ − r₋),   bias = (E₊ + E₋)/(2K) − (r₊ + r₋)/2,

and for a channel perpendicular to the axis of rotation (E₊ − E₋)/(2 K v) is its inclination towards that axis.  Samples
between those instants are not used; the reference, its clock and its mounting are taken as exact.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from imubayes.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.kinematics import table_stimulus
from imubayes.procedures.nominal_stimulus import Stimulus
from imubayes.procedures.textbook import Estimate, TextbookResult, Undetermined, along_table, measured
from imubayes.units import to_si

AXES = ("reference_x", "reference_y", "reference_z")

METHOD = "matched speeds beside a reference gyro"
_ALONG, _ACROSS = 0.5, 0.05
_DEGREE_PER_HOUR = np.pi / 180 / 3600


def reference_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return scale factor and bias of gyros along an axis of rotation, and the inclination of perpendicular ones."""
    by_mounting: dict[str, dict[bool, list[Run]]] = defaultdict(lambda: {True: [], False: []})
    for run in runs:
        if run.mounting is not None:
            by_mounting[run.mounting][float(np.mean(_speed(run, campaign))) > 0].append(run)
    found: list[TextbookResult] = []
    for forward_runs, reverse_runs in ((group[True], group[False]) for group in by_mounting.values()):
        if not forward_runs or not reverse_runs:
            only = (forward_runs or reverse_runs)[0]
            found.append(Undetermined(only.name, "one direction of rotation only: no speeds to match"))
            continue
        for forward, reverse in zip(forward_runs, reverse_runs, strict=False):
            found += _of_pair(campaign, forward, reverse)
    return found


def _speed(run: Run, campaign: Campaign) -> np.ndarray:
    """Return the rate of the reference about the table axis, rad/s, shape (R,)."""
    assert run.mounting is not None
    return reference_rate(run) @ campaign.mountings[run.mounting].body_to_table[2]


def matched(forward: np.ndarray, reverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where two speeds cross: the row before each crossing, and the fraction to the next row (0 … 1)."""
    count = min(len(forward), len(reverse))
    apart = forward[:count] - reverse[:count]
    before = np.flatnonzero(np.sign(apart[:-1]) * np.sign(apart[1:]) < 0)
    return before, apart[before] / (apart[before] - apart[before + 1])


def _of_pair(campaign: Campaign, forward: Run, reverse: Run) -> list[TextbookResult]:
    before, part = matched(np.abs(_speed(forward, campaign)), np.abs(_speed(reverse, campaign)))
    names = f"{forward.name}, {reverse.name}"
    if not len(before):
        return [Undetermined(names, "the two runs have no matched speeds")]

    def at(values: np.ndarray) -> np.ndarray:
        return values[before] * (1 - part) + values[before + 1] * part

    opposite = {gyro.name: at(output) for gyro, output in measured(reverse, campaign, "gyro")}
    found: list[TextbookResult] = []
    for channel, output in measured(forward, campaign, "gyro"):
        if channel.name not in opposite:
            continue
        plus, minus = at(output), opposite[channel.name]
        cosine = float(along_table(forward, campaign, channel.axes[0])[2])
        if abs(cosine) > _ALONG:
            rates = [at(reference_rate(run) @ channel.axes[0]) for run in (forward, reverse)]
            found += _along(channel, names, plus, minus, *rates)
        elif abs(cosine) < _ACROSS:
            found += _across(campaign, forward, channel, names, (plus - minus) / (2 * at(_speed(forward, campaign))))
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
    bias, bias_sd = _mean(((plus + minus) / (2 * scale) - (forward + reverse) / 2) / _DEGREE_PER_HOUR)
    method = f"{METHOD}: {len(plus)} instants"
    return [
        Estimate(f"scale_factor[{channel.name}]", names, scale * per, scale_sd * per, unit, method),
        Estimate(f"gyro_bias.bias[{channel.name}]", names, bias, bias_sd, "deg/h", method),
    ]


def _across(
    campaign: Campaign, run: Run, channel: Channel, names: str, inclination: np.ndarray
) -> list[TextbookResult]:
    """Return the inclination of an input axis towards an axis of rotation that lies along its O or S axis."""
    cosines = [along_table(run, campaign, axis)[2] for axis in channel.axes]
    place = next((place for place in (1, 2) if abs(cosines[place]) > 1 - _ACROSS), None)
    if place is None:
        return []
    sign = np.sign(cosines[place])
    value, sd = _mean(sign * inclination / channel.scale_si)
    arcsec = np.degrees(1.0) * 3600
    name = f"gyro_misalignment.toward_{'o' if place == 1 else 's'}[{channel.name}]"
    return [Estimate(name, names, value * arcsec, sd * arcsec, "arcsec", METHOD)]


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
        found[order] = CubicSpline(time[order], rate[order]).derivative()(time[order])
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
    evaluate=reference_test,
)

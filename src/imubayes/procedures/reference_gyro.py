"""Runs beside a reference gyro: the table need not hold its rate (P9).

The reference rides along with the unit and measures the inertial rate about the axes of the body, the Earth's with it.
Its reading stands in the place of the true rate; that it is a reading is `reference_noise`, its scale, bias and
alignment and the delay of its clock are effects.  The table says how the unit stands to gravity.

The textbook matches speeds of a forward and a reverse run.  Laid over each other in time, the forward and the reverse
run pass the same speed v at some instants.  There, with the readings E₊ and E₋ of a channel and r₊, r₋ of the reference
along the channel's input axis,

    K = (E₊ − E₋)/(r₊ − r₋),   bias = (E₊ + E₋)/(2K) − (r₊ + r₋)/2,

and for a channel across the axis of rotation (E₊ − E₋)/(2 K v) is its inclination towards it.  All that lies between
those instants is left unused, and the reference, its clock and its seat are taken as exact.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.kinematics import table_stimulus
from imubayes.procedures.nominal_stimulus import Stimulus
from imubayes.procedures.textbook import Estimate, TextbookResult, Undetermined, along_table, measured
from imubayes.run import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.units import to_si

AXES = ("reference_x", "reference_y", "reference_z")

METHOD = "matched speeds beside a reference gyro"
_ALONG, _ACROSS = 0.5, 0.05
_DEGREE_PER_HOUR = np.pi / 180 / 3600


def reference_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return scale factor and bias of every gyro along an axis of rotation, and the inclination of those across."""
    by_seat: dict[str, dict[bool, list[Run]]] = defaultdict(lambda: {True: [], False: []})
    for run in runs:
        if run.mounting is not None:
            by_seat[run.mounting][float(np.mean(_speed(run, campaign))) > 0].append(run)
    found: list[TextbookResult] = []
    for ways in by_seat.values():
        if not ways[True] or not ways[False]:
            only = (ways[True] or ways[False])[0]
            found.append(Undetermined(only.name, "turned one way only: there is nothing to match its speeds with"))
            continue
        for forward, reverse in zip(ways[True], ways[False], strict=False):
            found += _of_pair(campaign, forward, reverse)
    return found


def _speed(run: Run, campaign: Campaign) -> np.ndarray:
    """Return the reference's rate about the table's axis, rad/s, shape (R,)."""
    assert run.mounting is not None
    return reference_rate(run) @ campaign.mountings[run.mounting].body_to_table[2]


def matched(forward: np.ndarray, reverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where two speeds cross: the row before each crossing, and how far on to the next (0 … 1)."""
    count = min(len(forward), len(reverse))
    apart = forward[:count] - reverse[:count]
    before = np.flatnonzero(np.sign(apart[:-1]) * np.sign(apart[1:]) < 0)
    return before, apart[before] / (apart[before] - apart[before + 1])


def _of_pair(campaign: Campaign, forward: Run, reverse: Run) -> list[TextbookResult]:
    before, part = matched(np.abs(_speed(forward, campaign)), np.abs(_speed(reverse, campaign)))
    names = f"{forward.name}, {reverse.name}"
    if not len(before):
        return [Undetermined(names, "the two runs never pass the same speed at the same time")]

    def at(values: np.ndarray) -> np.ndarray:
        return values[before] * (1 - part) + values[before + 1] * part

    opposite = {one.name: at(output) for one, output in measured(reverse, campaign, "gyro")}
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
    """Return the mean and its standard deviation; NaN for one value."""
    sd = float(np.std(values, ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else float("nan")
    return float(np.mean(values)), sd


def _along(channel: Channel, names: str, plus, minus, forward, reverse) -> list[TextbookResult]:
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
    place = next((one for one in (1, 2) if abs(along_table(run, campaign, channel.axes[one])[2]) > 1 - _ACROSS), None)
    if place is None:
        return []
    sign = np.sign(along_table(run, campaign, channel.axes[place])[2])
    value, sd = _mean(sign * inclination / channel.scale_si)
    arcsec = np.degrees(1.0) * 3600
    name = f"gyro_misalignment.toward_{'o' if place == 1 else 's'}[{channel.name}]"
    return [Estimate(name, names, value * arcsec, sd * arcsec, "arcsec", METHOD)]


def reference_rate(run: Run) -> np.ndarray:
    """Return what the reference measured, body axes, rad/s, shape (R, 3)."""
    return np.stack([run.covariates[name] for name in AXES], axis=1)


def _axis(run: Run, campaign: Campaign) -> np.ndarray:
    """Return the table's axis in body axes."""
    return campaign.mountings[run.mounting].body_to_table[2] if run.mounting is not None else np.array([0.0, 0.0, 1.0])


def _acceleration(time: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the slope of a cubic spline through the rates, (R, 3); differences would flatten what wanders fast."""
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
        # The reference knows better.
        table_rate=np.zeros_like(nominal.table_rate),
        table_acceleration=np.zeros_like(nominal.table_acceleration),
        reference_rate=rate[nominal.row],
        reference_acceleration=_acceleration(run.covariates["time"], rate)[nominal.row],
        ambient=nominal.ambient | {"table_rate": (rate @ _axis(run, campaign))[nominal.row]},
    )


def _nominal_input(
    run: Run, channel: Channel, _site: Site, _table: Table | None, _mounting: Mounting | None
) -> np.ndarray | None:
    """Return what the reference measured along the channel; accelerometers have none."""
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

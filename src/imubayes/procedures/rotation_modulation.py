"""Rotation modulation: continuous forward and reverse rotation with recorded table angle (P3).

Of the bias ε of a channel at the angle θ from the axis of rotation, the component ε cos θ along the axis is not
modulated.  The component ε sin θ turns with the unit: over the angle Φ its mean is ε sin θ · |sin(Φ/2)|/(Φ/2), zero
over whole turns.  The same holds for the errors of scale factor and input axes times the rate of rotation: in a run at
constant rate they act like a bias.  The bias is estimated by least squares from the outputs at table angles φ and rates
Ω, forward and reverse,

    E/K = ε + w_a cos θ + s Ω cos θ + A cos φ + B sin φ,

with w_a the Earth rate (for accelerometers the specific force) along the axis; A and B absorb its components
perpendicular to the axis.  θ is nominal and taken as exact.
"""

from collections.abc import Sequence

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.earth import earth_rate
from imubayes.procedures import textbook
from imubayes.procedures.base import PlannedRows, PlannedSteps, PlanRules, Procedure, Reduction
from imubayes.procedures.fitted_terms import StandardCombination, projected_scale_factors
from imubayes.procedures.textbook import DEGREE_PER_HOUR, Evaluation, TextbookResult, Undetermined

METHOD = "rotation modulation"
_UNITS = {"gyro": ("gyro_bias.bias", "deg/h", DEGREE_PER_HOUR), "accelerometer": ("accel_bias.bias", "ug", None)}
_TURN = 2 * np.pi
# Over shorter arcs modulated and unmodulated components are not separable.
_LEAST_ARC = np.pi
_REST = 1e-9
_ROUNDING = 1e-12


def modulation_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return the bias of every channel per mounting, with its modulated and unmodulated components.

    `left_in_plane` is what remains of the modulated errors of a kind after the angle that a run has swept: of biases,
    and of the errors of scale factor and input axes times the rate.
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
    names = textbook.names_of(runs)
    found: list[TextbookResult] = []
    for channel in campaign.of_kind(kind):
        bias, sd = _bias(campaign, runs, channel)
        if not np.isfinite(bias):
            found.append(Undetermined(names, f"{channel.name}: its bias is not separable from its input"))
            continue
        cosine = float(textbook.along_table(runs[0], campaign, channel.axes[0])[2])
        parts = ((name, 1.0), ("modulated", np.sqrt(1 - cosine**2)), ("unmodulated", cosine))
        tested = Evaluation(channel.name, names, METHOD)
        found += [tested.estimate(part, bias * x / factor, sd * abs(x) / factor, unit) for part, x in parts]
    return found + [estimate for run in runs for estimate in _left(campaign, run, kind, unit, factor)]


def _bias(campaign: Campaign, runs: Sequence[Run], channel: Channel) -> tuple[float, float]:
    """Return the bias of a channel and its standard deviation, SI; NaN where the runs do not determine it."""
    designs, outputs = [], []
    for run in runs:
        outputs_of = {other.name: values for other, values in textbook.measured(run, campaign, channel.kind)}
        output = outputs_of.get(channel.name)
        if output is None:
            continue
        cosine = float(textbook.along_table(run, campaign, channel.axes[0])[2])
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
    value, covariance, _ = textbook.least_squares(design, output)
    return float(value[0]), float(np.sqrt(covariance[0, 0]))


def attenuation(run: Run) -> np.ndarray:
    """Return the attenuation of a rotating vector in its mean over the arc s of each row, sin(s/2)/(s/2), (R,)."""
    return np.sinc(run.covariates["table_angle_span"] / _TURN)


def _axial(campaign: Campaign, run: Run, kind: str) -> float:
    """Return the Earth rate or the specific force at rest along the table axis, SI."""
    gravity = np.array([0.0, 0.0, campaign.site.gravity])
    return textbook.axial(run, campaign, earth_rate(campaign.site.latitude) if kind == "gyro" else gravity)


def swept(run: Run) -> float:
    """Return the total angle swept in a run, rad: the sum of the arcs of its rows."""
    return float(np.sum(np.abs(run.covariates["table_angle_span"])))


def left_after(angle: float) -> float:
    """Return the fraction of a rotating vector that remains in its mean over an angle in rad."""
    share = abs(float(np.sinc(angle / _TURN)))
    return share if share > _ROUNDING else 0.0


def _left(campaign: Campaign, run: Run, kind: str, unit: str, factor: float) -> list[TextbookResult]:
    angle = swept(run)
    if run.mounting is None or angle < _LEAST_ARC:
        return []
    error, covariance = constant_error(campaign, run, kind)
    if not np.isfinite(error).all():
        return []
    in_plane, along = float(np.hypot(error[0], error[1])), abs(float(error[2]))
    direction = np.array([*error[:2] / max(in_plane, np.finfo(float).tiny), 0.0])
    in_plane_sd = float(np.sqrt(direction @ covariance @ direction))
    turns = angle / _TURN
    whole = np.floor(turns + 1e-6)
    part, rest = left_after(angle), left_after(_TURN * whole)
    left = {
        "left_in_plane": (in_plane * part, in_plane_sd * part, f"across the axis, after {turns:.2f} turns"),
        "left_in_plane_whole": (in_plane * rest, in_plane_sd * rest, f"across the axis, after {whole:.0f} turns"),
        "left_along_axis": (along, np.sqrt(covariance[2, 2]), "along the axis, after any number of turns"),
    }
    tested = Evaluation(kind, run.name, METHOD)
    return [tested.estimate(name, value / factor, sd / factor, unit, how) for name, (value, sd, how) in left.items()]


def constant_error(campaign: Campaign, run: Run, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the error vector of a kind that is constant in the unit during a run, and its covariance.

    It is the bias together with the errors of scale factor and input axes times the rate.  In table axes at table angle
    0, SI, (3,) and (3, 3); NaN for fewer than three channels.
    """
    places, to_table = to_table_axes(campaign, run, kind)
    if len(places) < 3:
        return np.full(3, np.nan), np.full((3, 3), np.nan)
    fits = [_constant_and_rotating(campaign, run, place) for place in places]
    constant = np.array([value[0] for value, _, _ in fits])
    variance = np.diag([covariance[0, 0] for _, covariance, _ in fits])
    return to_table @ constant, to_table @ variance @ to_table.T


def noise_of(campaign: Campaign, run: Run, places: Sequence[int]) -> np.ndarray:
    """Return the scatter of a row about a constant and a rotating term, of each channel, SI, (n,)."""
    found = []
    for place in places:
        value, _, residual = _constant_and_rotating(campaign, run, place)
        freedom = len(residual) - len(value)
        found.append(np.sqrt(float(residual @ residual) / freedom) if freedom > 0 else float("nan"))
    return np.array(found)


def _constant_and_rotating(campaign: Campaign, run: Run, place: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return constant, cosine and sine of a channel's output less its nominal input along the axis, SI."""
    channel = campaign.channels[place]
    angle, mean = run.covariates["table_angle"], attenuation(run)
    design = np.stack([np.ones_like(angle), mean * np.cos(angle), mean * np.sin(angle)], axis=1)
    axial_input = _axial(campaign, run, channel.kind) + (run.covariates["table_rate"] if channel.kind == "gyro" else 0)
    cosine = float(textbook.along_table(run, campaign, channel.axes[0])[2])
    signal = (run.observed[:, place] - channel.offset) / channel.scale_si
    return textbook.least_squares(design, signal - axial_input * cosine)


def to_table_axes(campaign: Campaign, run: Run, kind: str) -> tuple[list[int], np.ndarray]:
    """Return the n channels of a kind with complete outputs, and the matrix to turning table axes, (3, n)."""
    assert run.mounting is not None
    places = [
        place
        for place, channel in enumerate(campaign.channels)
        if channel.kind == kind and np.isfinite(run.observed[:, place]).all()
    ]
    axes = np.array([campaign.channels[place].axes[0] for place in places]).reshape(-1, 3)
    return places, campaign.mountings[run.mounting].body_to_table @ np.linalg.pinv(axes)


_ARC, _TURNS = 15.0, 1.0


def _planned_rows(steps: PlannedSteps) -> PlannedRows:
    """Return consecutive arcs over the planned number of turns, at each rate in turn."""
    arc, turns = steps.arc_deg or _ARC, steps.turns or _TURNS
    rates = np.repeat(steps.rates_deg_s or [], max(1, round(turns * 360 / arc)))
    span = np.sign(rates) * arc
    columns = {
        "table_rate_deg_s": rates,
        "table_angle_deg": (np.cumsum(span) - span / 2) % 360.0,
        "table_angle_span_deg": span,
    }
    # A row at rest lasts as long as the shortest row is planned to last.
    duration = np.where(rates == 0, steps.duration, arc / np.where(rates == 0, 1.0, np.abs(rates)))
    return PlannedRows(duration, columns)


def combinations(campaign: Campaign, runs: Sequence[Run]) -> list[StandardCombination]:
    """Return k′ of every gyro in every mounting."""
    return [*projected_scale_factors(campaign, runs)]


ROTATION_MODULATION = Procedure(
    name="rotation_modulation",
    reference="Levinson and Majure, accuracy enhancement by rotation, AGARD 1987; Groves § 5",
    columns=(("table_rate_deg_s", "table_angle_deg"),),
    needs_table=True,
    reduction=Reduction.FOLLOWED,
    abscissae=("table_angle", "table_rate", "time"),
    plan=PlanRules(("rates_deg_s",), ("turns", "arc_deg", "converter_temperature_degC"), 0.0, _planned_rows),
    evaluate=modulation_test,
    combinations=combinations,
)

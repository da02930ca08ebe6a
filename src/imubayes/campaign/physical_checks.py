"""Plausibility of the reduced rows: channels must respond to the stimulus with about their nominal scale factor.

Each channel is regressed on its nominal input.  A slope near 57.3 means degrees for radians, near 9.81 g for m/s².
These checks detect errors of units and assignment, factors of two and more; calibration is left to the fit.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from imubayes.campaign.stream_checks import Finding
from imubayes.foundations.campaign_data import Channel, Mounting, Run, Site, Table
from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.earth import normal_gravity
from imubayes.procedures import PROCEDURES

if TYPE_CHECKING:
    from imubayes.campaign import reduction as reduce
else:
    reduce = DeferredModule("imubayes.campaign.reduction")  # only raw logs need it

DEGREE = math.pi / 180
TURN = 2 * math.pi
SAME_FACTOR = 0.05  # relative tolerance for identifying a slope with a unit factor
LARGEST_ANOMALY = 5e-3  # m/s², 500 mGal (convention): free-air anomalies on land seldom exceed 300
HIGHEST = 5000.0  # m, of a laboratory
ORDINARY = (0.6, 1.6)  # slopes consistent with the nominal scale factor
LEAST_SPREAD = {"gyro": 0.05 * DEGREE, "accelerometer": 0.5}  # of the input, rad/s and m/s²
MOST_SKEW = 0.05  # s, the largest delay that the effect `time_skew` is for
LEAST_OFFSET = 0.5  # s; a table follows its command with less
LEVEL_SHARE = 0.25  # of a level; a larger offset leaves no steady stretch of it
LEAST_ALONG = 0.05  # of the largest input of a kind in a run, several times what a misalignment makes across it
REVERSED = 0.3  # least share of the nominal slope that a reversed sign leaves
FOLLOWS = 0.9  # least squared correlation for a slope to be used
_DECIMAL = "a decimal place of the scale"
_RATE_FACTORS = {
    1 / DEGREE: "rad/s and deg/s exchanged", 3600.0: "deg/h and deg/s exchanged",
    3600 / DEGREE: "rad/s and deg/h exchanged", 10.0: _DECIMAL,
}  # fmt: skip
_ACCELERATION_FACTORS = {9.80665: "g and m/s² exchanged", 1000.0: "g and mg exchanged", 10.0: _DECIMAL}


def check_gravity(site: Site, where: str) -> list[Finding]:
    """Compare stated gravity with normal gravity; a height of 0 may be one that nobody stated."""
    normal = normal_gravity(site.latitude, site.height)
    lowest = normal_gravity(site.latitude, HIGHEST) if site.height == 0 else normal
    if lowest - LARGEST_ANOMALY <= site.gravity <= normal + LARGEST_ANOMALY:
        return []
    return [
        Finding(
            "gravity_improbable", "warning", "",
            f"gravity is stated as {site.gravity:.5f} m/s², and normal gravity at {site.latitude / DEGREE:.4g} deg and "
            f"{site.height:g} m is {normal:.5f} m/s². If the stated value is wrong, the scale factors of the "
            f"accelerometers have a relative error of {abs(site.gravity / normal - 1) * 1e6:.3g} ppm",
            where, f"normal gravity to {LARGEST_ANOMALY * 1e5:.0f} mGal: anomalies seldom exceed 300 mGal",
            "correct latitude_deg, height_m or gravity_m_s2; leave gravity_m_s2 out for normal gravity",
        )
    ]  # fmt: skip


def check_rest(blocks: "reduce.BlockSurvey", run: Run, channels: Sequence[Channel], where: str) -> list[Finding]:
    """Check the raw log of a unit at rest: gyros that change by levels turn, whatever gravity says."""
    if not PROCEDURES[run.procedure].at_rest:
        return []
    turned = {}
    for channel in channels:
        if channel.kind != "gyro" or channel.name not in blocks.mean:
            continue
        span = reduce.turning_span((blocks.mean[channel.name] - channel.offset) / channel.scale_si)
        if span:
            turned[channel.name] = span
    if not turned:
        return []
    name, span = max(turned.items(), key=lambda item: item[1])
    return [
        Finding(
            "turns_at_rest", "error", run.name,
            f"{', '.join(turned)} turn{'s' if len(turned) == 1 else ''} in a {run.procedure}, by up to "
            f"{span / DEGREE:.4g} deg/s",
            f"{where}, column '{name}'", "a unit at rest from the first row to the last",
            "of a rate table: procedure = \"rate_table\" with the column table_rate_deg_s; else keep the rows at rest",
        )
    ]  # fmt: skip


def check_log(blocks: "reduce.BlockSurvey", run: str, where: str) -> list[Finding]:
    """Check a surveyed raw log: an angle column that stays within 2π while the table turns is in radians."""
    if "table_angle_deg" not in blocks.mean or "table_rate_deg_s" not in blocks.mean or blocks.interval is None:
        return []
    swept = np.nansum(np.abs(blocks.mean["table_rate_deg_s"]) * blocks.count) * blocks.interval
    reach = np.nanmax(blocks.high["table_angle_deg"]) - np.nanmin(blocks.low["table_angle_deg"])
    if not (swept > 30.0 and 0.1 < reach <= TURN * 1.001):
        return []
    what = f"the angle column stays within {reach:.3g} while the table turns by {swept:.4g} deg"
    return [_angle_finding(run, what, where)]


def check_clock(
    blocks: "reduce.BlockSurvey", run: str, channels: Sequence[Channel], where: str, momentary: bool
) -> list[Finding]:
    """Check that the outputs of a raw log answer the table at the time of its columns.

    Parameters
    ----------
    momentary : whether rows are used while the rate changes; otherwise an offset only shortens the levels.
    """
    found = reduce.clock_offset(blocks, [channel.name for channel in channels if channel.kind == "gyro"])
    if found is None or blocks.interval is None:
        return []
    size, error = abs(found.seconds), momentary or abs(found.seconds) > LEVEL_SHARE * found.level
    if size < max(MOST_SKEW if momentary else LEAST_OFFSET, 2 * blocks.interval):
        return []
    sense, change = ("later", "add") if found.seconds > 0 else ("earlier", "subtract")
    return [
        Finding(
            "time_shift", "error" if error else "warning", run,
            f"the outputs are {size:.3g} s {sense} than the columns of the table, by channel '{found.channel}'",
            f"{where}, column 'time_s'", "outputs and table recorded on one clock",
            f"{change} {size:.3g} s {'to' if found.seconds > 0 else 'from'} the times of the table, and join the two "
            "logs again",
        )
    ]  # fmt: skip


def check_rows(
    run: Run, channels: Sequence[Channel], site: Site, table: Table | None, mounting: Mounting | None, where: str
) -> list[Finding]:
    """Check the rows of one run against the nominal stimulus and scale factors."""
    procedure = PROCEDURES[run.procedure]
    found = _partial_turns(run, where)
    if run.rows == 0:
        return found
    if radians := _angle_in_radians(run, table, where):
        return [*found, radians]
    slopes: list[tuple[Channel, float]] = []
    stimuli = [procedure.nominal_input(run, channel, site, table, mounting) for channel in channels]
    reach = _reach(channels, stimuli)
    for index, (channel, stimulus) in enumerate(zip(channels, stimuli, strict=True)):
        if stimulus is None:
            continue
        measured = _measured(run, index, channel)
        found += _stuck(run, channel, stimulus, run.observed[:, index], where)
        slope = _ratio(stimulus, measured) if procedure.injected else _slope(channel, stimulus, measured, reach)
        if procedure.injected and _is_factor(slope, 1000.0):
            found.append(_current_finding(run.name, channel, slope, where))
        else:
            slopes.append((channel, slope))
    return found + _judge(run, slopes, where, procedure.rate_recorded)


def _measured(run: Run, index: int, channel: Channel) -> np.ndarray:
    """Return the output of a channel over its nominal scale factor, rad/s or m/s², shape (R,)."""
    return (run.observed[:, index] - channel.offset) / channel.scale_si


def slope_findings(run: str, channel: Channel, slope: float, where: str) -> list[Finding]:
    """Return the findings for a channel that responds with `slope` times its nominal scale factor."""
    place = f"{where}, column '{channel.name}'"
    factors = _RATE_FACTORS if channel.kind == "gyro" else _ACCELERATION_FACTORS
    expected = f"{channel.scale:g} {channel.output_unit} per {channel.per} (a slope of about 1)"
    size = abs(math.log(abs(slope))) if slope else 0.0
    factor = min(factors, key=lambda each: abs(size - math.log(each)))
    meaning = factors[factor] if _is_factor(slope, factor) else ""
    if meaning:
        name = "rate_unit" if channel.kind == "gyro" else "acceleration_unit"
        sign = ", and the sign reversed" if slope < 0 else ""
        what = f"channel '{channel.name}' responds with {slope:.4g} times its nominal scale factor: {meaning}{sign}?"
        remedy = "correct 'scale' or 'per' of the channel, or convert the column"
        if rate_column := _rate_unit(slope) if channel.kind == "gyro" else "":
            remedy += f"; if 'table_rate_deg_s' is in {rate_column}, convert it to deg/s"
        return [Finding(name, "error", run, what, place, expected, remedy)]
    if slope < -REVERSED:
        what = f"channel '{channel.name}' responds to its nominal input with reversed sign (slope {slope:.3g})"
        remedy = "check input_axis, the mounting and the sign of the rate or of the current"
        return [Finding("sign_reversed", "warning", run, what, place, expected, remedy)]
    if not ORDINARY[0] <= slope <= ORDINARY[1]:
        what = f"channel '{channel.name}' responds with {slope:.3g} times its nominal scale factor"
        remedy = "check scale, per, input_axis and the mounting"
        return [Finding("scale_far_from_nominal", "warning", run, what, place, expected, remedy)]
    return []


def _rate_unit(slope: float) -> str:
    """Return the unit in which the rate column would explain the response of a gyro; empty if there is none."""
    units = {"rad/s": 1 / DEGREE, "deg/h": 1 / 3600, "rad/h": 1 / DEGREE / 3600}
    return next((unit for unit, size in units.items() if abs(abs(slope) / size - 1) < SAME_FACTOR), "")


def _is_factor(slope: float, factor: float) -> bool:
    size = abs(slope)
    return any(abs(size / f - 1) < SAME_FACTOR for f in (factor, 1 / factor))


def _judge(run: Run, slopes: Sequence[tuple[Channel, float]], where: str, rate_recorded: bool) -> list[Finding]:
    """Return one finding for the rate column if all gyros agree, otherwise one per channel."""
    finite = [(channel, slope) for channel, slope in slopes if math.isfinite(slope)]
    gyros = [slope for channel, slope in finite if channel.kind == "gyro"]
    if rate_recorded and len(gyros) > 1 and all(_is_factor(slope, 1 / DEGREE) for slope in gyros):
        what = f"every gyro indicates {abs(float(np.median(gyros))):.4g} times the recorded rate"
        found = [
            Finding(
                "rate_unit", "error", run.name, what, f"{where}, column 'table_rate_deg_s'",
                "degrees per second", "convert the rate column from rad/s to deg/s, or correct the gyros' scale",
            )
        ]  # fmt: skip
        finite = [(channel, slope) for channel, slope in finite if channel.kind != "gyro"]
    else:
        found = []
    for channel, slope in finite:
        found += slope_findings(run.name, channel, slope, where)
    return found


def _reach(channels: Sequence[Channel], stimuli: Sequence[np.ndarray | None]) -> dict[str, float]:
    """Return the largest span of the inputs of the channels of each kind in a run, rad/s or m/s²."""
    found: dict[str, float] = {}
    for channel, stimulus in zip(channels, stimuli, strict=True):
        known = stimulus[np.isfinite(stimulus)] if stimulus is not None else np.zeros(0)
        found[channel.kind] = max(found.get(channel.kind, 0.0), float(np.ptp(known)) if len(known) else 0.0)
    return found


def _slope(channel: Channel, stimulus: np.ndarray, measured: np.ndarray, reach: dict[str, float]) -> float:
    """Return the slope of the measured on the nominal input; NaN if the rows do not determine it.

    An input across that of the others is that of their misalignments as well.
    """
    good = np.isfinite(stimulus) & np.isfinite(measured)
    x, y = stimulus[good], measured[good]
    if len(x) >= 3 and np.ptp(x) > max(LEAST_SPREAD[channel.kind], LEAST_ALONG * reach[channel.kind]):
        dx, dy = x - x.mean(), y - y.mean()
        slope = float(dx @ dy / (dx @ dx))
        return slope if slope * float(dx @ dy) > FOLLOWS * float(dy @ dy) else math.nan
    if channel.kind == "accelerometer" and len(x) and abs(x.mean()) > 3.0:
        return float(y.mean() / x.mean())
    return math.nan


def _angle_in_radians(run: Run, table: Table | None, where: str) -> Finding | None:
    degrees = (run.covariates["table_angle"] + (table.zero_angle if table else 0.0)) / DEGREE
    static = np.isfinite(degrees) & (run.covariates["table_angle_span"] == 0)
    angle = degrees[static]
    if len(np.unique(angle)) < 5 or np.max(np.abs(angle)) > TURN * 1.01 or np.ptp(angle) < 1.0:
        return None
    periodic = [
        _unexplained(angle, values) < min(0.02, 0.05 * _unexplained(angle * DEGREE, values))
        for values in run.observed[static].T
        if np.isfinite(values).all() and np.ptp(values) > 0
    ]
    if not any(periodic):
        return None
    what = f"the angles reach {np.max(np.abs(angle)):.4g} and the outputs are periodic in them with 2π"
    return _angle_finding(run.name, what, where)


def _unexplained(angle: np.ndarray, values: np.ndarray) -> float:
    """Return the fraction of the variance not explained by the first harmonic of the angle."""
    design = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    scaled = (values - values.mean()) / np.std(values)
    residual = scaled - design @ np.linalg.lstsq(design, scaled, rcond=None)[0]
    return float(residual @ residual) / len(values) + 1e-12


def _angle_finding(run: str, what: str, where: str) -> Finding:
    place = f"{where}, column 'table_angle_deg'"
    return Finding("angle_in_radians", "error", run, what, place, "degrees", "multiply the angle column by 180/π")


def _stuck(run: Run, channel: Channel, stimulus: np.ndarray, observed: np.ndarray, where: str) -> list[Finding]:
    good = np.isfinite(observed) & np.isfinite(stimulus)
    x, y = stimulus[good], observed[good]
    if len(y) < 3 or np.ptp(y) > 0 or np.ptp(x) <= LEAST_SPREAD[channel.kind]:
        return []
    return [
        Finding(
            "stuck_channel", "error", run.name,
            f"channel '{channel.name}' has the value {y[0] + 0.0:g} in all {len(y)} rows while its input varies",
            f"{where}, column '{channel.name}'", "outputs that vary with the input",
            "check the channel; leave unusable cells empty",
        )
    ]  # fmt: skip


def _partial_turns(run: Run, where: str) -> list[Finding]:
    """Return a warning for means at unknown angle over a time too short for a full turn.

    A run of turns from rest to rest through a stated angle has none: its angles are known.
    """
    if run.turn_uncertainty is not None:
        return []
    span, angle = run.covariates["table_angle_span"], run.covariates["table_angle"]
    rate = np.abs(run.covariates["table_rate"])
    short = np.isnan(angle) & (span < TURN * 0.999)
    if "time" in run.covariates and run.rows > 2:
        step = np.diff(run.covariates["time"])
        longest = np.maximum(np.append(step, step[-1]), np.insert(step, 0, step[0]))
        short |= np.isnan(angle) & (rate > 0) & (rate * longest < TURN * 0.999)
    if not short.any():
        return []
    rows = np.flatnonzero(short)
    listed = ", ".join(f"{rate[row] / DEGREE:g}" for row in rows[:6])
    return [
        Finding(
            "partial_turn", "warning", run.name,
            f"{len(rows)} means over less than one full turn at an unknown angle (at {listed} deg/s)",
            f"{where}, column 'table_angle_deg'",
            "whole turns, or the mean angle in 'table_angle_deg' with 'table_angle_span_deg'",
            "record the table angle, or turn longer; these rows are treated as whole turns",
        )
    ]  # fmt: skip


def _ratio(stimulus: np.ndarray, measured: np.ndarray) -> float:
    """Return the median ratio of measured to nominal input; NaN if there is none."""
    good = np.isfinite(measured) & (stimulus != 0)
    with np.errstate(over="ignore"):  # a stimulus of next to nothing
        return float(np.median(measured[good] / stimulus[good])) if good.any() else math.nan


def _current_finding(run: str, channel: Channel, ratio: float, where: str) -> Finding:
    what = f"channel '{channel.name}' responds with {ratio:.4g} times its nominal scale factor: A for mA?"
    remedy = "convert the column to mA, or correct current_mA_per_g"
    return Finding("current_unit", "error", run, what, f"{where}, column 'current_mA'", "milliamperes", remedy)

"""Static record: the unit at rest for hours, for its noise, its drift and the Earth rate (IEEE Std 952 and 1293).

The noise itself is evaluated from the raw samples (`imubayes noise`).  Here the record is a run of block means: the
input is constant, and the remainder is bias.  The Earth rate along and across the vertical checks the gyros
(gyrocompassing): its length and both parts are known, its direction about the vertical is not.  Without a table and a
mounting the body axis z is up, and north is not known.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.earth import EARTH_RATE, earth_rate
from imubayes.procedures.base import PlannedRows, PlannedSteps, PlanRules, Procedure, Reduction
from imubayes.procedures.kinematics import about_z
from imubayes.procedures.textbook import (
    DEGREE_PER_HOUR,
    Estimate,
    Evaluation,
    TextbookResult,
    Undetermined,
    measured,
)

METHOD = "IEEE Std 952, mean of the static record"
COMPASS = "gyrocompass: mean rate against the Earth rate"
BATCHES = "type A: means of eight equal parts of the record; bias not included"
_BATCHES = 8
_HOUR = 3600.0
_LEVEL = 0.05  # rad; a plane tilted by more is not level
_RANK = 0.1  # least singular value of directions that span space


def static_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return biases if the attitude is known, and the gyrocompass check of every run with enough gyros."""
    found: list[TextbookResult] = []
    for run in runs:
        nominal = _nominal_attitude(run, campaign)
        if nominal is not None:
            found += _biases(campaign, run, nominal)
        found += _gyrocompass(campaign, run, nominal)
    return found


def _nominal_attitude(run: Run, campaign: Campaign) -> np.ndarray | None:
    """Return body → local level of a run on a table, shape (3, 3); None without a table or if its angle varies."""
    angle = run.covariates["table_angle"]
    if run.table is None or run.mounting is None or not run.rows or np.ptp(angle) > 0 or np.isnan(angle).any():
        return None
    in_local = campaign.tables[run.table].outer_to_local @ about_z(angle[:1])[0]
    return in_local @ campaign.mountings[run.mounting].body_to_table


def _mean(run: Run, output: np.ndarray) -> tuple[float, float]:
    """Return the mean over all samples and its standard deviation, from the scatter of parts of the record.

    Neighbouring rows are correlated by slow noise, parts of the record less so.
    """
    parts = np.array_split(np.arange(run.rows), min(_BATCHES, run.rows))
    means = np.array([np.average(output[part], weights=run.samples[part]) for part in parts])
    sd = float(np.std(means, ddof=1) / np.sqrt(len(means))) if len(means) > 1 else float("nan")
    return float(np.average(output, weights=run.samples)), sd


def _biases(campaign: Campaign, run: Run, attitude: np.ndarray) -> Iterator[TextbookResult]:
    gravity = campaign.site.gravity
    fixed = {
        "gyro": ("gyro_bias.bias", earth_rate(campaign.site.latitude), DEGREE_PER_HOUR, "deg/h"),
        "accelerometer": ("accel_bias.bias", np.array([0.0, 0.0, gravity]), 1e-6 * gravity, "ug"),
    }
    for kind, (name, vector, factor, unit) in fixed.items():
        if kind == "gyro" and not campaign.north_is_stated(run):
            sentence = (
                "gyro biases: the azimuth is not stated, and gyrocompassing determines them only as far as the runs "
                "allow"
            )
            yield Undetermined(run.name, sentence)
            continue
        for channel, output in measured(run, campaign, kind):
            mean, sd = _mean(run, output / channel.scale_si)
            value = mean - float(attitude @ channel.axes[0] @ vector)
            yield Evaluation(channel.name, run.name, METHOD).estimate(name, value / factor, sd / factor, unit)


def _vector(run: Run, found: list[tuple[Channel, np.ndarray]]) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the mean vector that channels measure and its covariance, (3,) and (3, 3); None if they span a plane.

    Channels are independent of each other.
    """
    if len(found) < 3:
        return None
    axes = np.stack([channel.axes[0] for channel, _ in found])
    if np.linalg.svd(axes, compute_uv=False)[-1] < _RANK:
        return None
    means = np.array([_mean(run, output / channel.scale_si) for channel, output in found])
    inverse = np.linalg.pinv(axes)
    return inverse @ means[:, 0], inverse @ np.diag(means[:, 1] ** 2) @ inverse.T


def _gyrocompass(campaign: Campaign, run: Run, attitude: np.ndarray | None) -> list[TextbookResult]:
    gyros = measured(run, campaign, "gyro")
    if not gyros:
        return []
    felt = _vector(run, measured(run, campaign, "accelerometer"))
    up = None if felt is None else felt[0] / np.linalg.norm(felt[0])
    if up is None and attitude is not None:
        up = attitude.T @ np.array([0.0, 0.0, 1.0])
    rate = _vector(run, gyros)
    if rate is not None:
        return _of_triad(campaign, run, rate, up)
    if up is not None and (pair := [pair for pair in gyros if abs(pair[0].axes[0] @ up) < _LEVEL])[1:]:
        return _of_level_gyros(campaign, run, pair, up)
    names = ", ".join(channel.name for channel, _ in gyros)
    sentence = f"the Earth rate: {names} do not span space, and no two of them are level"
    return [Undetermined(run.name, sentence)]


def _of_triad(
    campaign: Campaign, run: Run, rate: tuple[np.ndarray, np.ndarray], up: np.ndarray | None
) -> list[TextbookResult]:
    vector, covariance = rate
    size = float(np.linalg.norm(vector))
    found: list[TextbookResult] = [_part("norm", run, size, EARTH_RATE, vector / size, covariance)]
    if up is None:
        missing = "the vertical and level parts of the Earth rate: three accelerometers or the attitude would give the"
        return [*found, Undetermined(run.name, f"{missing} vertical")]
    latitude = campaign.site.latitude
    found.append(_part("vertical", run, float(vector @ up), EARTH_RATE * np.sin(latitude), up, covariance))
    level = vector - float(vector @ up) * up
    return [*found, *_level(campaign, run, level, up, covariance)]


def _of_level_gyros(
    campaign: Campaign, run: Run, gyros: list[tuple[Channel, np.ndarray]], up: np.ndarray
) -> list[TextbookResult]:
    """Return the level part of the Earth rate from level gyros; the vertical part does not reach them."""
    axes = np.stack([*(channel.axes[0] for channel, _ in gyros), up])
    if np.linalg.svd(axes, compute_uv=False)[-1] < _RANK:
        return [Undetermined(run.name, "the Earth rate: the level gyros are parallel")]
    means = np.array([*(_mean(run, output / channel.scale_si) for channel, output in gyros), (0.0, 0.0)])
    inverse = np.linalg.pinv(axes)
    level = inverse @ means[:, 0]
    return _level(campaign, run, level - float(level @ up) * up, up, inverse @ np.diag(means[:, 1] ** 2) @ inverse.T)


def _level(
    campaign: Campaign, run: Run, level: np.ndarray, up: np.ndarray, covariance: np.ndarray
) -> list[TextbookResult]:
    """Return the level part of the Earth rate and the heading that it gives, and what biases do to them."""
    size, expected = float(np.linalg.norm(level)), EARTH_RATE * np.cos(campaign.site.latitude)
    north = level / size
    found: list[TextbookResult] = [_part("level", run, size, expected, north, covariance)]
    body = np.eye(3)[int(np.argmax(np.abs(up) < np.sqrt(0.5)))]
    ahead = body - float(body @ up) * up
    east = np.cross(north, up)
    heading = np.degrees(np.arctan2(ahead @ east, ahead @ north))
    sd = np.degrees(np.sqrt(east @ covariance @ east)) / size
    axis = "xyz"[int(np.argmax(body))]
    found.append(_compass(run).estimate(f"heading_of_{axis}", heading, sd, "deg"))
    turn = np.degrees(DEGREE_PER_HOUR / expected)
    sentence = (
        f"the gyro bias across the level part of the Earth rate: 1 deg/h of it turns the heading by {turn:.3g} deg; "
        "only the bias along the vertical and along north shows in one attitude"
    )
    return [*found, Undetermined(run.name, sentence)]


def _part(
    name: str, run: Run, value: float, expected: float, direction: np.ndarray, covariance: np.ndarray
) -> Estimate:
    """Return a part of the Earth rate, with its deviation from the site's, which is the bias along it."""
    sd = np.sqrt(direction @ covariance @ direction) / DEGREE_PER_HOUR
    bias = (value - expected) / DEGREE_PER_HOUR
    decision = f"{expected / DEGREE_PER_HOUR:.4f} deg/h at the site: a bias of {bias:+.3g} deg/h along it"
    return _compass(run).estimate(f"earth_rate.{name}", value / DEGREE_PER_HOUR, sd, "deg/h", decision=decision)


def _compass(run: Run) -> Evaluation:
    return Evaluation(run.name, run.name, COMPASS, BATCHES)


def _planned_rows(steps: PlannedSteps) -> PlannedRows:
    """Return block means at equal intervals."""
    seconds = steps.duration
    return PlannedRows(np.full(max(2, round((steps.hours or 1.0) * _HOUR / seconds)), seconds), {})


STATIC_RECORD = Procedure(
    name="static_record",
    reference="IEEE Std 952, annex C; IEEE Std 1293, static record for noise analysis",
    columns=(("time_s",),),
    reduction=Reduction.BLOCKS,
    at_rest=True,
    abscissae=("time",),
    row_name="block",
    plan=PlanRules(("hours",), (), 0.0, _planned_rows),
    evaluate=static_test,
)

"""A wrong nominal scale is reported beside what imitates it, and alone if the outputs determine the two.

The outputs are those of a unit whose physics is written here: gravity and the rotation of a table, no more.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from imubayes.campaign.setup_gate.judgement import judge_setup
from imubayes.campaign.setup_gate.reading_mistakes import NominalScale
from imubayes.foundations.campaign_data import Campaign, Channel, Kind, Mounting, Run, Site, Table

DEGREE, GRAVITY, EARTH = np.pi / 180, 9.81, 7.292115e-5
LATITUDE = 48 * DEGREE
FLAT = np.eye(3)
X_UP = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
Z_ACROSS = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
HEAD_ANGLES = np.arange(12) * 30 * DEGREE
RATES = np.array([0.0, 10, -10, 50, -50, 100, -100]) * DEGREE


def _channels(kind: Kind, axes: str) -> tuple[Channel, ...]:
    unit, per = ("V", "m/s^2") if kind == "accelerometer" else ("V", "rad/s")
    turned = {axis: np.roll(np.eye(3), -k, axis=0) for k, axis in enumerate("xyz")}
    return tuple(Channel(kind[0] + axis, kind, turned[axis], unit, 0.5, per, 0.5, noise=1e-4) for axis in axes)


def _outputs(
    run: Run, channels: Sequence[Channel], matrix: np.ndarray, elevation: float, scale: Mapping[str, float],
) -> np.ndarray:  # fmt: skip
    """Return what channels of other scales read, the axis of the table toward North and raised."""
    axis = np.array([0.0, np.cos(elevation), np.sin(elevation)])  # East, North, up
    zero = np.array([1.0, 0.0, 0.0])
    across = np.cross(axis, zero)
    earth = EARTH * np.array([0.0, np.cos(LATITUDE), np.sin(LATITUDE)])
    generator, rows = np.random.default_rng(1), []
    rate, angle, span = (run.covariates[name] for name in ("table_rate", "table_angle", "table_angle_span"))
    for turning, at, swept in zip(rate, angle, span, strict=True):
        short = 0.0 if swept else 1.0
        at = 0.0 if swept else at
        table = np.array([short * (np.cos(at) * zero + np.sin(at) * across),
                          short * (-np.sin(at) * zero + np.cos(at) * across), axis])  # fmt: skip
        body = matrix.T @ table
        force, spin = body @ [0.0, 0.0, GRAVITY], body @ earth + turning * matrix[2]
        read = [
            0.5 * scale.get(each.name, 1.0) * (force if each.kind == "accelerometer" else spin) @ each.axes[0]
            for each in channels
        ]
        rows.append(read + 1e-5 * generator.normal(size=len(read)))
    return np.array(rows)


def _campaign(
    channels: tuple[Channel, ...],
    seats: Mapping[str, np.ndarray],
    *,
    turning: bool = False,
    elevation: float = 0.0,
    actual: float | None = None,
    scale: Mapping[str, float] | None = None,
    rates: float = 1.0,
) -> Campaign:
    """Return a campaign: a dividing head, or a rate table with recorded rates divided by a factor.

    Parameters
    ----------
    elevation, actual : of the axis, as stated and as it is.
    scale : of channels, over the nominal one.
    rates : those of the table over those recorded.
    """
    column = RATES if turning else HEAD_ANGLES
    still, shape = np.zeros(len(column)), (len(column), len(channels))
    moved = {"table_rate": RATES, "table_angle": np.where(RATES == 0, 0.0, np.nan),
             "table_angle_span": np.where(RATES == 0, 0.0, 2 * np.pi)}  # fmt: skip
    stood = {"table_rate": still, "table_angle": HEAD_ANGLES, "table_angle_span": still}
    runs = []
    for name, matrix in seats.items():
        covariates = moved if turning else stood
        empty, samples = np.zeros(shape), np.full(len(column), 100)
        run = Run(name, "rate_table" if turning else "dividing_head", "table", name, covariates, empty, samples,
                  np.full(shape, np.nan))  # fmt: skip
        observed = _outputs(run, channels, matrix, elevation if actual is None else actual, scale or {})
        recorded = {**covariates, "table_rate": covariates["table_rate"] / rates}
        runs.append(Run(name, run.procedure, "table", name, recorded, observed, samples, np.full(shape, np.nan)))
    mountings = {name: Mounting(name, matrix, 60 * DEGREE / 3600) for name, matrix in seats.items()}
    table = Table("table", 0.0, elevation, 20 * DEGREE / 3600)
    return Campaign("made", Site(LATITUDE, 0.0, GRAVITY), channels, {"table": table}, mountings, tuple(runs))


def told(campaign: Campaign) -> dict[str, float]:
    """Return the explanations that are reported as rivals: kind of mistake → size."""
    mistakes = judge_setup(campaign).mistakes
    assert len(mistakes) < 2
    return {each.mistake.kind: each.size for each in mistakes[0]} if mistakes else {}


ONE = _channels("accelerometer", "x")
THREE = _channels("accelerometer", "xyz")
SEATS = {"flat": FLAT, "x-up": X_UP, "z-across": Z_ACROSS}


@pytest.mark.parametrize("factor", [0.3, 0.5, 0.8])
def test_a_smaller_scale_and_a_raised_axis_are_rivals_where_one_accelerometer_turns(factor: float) -> None:
    """The input axis across that of the head: neither the scale nor the elevation shows by itself."""
    for campaign in (
        _campaign(ONE, {"flat": FLAT}, scale={"ax": factor}),
        _campaign(ONE, {"flat": FLAT}, actual=float(np.arccos(factor))),
    ):
        found = told(campaign)
        assert {"channel_unit", "table_elevation"} <= set(found)
        np.testing.assert_allclose(np.exp(found["channel_unit"]), factor, rtol=0.02)
        np.testing.assert_allclose(abs(np.cos(found["table_elevation"])), factor, rtol=0.05)


def test_a_larger_scale_is_rivalled_by_an_axis_that_is_stated_raised() -> None:
    found = told(_campaign(ONE, {"flat": FLAT}, elevation=60 * DEGREE, scale={"ax": 2.0}))
    assert {"channel_unit", "table_elevation"} <= set(found)


@pytest.mark.parametrize("factor", [0.3, 0.5, 2.0, 10.0])
def test_a_triad_in_three_mountings_tells_its_scale_from_the_axis(factor: float) -> None:
    scales: dict[str, float] = dict.fromkeys(("ax", "ay", "az"), factor)
    found = told(_campaign(THREE, SEATS, scale=scales))
    assert set(found) == {"channel_unit"}
    np.testing.assert_allclose(np.exp(found["channel_unit"]), factor, rtol=0.02)


def test_a_triad_tells_a_raised_axis_from_its_scale() -> None:
    found = told(_campaign(THREE, SEATS, actual=60 * DEGREE))
    assert set(found) == {"table_elevation"}
    np.testing.assert_allclose(found["table_elevation"], 60 * DEGREE, atol=DEGREE)


def test_one_channel_of_a_triad_with_another_scale_is_named() -> None:
    (found,) = judge_setup(_campaign(THREE, SEATS, scale={"ay": 0.5})).mistakes
    assert [each.mistake.kind for each in found] == ["channel_unit"]
    assert getattr(found[0].mistake, "channels", ()) == ("ay",)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_scales_of_gyros_and_rates_of_the_table_are_rivals(factor: float) -> None:
    gyros = _channels("gyro", "xyz")
    scaled = _campaign(gyros, SEATS, turning=True, elevation=np.pi / 2, scale=dict.fromkeys(("gx", "gy", "gz"), factor))
    rated = _campaign(gyros, SEATS, turning=True, elevation=np.pi / 2, rates=factor)
    for campaign in (scaled, rated):
        found = told(campaign)
        assert set(found) == {"channel_unit", "rate_unit"}
        np.testing.assert_allclose(np.exp([*found.values()]), factor, rtol=0.02)


def test_a_unit_is_named_before_a_factor_that_is_as_good() -> None:
    (found,) = judge_setup(_campaign(THREE, SEATS, scale=dict.fromkeys(("ax", "ay", "az"), 9.80665))).mistakes
    mistake = found[0].mistake
    assert isinstance(mistake, NominalScale)
    assert mistake.units(found[0].size) == "m/s² instead of g"


def test_a_valid_campaign_passes() -> None:
    assert not told(_campaign(THREE, SEATS))
    assert not told(_campaign(ONE, {"flat": FLAT}, scale={"ax": 1.004}))

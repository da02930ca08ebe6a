"""Default priors by grade of unit."""

from dataclasses import replace

import numpy as np
import pytest

from imubayes.campaign.unit_grade import grade_of
from imubayes.effects import EFFECTS
from imubayes.foundations.campaign_data import GRADES, Campaign, graded_prior
from imubayes.model.bind import bind
from imubayes.parameters.declarations import declared_parameters
from imubayes.parameters.priors import HalfNormal, LogNormal, Normal, Prior, parse_prior
from small_campaign import ACCEL_SCALE, DEGREE, GRAVITY, GYRO_SCALE, campaign, spec

COARSE = {
    f"{effect.name}.{field}": declared
    for effect in EFFECTS
    for field, declared in declared_parameters(effect).items()
    if declared.coarse is not None
}


@pytest.mark.parametrize(
    ("prior", "expected"),
    [
        ("normal(0, 20 mg)", "normal(0, 300 ug)"),
        ("halfnormal(20 ug)", "halfnormal(300 ug)"),
        ("lognormal(50 ug, 1.0)", "lognormal(300 ug, 1.0)"),
    ],
)
def test_a_coarser_prior_keeps_its_family(prior, expected):
    assert graded_prior(prior, "ug", (100.0, 300.0), "consumer") == expected
    assert graded_prior(prior, "ug", (100.0, 300.0), "industrial") == expected.replace("300", "100")
    assert {graded_prior(prior, "ug", (100.0, 300.0), grade) for grade in ("tactical", "navigation")} == {prior}
    assert {graded_prior(prior, "ug", None, grade) for grade in GRADES} == {prior}


def width(prior: Prior) -> float:
    """Return what a grade changes of a prior."""
    if isinstance(prior, Normal):
        assert prior.mean == 0
        return float(prior.deviation)
    assert isinstance(prior, HalfNormal | LogNormal)
    return float(prior.scale if isinstance(prior, HalfNormal) else prior.median)


@pytest.mark.parametrize(("name", "declared"), COARSE.items(), ids=COARSE)
def test_a_coarser_unit_has_a_wider_prior(name, declared):
    texts = [declared.prior_of(grade) for grade in ("tactical", "industrial", "consumer")]
    fine, coarser, coarsest = (width(parse_prior(text, declared.unit, GRAVITY, name)) for text in texts)
    assert 0 < fine <= coarser <= coarsest
    assert fine < coarsest


def with_noise(gyro: float, accelerometer: float) -> Campaign:
    """Return the campaign with a sample noise in deg/s and mg."""
    sizes = {"gyro": gyro * DEGREE * GYRO_SCALE, "accelerometer": accelerometer * 1e-3 * GRAVITY * ACCEL_SCALE}
    among = campaign()
    return replace(among, channels=tuple(replace(one, noise=sizes[one.kind]) for one in among.channels))


@pytest.mark.parametrize(
    ("gyro", "accelerometer", "grades"),
    [
        (0.008, 0.1, ("tactical", "tactical")),
        (0.03, 0.7, ("industrial", "industrial")),
        (0.1, 2.0, ("consumer", "consumer")),
        (0.1, 0.1, ("consumer", "tactical")),
    ],
)
def test_the_grade_follows_from_the_noise(gyro, accelerometer, grades):
    among = with_noise(gyro, accelerometer)
    assert (grade_of(among, "gyro"), grade_of(among, "accelerometer")) == grades
    assert grade_of(replace(among, grade="navigation"), "gyro") == "navigation"


@pytest.mark.parametrize(
    ("kinds", "grades"),
    [
        (("gyro",), ("consumer", "consumer")),
        (("accelerometer",), ("industrial", "industrial")),
        (("gyro", "accelerometer"), ("tactical", "tactical")),
    ],
)
def test_sensors_of_unknown_noise_have_the_grade_of_the_others(kinds, grades):
    """Nobody measures the noise of gyros that never rest."""
    among = with_noise(0.03, 2.0)
    unknown = replace(
        among, channels=tuple(replace(one, noise=None) if one.kind in kinds else one for one in among.channels)
    )
    assert (grade_of(unknown, "gyro"), grade_of(unknown, "accelerometer")) == grades


def test_a_default_prior_is_that_of_the_grade_and_a_written_one_stands():
    def sd(among: Campaign, name: str = "gyro_scale_cubic", **prior: str) -> float:
        model = spec(name)
        written = replace(model, effects=(replace(model.effects[0], prior=prior), *model.effects[1:]))
        return bind(written, among).layout.parameters[0].prior_sd

    plain = with_noise(0.008, 0.1)
    assert sd(plain) == pytest.approx(0.005)
    assert sd(replace(plain, grade="consumer")) == pytest.approx(1.0)
    assert sd(with_noise(0.1, 0.1)) == pytest.approx(1.0)
    assert sd(with_noise(0.1, 0.1), cubic="normal(0, 0.2 ppm/(deg/s)^2)") == pytest.approx(0.2)
    # A fact of the equipment belongs to no grade.
    assert sd(replace(plain, grade="consumer"), "mounting_error") == sd(plain, "mounting_error")


def test_the_output_of_a_gyro_is_per_deg_s_and_that_of_an_accelerometer_per_g():
    """The range of a converter is 400 deg/s or 12 g: at the largest size it bends by 1 … 2 per mille there."""
    among = with_noise(0.008, 0.1)
    by_kind = {channel.name: channel for channel in among.channels}
    bent: dict[str, list[np.ndarray]] = {"gyro": [], "accelerometer": []}
    for each in bind(spec("converter_nonlinearity"), among).layout.parameters:
        channel = by_kind[each.label[0]]
        unit, full = (np.radians(1), 400) if channel.kind == "gyro" else (among.site.gravity, 12)
        power = 1 if each.field == "quadratic" else 2
        share = np.array(each.typical) * (abs(channel.scale_si) * unit * full) ** power
        bent[channel.kind].append(share)
        assert each.prior_sd == pytest.approx(0.1 * each.typical[1], rel=0.01)
    for shares in bent.values():
        assert np.max(shares) == pytest.approx(1500, rel=0.3)  # ppm

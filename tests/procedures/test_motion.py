"""Units that never rest, waved or drilled by simulators of the tests' own, through reduction, model and textbook."""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import imubayes
from imubayes.criticism.diagnose import judge
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import InputError
from imubayes.inference.fitted_model import Fit
from imubayes.inference.laplace_marginal import knowledge
from imubayes.inference.parameter_fit import linearise_once
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.carried_motion import first_point
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.model.problem import prior_widths
from imubayes.noise.components import RowSpan, StateCovariance
from imubayes.noise.hand_components import HandVelocity
from imubayes.procedures import classical

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))
from motion_recordings import GRAVITY, NAMES, SetUp, UnitErrors, drilled, drilled_all, random_unit, waved

HELD = "normal(0, 0.001 arcsec)"
UNITS = {"accelerometer": "m/s^2", "gyro": "rad/s"}
SENSORS = ("gyro_bias", "gyro_scale_factor", "gyro_misalignment", "accel_bias", "accel_scale_factor")


def campaign_of(runs: dict[str, dict[str, np.ndarray]], procedure: str) -> Campaign:
    kinds = [("accelerometer" if name[0] == "a" else "gyro", name) for name in NAMES]
    channels = [
        {"name": name, "kind": kind, "input_axis": [float(name[1] == axis) for axis in "xyz"], "scale": 1.0,
         "output_unit": UNITS[kind], "per": UNITS[kind]} for kind, name in kinds
    ]  # fmt: skip
    content = {
        "format": 1, "name": "motion", "site": {"latitude_deg": 48.0, "height_m": 0.0, "gravity_m_s2": GRAVITY},
        "unit": {"serial": "1", "grade": "consumer"}, "channel": channels,
        "run": [{"name": name, "procedure": procedure} for name in runs],
    }  # fmt: skip
    return imubayes.build_campaign(content, runs)


def model_of(*further: str) -> ModelSpec:
    listed = [EffectSpec(name) for name in (*SENSORS, "hand_acceleration", "hand_velocity", *further)]
    listed += [
        EffectSpec("accel_misalignment", ("ax",), prior={"toward_o": HELD, "toward_p": HELD}),
        EffectSpec("accel_misalignment", ("ay",), prior={"toward_p": HELD}),
        EffectSpec("accel_misalignment", ("az",)),
        EffectSpec("white_noise", ("ax", "ay", "az"), prior={"sigma": "lognormal(1 noise, 0.2)"}),
    ]
    return ModelSpec("motion", tuple(listed))


def truth(errors: UnitErrors) -> dict[str, float]:
    """Return true coefficients in SI; an axis that is tilted in the simulator is longer than 1."""
    found = {}
    for kind, scale, bias, tilt in (
        ("accel", errors.accel_scale, errors.accel_bias, errors.accel_tilt),
        ("gyro", errors.gyro_scale, errors.gyro_bias, errors.gyro_tilt),
    ):
        size = np.linalg.norm(np.eye(3) + tilt, axis=1)
        for place, axis in enumerate("xyz"):
            name = f"{kind[0]}{axis}"
            found[f"{kind}_scale_factor.scale[{name}]"] = (1 + scale[place]) * size[place] - 1
            found[f"{kind}_bias.bias[{name}]"] = bias[place] / size[place]
    return found


def pulls(campaign: Campaign, spec: ModelSpec, errors: UnitErrors) -> dict[str, tuple[float, float]]:
    """Return (estimate − truth)/sd and sd of bias and scale factor of all channels, at the mode."""
    model = imubayes.bind(spec, campaign)
    problem = model.problem
    mode = find_mode(problem, first_point(model.assembly), np.zeros(len(model.hyper_layout)))
    assert mode.converged
    known = knowledge(problem, mode.about, mode.h)
    sd = np.sqrt(np.diag(np.linalg.inv(known.precision + np.diag(prior_widths(problem, mode.h) ** -2.0))))
    value, beyond = (np.asarray(problem.priors.values(z)) for z in (mode.z, mode.z + 1e-3 * sd))
    true, width = truth(errors), 1e3 * np.abs(beyond - value)
    return {
        name: ((value[place] - true[name]) / width[place], width[place])
        for place, name in enumerate(model.layout.names)
        if name in true
    }


@cache
def waved_campaign(seed: int = 1) -> tuple[Campaign, UnitErrors]:
    errors = random_unit(np.random.default_rng(100 + seed))
    return campaign_of({"waved": waved(errors, seed, seconds=45.0, knocks=2)}, "slow_motion"), errors


def test_a_unit_that_never_rests_has_windows_between_poses() -> None:
    campaign, _ = waved_campaign()
    run = campaign.runs[0]
    assert run.tumble is not None
    assert run.tumble.in_motion
    assert 50 < run.rows <= 250
    assert np.isfinite(run.observed[:, :3]).all()
    assert np.isnan(run.observed[:, 3:]).all()
    sums = np.bincount(run.tumble.carried_row, run.tumble.carried_weight)
    assert sums == pytest.approx(1.0)
    assert np.sqrt(np.mean(run.sample_sd[:, :3] ** 2)) == pytest.approx(0.02, rel=0.1)  # of the samples, not the motion


def test_knocked_windows_are_left_out() -> None:
    errors = random_unit(np.random.default_rng(7))
    columns = waved(errors, 7, seconds=40.0)
    before = campaign_of({"waved": columns}, "slow_motion").runs[0]
    columns["ax"] = columns["ax"] + np.where(np.abs(columns["time_s"] - 20.0) < 0.2, 40.0, 0.0)
    after = campaign_of({"waved": columns}, "slow_motion").runs[0]
    assert not any("windows left out" in note for note in before.notes)
    assert any("windows left out" in note for note in after.notes)
    assert after.rows < before.rows


def test_a_gap_divides_the_log() -> None:
    columns = drilled(random_unit(np.random.default_rng(102)), 9, 2, 1.0, seconds=20.0)
    there = np.abs(columns["time_s"] - 8.0) > 0.5
    run = campaign_of({"gap": {name: values[there] for name, values in columns.items()}}, "free_rotation").runs[0]
    assert run.rows > 30
    assert np.all(np.abs(run.covariates["time"] - 8.0) > 0.5)


def test_rows_that_are_far_apart_last_no_longer_than_their_samples() -> None:
    """Of a long log few windows are used: a row that lasted until the next one would share its velocity with it."""
    errors = random_unit(np.random.default_rng(1))
    campaign = campaign_of({"waved": waved(errors, 1, seconds=400.0, hz=50.0)}, "slow_motion")
    timeline = imubayes.bind(model_of(), campaign).problem.timeline
    assert timeline is not None
    rows = campaign.runs[0].rows
    assert timeline.row.length[:rows] == pytest.approx(campaign.runs[0].samples[0] / 50.0, rel=1e-6)
    assert np.mean(timeline.row.gap[1:rows] > 0.5 * timeline.row.length[1:rows]) > 0.3


def test_a_unit_in_motion_is_linearised_without_compiling(caplog: pytest.LogCaptureFixture) -> None:
    """`new` linearises a model of every candidate once: to compile it takes ten times as long."""
    errors = random_unit(np.random.default_rng(1))
    model = imubayes.bind(model_of(), campaign_of({"waved": waved(errors, 1, seconds=20.0, hz=50.0)}, "slow_motion"))
    problem, z = model.problem, first_point(model.assembly)
    step = 1e-6 * np.random.default_rng(2).normal(size=len(z))
    with jax.log_compiles():
        before, about, after = (linearise_once(problem, point) for point in (z - step, z, z + step))
    assert "XLA" not in caplog.text
    np.testing.assert_allclose(about.jacobian @ step, (before.misfit - after.misfit) / 2, rtol=1e-4, atol=1e-12)


def test_the_derivative_of_the_motion_is_that_of_its_differences() -> None:
    """Of the inverted outputs and of the products of rotations, whose derivatives are written in closed form."""
    errors = random_unit(np.random.default_rng(1))
    model = imubayes.bind(model_of(), campaign_of({"waved": waved(errors, 1, seconds=20.0, hz=50.0)}, "slow_motion"))
    problem, z = model.problem, first_point(model.assembly)
    gyros = [place for place, name in enumerate(model.layout.names) if name.startswith("gyro_")]
    step = np.zeros(len(z))
    step[gyros] = 3e-4 * np.random.default_rng(3).normal(size=len(gyros))
    before, about, after = (linearise_once(problem, point) for point in (z - step, z, z + step))
    moved = (before.misfit - after.misfit) / 2
    np.testing.assert_allclose(about.jacobian @ step, moved, atol=1e-6 * np.abs(moved).max())


def test_rows_have_the_covariance_of_a_velocity_that_oscillates() -> None:
    """Mean accelerations are differences of a velocity: their covariance is that of its differences, gap or not."""
    rng = np.random.default_rng(4)
    length = rng.uniform(0.2, 1.0, 12)
    gap = np.where(rng.uniform(size=12) < 0.5, 0.0, rng.uniform(0, 2, 12))
    start = np.cumsum(gap + np.concatenate([[0.0], length[:-1]]))
    velocity = HandVelocity(v=jnp.array(0.13), time=jnp.array(0.4))

    def states(start: jax.Array, length: jax.Array, gap: jax.Array) -> StateCovariance:
        return velocity.states(RowSpan(start, length, gap, jnp.ones(2)))

    before = np.concatenate([[np.inf], gap[1:]])
    found = jax.tree.map(np.asarray, jax.jit(jax.vmap(states))(*map(jnp.asarray, (start, length, before))))
    covariance = np.diag(found.variance)
    for first in range(12):
        state = found.end[first]
        for row in range(first + 1, 12):
            state = state * found.over_gap[row]
            covariance[first, row] = covariance[row, first] = state @ found.mean[row]
            state = state * found.over_row[row]
    ends = np.concatenate([start, start + length])
    apart = np.abs(ends[:, None] - ends) / 0.4
    difference = np.hstack([-np.eye(12), np.eye(12)]) / length[:, None]
    expected = difference @ (0.13**2 * np.exp(-apart) * (np.cos(apart) - np.sin(apart))) @ difference.T
    np.testing.assert_allclose(covariance, expected, atol=1e-12)


def test_a_short_log_is_refused() -> None:
    errors = random_unit(np.random.default_rng(1))
    short = {name: values[:200] for name, values in waved(errors, 1, seconds=5.0).items()}
    with pytest.raises(InputError, match="of motion without gaps"):
        campaign_of({"waved": short}, "slow_motion")


def test_slow_motion_recovers_the_unit() -> None:
    found = pulls(waved_campaign()[0], model_of(), waved_campaign()[1])
    assert max(abs(pull) for pull, _ in found.values()) < 4.0
    assert found["gyro_scale_factor.scale[gx]"][1] < 0.01


@cache
def drilled_campaign(seed: int = 2) -> tuple[Campaign, UnitErrors]:
    errors = random_unit(np.random.default_rng(100 + seed))
    return campaign_of(drilled_all(errors, seed), "free_rotation"), errors


@cache
def z_campaign(planted: float = 0.0) -> tuple[Campaign, UnitErrors]:
    errors = random_unit(np.random.default_rng(102))
    errors = replace(errors, gyro_scale=errors.gyro_scale + planted)
    runs = {name: drilled(errors, 9, 2, sense, seconds=8.0) for name, sense in (("forward", 1.0), ("reverse", -1.0))}
    return campaign_of(runs, "free_rotation"), errors


def textbook(campaign: Campaign) -> dict[str, float]:
    return {each.name: each.value for each in classical(campaign) if hasattr(each, "value")}


def test_turns_counted_by_gravity_are_the_textbook_estimate() -> None:
    campaign, errors = z_campaign()
    found = textbook(campaign)
    scale = found["scale_factor[gz]"] / np.radians(1) - 1
    assert scale == pytest.approx(truth(errors)["gyro_scale_factor.scale[gz]"], abs=4e-3)
    assert "scale_factor[gx]" not in found


def test_one_rate_alone_is_no_textbook_estimate() -> None:
    campaign, _ = z_campaign()
    assert textbook(replace(campaign, runs=campaign.runs[:1])) == {}


def test_a_planted_scale_factor_moves_the_textbook_estimate() -> None:
    before, after = (textbook(z_campaign(planted)[0])["scale_factor[gz]"] for planted in (0.0, 0.01))
    assert after / before == pytest.approx(1 + 0.01 / (1 + z_campaign()[1].gyro_scale[2]), abs=3e-4)


@pytest.mark.slow
def test_a_drill_tells_scale_factors_of_gyros_without_a_table() -> None:
    found = pulls(*_with_model(drilled_campaign(), "rotation_centre"))
    widths = [found[f"gyro_scale_factor.scale[g{axis}]"][1] for axis in "xyz"]
    assert max(widths) < 200e-6
    assert max(abs(pull) for pull, _ in found.values()) < 4.0


def _with_model(made: tuple[Campaign, UnitErrors], *further: str) -> tuple[Campaign, ModelSpec, UnitErrors]:
    return made[0], model_of(*further), made[1]


@pytest.mark.slow
@pytest.mark.parametrize("procedure", ["slow_motion", "free_rotation"])
def test_pulls_of_many_units(procedure: str) -> None:
    by_effect: dict[str, list[float]] = {}
    for seed in range(20):
        errors = random_unit(np.random.default_rng(500 + seed))
        if procedure == "slow_motion":
            found = pulls(campaign_of({"waved": waved(errors, seed)}, procedure), model_of(), errors)
        else:
            campaign = campaign_of(drilled_all(errors, seed), procedure)
            found = pulls(campaign, model_of("rotation_centre"), errors)
        for name, (pull, _) in found.items():
            by_effect.setdefault(name.partition(".")[0], []).append(pull)
    for effect, values in by_effect.items():
        assert 0.7 < np.sqrt(np.mean(np.square(values))) < 1.3, effect
    everything = np.concatenate(list(by_effect.values()))
    assert 0.85 < np.sqrt(np.mean(everything**2)) < 1.15


@pytest.mark.slow
@pytest.mark.parametrize(("planted", "seed", "verdict"), [(0.0, 1, "adequate"), (1.0, 2, "missing_effect")])
def test_a_g_sensitivity_that_the_model_lacks_is_named(planted: float, seed: int, verdict: str) -> None:
    """Of `planted` deg/s/g along each input axis; the noise of the hand is no alarm."""
    errors = random_unit(np.random.default_rng(700 + seed))
    errors = replace(errors, drag=planted * np.radians(1.0) / 9.8 * np.diag([1.0, -1.0, 1.0]))
    campaign = campaign_of({"waved": waved(errors, seed, seconds=60.0)}, "slow_motion")
    found = imubayes.diagnose(imubayes.fit(campaign, model_of(), sample=False))
    assert found.verdict == verdict
    if planted:
        assert "gyro_g_sensitivity" in found.groups[0].effects


def diagnosed(planted: float, *further: str, lag: float = 0.0) -> Diagnosis:
    """Return the diagnosis of a unit that is waved for a minute, whose gyros have a scale factor asymmetry, or lag."""
    errors = random_unit(np.random.default_rng(1), asymmetry=np.full(3, planted))
    columns = waved(errors, 1, seconds=60.0, setup=SetUp(lag=lag))
    model = imubayes.bind(model_of(*further), campaign_of({"waved": columns}, "slow_motion"))
    mode = find_mode(model.problem, first_point(model.assembly), np.zeros(len(model.hyper_layout)))
    return judge(Fit(model, np.asarray(mode.z), np.asarray(mode.h), bool(mode.converged)))


@pytest.mark.slow
def test_an_asymmetry_beyond_its_prior_contradicts_it() -> None:
    """The accelerometers and the closing rotations show it together: none of them alone."""
    found = diagnosed(0.03, "gyro_scale_asymmetry")
    assert found.verdict == "run_disagrees"
    assert found.explanations is not None
    form = found.explanations.form
    assert form is not None
    assert form.name == "prior of gyro_scale_asymmetry"


@pytest.mark.slow
def test_an_asymmetry_that_the_model_lacks_is_named() -> None:
    found = diagnosed(0.03)
    assert found.verdict == "missing_effect"
    assert "gyro_scale_asymmetry" in found.groups[0].effects


@pytest.mark.slow
def test_a_lag_of_the_gyros_is_named_with_its_size() -> None:
    """Of 20 ms, by the angular acceleration that the gyros show themselves."""
    found = diagnosed(0.0, lag=0.02)
    assert found.verdict == "missing_effect"
    assert found.groups[0].effects == ("gyro_bandwidth",)
    for each in found.groups[0].candidates[0].coefficients:
        assert each.value is not None
        assert each.sd is not None
        assert abs(each.value - 20.0) < 4 * each.sd


@pytest.mark.slow
def test_a_complete_model_of_motion_is_adequate() -> None:
    assert diagnosed(0.0).verdict == "adequate"

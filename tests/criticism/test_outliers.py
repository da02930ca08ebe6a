"""Outliers: reported as such, and distinguished from patterns, steps and effects; mended by `outliers`."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from null_data import fitted_to, redrawn, refitted, with_values
from planted_data import names, probability, surely_wrong, told

from imubayes.criticism.diagnose import judge
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.display.loop.diagnosis_report import diagnosis_json
from imubayes.display.loop.diagnosis_sentences import sentence
from imubayes.inference.fitted_model import Fit
from imubayes.loop.cross_validation import groups, predict_left_out, whole_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import EffectSpec
from imubayes.model.noise_covariance import noise_distribution
from imubayes.responses.residual_covariates import covariates


@pytest.fixture(scope="module")
def whole() -> Fit:
    return fitted_to("hidden-none")


def deviations(fitted: Fit) -> np.ndarray:
    return np.sqrt(np.asarray(noise_distribution(fitted.model.problem, jnp.asarray(fitted.h)).squared_scale))


def hits(fitted: Fit, count: int, size: float, seed: int) -> np.ndarray:
    """Return what some readings, drawn at random, are off by, (E,)."""
    rng = np.random.default_rng(seed)
    change = np.zeros(len(fitted.model.entries))
    change[rng.choice(len(change), count, replace=False)] = size * rng.choice([-1, 1], count)
    return change * deviations(fitted)


def places(fitted: Fit, change: np.ndarray) -> set[tuple[str, str, int]]:
    entries, campaign = fitted.model.entries, fitted.model.campaign
    return {
        (campaign.runs[entries.run[k]].name, campaign.channels[entries.channel[k]].name, int(entries.row[k]) + 1)
        for k in np.flatnonzero(change)
    }


def listed(found: Diagnosis) -> set[tuple[str, str, int]]:
    """Return the rows that a diagnosis reports as outliers."""
    return {(each.run, each.channel, each.row) for each in found.outliers}


def is_told(found: Diagnosis, where: set[tuple[str, str, int]]) -> None:
    """Fail if the rows are not reported, as outliers or as a wrong record of that row, or an effect is named."""
    rows = {(run, row) for run, _, row in where}
    wrong = {(each.run, each.row) for each in found.disagreeing}
    assert where <= listed(found) or rows <= wrong, told(found)
    assert found.verdict in ("noise_model", "run_disagrees"), told(found)
    assert all(each.probability < 0.5 for each in found.ranking), told(found)


def test_readings_that_are_far_off_are_told(whole: Fit) -> None:
    change = hits(whole, 12, 12.0, seed=3)
    found = judge(redrawn(whole, 5, change=change))
    is_told(found, places(whole, change))
    assert listed(found) == places(whole, change), told(found)
    assert found.explanations is not None
    assert "tails" in {each.family for each in found.explanations.noise}, told(found)
    assert found.suggested is not None
    assert found.suggested.effects == ("outliers",)
    assert "outlier" in sentence(found)
    assert any(one.table_angle_deg is not None for one in found.outliers)
    # In standard deviations of Student's t, whose scale is less than that of the noise.
    assert all(6 < abs(one.distance) < 30 for one in found.outliers), told(found)


@pytest.mark.slow  # several are reported at every run
@pytest.mark.parametrize("seed", [3, 8])
def test_one_reading_that_is_far_off_is_told(whole: Fit, seed: int) -> None:
    change = hits(whole, 1, 12.0, seed=seed)
    is_told(judge(redrawn(whole, 5, change=change)), places(whole, change))


@pytest.mark.slow
def test_white_noise_has_no_outliers(whole: Fit) -> None:
    assert not sum(len(judge(redrawn(whole, seed)).outliers) for seed in range(2))


@pytest.mark.slow
def test_a_pattern_in_a_few_rows_is_no_matter_of_outliers(whole: Fit) -> None:
    """All readings of the gyros at one rate about their own axes are off alike: many outliers, and one cause."""
    model = whole.model
    gyros = [k for k, channel in enumerate(model.campaign.channels) if channel.kind == "gyro"]
    own = next(each.values for each in covariates(whole) if each.name == "rate_i")
    here = np.isin(model.entries.channel, gyros) & (np.abs(np.abs(np.nan_to_num(own)) - 60.0) < 1.0)
    assert 0 < here.mean() < 0.2
    found = judge(redrawn(whole, 6, change=9.0 * here * deviations(whole)))
    assert found.verdict not in ("noise_model", "adequate"), told(found)
    assert not surely_wrong(found), told(found)
    assert found.explanations is not None
    form = found.explanations.form
    assert form is not None
    assert set(form.channels) == {model.campaign.channels[k].name for k in gyros}, told(found)


@pytest.mark.slow
def test_a_step_is_no_matter_of_outliers(whole: Fit) -> None:
    """The last three readings of one channel in one run are off alike."""
    entries = whole.model.entries
    own = np.flatnonzero((entries.run == 1) & (entries.channel == 0))
    change = np.zeros(len(entries))
    change[own[np.argsort(entries.row[own])][-3:]] = 12.0
    found = judge(redrawn(whole, 8, change=change * deviations(whole)))
    assert found.verdict == "unexplained_structure", told(found)
    assert found.explanations is not None
    form = found.explanations.form
    assert form is not None
    assert form.name.startswith("step"), told(found)
    assert form.run == whole.model.campaign.runs[1].name
    assert form.row == int(np.sort(entries.row[own])[-3]) + 1, told(found)
    assert form.channels == (whole.model.campaign.channels[0].name,)
    assert not found.outliers, told(found)
    assert diagnosis_json(found)["next"].startswith("imubayes compare")


@pytest.mark.slow
def test_an_effect_is_found_behind_them() -> None:
    hidden = fitted_to("hidden-gyro")
    change = hits(hidden, 12, 12.0, seed=4)
    found = judge(with_values(hidden, np.asarray(hidden.model.problem.observations.value) + change))
    assert names(found, "gyro_scale_asymmetry"), told(found)
    assert "gyro_scale_asymmetry" in found.groups[0].effects
    assert places(hidden, change) <= listed(found), told(found)
    assert found.explanations is not None
    assert "tails" in {each.family for each in found.explanations.noise}, told(found)
    assert not surely_wrong(found, "gyro_scale_asymmetry"), told(found)


@pytest.fixture(scope="module")
def mended(whole: Fit) -> tuple[Fit, Fit]:
    """The fit to readings of which some are far off, without `outliers` and with."""
    change = hits(whole, 12, 12.0, seed=3)
    spoilt = with_values(whole, np.asarray(whole.model.problem.observations.value) + change)
    spec = replace(spoilt.model.spec, effects=(*spoilt.model.spec.effects, EffectSpec("outliers")))
    model = bind(spec, spoilt.model.campaign)
    robust = refitted(model, np.zeros(model.problem.size[0]), np.zeros(model.problem.size[1]))
    assert robust.converged
    return spoilt, robust


@pytest.mark.slow  # compiles a model of its own; its likelihood is that of model/test_robust_likelihood.py
def test_with_outliers_in_the_model_nothing_is_missing(whole: Fit, mended: tuple[Fit, Fit]) -> None:
    _, robust = mended
    found = judge(robust)
    assert found.verdict == "adequate", told(found)
    assert not found.groups
    # The scale is that of the good readings again.
    names = robust.model.hyper_layout.names
    sigma = np.asarray(robust.model.problem.hyper_priors.values(jnp.asarray(robust.h)))
    was = np.asarray(whole.model.problem.hyper_priors.values(jnp.asarray(whole.h)))
    for place, name in enumerate(whole.model.hyper_layout.names):
        if name.startswith("white_noise"):
            assert 0.7 < sigma[names.index(name)] / was[place] < 1.15


@pytest.mark.slow
def test_runs_that_were_left_out_are_predicted_better(mended: tuple[Fit, Fit]) -> None:
    _, _, masks = groups(mended[0].model)
    gains = []
    for mask in masks[:3]:
        normal, heavy = (predict_left_out(whole_fit(each), mask).density for each in mended)
        gains.append(heavy - normal)
    assert min(gains) > 0
    assert sum(gains) > 30


@pytest.mark.slow
def test_a_reading_that_the_model_leans_on_is_seen(whole: Fit) -> None:
    """The reading of the largest force along ax, whose neighbours share most of its leverage, 20 deviations off."""
    entries = whole.model.entries
    own = np.flatnonzero((entries.channel == 3) & ~entries.closing)
    change = np.zeros(len(entries))
    place = own[np.argmax(np.abs(entries.value[own]))]
    change[place] = 20 * deviations(whole)[place]
    found = judge(redrawn(whole, 7, change=change))
    is_told(found, places(whole, change))
    assert probability(found, "nothing") < 0.01

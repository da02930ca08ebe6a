"""Readings that are far off: told from patterns, from effects and from chance, and mended by `outliers`."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from null_data import fitted_to, redrawn, refitted, with_values

import imubayes.criticism.stepwise_search as search_module
from imubayes.responses.candidate_effects import candidate_responses
from imubayes.loop.cross_validation import groups, predict_left_out, whole_fit
from imubayes.criticism.diagnose import judge
from imubayes.adequacy.noise_tests import screen_noise, to_entries
from imubayes.criticism.outliers import consecutive
from imubayes.adequacy.projection import project
from imubayes.display.diagnosis_report import diagnosis_json
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import bind
from imubayes.model.model_spec import EffectSpec
from imubayes.model.noise_covariance import noise_distribution


@pytest.fixture(scope="module")
def whole():
    return fitted_to("hidden-none")


def deviations(fitted: Fit) -> np.ndarray:
    return np.sqrt(np.asarray(noise_distribution(fitted.model.problem, jnp.asarray(fitted.h)).squared_scale))


def hits(fitted: Fit, count: int, size: float, seed: int) -> np.ndarray:
    """Return what some readings, drawn at random, are off by, (E,)."""
    rng = np.random.default_rng(seed)
    change = np.zeros(len(fitted.model.entries))
    change[rng.choice(len(change), count, replace=False)] = size * rng.choice([-1, 1], count)
    return change * deviations(fitted)


def named(document: dict) -> set[tuple[str, str, int]]:
    return {(one["run"], one["channel"], one["row"]) for one in document["outliers"]}


def places(fitted: Fit, change: np.ndarray) -> set[tuple[str, str, int]]:
    entries, campaign = fitted.model.entries, fitted.model.campaign
    return {
        (campaign.runs[entries.run[k]].name, campaign.channels[entries.channel[k]].name, int(entries.row[k]) + 1)
        for k in np.flatnonzero(change)
    }


@pytest.mark.parametrize("count", [1, pytest.param(12, marks=pytest.mark.slow)])
def test_readings_that_are_far_off_are_named(whole, count):
    change = hits(whole, count, 12.0, seed=3)
    found = diagnosis_json(judge(redrawn(whole, 5, change=change)))
    assert found["verdict"] == "noise_model", found["sentence"]
    assert {one["effect"] for one in found["noise"] if one["adopted"]} == {"outliers"}
    assert named(found) == places(whole, change)
    assert any(one["table_angle_deg"] is not None for one in found["outliers"]) or count == 1
    assert "outlier" in found["sentence"]
    assert all(8 < abs(one["distance"]) < 16 for one in found["outliers"])


def test_without_the_look_for_outliers_they_pass_for_something_else(whole, monkeypatch):
    """The planted fault: the check goes red where readings that are far off are not looked for."""
    monkeypatch.setattr(search_module, "_outliers", lambda ground, sight: ([], np.zeros(0, dtype=bool)))
    found = diagnosis_json(judge(redrawn(whole, 5, change=hits(whole, 12, 12.0, seed=3))))
    assert found["verdict"] not in ("noise_model", "adequate")
    assert not found["outliers"]


def test_a_pattern_in_a_few_rows_is_no_matter_of_outliers(whole):
    """All readings of the gyros at one rate, in all runs, are off alike: many that are far off, and one cause."""
    model = whole.model
    gyros = [k for k, channel in enumerate(model.campaign.channels) if channel.kind == "gyro"]
    rate = np.array(
        [
            model.campaign.runs[run].covariates["table_rate"][row]
            for run, row in zip(model.entries.run, model.entries.row, strict=True)
        ]
    )
    rates = np.unique(np.abs(rate[np.isin(model.entries.channel, gyros)]))
    one = rates[len(rates) // 2]
    here = np.isin(model.entries.channel, gyros) & (rate == one)
    assert 0 < here.mean() < 0.2
    found = diagnosis_json(judge(redrawn(whole, 6, change=9.0 * here * deviations(whole))))
    assert found["verdict"] not in ("noise_model", "adequate"), found["sentence"]
    assert not found["outliers"]


def step(whole: Fit) -> np.ndarray:
    """Return what the last three readings of one channel in one run are off by, (E,)."""
    entries = whole.model.entries
    own = np.flatnonzero((entries.run == 1) & (entries.channel == 0))
    change = np.zeros(len(entries))
    change[own[np.argsort(entries.row[own])][-3:]] = 12.0
    return change * deviations(whole)


def test_a_step_is_no_matter_of_outliers(whole):
    found = diagnosis_json(judge(redrawn(whole, 8, change=step(whole))))
    assert found["verdict"] == "unexplained_structure", found["sentence"]
    assert not found["outliers"]
    assert "time" in found["structure"][0]["covariate"]
    # What happens once has no formula: none is offered, and what comes next can be done.
    assert "has a step" in found["sentence"]
    assert not any(line.get("python") for line in found["structure"])
    assert found["next"].startswith("imubayes compare")


def test_a_step_would_pass_for_outliers(whole, monkeypatch):
    """The planted fault: the check goes red where nobody asks whether they follow one another."""
    monkeypatch.setattr(search_module, "consecutive", lambda model, sizes: False)
    found = diagnosis_json(judge(redrawn(whole, 8, change=step(whole))))
    assert found["verdict"] == "noise_model", found["sentence"]


def test_readings_hit_at_random_seldom_follow_one_another(whole):
    hit = [consecutive(whole.model, hits(whole, count, 12.0, seed)) for count in (2, 6, 12, 30) for seed in range(50)]
    assert np.mean(hit) < 0.03


def test_an_effect_is_found_behind_them():
    hidden = fitted_to("hidden-gyro")
    change = hits(hidden, 12, 12.0, seed=4)
    value = np.asarray(hidden.model.problem.observations.value) + change
    spoilt = with_values(hidden, value)
    found = diagnosis_json(judge(spoilt))
    assert "gyro_scale_asymmetry" in found["groups"][0]["effects"], found["sentence"]
    assert places(hidden, change) <= named(found)
    assert "outliers" in {one["effect"] for one in found["noise"] if one["adopted"]}


@pytest.fixture(scope="module")
def mended(whole):
    """The fit to readings of which some are far off, without `outliers` and with."""
    change = hits(whole, 12, 12.0, seed=3)
    spoilt = with_values(whole, np.asarray(whole.model.problem.observations.value) + change)
    spec = replace(spoilt.model.spec, effects=(*spoilt.model.spec.effects, EffectSpec("outliers")))
    model = bind(spec, spoilt.model.campaign)
    robust = refitted(model, np.zeros(model.problem.size[0]), np.zeros(model.problem.size[1]))
    assert robust.converged
    return spoilt, robust


def test_with_outliers_in_the_model_nothing_is_missing(whole, mended):
    _, robust = mended
    found = diagnosis_json(judge(robust))
    assert found["verdict"] == "adequate", found["sentence"]
    assert not found["outliers"]
    # The scale is that of the good readings again.
    names = robust.model.hyper_layout.names
    sigma = np.asarray(robust.model.problem.hyper_priors.values(jnp.asarray(robust.h)))
    was = np.asarray(whole.model.problem.hyper_priors.values(jnp.asarray(whole.h)))
    for place, name in enumerate(whole.model.hyper_layout.names):
        if name.startswith("white_noise"):
            assert 0.7 < sigma[names.index(name)] / was[place] < 1.15


def test_runs_that_were_left_out_are_predicted_better(mended):
    _, _, masks = groups(mended[0].model)
    gains = []
    for mask in masks[:3]:
        normal, heavy = (predict_left_out(whole_fit(each), mask).density for each in mended)
        gains.append(heavy - normal)
    assert min(gains) > 0
    assert sum(gains) > 30


def test_a_reading_that_the_model_leans_on_is_seen(whole):
    """The reading with the least of its variance left, yet enough, 20 standard deviations off."""
    responses = candidate_responses(whole)
    projection = project(whole, responses.misfit, responses.jacobian)
    left = 1 - np.sum(to_entries(projection, projection.basis) ** 2, axis=1)
    place = int(np.argmin(np.where(left > 0.2, left, 1.0)))
    change = np.zeros(len(left))
    change[place] = 20 * deviations(whole)[place]
    assert left[place] < 0.7
    found = diagnosis_json(judge(redrawn(whole, 7, change=change)))
    assert found["verdict"] == "noise_model", found["sentence"]
    assert named(found) == places(whole, change)


def test_chance_of_tails_under_white_noise(whole):
    """p-values of fresh white residuals are spread evenly; those of Student's t of 4 degrees of freedom are not."""
    responses = candidate_responses(whole)
    projection = project(whole, responses.misfit, responses.jacobian)
    rng = np.random.default_rng(2)

    def chances(draws: np.ndarray) -> np.ndarray:
        found = [screen_noise(replace(projection, residual=projection.project(one))) for one in draws]
        return np.array([c.p for candidates in found for c in candidates if c.effect == "outliers"])

    rows = len(projection.residual)
    white = chances(rng.normal(size=(60, rows)))
    assert 0.2 < np.mean(white < 0.5) < 0.75
    assert np.mean(white < 0.05) < 0.12
    assert np.mean(white < 0.001) < 0.02
    heavy = chances(rng.standard_t(4, size=(10, rows)))
    assert np.mean(heavy < 0.001) > 0.6

"""The screen: it says before a refit what the refit finds, it does not cry wolf, and its faults would show."""

from dataclasses import replace

import numpy as np
import pytest
from null_data import fitted_to, redrawn
from scipy import stats

import imubayes.criticism.stepwise_search as search_module
from imubayes.criticism import thresholds
from imubayes.responses.candidate_effects import candidate_responses
from imubayes.criticism.diagnose import judge
from imubayes.criticism.multiple_testing import look_elsewhere
from imubayes.adequacy.projection import project
from imubayes.criticism.score_test import project_responses, score_test, screen
from imubayes.criticism.stepwise_search import search
from imubayes.display.diagnosis_report import diagnosis_json, diagnosis_lines


@pytest.fixture(scope="module")
def fitted():
    return fitted_to("accel-channel", "accel-channel")


@pytest.fixture(scope="module")
def looked(fitted):
    """Candidates of twenty null data sets, with the chance of the best of each."""
    found = []
    for seed in range(20):
        fresh = redrawn(fitted, seed)
        responses = candidate_responses(fresh)
        projection = project(fresh, responses.misfit, responses.jacobian)
        candidates = screen(projection, project_responses(projection, responses.candidates))
        found.append((projection, candidates))
    return found


def test_what_the_model_absorbs_is_orthogonal_to_what_is_screened(fitted):
    responses = candidate_responses(fitted)
    projection = project(fitted, responses.misfit, responses.jacobian)
    assert np.abs(projection.basis.T @ projection.residual).max() < 1e-8
    for one in project_responses(projection, responses.candidates):
        assert np.abs(projection.basis.T @ one.projected).max() < 1e-8 * max(1.0, np.abs(one.whitened).max())


def test_what_only_a_prior_speaks_against_is_screened(fitted):
    """A parameter has taken the place of a candidate of the same response, 10⁵ times the noise, 20 sd off its prior."""
    responses = candidate_responses(fitted)
    at = project(fitted, responses.misfit, responses.jacobian)
    rows, entries = at.jacobian.copy(), len(responses.misfit)
    parameter = int(np.argmax(np.linalg.norm(rows[:entries], axis=0)))
    rows[:entries, parameter] *= 1e5 / np.linalg.norm(rows[:entries, parameter])
    response = np.concatenate([rows[:entries, [parameter]], np.zeros((len(rows) - entries, 1))])
    residual = np.concatenate([np.random.default_rng(1).normal(size=entries), np.zeros(len(rows) - entries)])
    residual[entries + parameter] = 20.0
    basis, upper = np.linalg.qr(rows)
    there = replace(at, basis=basis, upper=upper, jacobian=rows, residual=residual - basis @ (basis.T @ residual))
    found = score_test(there, there.project(response), np.array([1e5]))
    assert found.delta_chi2 == pytest.approx(400, rel=0.1)
    assert found.prior_share > 0.9
    assert score_test(there, there.project(response), np.array([1e5]), least=1e-9).p == 1  # what it was


def test_what_is_rounding_of_a_response_has_no_coefficient(fitted, monkeypatch):
    """On a level table at rest a tilt about one axis does nothing; of its derivative only rounding is left."""

    def absurd() -> list[str]:
        projection = project(fitted, responses.misfit, responses.jacobian)
        return [
            coefficient.parameter.name
            for one in screen(projection, project_responses(projection, responses.candidates))
            for coefficient, value in zip(one.coefficients, one.value, strict=True)
            if abs(value) > 1e6 * coefficient.typical[1]
        ]

    responses = candidate_responses(fitted)
    assert not absurd()
    monkeypatch.setattr(thresholds, "RESPONSE_MIN", 0.0)
    assert any(name.startswith("table_axis_tilt") for name in absurd())


def test_degrees_of_freedom_add_up(fitted):
    responses = candidate_responses(fitted)
    projection = project(fitted, responses.misfit, responses.jacobian)
    assert projection.freedom.sum() == pytest.approx(len(fitted.model.entries), abs=1e-6)


def test_the_score_is_the_drop_of_a_linear_refit(fitted):
    """Δχ² by least squares with the columns of the candidate added, from scratch."""
    responses = candidate_responses(fitted)
    projection = project(fitted, responses.misfit, responses.jacobian)
    one = project_responses(projection, responses.candidates)[0]
    candidate = next(c for c in screen(projection, [one]) if len(c.coefficients) == len(one.response.coefficients))
    whole = projection.basis @ (projection.basis.T @ one.whitened) + one.projected
    both = np.concatenate([projection.jacobian, whole], axis=1)
    left = projection.residual - both @ np.linalg.lstsq(both, projection.residual, rcond=1e-12)[0]
    drop = projection.residual @ projection.residual - left @ left
    assert candidate.score.delta_chi2_at_fit == pytest.approx(drop, rel=1e-6, abs=1e-9)


def test_single_p_values_are_uniform_under_no_effect(looked):
    """Where the model absorbs nearly all, only the pull on the priors is left: the truth is the same each time."""
    values = [one.p for _, candidates in looked for one in candidates if one.dof == 1 and one.retained.min() > 0.02]
    below = np.mean(np.array(values) < 0.1)
    assert 0.02 < below < 0.2
    assert 0.35 < np.mean(values) < 0.65


def test_the_best_of_many_is_judged_by_all_looks(looked):
    """Left out, the look-elsewhere correction would raise an alarm nearly every time."""
    uncorrected = np.array([min(one.p for one in candidates) for _, candidates in looked])
    corrected = np.array([look_elsewhere([c.score for c in cs])(min(c.p for c in cs)) for _, cs in looked])
    assert np.mean(corrected < 0.05) <= 0.2
    assert np.mean(uncorrected < 0.05) > 0.5


def test_understated_noise_does_not_raise_an_alarm(looked):
    """The noise is judged after the candidate; a χ² test that believes in a noise 1.5 times too small cries wolf."""
    believed = []
    for _, candidates in looked:
        chance = look_elsewhere([one.score for one in candidates])
        p = min(stats.chi2.sf(1.5**2 * one.score.delta_chi2_at_fit, one.dof) for one in candidates)
        believed.append(chance(float(p)))
        louder = candidates[0].score
        assert louder.delta_chi2 > 0
    corrected = [look_elsewhere([c.score for c in cs])(min(c.p for c in cs)) for _, cs in looked]
    assert np.mean(np.array(believed) < 0.05) > 0.3
    assert np.mean(np.array(corrected) < 0.05) <= 0.2


def test_correlated_noise_is_named_as_noise(fitted, monkeypatch):
    """With the correlation ignored the same data raise alarms."""
    data = [redrawn(fitted, seed, correlation=0.8) for seed in range(4)]
    verdicts = [judge(one).verdict for one in data]
    assert all(verdict == "noise_model" for verdict in verdicts), verdicts
    monkeypatch.setattr(search_module, "screen_noise", lambda projection: [])
    ignored = [search(one) for one in data]
    assert any(one.groups or one.structures for one in ignored)


def test_a_hidden_effect_is_found_with_its_size(fitted):
    """A planted drift of the response is found with the coefficient it was planted with."""
    responses = candidate_responses(fitted)
    hidden = next(one for one in responses.candidates if one.scan.effect == "accel_bias_drift")
    projection = project(fitted, responses.misfit, responses.jacobian)
    length = float(np.linalg.norm(project_responses(projection, [hidden])[0].projected))
    size = 10 / length
    fresh = redrawn(fitted, 3, change=hidden.columns[:, 0] * size)
    found = search(fresh)
    assert "accel_bias_drift" in found.groups[0].effects
    member = next(one for one in found.groups[0].members if one.effect == "accel_bias_drift")
    assert abs(member.value[0] - size) < 3.5 * member.sd[0]


def test_an_unconverged_fit_is_not_ranked(fitted):

    document = diagnosis_json(judge(replace(fitted, optimised=False, message="It did not settle.")))
    assert document["verdict"] == "not_converged"
    assert document["ranking"] == []
    assert document["sentence"] == "It did not settle."


def test_chains_that_did_not_converge_do_not_keep_candidates_from_being_ranked(fitted):
    """The screening is about the mode, which does not depend on the sampling; that it failed is said."""
    assert not replace(fitted, sampled=False).converged
    with_chains = judge(replace(fitted, sampled=False, message="The chains are too short."))
    assert with_chains.ranking == judge(fitted).ranking
    assert with_chains.ranking
    told = diagnosis_lines(with_chains)
    assert any("The sampling of this fit did not converge" in line for line in told)
    assert told[1:] != diagnosis_lines(judge(fitted))[1:]


def test_what_only_pleases_the_priors_at_an_absurd_size_is_no_candidate(fitted):
    """Its evidence all in the prior rows, its coefficient far beyond what is met in practice."""
    responses = candidate_responses(fitted)
    projection = project(fitted, responses.misfit, responses.jacobian)
    found = screen(projection, project_responses(projection, responses.candidates))[0]
    absurd = np.array([1e4 * one.typical[1] for one in found.coefficients])
    assert not replace(found, value=absurd, score=replace(found.score, prior_share=0.9)).plausible
    assert replace(found, value=absurd, score=replace(found.score, prior_share=0.1)).plausible
    assert replace(found, value=absurd / 1e4, score=replace(found.score, prior_share=0.9)).plausible

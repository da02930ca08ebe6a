"""What remains beside an effect is judged at the noise that is left, against which priors weigh less."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from null_data import fitted_to, redrawn

from imubayes.criticism import thresholds
from imubayes.responses.candidate_effects import candidate_responses
from imubayes.adequacy.projection import project
from imubayes.criticism.score_test import project_responses
from imubayes.criticism.stepwise_search import search


@pytest.mark.slow
def test_only_noise_that_acts_on_the_channels_is_a_candidate():
    found = {each.effect for each in search(fitted_to("accel-channel", "accel-channel")).noise}
    assert "correlated_noise" in found
    assert "rate_proportional_noise" not in found  # it goes with the rate: accelerometers have none
    of_gyros = {each.effect for each in search(fitted_to("hidden-none")).noise}
    assert "rate_proportional_noise" in of_gyros


HYSTERESIS, PLAY = "converter_gain_hysteresis", 12.0


def test_reweighted_rows_are_those_of_less_noise():
    """A fit with three times the noise, reweighted by three, against the projection with the noise itself."""
    fitted = fitted_to("accel-channel", "accel-channel")
    responses, problem = candidate_responses(fitted), fitted.model.problem
    names = [parameter.name for parameter in fitted.model.hyper_layout.parameters]
    values, noise = np.asarray(problem.hyper_priors.values(jnp.asarray(fitted.h))), names.index("white_noise.sigma[ax]")
    scatter = names.index("run_scatter.tau[ax]")

    def at(factor: float):
        h = np.asarray(fitted.h).copy()
        h[scatter] = -6.0  # without scatter between runs there is one scale
        h[noise] += np.log(factor) / log_sd
        fit = replace(fitted, h=h)
        found = np.asarray(problem.hyper_priors.values(jnp.asarray(h)))
        assert found[noise] == pytest.approx(factor * values[noise])
        return project(fit, responses.misfit, responses.jacobian)

    step = np.asarray(fitted.h).copy()
    step[noise] += 1.0
    log_sd = float(np.log(np.asarray(problem.hyper_priors.values(jnp.asarray(step)))[noise] / values[noise]))
    more, true = at(3.0), at(1.0)
    root = np.where(more.strata.of_row < 0, 1.0, 3.0)
    found = more.reweighted(root)
    np.testing.assert_allclose(found.residual, true.residual, atol=1e-6)
    np.testing.assert_allclose(found.freedom, true.freedom, atol=1e-6)
    np.testing.assert_allclose(found.basis @ found.basis.T, true.basis @ true.basis.T, atol=1e-6)
    # Planted fault: the priors are multiplied along.
    assert np.abs(more.reweighted(np.full(len(root), 3.0)).residual - true.residual).max() > 1e-3


@pytest.mark.parametrize(("least", "groups"), [(thresholds.LESS_NOISE, 1), (0.0, 2)])
def test_a_large_effect_leaves_none_beside_it(monkeypatch, least, groups):
    """Priors that pull on the noise as fitted, four times too large, pass for a lag beside a hysteresis.

    Planted fault: what remains is judged at the noise as fitted.
    """
    fitted = fitted_to("accel-channel", "accel-channel")
    responses = candidate_responses(fitted)
    at = project(fitted, responses.misfit, responses.jacobian)
    [truth] = [
        each
        for each in project_responses(at, responses.candidates)
        if each.response.scan.effect == HYSTERESIS and each.response.scan.shape == {"play": PLAY}
    ]
    planted = redrawn(fitted, 0, change=truth.response.columns[:, 0] * 45 / np.linalg.norm(truth.projected[:, 0]))
    monkeypatch.setattr(thresholds, "LESS_NOISE", least)
    found = search(planted)
    assert len(found.groups) == groups
    assert found.groups[0].effects == (HYSTERESIS,)

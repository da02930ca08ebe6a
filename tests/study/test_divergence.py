"""Detectability of a hidden effect at unknown noise, against dense matrices."""
# pyright: reportMissingImports=false

from dataclasses import replace

import detectability
import hidden
import hidden_servo
import numpy as np
import pytest
import truth
from divergence import Baseline, seen_past_noise
from procedure_plans import PLANS
from scipy import stats

EFFECT = {"gyro_bias_drift.slope[g]": 0.4, "gyro_scale_asymmetry.asymmetry[g]": 900.0}


@pytest.fixture(scope="module")
def sight(tmp_path_factory) -> detectability.Sight:
    """Three series of positions, the first two of which may differ by the scatter between them alone."""
    model = tmp_path_factory.mktemp("plan") / "model.toml"
    model.write_text(hidden.without("geographic-tumble", ()), encoding="utf-8")
    plan = replace(PLANS["geographic_tumble"].draw(np.random.default_rng(5)), model=model)
    return detectability.look(plan, plan.draw(5))


def _dense(sight: detectability.Sight, white: float, scatter: float) -> np.ndarray:
    samples = np.array([row.samples for run in sight.moments.plan.runs for row in run.rows])
    same = np.equal.outer(sight.moments.run_of_row, sight.moments.run_of_row)
    slopes = sight.slopes[:, 0]
    return np.diag(white**2 / samples) + scatter**2 * same + slopes @ slopes.T


def test_twice_the_divergence_is_that_of_two_normal_distributions(sight: detectability.Sight):
    baseline = Baseline.of(sight)
    ((white,), (scatter,)) = baseline.true
    shift = sight.moments.means(sight.moments.outputs({**sight.values, **EFFECT})) - sight.exact
    for by_white, by_scatter in ((1.0, 1.0), (1.7, 1.0), (0.8, 6.0), (1.1, 0.2)):
        there = baseline.covariance(baseline.true * [[by_white], [by_scatter]])
        k, true = _dense(sight, by_white * white, by_scatter * scatter), _dense(sight, white, scatter)
        levels = np.linalg.slogdet(k)[1] - np.linalg.slogdet(true)[1]
        wanted = levels + np.trace(np.linalg.solve(k, true)) - len(k) + shift[:, 0] @ np.linalg.solve(k, shift[:, 0])
        assert there.divergence(baseline.covariance(baseline.true), shift) == pytest.approx(wanted, rel=1e-6, abs=1e-4)


def test_at_the_true_noise_it_is_the_noncentrality(sight: detectability.Sight):
    baseline = Baseline.of(sight)
    true = baseline.covariance(baseline.true)
    shift = sight.moments.means(sight.moments.outputs({**sight.values, **EFFECT})) - sight.exact
    assert true.divergence(true, shift) == pytest.approx(sight.detectability(EFFECT), rel=1e-5)


def test_unknown_noise_hides_a_part(sight: detectability.Sight):
    s, seen = sight.detectability(EFFECT), seen_past_noise(sight, EFFECT)
    assert 0 < seen < s
    assert seen_past_noise(sight, {}) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.slow
def test_what_scatter_between_few_runs_frees_is_not_seen(tmp_path):
    """Seven runs; S 54 of a drift linear in g, 36 of it against priors that a larger scatter relieves."""
    sizes = {"d_i": 1.0, "d_o": 1.2, "d_s": -2.1}
    effect = {f"gyro_g_sensitivity.{name}[g]": size for name, size in sizes.items()}
    plan = replace(PLANS["centrifuge"].draw(np.random.default_rng(11)), model=tmp_path / "model.toml")
    plan.model.write_text(hidden.without("centrifuge", ("gyro_g_sensitivity",)), encoding="utf-8")
    sight = detectability.look(plan, plan.draw(11))
    effect = hidden.scaled(effect, np.sqrt(60 / sight.detectability(hidden.scaled(effect, 1e-4))) * 1e-4)
    assert sight.detectability(effect) == pytest.approx(60, rel=0.05)
    assert seen_past_noise(sight, effect) < 25 < sight.seen(effect)


@pytest.mark.parametrize("prior", ["lognormal(0.3 output, 0.5)", "halfnormal(0.2 output)"])
def test_a_score_is_that_of_the_quantile(prior: str):
    of = stats.lognorm(0.5, scale=0.3) if prior.startswith("log") else stats.halfnorm(scale=0.2)
    for score in (-2.0, 0.0, 1.5, 5.0):
        value = truth.at_score(prior, score)
        assert of.sf(value) == pytest.approx(stats.norm.sf(score), rel=1e-6)
        assert truth.normal_score(prior, value) == pytest.approx(score, abs=1e-6)


@pytest.mark.slow
def test_what_a_refit_of_a_servo_table_absorbs_is_not_seen(tmp_path):
    """A drift of 1 deg/h per g turns the table by tens of degrees; terms quadratic in g absorb it, z below 2.1 each."""
    drawn = hidden_servo.random_campaign(tmp_path / "campaign", 320001)
    assert drawn.passed_over == ("gyro_g_sensitivity",)
    assert drawn.planted[0].effect == "gyro_bias_drift"

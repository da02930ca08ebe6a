"""Information of the data on θ at noise scales far from the mode: blocks against the whole Jacobian."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from imubayes.inference.conditional_precision import conditional, conditional_precision, precision_blocks
from imubayes.inference.laplace_marginal import knowledge
from imubayes.inference.nested_laplace import grouped_normals
from imubayes.inference.posterior_mode import Mode, find_mode
from imubayes.inference.scale_density import scale_probes
from imubayes.model.bind import Model, bind
from imubayes.model.problem import prior_widths
from small_campaign import campaign, simulated, spec


@cache
def made() -> Model:
    plain = bind(spec("gyro_bias", noise=("white_noise", "run_scatter")), campaign())
    rng = np.random.default_rng(3)
    return bind(plain.spec, simulated(plain, rng.normal(size=plain.problem.size[0]), 4))


@cache
def mode() -> Mode:
    return find_mode(made().problem, *(np.zeros(size) for size in made().problem.size))


@pytest.mark.parametrize("far", [0.0, -4.0, 4.0])
@pytest.mark.slow
def test_precision_and_gradient_follow_the_scatter_between_runs(far):
    problem = made().problem
    scatter = np.array([parameter.effect == "run_scatter" for parameter in made().hyper_layout.parameters])
    assert scatter.any()
    h = mode().h + far * scatter + np.where(scatter, 0.0, 0.1 * far)
    (precision,), (gradient,) = conditional(conditional_precision(problem, mode()), problem, h[None])
    known = knowledge(problem, mode().about, h)
    weight = prior_widths(problem, h) ** -2
    scale = np.sqrt(np.diag(np.asarray(precision)))
    expected = known.precision + np.diag(weight)
    np.testing.assert_allclose(precision / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-9)
    np.testing.assert_allclose(gradient / scale, (known.gradient - weight * mode().z) / scale, atol=1e-7)
    if far > 0:
        # What no longer shrinks is a tenth and less of what a precision fixed at the mode would claim.
        at_mode = knowledge(problem, mode().about, mode().h).precision
        assert np.min(np.diag(np.asarray(known.precision)) / np.diag(np.asarray(at_mode))) < 0.1


def test_a_second_mode_of_a_scale_is_named():
    probes = scale_probes(np.array([0.5, 0.0]), np.diag([400.0, 4.0]))
    step = probes.points - np.array([0.5, 0.0])
    heights = -0.5 * step**2 @ np.array([400.0, 4.0])
    assert probes.other_maxima(heights) == []
    # A narrow mode, and another that is higher beyond what is tabulated about it.
    both = np.logaddexp(heights, 1.0 - 2 * (step[:, 0] + 2.5) ** 2 - 2 * step[:, 1] ** 2)
    (other,) = probes.other_maxima(both)
    np.testing.assert_allclose(probes.points[other], [-2.0, 0.0], atol=0.3)


@pytest.mark.slow
def test_a_correlation_near_one_leaves_the_precision_positive_and_right_for_means():
    plain = bind(spec("gyro_bias", noise=("white_noise", "correlated_noise")), campaign())
    correlated = np.array([each.effect == "correlated_noise" for each in plain.hyper_layout.parameters])
    rng = np.random.default_rng(3)
    model = bind(plain.spec, simulated(plain, rng.normal(size=plain.problem.size[0]), 4))
    start = np.where(correlated, 1.5, 0.0)
    found = find_mode(model.problem, np.zeros(model.problem.size[0]), start)
    at = replace(found, h=start)
    blocks = precision_blocks(model.problem, at)
    for far in (-2.0, -0.5, 0.5, 2.0):
        h = start + far * correlated - 0.3 * far * ~correlated
        (precision,), _ = conditional(blocks, model.problem, h[None])
        assert np.linalg.eigvalsh(precision).min() > 0
        known = knowledge(model.problem, at.about, h).precision + np.diag(prior_widths(model.problem, h) ** -2)
        np.testing.assert_allclose(np.diag(precision) / np.diag(known), 1, atol=0.3)


def test_draws_in_fours_share_noise_scales_and_show_their_marginals() -> None:
    normal = grouped_normals(4000, 3, 2)
    assert normal.shape == (4000, 5)
    fours = normal.reshape(1000, 4, 5)
    assert np.all(fours[:, :, 3:] == fours[:, :1, 3:])
    np.testing.assert_array_equal(fours[:, ::2, :3], -fours[:, 1::2, :3])
    # Strata: each thousandth of a marginal is drawn once.
    ends = np.quantile(fours[:, 0, 3:], (0.025, 0.975), axis=0)
    np.testing.assert_allclose(ends, np.array([[-1.96] * 2, [1.96] * 2]), atol=0.02)
    assert abs(np.corrcoef(fours[:, 0, 3:].T)[0, 1]) < 0.1
    np.testing.assert_allclose(normal[:, :3].std(axis=0), 1.0, atol=0.05)

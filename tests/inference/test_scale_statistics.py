"""The marginal of the noise scales from statistics of a linearisation: value and gradient against JAX."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest

from imubayes.inference import alike_groups, scale_statistics
from imubayes.inference.laplace_marginal import ScaleMarginal, log_marginal
from imubayes.inference.parameter_fit import Linearised, fit_at, linearise
from imubayes.model.bind import Model, bind
from imubayes.model.problem import masked
from small_campaign import campaign, simulated, spec

NOISE = {
    "independent": ("white_noise",),
    "offsets of runs": ("white_noise", "run_scatter"),
    "several kinds": ("white_noise", "quantisation", "rate_proportional_noise", "run_scatter"),
}


@cache
def made(kind: str) -> tuple[Model, Linearised]:
    plain = bind(spec("gyro_bias", "gyro_scale_factor", noise=NOISE[kind]), campaign())
    rng = np.random.default_rng(3)
    model = bind(plain.spec, simulated(plain, rng.normal(size=plain.problem.size[0]), 4))
    z = fit_at(model.problem, *(np.zeros(size) for size in model.problem.size))
    return model, linearise(model.problem, z)


def scales(model: Model, seed: int) -> np.ndarray:
    return 0.7 * np.random.default_rng(seed).normal(size=model.problem.size[1])


@pytest.mark.parametrize("way", ["by kinds of groups", "group by group", "formed anew"])
@pytest.mark.parametrize("kind", NOISE)
def test_value_and_gradient_are_those_of_the_traced_marginal(kind, way, monkeypatch):
    model, about = made(kind)
    if way == "formed anew":
        monkeypatch.setattr(scale_statistics, "_MOST_STORED", 0)
    if way == "group by group":
        monkeypatch.setattr(alike_groups, "_MOST_PAIRS", 0)
    some = masked(model.problem, np.arange(len(about.misfit)) % 7 == 3)
    own = ScaleMarginal(some, about)
    assert own.statistics is not None
    assert (own.statistics.gram is None) == (way == "formed anew")
    assert (own.statistics.alike is not None) == (way == "by kinds of groups" and kind != "independent")
    of_jax = jax.jit(jax.value_and_grad(lambda h: log_marginal(some, about, h)))
    for seed in range(4):
        h = scales(model, seed)
        value, gradient = of_jax(h)
        found = own.slope(h)
        assert found.value == pytest.approx(float(value), abs=1e-7)
        assert own.values(h[None])[0] == pytest.approx(float(value), abs=1e-7)
        np.testing.assert_allclose(found.gradient, gradient, rtol=1e-7, atol=1e-7)


def test_precision_at_many_scales_is_that_at_each():
    model, about = made("several kinds")
    statistics = ScaleMarginal(model.problem, about).statistics
    assert statistics is not None
    h = np.stack([scales(model, seed) for seed in range(5)])
    many = statistics.normal(h)
    for place, one in enumerate(h):
        alone = statistics.normal(one)
        for name in ("precision", "gradient", "square", "log_determinant"):
            found, expected = getattr(many, name)[place], getattr(alone, name)
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_rows_of_different_variance_are_of_different_classes(monkeypatch):
    """With all rows of a channel in one class, the planted fault, the value is off."""
    model, about = made("several kinds")
    right = ScaleMarginal(model.problem, about)
    assert right.statistics is not None
    h = scales(model, 5)
    monkeypatch.setattr(scale_statistics, "_DIGITS", -1)
    wrong = ScaleMarginal(model.problem, about)
    assert wrong.statistics is not None
    assert wrong.statistics.classes.count < right.statistics.classes.count
    assert abs(wrong.slope(h).value - right.slope(h).value) > 1.0


def test_groups_of_different_shared_variance_are_of_different_kinds(monkeypatch):
    """Group by group the precision is the same; with all groups in one kind, the planted fault, it is off."""
    rng = np.random.default_rng(0)
    cell_group, cell_class = np.repeat(np.arange(8), 2), np.tile([0, 1], 8)
    along, misfit = rng.normal(size=(16, 3)), rng.normal(size=16)
    size = np.tile([3.0, 5.0], 8)
    shared = np.where(np.arange(8) < 5, 0.1, 40.0)[None]
    weight = np.array([[0.7, 2.0]])

    m = (weight[0, cell_class, None] * along).reshape(8, 2, 3).sum(axis=1)
    drawn = shared[0] / (1 + shared[0] * (weight[0] @ size[:2]))
    expected = np.einsum("g,gp,gq->pq", drawn, m, m)

    def precision() -> np.ndarray:
        found = alike_groups.alike_groups(cell_class, cell_group, shared, 2, (along, misfit, size))
        assert found is not None
        return (found.weights(weight, shared)[0] @ found.gram).reshape(3, 3)

    np.testing.assert_allclose(precision(), expected, rtol=1e-12)
    monkeypatch.setattr(alike_groups, "_DIGITS", -2)
    assert np.abs(precision() - expected).max() > 0.1


def test_correlated_rows_have_no_statistics():
    plain = bind(spec("gyro_bias", noise=("white_noise", "correlated_noise")), campaign())
    assert scale_statistics.row_classes(plain.problem) is None
    tails = bind(spec("gyro_bias", noise=("white_noise", "outliers")), campaign())
    assert scale_statistics.row_classes(tails.problem) is None


@pytest.mark.slow
def test_learnt_prior_widths_are_in_the_gradient():
    model, about = made("offsets of runs")
    problem = model.problem
    # The width of the first parameter is learnt as the first noise scale, in units of one prior width.
    spread = np.where(np.arange(problem.size[0]) == 0, 0, problem.size[1])
    unit = np.where(np.arange(problem.size[0]) == 0, problem.hyper_priors.values(np.zeros(problem.size[1]))[0], 1.0)
    learnt = replace(problem, spread_of=spread, spread_unit=unit)
    h = scales(model, 6)
    value, gradient = jax.value_and_grad(lambda one: log_marginal(learnt, about, one))(h)
    found = ScaleMarginal(learnt, about).slope(h)
    assert found.value == pytest.approx(float(value), abs=1e-7)
    np.testing.assert_allclose(found.gradient, gradient, rtol=1e-7, atol=1e-7)
    assert np.abs(found.gradient - ScaleMarginal(problem, about).slope(h).gradient).max() > 1e-3

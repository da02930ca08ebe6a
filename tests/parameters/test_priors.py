"""Priors against scipy.stats, as a map and its inverse, and as text."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from imubayes.foundations.errors import InputError
from imubayes.parameters.priors import (
    FAMILIES,
    HalfCauchy,
    HalfNormal,
    LogNormal,
    LogUniform,
    Normal,
    Prior,
    Uniform,
    parse_prior,
)

CASES: dict[str, tuple[Prior, stats.rv_continuous]] = {
    "normal": (Normal(3.0, 2.0), stats.norm(3.0, 2.0)),
    "uniform": (Uniform(-1.0, 4.0), stats.uniform(-1.0, 5.0)),
    "lognormal": (LogNormal(5.0, 0.7), stats.lognorm(0.7, scale=5.0)),
    "halfnormal": (HalfNormal(2.0), stats.halfnorm(scale=2.0)),
    "halfcauchy": (HalfCauchy(2.0), stats.halfcauchy(scale=2.0)),
    "loguniform": (LogUniform(0.1, 50.0), stats.loguniform(0.1, 50.0)),
}
Z = np.linspace(-5, 5, 41)


def test_every_family_is_checked():
    assert set(CASES) == set(FAMILIES)


@pytest.mark.parametrize("family", CASES)
def test_quantiles_are_those_of_scipy(family):
    prior, known = CASES[family]
    found = jax.jit(jax.vmap(prior.value))(jnp.asarray(Z))
    # Each half by the tail that keeps its digits.
    expected = np.where(Z < 0, known.ppf(stats.norm.cdf(Z)), known.isf(stats.norm.sf(Z)))
    np.testing.assert_allclose(found, expected, rtol=2e-9, atol=1e-12)


def test_a_half_normal_scale_far_beyond_its_prior_has_value_and_derivatives():
    """A fit of a wrong model drives noise scales there, where the tail probability underflows."""
    value = HalfNormal(2.0).value
    z = jnp.array([19.999, 20.001, 30.0, 37.5, 60.0])
    known = stats.norm.isf(np.exp(stats.norm.logsf(z[:3]) - np.log(2)))
    np.testing.assert_allclose(jax.vmap(value)(z)[:3], 2 * known, rtol=1e-6)
    slope, bend = (np.asarray(jax.vmap(each)(z)) for each in (jax.grad(value), jax.grad(jax.grad(value))))
    assert np.all(np.diff(slope) > 0)
    assert slope[-1] == pytest.approx(2, rel=1e-3)
    assert np.all((bend > 0) & (bend < 1e-3))


@pytest.mark.parametrize("family", CASES)
def test_z_undoes_value(family):
    prior, _ = CASES[family]
    values = np.asarray(jax.jit(jax.vmap(prior.value))(jnp.asarray(Z)))
    np.testing.assert_allclose([prior.z(value) for value in values], Z, atol=1e-8)


@pytest.mark.parametrize("family", CASES)
def test_the_standard_deviation_is_that_of_scipy(family):
    prior, known = CASES[family]
    if family == "halfcauchy":
        assert prior.sd() == np.inf
    else:
        assert prior.sd() == pytest.approx(known.std(), rel=1e-12)


@pytest.mark.parametrize("family", CASES)
def test_value_rises_smoothly(family):
    prior, _ = CASES[family]
    slope = jax.jit(jax.vmap(jax.grad(prior.value)))(jnp.asarray(Z))
    curvature = jax.jit(jax.vmap(jax.grad(jax.grad(prior.value))))(jnp.asarray(Z))
    assert np.all(np.isfinite(slope))
    assert np.all(np.asarray(slope) > 0)
    assert np.all(np.isfinite(curvature))


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("normal(0, 2000 ppm)", "ppm", Normal(0.0, 2e-3)),
        ("normal(0, 2000)", "ppm", Normal(0.0, 2e-3)),
        ("normal(10 ppm, 0.2 %)", "ppm", Normal(1e-5, 2e-3)),
        ("normal(-1, 2 mg)", "ug", Normal(-9.8e-3, 2 * 9.8e-3)),
        ("uniform(-180, 180 deg)", "deg", Uniform(-np.pi, np.pi)),
        (" halfnormal( 3 mm ) ", "mm", HalfNormal(3e-3)),
        ("lognormal(1 noise, 0.5)", "output", LogNormal(4.0, 0.5)),
        ("loguniform(1, 1e3 arcsec)", "deg", LogUniform(np.pi / 648000, np.pi / 648)),
        ("halfcauchy(.5)", "1", HalfCauchy(0.5)),
    ],
)
def test_text_becomes_a_prior_in_si(text, unit, expected):
    found = parse_prior(text, unit, 9.8, "model.toml", {"noise": 4.0})
    assert type(found) is type(expected)
    np.testing.assert_allclose(jax.tree.leaves(found), jax.tree.leaves(expected), rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "unit", "what", "allowed"),
    [
        ("normal 0 1", "ppm", "not a prior", "normal("),
        ("norml(0, 1)", "ppm", "'norml' is not a prior", "normal"),
        ("gaussian(0, 1)", "ppm", "not a prior", "normal"),
        ("normal(0)", "ppm", "arguments", "normal(mean, deviation)"),
        ("normal(0, 1, 2)", "ppm", "arguments", "normal(mean, deviation)"),
        ("normal(0, one)", "ppm", "arguments", "normal(mean, deviation)"),
        ("normal(0, 1 mm)", "ppm", "'mm' is not a unit of this parameter", "ppm"),
        ("normal(0, 1 furlong)", "ppm", "'furlong' is not a unit", ""),
        ("lognormal(1 ppm, 0.5 ppm)", "ppm", "'ppm' is not a unit here", "a plain number"),
        ("normal(0, -1)", "ppm", "width", "above 0"),
        ("normal(0, 0)", "ppm", "width", "above 0"),
        ("halfnormal(0)", "ppm", "width", "above 0"),
        ("lognormal(-1, 0.5)", "ppm", "width", "above 0"),
        ("uniform(1, 1)", "ppm", "limits", "low < high"),
        ("loguniform(0, 1)", "ppm", "limits", "low > 0"),
        ("normal(0, 1e999)", "ppm", "not finite", "finite"),
    ],
)
def test_what_is_no_prior_is_refused_in_four_parts(text, unit, what, allowed):
    with pytest.raises(InputError) as caught:
        parse_prior(text, unit, 9.8, "model.toml, line 7", {"noise": 1.0})
    (problem,) = caught.value.issues
    assert what in problem.what
    assert problem.where == "model.toml, line 7"
    assert allowed in problem.allowed
    assert problem.remedy


@given(st.sampled_from(sorted(CASES)), st.floats(-4.9, 4.9), st.floats(0.01, 0.1))
def test_value_is_monotone(family, z, more):
    prior, _ = CASES[family]
    assert prior.value(jnp.asarray(z)) < prior.value(jnp.asarray(z + more))

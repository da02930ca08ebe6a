"""Names against places, and a whole vector of priors at once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.parameters.declarations import Layout, Parameter, Priors
from imubayes.parameters.priors import HalfNormal, LogNormal, Normal, Uniform

PRIORS = [
    Normal(1.0, 2.0),
    LogNormal(3.0, 0.5),
    Normal(-1.0, 0.1),
    Uniform(0.0, 1.0),
    HalfNormal(2.0),
    Normal(0.0, 7.0),
]


def layout() -> Layout:
    return Layout(
        tuple(Parameter("effect", f"p{i}", ("gx", f"run{i}"), "ppm", 1e-6, one) for i, one in enumerate(PRIORS))
    )


def test_names_places_and_factors():
    found = layout()
    assert found.names[1] == "effect.p1[gx,run1]"
    assert found.index("effect.p4[gx,run4]") == 4
    assert len(found) == len(PRIORS)
    np.testing.assert_array_equal(found.factors(), np.full(len(PRIORS), 1e-6))
    assert found.parameters[0].prior_sd == pytest.approx(2e6)
    with pytest.raises(ValueError, match="not in"):
        found.index("effect.p9[gx]")


def test_a_stack_gives_every_value_in_its_own_place():
    z = jnp.asarray(np.random.default_rng(1).normal(size=len(PRIORS)))
    expected = [float(prior.value(one)) for prior, one in zip(PRIORS, z, strict=True)]
    np.testing.assert_allclose(Priors.stack(PRIORS).values(z), expected, rtol=1e-14)


def test_z_of_undoes_values():
    z = np.random.default_rng(2).normal(size=len(PRIORS))
    values = np.asarray(Priors.stack(PRIORS).values(jnp.asarray(z)))
    np.testing.assert_allclose(layout().z_of(values / 1e-6), z, atol=1e-12)


def test_no_parameters_give_no_values():
    assert Priors.stack([]).values(jnp.zeros(0)).shape == (0,)


def test_stacks_of_units_are_treated_in_one_vmap():
    other = [Normal(p.mean + 1, p.deviation) if isinstance(p, Normal) else p for p in PRIORS]
    stacks = [jax.tree.map(jnp.asarray, Priors.stack(one)) for one in (PRIORS, other)]
    together = jax.tree.map(lambda *leaves: jnp.stack(leaves), *stacks)
    z = jnp.asarray(np.random.default_rng(3).normal(size=(2, len(PRIORS))))
    both = jax.vmap(lambda priors, one: priors.values(one))(together, z)
    for i, stack in enumerate(stacks):
        np.testing.assert_allclose(both[i], stack.values(z[i]), rtol=1e-15)

"""Laws that every registered member keeps.  Each is a function that raises AssertionError, so that a test can show it a
member that breaks it."""

import re

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.effects.base import MotionEffect, PlaceEffect, Stage
from imubayes.noise.base import Entry, EntryNoise, SharedNoise
from imubayes.parameters.parameter import declared_options, declared_parameters
from imubayes.parameters.priors import Prior, parse_prior
from imubayes.stimulus import AMBIENT_NAMES, Ambient, Experience, Motion, Sample
from imubayes.units import dimension, to_si

GRAVITY = 9.7966
OWN = {"noise": 0.5, "scale": 1000.0}
# What "nothing" is for a covariate: the effect's own reference for temperatures, 0 for all else.
TEMPERATURES = ("temperature", "converter_temperature")


def priors(member: type) -> dict[str, Prior]:
    """Return the default prior of every parameter, in SI."""
    return {
        field: parse_prior(one.prior, one.unit, GRAVITY, f"{member.name}.{field}", OWN)
        for field, one in declared_parameters(member).items()
    }


def instance(member: type, values: dict) -> object:
    return member(**{field: jnp.asarray(value, dtype=float) for field, value in values.items()})


def null_values(member: type) -> dict[str, float]:
    return {field: one.null for field, one in declared_parameters(member).items()}


def drawn_values(member: type, seed: int) -> dict[str, jax.Array]:
    rng = np.random.default_rng(seed)
    return {field: prior.value(jnp.asarray(rng.normal())) for field, prior in priors(member).items()}


def random_rotation(rng: np.random.Generator) -> jax.Array:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return jnp.asarray(q * np.sign(np.linalg.det(q)))


def ambient(seed: int, **fixed: float) -> Ambient:
    rng = np.random.default_rng(seed)
    drawn = {name: rng.uniform(1.0, 60.0) for name in AMBIENT_NAMES} | fixed
    return Ambient(**{name: jnp.asarray(float(value)) for name, value in drawn.items()})


def states(member: type, seed: int, still: bool = False, **fixed: float) -> tuple:
    """Return the arguments of `apply` at a random instant; without any rotation or signal where `still`."""
    rng = np.random.default_rng(seed)

    def vector(size: float) -> jax.Array:
        return jnp.asarray(rng.normal(size=3) * (0.0 if still else size))

    circumstances = ambient(seed, **fixed)
    if issubclass(member, MotionEffect):
        table = [jnp.asarray(0.0 if still else rng.normal()) for _ in range(2)]
        angle, gravity = jnp.asarray(rng.normal()), jnp.asarray([0, 0, GRAVITY])
        earth = jnp.asarray([0, 6e-5, 4e-5])
        return Motion(random_rotation(rng), random_rotation(rng), angle, *table, gravity, earth), circumstances
    if issubclass(member, PlaceEffect):
        return (Experience(vector(1.0), vector(10.0), vector(1.0), vector(1.0)),)
    signal = jnp.asarray(0.0 if still else rng.normal())
    return signal, Sample(vector(1.0), vector(10.0), vector(1.0), circumstances, jnp.asarray(1000.0))


def moved(member: type, values: dict, state: tuple) -> list[np.ndarray]:
    """Return what the effect makes of its first argument, as leaves."""
    return [np.asarray(leaf) for leaf in jax.tree.leaves(instance(member, values).apply(*state))]


def unmoved(state: tuple) -> list[np.ndarray]:
    return [np.asarray(leaf) for leaf in jax.tree.leaves(state[0])]


def assert_unchanged(member: type, values: dict, state: tuple) -> None:
    for after, before in zip(moved(member, values, state), unmoved(state), strict=True):
        np.testing.assert_allclose(after, before, rtol=1e-15, atol=1e-15 * max(1.0, np.abs(before).max()))


def name_is_that_of_the_class(member: type) -> None:
    """The name in files is the class name in snake case."""
    snake = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", member.__name__).lower()
    assert member.name == snake, f"{member.__name__} calls itself {member.name}"


def text_says_formula_and_source(member: type) -> None:
    """The docstring gives the formula, the class its source, each parameter a phrase."""
    text = member.__doc__ or ""
    written = text and not text.startswith(f"{member.__name__}(")  # what a dataclass writes itself is no docstring
    assert written, f"{member.name} has no docstring"
    assert re.search(r"[·×∝=²√|⁻₀-₉]|[a-zσΩω)] [+−-] ", text), f"{member.name}: no formula in its docstring"
    assert member.reference, f"{member.name} names no source"
    for field, one in declared_parameters(member).items():
        assert one.meaning.split()[0] in ("the", "half", "each", "a"), f"{member.name}.{field}: '{one.meaning}'"


def units_and_priors_are_known(member: type) -> None:
    """Every unit is in the table, every prior has that dimension, and what is typical is positive and ordered."""
    assert declared_parameters(member), f"{member.name} has no parameter"
    for field, one in declared_parameters(member).items():
        assert to_si(one.unit, GRAVITY, own=OWN) > 0
        prior = parse_prior(one.prior, one.unit, GRAVITY, f"{member.name}.{field}", OWN)
        low, high = one.typical
        assert 0 < low < high, f"{member.name}.{field}: typical range {one.typical}"
        if dimension(one.unit)[5] == 0 and np.isfinite(prior.sd()):
            width = prior.sd() / to_si(one.unit, GRAVITY, own=OWN)
            assert width > 0.1 * low, f"{member.name}.{field}: the prior leaves no room for what is typical"


def stage_and_covariates_are_known(member: type) -> None:
    """The stage fits the base class, and what the effect needs is something that runs supply."""
    stages = {MotionEffect: (Stage.STAND, Stage.TABLE), PlaceEffect: (Stage.PLACE,)}
    allowed = next((s for base, s in stages.items() if issubclass(member, base)), (Stage.SENSOR, Stage.CONVERTER))
    assert member.stage in allowed, f"{member.name} stands at {member.stage!r}"
    assert set(member.needs) <= {*AMBIENT_NAMES, "turning", "injection"}, f"{member.name} needs {member.needs}"
    assert set(member.kinds) <= {"gyro", "accelerometer"}
    for one in declared_parameters(member).values():
        assert not one.spread or one.spread in declared_parameters(member)


def null_is_the_identity(member: type) -> None:
    """At its null values an effect changes nothing, wherever and whenever."""
    for seed in range(5):
        assert_unchanged(member, null_values(member), states(member, seed))


def gradients_are_finite(member: type) -> None:
    """At null and over draws of the prior, first and second derivatives are finite."""
    for seed in range(6):
        values = null_values(member) if seed == 0 else drawn_values(member, seed)
        values = {field: jnp.asarray(value, dtype=float) for field, value in values.items()}
        state = states(member, seed, still=seed == 1)

        def total(one, first, rest=state[1:]):
            leaves = jax.tree.leaves(instance(member, one).apply(first, *rest))
            return sum(jnp.sum(leaf * leaf) for leaf in leaves)

        for leaf in jax.tree.leaves(jax.grad(total, argnums=(0, 1))(values, state[0])):
            assert np.all(np.isfinite(leaf)), f"{member.name}: gradient {leaf}"
        for leaf in jax.tree.leaves(jax.hessian(total)(values, state[0])):
            assert np.all(np.isfinite(leaf)), f"{member.name}: second derivative {leaf}"


def silent_without_its_covariate(member: type) -> None:
    """Where what it needs is absent, or at the reference, the effect changes nothing, whatever its values."""
    reference = next((v for name, v in declared_options(member).items() if name.startswith("reference")), 0.0)
    for need in member.needs:
        if need == "injection":
            continue  # a gate: `test_registry` shows that nothing reaches a run without it
        fixed = {} if need == "turning" else {need: reference if need in TEMPERATURES else 0.0}
        for seed in range(1, 4):
            state = states(member, seed, still=need == "turning", **fixed)
            assert_unchanged(member, drawn_values(member, seed), state)


def changes_something(member: type) -> None:
    """Away from null every parameter matters: an effect that cannot be seen is none."""
    spreads = {one.spread for one in declared_parameters(member).values()}
    for field in set(declared_parameters(member)) - spreads:
        responses = []
        for seed in range(1, 6):
            values = null_values(member) | {field: drawn_values(member, seed)[field]}
            state = states(member, seed)
            pairs = zip(moved(member, values, state), unmoved(state), strict=True)
            responses.append(max(np.abs(after - before).max() for after, before in pairs))
        assert max(responses) > 0, f"{member.name}.{field} changes nothing"


def variance_of(member: type, values: dict, samples: float) -> float:
    one = instance(member, values)
    if issubclass(member, EntryNoise):
        return float(one.variance(Entry(jnp.asarray(samples))))
    assert issubclass(member, SharedNoise)
    return float(one.shared_variance())


def variance_is_positive(member: type) -> None:
    """Over draws of the prior the variance is positive and finite."""
    for seed in range(20):
        values = drawn_values(member, seed)
        found = variance_of(member, values, samples=7.0)
        assert 0 < found < np.inf, f"{member.name}: variance {found}"


def misstated_noise_is_less_likely(member: type) -> None:
    """Data drawn at some width are less likely at a third and at three times of it."""
    rng = np.random.default_rng(8)
    for field in declared_parameters(member):
        values = {name: float(value) for name, value in drawn_values(member, 3).items()}
        samples = rng.integers(1, 50, size=400)
        drawn = rng.normal(size=400) * np.sqrt([variance_of(member, values, float(n)) for n in samples])

        def likelihood(factor: float, values=values, field=field, samples=samples, drawn=drawn) -> float:
            misstated = values | {field: values[field] * factor}
            variance = np.array([variance_of(member, misstated, float(n)) for n in samples])
            return float(np.sum(-0.5 * drawn**2 / variance - 0.5 * np.log(variance)))

        assert likelihood(1.0) > likelihood(1 / 3) + 10, f"{member.name}.{field}"
        assert likelihood(1.0) > likelihood(3.0) + 10, f"{member.name}.{field}"


OF_ALL = (name_is_that_of_the_class, text_says_formula_and_source, units_and_priors_are_known)
OF_EFFECTS = (
    stage_and_covariates_are_known,
    null_is_the_identity,
    gradients_are_finite,
    silent_without_its_covariate,
    changes_something,
)
OF_NOISE = (variance_is_positive, misstated_noise_is_less_likely)

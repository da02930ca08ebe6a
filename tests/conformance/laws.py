"""Laws that every registered member keeps.  Each is a function that raises AssertionError, so that a test can show it a
member that breaks it."""

import math
import re
from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from imubayes.effects.base import AmbientEffect, MotionEffect, PlaceEffect, RecordEffect, Stage
from imubayes.foundations.covariates import ambient_names
from imubayes.foundations.signal_path_state import Ambient, Experience, Motion, OuterAxes, Records, Sample
from imubayes.foundations.units import dimension, to_si
from imubayes.noise.components import (
    Entry,
    EntryNoise,
    RowSpan,
    SeriesNoise,
    SharedNoise,
    SlowNoise,
    TailNoise,
)
from imubayes.parameters.declarations import declared_options, declared_parameters
from imubayes.parameters.priors import Prior, parse_prior

GRAVITY = 9.7966
OWN = {"noise": 0.5, "scale": 1000.0}
# What "nothing" is for a covariate: the effect's own reference for temperatures, long ago for power-on, 0 for all else.
TEMPERATURES = ("temperature", "converter_temperature")
LONG_AGO = 1e12
GATES = ("injection", "reference", "driven", "directions", "unknown_heading", "unknown_level", "hand", "carried",
         "posed")  # fmt: skip
INSTANTS = 24  # of a record, two runs


def priors(member: type) -> dict[str, Prior]:
    """Return the default prior of every parameter, in SI."""
    return {
        field: parse_prior(parameter.prior, parameter.unit, GRAVITY, f"{member.name}.{field}", OWN)
        for field, parameter in declared_parameters(member).items()
    }


def instance(member: type, values: dict) -> object:
    return member(**{field: jnp.asarray(value, dtype=float) for field, value in values.items()})


def null_values(member: type) -> dict[str, float]:
    return {field: parameter.null for field, parameter in declared_parameters(member).items()}


def drawn_values(member: type, seed: int) -> dict[str, jax.Array]:
    rng = np.random.default_rng(seed)
    return {field: prior.value(jnp.asarray(rng.normal())) for field, prior in priors(member).items()}


def random_rotation(rng: np.random.Generator) -> jax.Array:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return jnp.asarray(q * np.sign(np.linalg.det(q)))


def ambient(seed: int, **fixed: float) -> Ambient:
    rng = np.random.default_rng(seed)
    drawn = {name: rng.uniform(1.0, 60.0) for name in ambient_names()} | fixed
    return Ambient(**{name: jnp.asarray(float(value)) for name, value in drawn.items()})


def states(member: type, seed: int, still: bool = False, **fixed: float) -> tuple:
    """Return the arguments of `apply` at a random instant; without any rotation or signal if `still`."""
    rng = np.random.default_rng(seed)

    def vector(size: float) -> jax.Array:
        return jnp.asarray(rng.normal(size=3) * (0.0 if still else size))

    circumstances = ambient(seed, **fixed)
    if issubclass(member, AmbientEffect):
        return (circumstances,)
    if issubclass(member, MotionEffect):
        table = [jnp.asarray(0.0 if still else rng.normal()) for _ in range(2)]
        angle, gravity = jnp.asarray(rng.normal()), jnp.asarray([0, 0, GRAVITY])
        earth = jnp.asarray([0, 6e-5, 4e-5])
        reference = [vector(1.0) for _ in range(2)]
        body = random_rotation(rng), random_rotation(rng)
        # The platform of a centrifuge turns about an axis parallel to the arm's.
        link = jnp.stack([jnp.eye(3) if seed % 2 else random_rotation(rng), random_rotation(rng)])
        moving = [jnp.asarray(rng.normal(size=2) * (0.0 if still else 1.0)) for _ in range(2)]
        outer = OuterAxes(link, jnp.asarray(rng.normal(size=(2, 3))), jnp.asarray(rng.normal(size=2)), *moving)
        return Motion(*body, angle, *table, *reference, gravity, earth, outer), circumstances
    if issubclass(member, PlaceEffect):
        return (Experience(*(vector(size) for size in (1.0, 10.0, 1.0, 1.0, 1.0, 1.0))),)
    # A converter is fed with what stands for a hundred g or degrees per second, in output units.
    size = 100 * OWN["scale"] if member.stage == Stage.CONVERTER else 1.0
    signal = jnp.asarray(0.0 if still else size * rng.normal())
    seen = Sample(*(vector(size) for size in (1.0, 10.0, 1.0, 1.0, 1.0)), circumstances, jnp.asarray(1000.0))
    if issubclass(member, RecordEffect):
        return signal + jnp.zeros(INSTANTS), _many(seen), record(seed, **fixed)
    return signal, seen


def _many(tree: object) -> object:
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (INSTANTS, *leaf.shape)), tree)


def record(seed: int, **fixed: float) -> Records:
    """Return two runs in which all changes, but for what is fixed: a rate of 0 fixes its temperature too."""
    rng = np.random.default_rng(seed)
    count = np.arange(INSTANTS)
    begins = (count == 0) | (count == 9)
    seconds = np.where(begins, 0.0, rng.uniform(10, 900, INSTANTS))
    values = {name: np.asarray(getattr(ambient(seed, **fixed), name)) + np.zeros(INSTANTS) for name in ambient_names()}
    for name in TEMPERATURES:
        if name not in fixed and f"{name}_rate" not in fixed:
            values[name] = values[name] + np.cumsum(rng.normal(size=INSTANTS) * 5)
    as_arrays = {name: jnp.asarray(value) for name, value in values.items()}
    order = jnp.asarray(count)
    return Records(order, order, jnp.asarray(begins), jnp.asarray(seconds), Ambient(**as_arrays))


def act_of(effect) -> Callable:
    """Return what an effect without a memory makes of its first argument, as a function."""
    return effect.true_ambient if isinstance(effect, AmbientEffect) else effect.apply


def acted(member: type, values: dict, *state):
    """Return what the effect makes of its first argument."""
    if not issubclass(member, RecordEffect):
        return act_of(instance(member, values))(*state)
    return _over_a_record(member)({field: jnp.asarray(value, dtype=float) for field, value in values.items()}, *state)


@cache
def _over_a_record(member: type) -> Callable:
    """Return `acted` of an effect with a memory, compiled: its scan over the record would be compiled at every call."""

    def act(values, signal, samples, before):
        columns = {field: value.reshape(1, 1) for field, value in values.items()}
        memory = member.memories(lambda chosen: member(**chosen), columns, before)[:, 0]
        return jax.vmap(instance(member, values).apply)(signal, samples, memory)

    return jax.jit(act)


def moved(member: type, values: dict, state: tuple) -> list[np.ndarray]:
    """Return what the effect makes of its first argument, as leaves."""
    return [np.asarray(leaf) for leaf in jax.tree.leaves(acted(member, values, *state))]


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
    for field, parameter in declared_parameters(member).items():
        assert parameter.meaning.split()[0] in ("the", "half", "each", "a"), (
            f"{member.name}.{field}: '{parameter.meaning}'"
        )


def units_and_priors_are_known(member: type) -> None:
    """Every unit is in the table, every prior has that dimension, and what is typical is positive and ordered."""
    assert declared_parameters(member), f"{member.name} has no parameter"
    for field, parameter in declared_parameters(member).items():
        assert to_si(parameter.unit, GRAVITY, own=OWN) > 0
        for kind in ("", "gyro"):
            low, high = parameter.typical_of(kind)
            assert 0 < low < high, f"{member.name}.{field}: typical range {(low, high)}"
            stated = parameter.prior_of("tactical", kind)
            prior = parse_prior(stated, parameter.unit, GRAVITY, f"{member.name}.{field}", OWN)
            if "noise" not in stated and np.isfinite(prior.sd()):
                # Of what is in output units the typical sizes are in those of the nominal scale.
                width = prior.sd() / to_si(parameter.unit, GRAVITY, own=OWN | {"output": OWN["scale"]})
                assert width > 0.1 * low, f"{member.name}.{field}: the prior leaves no room for what is typical"


def stage_and_covariates_are_known(member: type) -> None:
    """The stage fits the base class, and what the effect needs is something that runs record."""
    stages = {MotionEffect: (Stage.STAND, Stage.TABLE), PlaceEffect: (Stage.PLACE,)}
    allowed = next((s for base, s in stages.items() if issubclass(member, base)), (Stage.SENSOR, Stage.CONVERTER))
    assert member.stage in allowed, f"{member.name} stands at {member.stage!r}"
    assert set(member.needs) <= {*ambient_names(), *GATES}, f"{member.name} needs {member.needs}"
    assert set(member.kinds) <= {"gyro", "accelerometer"}
    for parameter in declared_parameters(member).values():
        assert not parameter.spread or parameter.spread in declared_parameters(member)


def null_is_the_identity(member: type) -> None:
    """At its null values an effect changes nothing, wherever and whenever."""
    for seed in range(5):
        assert_unchanged(member, null_values(member), states(member, seed))


def gradients_are_finite(member: type) -> None:
    """At null and over draws of the prior, first and second derivatives are finite."""

    def total(values, first, rest):
        return sum(jnp.sum(leaf * leaf) for leaf in jax.tree.leaves(acted(member, values, first, *rest)))

    def both(values, first, rest):
        gradient = jax.grad(total, argnums=(0, 1))(values, first, rest)
        return gradient[0], gradient

    derivatives = jax.jit(jax.jacfwd(both, has_aux=True))
    for seed in range(6):
        values = null_values(member) if seed == 0 else drawn_values(member, seed)
        values = {field: jnp.asarray(value, dtype=float) for field, value in values.items()}
        first, *rest = states(member, seed, still=seed == 1)
        second, gradient = derivatives(values, first, rest)
        for leaf in jax.tree.leaves(gradient):
            assert np.all(np.isfinite(leaf)), f"{member.name}: gradient {leaf}"
        for leaf in jax.tree.leaves(second):
            assert np.all(np.isfinite(leaf)), f"{member.name}: second derivative {leaf}"


def silent_without_its_covariate(member: type) -> None:
    """If what it needs is absent, or at the reference, the effect changes nothing, whatever its values.

    A quantity that is itself in error is so at any value: `test_registry` shows that nothing gets into runs without it.
    """
    if issubclass(member, AmbientEffect):
        return
    reference = next((v for name, v in declared_options(member).items() if name.startswith("reference")), 0.0)
    for need in member.needs:
        if need in (*GATES, "table_angle", "outer_angle", "middle_angle"):
            continue  # known or not, without a value that is none: `test_registry` shows that nothing gets by
        nothing = {"power_on": LONG_AGO} | dict.fromkeys(TEMPERATURES, reference)
        fixed = {need: nothing.get(need, 0.0)}
        for seed in range(1, 4):
            state = states(member, seed, **fixed)
            assert_unchanged(member, drawn_values(member, seed), state)


def changes_something(member: type) -> None:
    """Away from null every parameter matters: an effect that cannot be seen is none.

    A shape means something if the coefficients are not null: there it has to matter.
    """
    declared = declared_parameters(member)
    spreads = {parameter.spread for parameter in declared.values()}
    for field in set(declared) - spreads:
        responses = []
        for seed in range(1, 6):
            drawn = drawn_values(member, seed)
            if declared[field].shape:
                responses.append(_change(member, drawn, drawn | {field: drawn[field] * 1.5}, seed))
                continue
            values = null_values(member) | {field: drawn[field]}
            state = states(member, seed)
            pairs = zip(moved(member, values, state), unmoved(state), strict=True)
            responses.append(max(np.abs(after - before).max() for after, before in pairs))
        assert max(responses) > 0, f"{member.name}.{field} changes nothing"


def _change(member: type, first: dict, second: dict, seed: int) -> float:
    state = states(member, seed)
    pairs = zip(moved(member, first, state), moved(member, second, state), strict=True)
    return max(np.abs(a - b).max() for a, b in pairs)


def linear_coefficients_show_at_null(member: type) -> None:
    """At null the derivative by each coefficient is there and finite, whatever the shape: a first-order screen sees it.

    Shapes are of positive priors, tried over values inside these, their null among what is tried.
    """
    declared = declared_parameters(member)
    factors = {field: to_si(parameter.unit, GRAVITY, own=OWN) for field, parameter in declared.items()}
    shapes = {field: parameter for field, parameter in declared.items() if parameter.shape}
    for field, parameter in shapes.items():
        assert min(parameter.shape) > 0, f"{member.name}.{field}: shapes {parameter.shape}"
        assert float(priors(member)[field].value(jnp.asarray(-8.0))) > 0, f"{member.name}.{field} may be negative"
        # What a unit of the channel's own stands for is not known to the class: any positive null will do.
        own = dimension(parameter.unit)[5] != 0
        inside = (
            parameter.null > 0
            if own
            else min(parameter.shape) <= parameter.null / factors[field] <= max(parameter.shape)
        )
        assert inside, f"{member.name}.{field}: null {parameter.null} is not among what is tried"
        places = [priors(member)[field].z(value * factors[field]) for value in parameter.shape]
        assert max(map(abs, places)) < 4, f"{member.name}.{field}: shapes {parameter.shape} outside the prior"
    spreads = {parameter.spread for parameter in declared.values()}
    count = max((len(parameter.shape) for parameter in shapes.values()), default=1)
    slopes = {field: _slope_of(member, field) for field in set(declared) - set(shapes) - spreads}
    for place in range(count):
        at = {
            name: parameter.shape[min(place, len(parameter.shape) - 1)] * factors[name]
            for name, parameter in shapes.items()
        }
        for field, slope in slopes.items():
            found = [slope(at, seed) for seed in range(1, 6)]
            assert np.all(np.isfinite(found)), f"{member.name}.{field}: derivative {found}"
            if place == 0:
                assert max(found) > 0, f"{member.name}.{field} has no derivative at its null"


def _slope_of(member: type, field: str) -> Callable[[dict, int], float]:
    """Return the largest derivative by one parameter at null, as a function of the shapes and of where it is taken."""

    @jax.jit
    def slope(values, state):
        _, found = jax.jvp(
            lambda value: acted(member, values | {field: value}, *state),
            (values[field],),
            (jnp.ones_like(values[field]),),
        )
        return found

    def largest(shapes: dict, seed: int) -> float:
        values = {name: jnp.asarray(float(value)) for name, value in (null_values(member) | shapes).items()}
        return max(float(jnp.abs(leaf).max()) for leaf in jax.tree.leaves(slope(values, states(member, seed))))

    return largest


def variances_of(member: type, values: dict, samples: np.ndarray) -> np.ndarray:
    """Return the variance of each of the entries, which are means of so many samples."""
    component = instance(member, values)
    if issubclass(member, EntryNoise):
        facts = (jnp.asarray(samples, dtype=float), *(jnp.full(len(samples), 1e5) for _ in range(3)))
        return np.broadcast_to(jax.vmap(component.variance)(Entry(*facts)), samples.shape)
    assert issubclass(member, SharedNoise)
    return np.full(samples.shape, float(component.shared_variance()))


def variance_is_positive(member: type) -> None:
    """Over draws of the prior: variances and degrees of freedom are positive and finite, correlations in (−1, 1)."""
    for seed in range(6 if issubclass(member, SlowNoise) else 20):
        values = drawn_values(member, seed)
        if issubclass(member, SeriesNoise):
            correlation = float(instance(member, values).lag_one_correlation())
            assert -1 < correlation < 1, f"{member.name}: correlation {correlation}"
            continue
        if issubclass(member, TailNoise):
            degrees = float(instance(member, values).degrees())
            assert 0 < degrees < np.inf, f"{member.name}: {degrees} degrees of freedom"
            continue
        if issubclass(member, SlowNoise):
            covariance = slow_covariance(member, values, row_length(member, values))
            least = float(np.linalg.eigvalsh(covariance / np.abs(covariance).max())[0])
            assert least > -1e-12, f"{member.name}: covariance with an eigenvalue of {least:.1g}"
            continue
        (found,) = variances_of(member, values, np.array([7.0]))
        assert 0 < found < np.inf, f"{member.name}: variance {found}"


def row_length(member: type, values: dict) -> float:
    """Return the length of rows, s: those of a unit in motion are as short as a stroke of the hand."""
    return 0.5 * float(values["time"]) if member.of_motion and "time" in values else 100.0


def slow_covariance(member: type, values: dict, length: float, rows: int = 60) -> np.ndarray:
    """Return the covariance of rows that follow one another without a gap, from the states of each."""
    times = jnp.geomspace(length / 2, rows * length, 6)
    noise = instance(member, values)
    spans = [RowSpan(i * length, length, 0.0 if i else math.inf, times) for i in range(rows)]
    states = [jax.tree.map(np.asarray, noise.states(jax.tree.map(jnp.asarray, span))) for span in spans]
    found = np.zeros((rows, rows))
    for i, state in enumerate(states):
        found[i, i], carried = float(state.variance), state.end
        for j in range(i + 1, rows):
            found[i, j] = found[j, i] = float(np.sum(carried * states[j].mean))
            carried = carried * states[j].over_row
    return found


def misstated_slow_noise_is_less_likely(member: type, rng: np.random.Generator) -> None:
    values = {name: float(value) for name, value in drawn_values(member, 3).items()}
    # White noise of a hundredth of the variance keeps the covariance of rows regular.
    length = row_length(member, values)
    true = slow_covariance(member, values, length)
    floor = 0.01 * true[1, 1] * np.eye(60)
    drawn = np.linalg.cholesky(true + floor) @ rng.normal(size=(60, 20))

    def likelihood(assumed: dict) -> float:
        covariance = slow_covariance(member, assumed, length) + floor
        squares = np.sum(drawn * np.linalg.solve(covariance, drawn))
        return float(-0.5 * squares - 0.5 * drawn.shape[1] * np.linalg.slogdet(covariance)[1])

    for field in declared_parameters(member):
        for factor in (1 / 3, 3.0):
            wrong = likelihood(values | {field: values[field] * factor})
            assert likelihood(values) > wrong + 10, f"{member.name}.{field}"


def in_series(correlation: float, independent: np.ndarray) -> np.ndarray:
    """Return AR(1) noise of unit variance."""
    found = independent.copy()
    for k in range(1, len(found)):
        found[k] = correlation * found[k - 1] + np.sqrt(1 - correlation**2) * independent[k]
    return found


def series_likelihood(member: type, values: dict, drawn: np.ndarray) -> float:
    correlation = float(instance(member, values).lag_one_correlation())
    renewed = (drawn[1:] - correlation * drawn[:-1]) / np.sqrt(1 - correlation**2)
    return float(-0.5 * np.sum(renewed**2) - 0.5 * len(renewed) * np.log(1 - correlation**2))


def misstated_noise_is_less_likely(member: type) -> None:
    """Data drawn at some width are less likely at a third and at three times of it; correlated ones, as independent."""
    rng = np.random.default_rng(8)
    if issubclass(member, SeriesNoise):
        values = {name: float(prior.value(jnp.asarray(0.5))) for name, prior in priors(member).items()}
        drawn = in_series(float(instance(member, values).lag_one_correlation()), rng.normal(size=400))
        right, wrong = (series_likelihood(member, assumed, drawn) for assumed in (values, null_values(member)))
        assert right > wrong + 10, f"{member.name} says nothing of neighbours"
        return
    if issubclass(member, TailNoise):
        far = stats.t(4).rvs(size=400, random_state=rng)
        law = stats.t(float(instance(member, dict.fromkeys(declared_parameters(member), 4.0)).degrees()))
        assert law.logpdf(far).sum() > stats.norm.logpdf(far).sum() + 10, f"{member.name} has no tails"
        return
    if issubclass(member, SlowNoise):
        misstated_slow_noise_is_less_likely(member, rng)
        return
    for field in declared_parameters(member):
        values = {name: float(value) for name, value in drawn_values(member, 3).items()}
        samples = rng.integers(1, 50, size=400)
        drawn = rng.normal(size=400) * np.sqrt(variances_of(member, values, samples))

        def likelihood(factor: float, values=values, field=field, samples=samples, drawn=drawn) -> float:
            variance = variances_of(member, values | {field: values[field] * factor}, samples)
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
    linear_coefficients_show_at_null,
)
OF_NOISE = (variance_is_positive, misstated_noise_is_less_likely)

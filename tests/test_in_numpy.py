"""NumPy evaluates a traced function to the values of compiled code, also for derivatives; nothing is compiled."""

import pickle
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.compiled import in_numpy as module
from imubayes.compiled import kept_programs, program_identity
from imubayes.compiled.in_numpy import in_numpy, linearised_in_numpy
from imubayes.compiled.numpy_primitives import NoNumpyError
from imubayes.compiled.numpy_programs import lowered
from imubayes.foundations.arrays import exponential, take

VECTOR = np.array([0.3, -1.2, 0.0, 2.5])
MATRIX = np.arange(12.0).reshape(3, 4) - 5.0
WHOLE = np.array([7, -7, 3, 0])


def running(x):
    def step(before, row):
        after = 0.5 * before + row
        return after, after[0] * row

    return jax.lax.scan(step, jnp.zeros(4), x)


def backwards(x):
    return jax.lax.scan(lambda before, row: (before + row, before), jnp.zeros(4), x, reverse=True)[1]


FUNCTIONS = {
    "arithmetic": lambda x, m, k: (m - x[None]) / (2 + x[None] ** 2) + (x**3 * (x - 9) ** -2)[None],
    "integers": lambda x, m, k: (k // 2, k % 3, jax.lax.div(k, 0 * k + 2), k**2, (-k).astype(float)),
    "elementary": lambda x, m, k: [f(x) for f in (jnp.sin, jnp.cos, jnp.tanh, jnp.exp, jnp.expm1, jnp.abs, jnp.sign)],
    "choices": lambda x, m, k: (
        jnp.where(x > 0, x, -1.0),
        jnp.clip(x, -1, 1),
        jnp.maximum(x, 0),
        jnp.minimum(x, k.astype(float)),
    ),
    "logic": lambda x, m, k: ((x > 0) & (k != 0), ~(x <= 0), jnp.isfinite(1 / x), jnp.any(m > 3, axis=1)),
    "shapes": lambda x, m, k: (m.T, m[1:, ::2], m.reshape(2, 6), x[None] + m, jnp.stack([x, x]), jnp.flip(m, 0)),
    "sums": lambda x, m, k: (
        m.sum(),
        m.sum(axis=0),
        jnp.cumsum(m, axis=1),
        m.max(axis=1),
        m @ x,
        jax.vmap(jnp.dot)(m, m),
        jnp.linalg.norm(x),
    ),
    "places": lambda x, m, k: (take(x, np.array([3, 0, 0])), m[:, np.array([0, 2])], m[jnp.abs(k) % 3], x[-1]),
    "out of bounds": lambda x, m, k: (jnp.take(x, k, mode="fill"), jnp.take(x, k, mode="clip")),
    "windows": lambda x, m, k: (
        jax.lax.dynamic_slice(m, (k[3], k[3] + 9), (2, 2)),
        jnp.pad(x, (1, 2), constant_values=3),
    ),
    "split": lambda x, m, k: jnp.split(m, [1, 3], axis=1),
    "rounded": lambda x, m, k: (jnp.round(m / 2), jnp.floor(x), jnp.ceil(x), jnp.arange(4.0) * x),
    "scan": lambda x, m, k: (running(m), backwards(m)),
    "batched": lambda x, m, k: jax.vmap(lambda row: jax.vmap(exponential)(row[None, :3] * x[:3, None]))(m),
    "constant": lambda x, m, k: {"one": jnp.ones((2, 3)), "as it is": x, "text": "told"},
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_numpy_gives_what_compiled_code_gives(name):
    function = FUNCTIONS[name]
    found = in_numpy(function)(VECTOR, MATRIX, WHOLE)
    wanted = kept_programs.kept(function)(VECTOR, MATRIX, WHOLE)
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        if isinstance(other, str):
            assert one == other
            continue
        assert isinstance(one, np.ndarray)
        assert (one.shape, one.dtype) == (other.shape, other.dtype)
        np.testing.assert_allclose(one, other, rtol=1e-14, atol=1e-15)


def curved(matrix, x):
    bent = jnp.where(x > 0, x**2, jnp.sin(x))
    carried, rows = running(matrix * bent[None])
    return jnp.concatenate([carried, rows.sum(axis=1), jnp.abs(x) * jnp.split(x, 2)[0][0]])


def linearised(function):
    found = linearised_in_numpy(function, MATRIX, VECTOR)
    assert found is not None
    return found


def test_derivatives_are_those_of_jax():
    value, push = linearised(curved)
    for along in (*np.eye(4), np.array([1.0, -2.0, 0.5, 0.0]), np.zeros(4)):
        wanted = jax.jit(lambda v: jax.jvp(partial(curved, MATRIX), (VECTOR,), (v,)))(along)
        np.testing.assert_allclose(value, wanted[0], rtol=1e-14)
        np.testing.assert_allclose(push(along), wanted[1], rtol=1e-13, atol=1e-15)


def test_only_what_follows_from_a_direction_is_computed(monkeypatch):
    def apart(matrix, x):
        return jnp.concatenate([jnp.exp(matrix).sum() * x[:1], jnp.sin(jnp.cos(jnp.tan(x[1:])))])

    _, push = linearised(apart)
    (*_, last) = module._programs.values()
    assert last is not None
    program = last.linear
    counted = []
    own = type(program)._not_zero
    monkeypatch.setattr(type(program), "_not_zero", lambda *args: counted.append(args[1].name) or own(*args))
    push(np.array([1.0, 0.0, 0.0, 0.0]))
    first = len(counted)
    push(np.ones(4))
    assert 0 < first < len(counted) - first


def test_nothing_is_compiled(caplog):
    with jax.log_compiles():
        in_numpy(FUNCTIONS["elementary"])(VECTOR + 1, MATRIX[:2], WHOLE)
    assert "XLA" not in caplog.text


def sorted_by_jax(x):
    return jnp.sort(x)


def test_what_numpy_lacks_is_compiled():
    with pytest.raises(NoNumpyError):
        lowered(jax.make_jaxpr(sorted_by_jax)(VECTOR))
    np.testing.assert_array_equal(in_numpy(sorted_by_jax)(VECTOR), np.sort(VECTOR))
    assert linearised_in_numpy(sorted_by_jax, VECTOR) is None


def test_what_takes_numpy_long_is_compiled(monkeypatch):
    monkeypatch.setattr(module, "MOST_VALUES", 3)
    assert linearised_in_numpy(doubled, VECTOR) is None
    np.testing.assert_array_equal(in_numpy(doubled)(VECTOR), 2 * VECTOR)


TRACED: list[str] = []


def doubled(x):
    TRACED.append("doubled")
    return 2.0 * x


def test_within_another_trace_it_is_a_function_of_jax():
    np.testing.assert_array_equal(jax.jit(jax.vmap(in_numpy(doubled)))(MATRIX), 2 * MATRIX)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(kept_programs._Folder, "place", tmp_path)
    monkeypatch.setattr(program_identity, "_KNOWN", {*program_identity._KNOWN, __name__})
    monkeypatch.setattr(module, "_programs", {})
    TRACED.clear()
    return tmp_path


def in_a_new_process(x):
    module._programs.clear()
    return in_numpy(doubled)(x)


def test_a_traced_program_outlasts_the_process(folder):
    first, again = in_a_new_process(VECTOR), in_a_new_process(VECTOR)
    np.testing.assert_array_equal(first, again)
    assert TRACED == ["doubled"]
    in_a_new_process(MATRIX)
    assert TRACED == ["doubled"] * 2


def test_a_damaged_file_is_traced_anew(folder):
    in_a_new_process(VECTOR)
    (file,) = folder.iterdir()
    file.write_bytes(file.read_bytes()[:-1] + b"\0")
    np.testing.assert_array_equal(in_a_new_process(VECTOR), 2 * VECTOR)
    assert TRACED == ["doubled"] * 2


def test_a_program_can_be_pickled_with_its_loops():
    program = lowered(jax.make_jaxpr(running)(MATRIX))
    for one, other in zip(program(MATRIX), pickle.loads(pickle.dumps(program))(MATRIX), strict=True):
        np.testing.assert_array_equal(one, other)


def test_programs_of_which_there_are_too_many_are_forgotten(monkeypatch):
    monkeypatch.setattr(module, "_programs", {})
    monkeypatch.setattr(module, "MOST_STEPS", 3)
    for size in range(1, 9):
        in_numpy(doubled)(np.ones(size))
    assert 1 <= len(module._programs) <= 4

"""A kept program is the one that tracing now would give, or none is taken."""

import atexit
import os
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.compiled import kept_programs, program_identity, stored_programs
from imubayes.compiled.kept_programs import kept
from imubayes.compiled.program_identity import NoIdentityError, describe
from imubayes.compiled.stored_programs import Preloading, read_program
from imubayes.model.effect_registry import Registry

TRACED: list[str] = []


def unkept(values, by=1.0, how=np.sin):
    TRACED.append("scaled")
    return {"out": jnp.asarray(by, dtype=values.dtype) * jnp.cumsum(jnp.exp(values)), "by": by, "how": (how, None)}


scaled = kept(unkept)


@kept
def counted_back(values):
    jax.debug.callback(lambda total: TRACED.append("called"), values.sum())
    return values + 1.0


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(kept_programs._Folder, "place", tmp_path)
    monkeypatch.setattr(program_identity, "_KNOWN", {*program_identity._KNOWN, __name__})
    TRACED.clear()
    kept_programs.forget_programs()
    yield tmp_path
    kept_programs.forget_programs()


def in_a_new_process(*args, **kwargs):
    """Call `scaled` as a process would that has loaded no program yet."""
    kept_programs.forget_programs()
    return scaled(*args, **kwargs)


VALUES = np.linspace(0.0, 1.0, 5)


def test_a_program_compiled_ahead_is_the_one_that_is_called(folder):
    kept_programs.compile_ahead(scaled, VALUES)
    kept_programs.compile_ahead(scaled, VALUES)
    found = scaled(VALUES)
    assert TRACED == ["scaled"], "one program, traced once"
    np.testing.assert_allclose(found["out"], np.cumsum(np.exp(VALUES)), rtol=1e-15)
    assert not kept_programs._ahead
    # What is kept already is not compiled again.
    kept_programs.forget_programs()
    kept_programs.compile_ahead(scaled, VALUES)
    assert not kept_programs._ahead
    assert TRACED == ["scaled"]


def test_a_kept_program_is_not_traced_again_and_gives_the_same_bits(folder):
    first, again = in_a_new_process(VALUES, by=2.5), in_a_new_process(VALUES, by=2.5)
    assert TRACED == ["scaled"]
    ordinary = unkept(jnp.asarray(VALUES), by=2.5)
    for found in (first, again):
        assert found["by"] == 2.5
        assert found["how"] == (np.sin, None)
        assert np.asarray(found["out"]).tobytes() == np.asarray(first["out"]).tobytes()
        np.testing.assert_allclose(found["out"], ordinary["out"], rtol=1e-15)
    assert len(list(folder.iterdir())) == 1


@pytest.mark.parametrize(
    ("values", "by"),
    [
        (VALUES[:4], 1.0),
        (VALUES.astype(np.float32), 1.0),
        (VALUES[:, None], 1.0),
        (VALUES, 2.0),
        (VALUES, 1),
        (VALUES, True),
        (jnp.asarray(1.0) * 1.0, 1.0),
    ],
)
def test_another_shape_type_or_value_is_another_program(folder, values, by):
    in_a_new_process(VALUES, by=1.0)
    in_a_new_process(values, by=by)
    assert len(list(folder.iterdir())) == len(TRACED) == 2


def test_a_weakly_typed_argument_is_another_program(folder):
    for argument in (jnp.asarray(2.0), jnp.asarray(2.0, dtype=float)):
        in_a_new_process(argument)
    assert len(TRACED) == 1 + (jnp.asarray(2.0).weak_type is True)


def scaled_by_number(values, number):
    TRACED.append("scaled")
    return values * number


@pytest.mark.parametrize("is_kept", [True, False])
def test_a_program_bound_to_a_key_is_found_by_it_alone(folder, monkeypatch, is_kept):
    if not is_kept:
        monkeypatch.setattr(kept_programs._Folder, "place", None)

    def run(number, values):
        return kept_programs.run_bound((number,), scaled_by_number, [values], lambda: (values, number))

    for _ in range(2):
        for number in (2.0, 3.0):
            for values in (VALUES, VALUES + 1):
                np.testing.assert_array_equal(run(number, values), values * number)
        assert len(TRACED) == 2, "once for a key"
    kept_programs.forget_programs()
    run(2.0, VALUES)
    assert len(TRACED) == (2 if is_kept else 3)
    assert len(list(folder.iterdir())) == (2 if is_kept else 0)


@pytest.mark.parametrize("setting", [lambda: jax.enable_x64(False), lambda: jax.default_matmul_precision("highest")])
def test_another_setting_of_jax_is_another_program(folder, setting):
    in_a_new_process(VALUES)
    with setting():
        in_a_new_process(VALUES)
    assert len(TRACED) == 2


@pytest.mark.parametrize("surroundings", ["_surroundings", "_sources"])
def test_other_versions_or_sources_are_another_program(folder, monkeypatch, surroundings):
    in_a_new_process(VALUES)
    monkeypatch.setattr(program_identity, surroundings, lambda: "another")
    in_a_new_process(VALUES)
    assert len(TRACED) == 2


def test_sources_edited_since_the_process_began_are_not_kept(folder, monkeypatch):
    in_a_new_process(VALUES)
    monkeypatch.setattr(program_identity, "_READ", frozenset())
    in_a_new_process(VALUES[1:])
    assert len(list(folder.iterdir())) == 1
    program_identity._sources.cache_clear()
    in_a_new_process(VALUES)
    assert len(TRACED) == 3
    assert len(list(folder.iterdir())) == 1
    monkeypatch.undo()
    program_identity._sources.cache_clear()


@pytest.mark.parametrize("damage", [lambda content: content[:-9], lambda content: b"", lambda content: b"x" * 40])
def test_a_damaged_file_is_replaced(folder, damage):
    first = in_a_new_process(VALUES)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    for broken in (damage(whole), whole[:-1] + bytes([whole[-1] ^ 1])):
        file.write_bytes(broken)
        again = in_a_new_process(VALUES)
        assert np.array_equal(first["out"], again["out"])
        assert file.read_bytes() != broken
    assert len(TRACED) == 3


def test_a_folder_that_cannot_be_written_is_survived(folder, monkeypatch):
    monkeypatch.setattr(kept_programs._Folder, "place", folder / "file" / "below")
    (folder / "file").write_text("in the way")
    assert np.array_equal(in_a_new_process(VALUES)["out"], in_a_new_process(VALUES)["out"])


def test_callbacks_are_not_kept(folder):
    assert np.array_equal(counted_back(VALUES), VALUES + 1.0)
    jax.effects_barrier()
    assert TRACED == ["called"]
    assert not list(folder.iterdir())


def test_within_another_trace_nothing_is_kept(folder):
    slope = jax.jacfwd(lambda values: scaled(values)["out"])(jnp.asarray(VALUES))
    np.testing.assert_allclose(slope, np.tril(np.tile(np.exp(VALUES), (5, 1))))
    batch = jax.vmap(lambda values: scaled(values)["out"])(jnp.ones((3, 5)))
    assert batch.shape == (3, 5)
    assert not list(folder.iterdir())


def closure(offset):
    return lambda values: values + offset


class Local:
    """Of the tests, which the package does not know."""


@pytest.mark.parametrize("value", [closure(1.0), partial(closure(2.0), 1.0), Local, Local(), object(), {1: iter([])}])
def test_what_means_something_in_this_process_only_has_no_identity(value):
    with pytest.raises(NoIdentityError):
        describe(value)


def test_what_differs_is_described_differently():
    plain = [1, 1.0, True, "1", b"1", None, -0.0, 0.0, (1,), [1], {1: 2}, {"1": 2}, {2: 1}, frozenset({1})]
    arrays = [np.arange(3), np.arange(3) + 1, np.arange(3.0), np.dtype("f4")]
    values = [*plain, *arrays, float, int, partial(describe, 1), partial(describe, 2)]
    assert len({repr(describe(value)) for value in values}) == len(values)
    assert describe({"a": 1, "b": 2}) == describe({"b": 2, "a": 1})


def test_a_file_of_the_user_is_never_kept(tmp_path):
    """It may be edited, and may read tables of its own."""
    file = tmp_path / "own.py"
    file.write_text(
        '"""An effect of the user."""\n'
        "from imubayes import Scalar, SignalEffect, Stage, Order, parameter\n\n\n"
        "class OwnEffect(SignalEffect):\n"
        '    """Own."""\n\n'
        '    name = "own_effect"\n'
        '    stage, order, kinds = Stage.SENSOR, Order.SCALE, ("gyro",)\n'
        '    reference = "none"\n'
        '    size: Scalar = parameter("ppm", "normal(0, 100 ppm)", (10, 300), "own")\n\n'
        "    def apply(self, signal, sample):\n"
        "        return signal + self.size\n"
    )
    with pytest.raises(NoIdentityError):
        describe(Registry().with_files((str(file),)).find("own_effect", "here"))


def test_the_programs_used_longest_ago_give_way(folder, monkeypatch):
    for count in (2, 3, 4, 5):
        in_a_new_process(np.ones(count))
    for age, file in enumerate(folder.iterdir()):
        os.utime(file, (1e9 - age, 1e9 - age))
    in_a_new_process(np.ones(2))  # used again: now the youngest
    largest = max(file.stat().st_size for file in folder.iterdir())
    monkeypatch.setattr(kept_programs, "MOST_BYTES", 7 * largest // 2)
    in_a_new_process(np.ones(6))
    assert len(list(folder.iterdir())) == 2
    TRACED.clear()
    for count in (2, 6):
        in_a_new_process(np.ones(count))
    assert TRACED == []


def test_code_that_does_not_run_is_compiled_anew(folder, monkeypatch):
    first = in_a_new_process(VALUES)
    kept_programs.forget_programs()

    def not_linked(self, arrays):
        if self.file is None:
            return whole(self, arrays)
        raise jax.errors.JaxRuntimeError("NOT_FOUND: Function exponential_fusion not found")

    whole = kept_programs._Program.__call__
    monkeypatch.setattr(kept_programs._Program, "__call__", not_linked)
    assert np.array_equal(scaled(VALUES)["out"], first["out"])
    assert len(TRACED) == 2
    assert len(list(folder.iterdir())) == 1


def test_what_jax_has_in_its_own_cache_is_kept_whole(folder):
    """Jaxlib serialises code taken from its cache without the functions in it."""
    in_a_new_process(VALUES)
    for file in folder.iterdir():
        file.unlink()
    kept_programs.forget_programs()
    jax.clear_caches()
    for _ in range(2):
        in_a_new_process(VALUES)
    assert len(TRACED) == 2


def test_the_environment_switches_it_off(monkeypatch, tmp_path):
    monkeypatch.setattr(kept_programs._Folder, "place", None)
    monkeypatch.setenv(kept_programs.SWITCH, "0")
    kept_programs.keep_programs(tmp_path)
    assert kept_programs._Folder.place is None
    monkeypatch.delenv(kept_programs.SWITCH)
    kept_programs.keep_programs(tmp_path)
    assert kept_programs._Folder.place == tmp_path


def preloading(folder: Path, purpose: str = "diagnose") -> Preloading:
    """What a process loads ahead, with its list written at once instead of at the exit."""
    found = Preloading(folder, purpose)
    atexit.unregister(found.remember)
    return found


def test_what_the_last_process_used_is_loaded_ahead_in_that_order(folder, monkeypatch):
    monkeypatch.setattr(kept_programs._Folder, "preloading", first := preloading(folder))
    made = [in_a_new_process(np.ones(count))["out"] for count in (4, 3, 4)]
    first.remember()
    names = (folder / "diagnose.used").read_text().split()
    assert len(names) == len(set(names)) == 2

    read: list[tuple[str, str]] = []

    def seen(file):
        read.append((file.name, threading.current_thread().name))
        return read_program(file)

    monkeypatch.setattr(stored_programs, "read_program", seen)
    monkeypatch.setattr(kept_programs._Folder, "preloading", again := preloading(folder))
    while len(read) < 2:
        time.sleep(0.01)
    assert [name for name, _ in read] == names
    assert all(thread.startswith("preloading") for _, thread in read)
    TRACED.clear()
    assert np.array_equal(in_a_new_process(np.ones(3))["out"], made[1])
    assert TRACED == []
    assert len(read) == 2
    # A program that is asked for a second time, and one that was not on the list, are read as ever.
    in_a_new_process(np.ones(3))
    in_a_new_process(np.ones(7))
    assert [name for name, _ in read[2:3]] == names[1:]
    assert all(not thread.startswith("preloading") for _, thread in read[2:])
    again.remember()
    assert len((folder / "diagnose.used").read_text().split()) == 2  # those of 3 and of 7
    assert not (folder / "add.used").exists()


@pytest.mark.parametrize("content", [b"", b"no-such-program\n", b"\xff\xfe\x00"])
def test_a_list_that_names_nothing_is_survived(folder, monkeypatch, content):
    (folder / "diagnose.used").write_bytes(content)
    monkeypatch.setattr(kept_programs._Folder, "preloading", found := preloading(folder))
    in_a_new_process(VALUES)
    found.remember()
    assert (folder / "diagnose.used").read_text().split() != ["no-such-program"]


def test_another_process_finds_the_program_and_its_linear_algebra(tmp_path):
    script, source = Path(__file__).parent / "kept_process.py", str(Path(__file__).parents[1] / "src")
    said = [
        subprocess.run(
            [sys.executable, str(script), str(tmp_path), *words],
            env={**os.environ, "PYTHONPATH": source, "IMUBAYES_KEEP_PROGRAMS": "1"},
            capture_output=True,
            text=True,
            check=True,
        )
        for words in ([], ["forbid"])
    ]
    assert len(said[0].stdout.split()) == 12
    assert said[0].stdout == said[1].stdout
    assert said[1].stderr == ""
    assert len(list(tmp_path.iterdir())) == 1

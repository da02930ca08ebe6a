"""Compiled code is given up before the process holds more memory maps than it may."""

from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from imubayes.model import compile_cache_limit

pytestmark = pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="counts memory maps as Linux does")


def held() -> int:
    return len(Path("/proc/self/maps").read_text().splitlines())


def test_a_fresh_process_is_far_from_the_limit():
    assert not compile_cache_limit.clear_if_crowded()


def test_compiled_code_is_given_up(monkeypatch, tmp_path):
    for size in range(30):
        jax.jit(lambda x: jnp.linalg.norm(jnp.outer(x, x)))(jnp.ones(40 + size))
    before = held()
    limit = tmp_path / "max_map_count"
    limit.write_text(f"{before}\n")
    monkeypatch.setattr(compile_cache_limit, "_MOST", limit)
    assert compile_cache_limit.clear_if_crowded()
    assert held() < before - 30


def test_another_system_is_left_alone(monkeypatch, tmp_path):
    monkeypatch.setattr(compile_cache_limit, "_MOST", tmp_path / "none")
    assert not compile_cache_limit.clear_if_crowded()

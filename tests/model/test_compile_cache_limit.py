"""Compiled code is discarded before the process reaches its limit of memory maps."""

from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from imubayes.compiled import jax_settings

pytestmark = pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="memory maps are counted on Linux only")


def memory_maps() -> int:
    return len(Path("/proc/self/maps").read_text().splitlines())


def test_a_fresh_process_is_far_from_the_limit():
    assert not jax_settings.clear_if_crowded()


def test_compiled_code_is_discarded_near_the_limit(monkeypatch, tmp_path):
    for size in range(30):
        jax.jit(lambda x: jnp.linalg.norm(jnp.outer(x, x)))(jnp.ones(40 + size))
    before = memory_maps()
    limit = tmp_path / "max_map_count"
    limit.write_text(f"{before}\n")
    monkeypatch.setattr(jax_settings, "_MOST", limit)
    assert jax_settings.clear_if_crowded()
    assert memory_maps() < before - 30


def test_without_a_limit_nothing_is_discarded(monkeypatch, tmp_path):
    monkeypatch.setattr(jax_settings, "_MOST", tmp_path / "none")
    assert not jax_settings.clear_if_crowded()

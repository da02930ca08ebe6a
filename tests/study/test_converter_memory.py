"""Converters that remember their temperature: each kind of memory is named, on the generator's thermal ramps."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import blind
import judging
from hidden import random_campaign

MEMORIES = [
    f"converter_{part}_{memory}" for part in ("offset", "gain") for memory in ("temperature_rate", "lag", "hysteresis")
]
SEEDS = range(231001, 231021)


def line(folder: Path, seed: int, effect: str) -> judging.Line:
    """Draw a thermal ramp with a hidden effect, and return its diagnosis as a line of the blind study."""
    drawn = random_campaign(folder, seed, "hidden", "thermal_ramp", effect)
    fitted = blind.mode_of(folder, drawn.model)
    [one] = drawn.planted
    planted = {"effect": one.effect, "channels": list(one.channels), "s": one.s, "within": one.within}
    document = blind.diagnosed(fitted)
    return {"kind": "hidden", "seed": seed, "converged": fitted.converged, "planted": [planted], "document": document}


@pytest.mark.slow
@pytest.mark.parametrize("effect", MEMORIES)
def test_memory_of_a_converter(tmp_path, effect):
    found = judging.of_kind([line(tmp_path / str(seed), seed, effect) for seed in SEEDS], "hidden")
    print(effect, found.ok, found.false_adequate, found.wrong_single_names, found.failures)
    assert found.ok[0] >= 0.95 * found.ok[1]
    assert found.false_adequate[0] == 0
    assert found.wrong_single_names[0] <= 0.02 * found.ok[1]

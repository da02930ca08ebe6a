"""Converters that remember their temperature: each kind of memory is named, on the generator's thermal ramps."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import blind
from binomial_share import told
from hidden import random_campaign

from imubayes.criticism.diagnose import judge
from imubayes.criticism.explanation_records import NAMED

MEMORIES = [
    f"converter_{part}_{memory}" for part in ("offset", "gain") for memory in ("temperature_rate", "lag", "hysteresis")
]
SEEDS = range(231001, 231021)


def groups(folder: Path, seed: int, effect: str) -> tuple[bool, bool]:
    """Draw a thermal ramp with a hidden effect; return whether a group has it, and whether a wrong one is certain."""
    drawn = random_campaign(folder, seed, "hidden", "thermal_ramp", effect)
    found = judge(blind.mode_of(folder, drawn.model))
    wrong = [each for each in found.groups if effect not in each.effects and each.probability >= NAMED]
    return any(effect in each.effects for each in found.groups), bool(wrong)


@pytest.mark.slow
@pytest.mark.parametrize("effect", MEMORIES)
def test_memory_of_a_converter(tmp_path, effect):
    found = [groups(tmp_path / str(seed), seed, effect) for seed in SEEDS]
    print(f"{effect}: in a group {told(sum(right for right, _ in found), len(found))}", found)
    assert sum(right for right, _ in found) >= 0.95 * len(found)
    assert sum(wrong for _, wrong in found) <= 0.02 * len(found)

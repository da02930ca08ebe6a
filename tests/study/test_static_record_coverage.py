"""Coverage of the noise terms of static records of 6 h at 100 Hz."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from binomial_share import told
from static_record_study import SEEDS, TERMS, Recovery, coverage, recovered


@pytest.fixture(scope="module")
def found() -> list[Recovery]:
    return [each for seed in SEEDS for each in recovered(seed)]


@pytest.mark.slow
def test_white_noise_flicker_and_random_walk_are_recovered(found):
    assert len({each.seed for each in found}) >= 50
    for term in TERMS:
        known = [each for each in found if each.term is term and each.found.determined]
        assert len(known) >= 45
        z = np.array([each.z for each in known])
        assert np.mean(np.abs(z) <= 2) >= 0.9
        assert abs(z.mean()) < 3 / np.sqrt(len(z)) * z.std()
        assert np.max(np.abs(z)) < 4


@pytest.mark.slow
def test_intervals_hold_what_they_promise(found):
    print(f"\ninside: {told(sum(each.inside() for each in found), len(found), 1)}")
    assert 0.90 <= coverage(found) <= 0.98
    for term in TERMS:
        assert 0.90 <= coverage([each for each in found if each.term is term]) <= 0.98


@pytest.mark.slow
def test_intervals_that_are_too_short_show(found):
    """The planted fault."""
    assert coverage(found, understate=0.6) < 0.90

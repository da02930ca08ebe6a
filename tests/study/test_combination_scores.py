"""Combinations that the data determine, over draws of the generators: calibrated, and known as well as is said."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "results"))
from combination_scores import fitted, scored  # pyright: ignore[reportMissingImports]

DRAWS = 40
CASES = {
    "polar_tumble": (),
    "geographic_tumble": (),
    "servo_table": (),
    "reference_gyro": (),
    "rotation_modulation": (),
    "trihedral_imu": ("rate-pyramid-25C",),
}
"""Generator → the runs to take; all if empty."""


@pytest.mark.slow
@pytest.mark.parametrize("case", list(CASES))
def test_scores_over_draws(case, tmp_path):
    generator, name = importlib.import_module(case), case.replace("_", "-")
    found = []
    for seed in range(7001, 7001 + DRAWS):
        folder = tmp_path / str(seed) / name
        generator.generate(folder, seed)
        found += scored(fitted(folder, name, CASES[case]), folder)
    scores = np.array([each.score for each in found])
    print(
        case, len(scores), np.sqrt(np.mean(scores**2)), np.mean([each.inside for each in found]), np.abs(scores).max()
    )
    assert len(found) >= 2 * DRAWS
    # A standard combination needs no search, and is reported if it is twice as well known as its leading member.
    assert all(each.share < (0.5 if each.combination.standard else 0.21) for each in found)
    assert 0.9 < np.sqrt(np.mean(scores**2)) < 1.1

"""Long study: 20 replicates of the trihedral campaign (`make study`)."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import trihedral_imu
from binomial_share import told
from coverage import study

REPLICATES = 20


@pytest.mark.slow
def test_intervals_hold_what_they_promise():
    scores = study(trihedral_imu, "trihedral-imu", range(1, REPLICATES + 1))
    assert all(scores.converged)
    covered = told(int(scores.inside.sum()), len(scores.inside), 1)
    print(f"\ncoverage {scores.coverage:.4f}, {covered} as if independent, rms z {scores.rms:.3f}")
    angles = np.array([name.startswith("mounting_angle") for name in scores.names])
    held, widest = scores.inside[angles].mean(), scores.sd[angles].max() * 3600
    print(f"mounting angles: coverage {held:.4f}, largest sd {widest:.3f} arcsec")
    assert 0.92 <= scores.coverage <= 0.98
    assert 0.9 <= scores.rms <= 1.1
    assert scores.sd[angles].max() * 3600 <= 2.0
    # The same numbers with uncertainties understated 1.5 times must fail, or the check checks nothing.
    assert not np.sqrt(np.mean((scores.z * 1.5) ** 2)) <= 1.1

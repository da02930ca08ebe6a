"""Every procedure by itself over replicates of the independent generator (`make study`)."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from binomial_share import told
from replicates import CASES, scores


@pytest.mark.slow
@pytest.mark.parametrize("procedure", CASES)
def test_uncertainties_hold_what_they_promise(procedure):
    found = scores(procedure)
    print(
        f"\n{procedure}: rms {found.rms:.3f}, coverage {told(int(np.sum(found.inside)), len(found.z), 1)}, "
        f"largest {found.largest}, of ranks {found.largest_rank}"
    )
    assert found.failed == 0
    assert 0.9 <= found.rms <= 1.1
    assert 0.92 <= found.coverage <= 0.98
    # Of some thousand scores none is a miss by a mode that the posterior lacks, or by tails that its sd does not show.
    assert found.largest.size < 5.5
    assert found.largest_rank.size < 4.5
    # Uncertainties understated 1.5 times must fail, or the check checks nothing.
    assert np.sqrt(np.mean((found.z * 1.5) ** 2)) > 1.1

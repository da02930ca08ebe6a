"""Fresh set-up mistakes are named, none in silence, and campaigns without one are not doubted."""

from pathlib import Path

import numpy as np
import pytest
from fresh_setup_shares import Said, judge, table
from fresh_setups import AGREEMENT, KINDS

OF_A_RUN = [each.__name__ for each in AGREEMENT]


@pytest.mark.slow
def test_thirty_fresh_mistakes(tmp_path: Path) -> None:
    """At least 28 of 30 of drawn kinds are named right, and none is passed in silence."""
    draw, said = np.random.default_rng(49), list[Said]()
    kinds = [kind for kind in KINDS if kind not in OF_A_RUN]
    while len(said) < 30:
        seed = int(draw.integers(10_000, 1_000_000))
        found = judge(str(draw.choice(kinds)), seed, tmp_path / str(seed))
        said += [found] if found else []
    print(table(said))
    assert sum(each.named for each in said) >= 28, [each for each in said if not each.named]
    assert not any(each.silent for each in said)


@pytest.mark.slow
def test_forty_campaigns_without_a_mistake(tmp_path: Path) -> None:
    """None of forty is doubted, warnings included."""
    said = [judge("null", seed, tmp_path / str(seed)) for seed in range(7000, 7040)]
    assert [each for each in said if each is None or each.stopped or not each.silent] == []

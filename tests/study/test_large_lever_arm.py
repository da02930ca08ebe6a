"""An accelerometer off the axis of a rate table, seen at 70 to 900 times the noise: named, added and done with.

Campaigns are drawn by `data/generators/hidden.py`, which shares no code with the package.
"""

import math
from pathlib import Path

import hidden
import pytest

import imubayes.api
from imubayes.results.result import Result

SEEDS = range(1, 21)


def fitted(folder: Path, seed: int) -> Result:
    """Return the fit of a rate table without the lever arm that acts there."""
    drawn = hidden.random_campaign(folder, seed, "large", effect="lever_arm")
    assert math.sqrt(drawn.planted[0].s) > 50
    return imubayes.api.fit(folder, drawn.model, sample=False)


@pytest.mark.slow
def test_it_is_named_and_nothing_remains_after_it(tmp_path):
    result = fitted(tmp_path / "campaign", 2)
    found = imubayes.api.diagnose(result)
    assert found.groups[0].effects[0] == "lever_arm"
    assert found.suggested is not None
    assert found.suggested.effects == ("lever_arm",)
    added = imubayes.api.add(result, diagnosis=found)
    assert added.taken
    assert added.result.summary.converged
    assert imubayes.api.diagnose(added.result).verdict == "adequate"


@pytest.mark.slow
def test_it_is_named_at_every_size(tmp_path):
    said = {}
    for seed in SEEDS:
        found = imubayes.api.diagnose(fitted(tmp_path / str(seed), seed))
        said[seed] = (found.verdict, found.groups[0].effects if found.groups else (), found.suggested)
    wrong = {seed: each for seed, each in said.items() if "lever_arm" not in each[1] or each[2] is None}
    print(f"of {len(said)}: lever arm in the first group and proposed {len(said) - len(wrong)}")
    assert not wrong

"""The loop from the start model alone: followed to its end, it finds what the simulated unit has, and nothing else."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

import imubayes.api
from imubayes.model.model_file import read_model

ROOT = Path(__file__).parents[2]
START = ROOT / "models" / "start.toml"
MOST_STEPS = 8
CAMPAIGNS = ("trihedral-imu", "polar-tumble", "geographic-tumble", "reference-gyro", "redundant-imu")

pytestmark = pytest.mark.slow


def names(model: str) -> set[str]:
    return {effect.name for effect in read_model(ROOT / "models" / f"{model}.toml").effects}


@pytest.mark.parametrize("campaign", CAMPAIGNS)
def test_the_loop_finds_the_model(campaign):
    """Effects that the data can hardly show may be left out; what is named is in the unit."""
    truth = tomllib.loads((ROOT / "data" / campaign / "truth.toml").read_text(encoding="utf-8"))["parameters"]
    result = imubayes.api.fit(ROOT / "data" / campaign, START, sample=False)
    added: set[str] = set()
    for _ in range(MOST_STEPS):
        found = imubayes.api.diagnose(result)
        print(found.verdict, found.suggested, flush=True)
        if found.suggested is None:
            break
        addition = imubayes.api.add(result, diagnosis=found)
        assert addition.taken
        result = addition.result
        added |= set(found.suggested.effects)
    assert found.verdict == "adequate"
    assert added <= names(campaign)
    own = [one for one in result.summary.parameters if one.name in truth and one.sd]
    scores = np.array([(one.mean - truth[one.name]) / one.sd for one in own])
    print(
        f"{len(added)} effects added, rms score {np.sqrt(np.mean(scores**2)):.2f}, largest {np.abs(scores).max():.1f}"
    )
    assert np.sqrt(np.mean(scores**2)) < 1.5
    assert np.abs(scores).max() < 5

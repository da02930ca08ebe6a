"""The loop from the start model alone: followed to its end, it finds what the simulated unit has, and nothing else."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import imubayes.api
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.model.model_file import read_model
from imubayes.results.result import Result

ROOT = Path(__file__).parents[2]
START = ROOT / "models" / "start.toml"
MOST_STEPS = 8
CAMPAIGNS = ("trihedral-imu", "polar-tumble", "geographic-tumble", "reference-gyro", "redundant-imu")

pytestmark = pytest.mark.slow


def names(model: str) -> set[str]:
    return {effect.name for effect in read_model(ROOT / "models" / f"{model}.toml").effects}


def scores(result: Result, campaign: str) -> np.ndarray:
    """Return (mean − truth)/sd of every parameter whose truth is known."""
    truth = tomllib.loads((ROOT / "data" / campaign / "truth.toml").read_text(encoding="utf-8"))["parameters"]
    own = [one for one in result.summary.parameters if one.name in truth and one.sd]
    return np.array([(one.mean - truth[one.name]) / one.sd for one in own])


def followed(result: Result, campaign: str) -> tuple[Result, Diagnosis]:
    """Return where the loop ends; each finding that is added on the way has an effect of the unit."""
    for _ in range(MOST_STEPS):
        found = imubayes.api.diagnose(result)
        print(found.verdict, found.suggested, flush=True)
        if found.suggested is None:
            break
        suggested = set(found.suggested.effects)
        findings = [group.effects for group in found.groups if suggested.intersection(group.effects)]
        assert findings
        assert all(names(campaign).intersection(effects) for effects in findings), findings
        addition = imubayes.api.add(result, diagnosis=found)
        assert addition.taken
        result = addition.result
    return result, found


@pytest.mark.parametrize("campaign", CAMPAIGNS)
def test_the_loop_finds_the_model(campaign):
    """Effects that the data can hardly show may be left out; each finding has an effect of the unit in it."""
    result, found = followed(imubayes.api.fit(ROOT / "data" / campaign, START, sample=False), campaign)
    assert found.verdict == "adequate"
    far = scores(result, campaign)
    print(f"rms score {np.sqrt(np.mean(far**2)):.2f}, largest {np.abs(far).max():.1f}")
    assert np.sqrt(np.mean(far**2)) < 1.5
    assert np.abs(far).max() < 5


def test_what_the_runs_do_not_distinguish_is_offered_together():
    """Without misalignment in the model, a scale factor linear in g imitates it: both are offered."""
    start = read_model(START)
    lacking = replace(start, effects=tuple(one for one in start.effects if not one.name.endswith("_misalignment")))
    found = imubayes.api.diagnose(imubayes.api.fit(ROOT / "data" / "redundant-imu", lacking, sample=False))
    offered = {effect for group in found.groups for effect in group.effects}
    assert {"gyro_misalignment", "accel_misalignment"} & offered, offered

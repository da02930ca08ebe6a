# pyright: reportMissingImports=false
"""A drift in a record with correlated noise is named, and noise that wanders is no drift.

Records and noise come from `data/generators`, which share no code with the models.
"""

import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hidden import random_campaign
from static_record import noise

from imubayes.criticism import search_input, slow_noise_records, thresholds
from imubayes.criticism.diagnose import judge
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.criticism.slow_noise_evidence import slow_noise_evidence
from imubayes.criticism.slow_noise_records import SlowRecords

sys.path.insert(0, str(Path(__file__).parents[1] / "study"))
from blind import mode_of  # pyright: ignore[reportMissingImports]

ROWS = 100
HOURS = np.linspace(-1, 1, ROWS)
COURSES = [HOURS[:, None], HOURS[:, None] ** 2, np.exp(-3 * HOURS)[:, None], np.sin(4 * HOURS)[:, None]]
NAMED_DRIFTS = (9003, 9006)
"""Static records with a drift of one gyro or of all."""
MOST_EQUIVALENT = 12
"""At the noise that took the drift up nothing is distinguishable, and forty effects would do."""


def record(misfit: np.ndarray) -> SlowRecords:
    one = np.full((ROWS, 1), ROWS**-0.5)
    return SlowRecords((np.arange(ROWS),), np.ones(ROWS), 1.0, misfit, one)


def wandering(seed: int, ramp: float = 0.0) -> SlowRecords:
    """Return white, flicker and random-walk noise of random sizes, with a ramp."""
    generator = np.random.default_rng([seed, 5])
    b, k = np.exp(generator.uniform(np.log([0.1, 0.03]), np.log([2.0, 0.6])))
    return record(noise({"white": 1.0, "flicker": b, "random_walk": k}, ROWS, 1.0, generator) + ramp * HOURS)


def alarms(count: int) -> int:
    found = [slow_noise_evidence({0: wandering(seed)}, COURSES) for seed in range(count)]
    return sum(each is not None and each.corrected < thresholds.SLOW_NOISE_EVIDENCE for each in found)


@pytest.mark.slow
def test_noise_that_wanders_is_no_drift(monkeypatch):
    """Of 40 records 0.6 alarms are expected."""
    assert alarms(40) <= 3
    # Planted fault: with white noise as the only shape, a random walk passes for a drift.
    for name, only in (("SLOW_SHARES", ()), ("SLOW_FLICKERS", (0.0,)), ("SLOW_WALKS", (0.0,))):
        monkeypatch.setattr(thresholds, name, only)
    slow_noise_records.slow_covariances.cache_clear()
    assert alarms(40) > 3
    monkeypatch.undo()
    slow_noise_records.slow_covariances.cache_clear()


def test_a_ramp_in_noise_that_wanders_little_is_evident():
    generator = np.random.default_rng(17)
    own = record(noise({"white": 1.0, "flicker": 0.1}, ROWS, 1.0, generator) + 4 * HOURS)
    found = slow_noise_evidence({0: own}, COURSES)
    assert found is not None
    assert min(found.p, key=lambda place: found.p[place]) == 0
    assert found.corrected < thresholds.SLOW_NOISE_EVIDENCE


@pytest.mark.slow
@pytest.mark.parametrize("seed", NAMED_DRIFTS)
def test_a_drift_that_correlated_noise_took_up_is_named(tmp_path, seed):
    drawn = random_campaign(tmp_path / "record", seed, "hidden", "static_record", "gyro_bias_drift")
    named(judge(mode_of(tmp_path / "record", drawn.model)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", NAMED_DRIFTS)
def test_in_a_record_of_other_length_the_noise_of_the_model_tells(tmp_path, monkeypatch, seed):
    drawn = random_campaign(tmp_path / "record", seed, "hidden", "static_record", "gyro_bias_drift")
    fitted = mode_of(tmp_path / "record", drawn.model)
    with mock.patch.object(search_input, "slow_records", return_value={}):
        found = judge(fitted)
        named(found)
        assert found.wandering == "rival"
        # Planted fault: judged at the noise that the fit reached without the drift.
        monkeypatch.setattr(thresholds, "TAKEN_UP_MOST", 0)
        assert judge(fitted).verdict == "adequate"


def named(found: Diagnosis) -> None:
    assert found.groups
    assert "gyro_bias_drift" in found.groups[0].effects
    assert len(found.groups[0].effects) <= MOST_EQUIVALENT


@pytest.mark.slow
@pytest.mark.parametrize("most", [None, 0])
def test_a_random_walk_that_would_do_as_well_is_named_beside_the_drift(tmp_path, monkeypatch, most):
    """The bootstrap over all noises says 5.5 %, the noise of the model 0.2 %: neither is adequate."""
    drawn = random_campaign(tmp_path / "record", 200004, "hidden", "static_record")
    if most is not None:
        monkeypatch.setattr(thresholds, "TAKEN_UP_MOST", most)
    found = judge(mode_of(tmp_path / "record", drawn.model))
    assert (found.verdict, found.wandering) == (("equivalent_effects", "rival") if most is None else ("adequate", ""))


@pytest.mark.slow
def test_a_drift_that_wandering_noise_outdoes_is_told_beside_it(tmp_path):
    drawn = random_campaign(tmp_path / "record", 260009, "hidden", "static_record")
    assert drawn.planted[0].effect == "gyro_bias_drift"
    found = judge(mode_of(tmp_path / "record", drawn.model))
    assert (found.verdict, found.wandering) == ("noise_model", "instead")
    assert [each.effect for rival in found.rivals for each in rival.effects] == ["gyro_bias_drift"]

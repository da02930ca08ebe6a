"""Outliers, steps and transients of a record are distinguished from its noise."""

import numpy as np
import pytest
import static_record as generator

from imubayes_recordings.noise_analysis import running_sum
from imubayes_recordings.noise_analysis.running_sum import from_samples, sudden_change

STEP, SAMPLES = 0.1, 60_000
TIME = STEP * np.arange(SAMPLES)
NOISES = (
    {"white": 1.0},
    {"white": 0.1, "quantisation": 1.0},
    {"white": 1.0, "flicker": 0.5},
    {"white": 1.0, "random_walk": 0.1},
)


def noise(terms: dict[str, float], seed: int) -> np.ndarray:
    return generator.noise(terms, SAMPLES, STEP, np.random.default_rng(seed))


@pytest.mark.parametrize("terms", NOISES)
def test_noise_is_none(terms: dict[str, float]):
    assert [sudden_change(from_samples(noise(terms, seed), STEP)) for seed in range(6)] == [None] * 6


def test_a_ramp_is_none():
    assert sudden_change(from_samples(noise({"white": 1.0}, 7) + 1e-3 * TIME, STEP)) is None


@pytest.mark.parametrize(
    ("added", "time", "tau"),
    [
        (np.where(np.arange(SAMPLES) == 40_000, 250.0, 0.0), 4000.0, 0.2),
        (np.where(TIME > 3000, 4.0, 0.0), 3000.0, 200.0),
        (20.0 * np.exp(-TIME / 100), 100.0, 200.0),
    ],
    ids=["outlier", "step", "turn-on"],
)
def test_what_is_no_noise_is_found_with_its_time(added: np.ndarray, time: float, tau: float):
    for terms in NOISES[:2]:
        found = sudden_change(from_samples(5.0 + noise(terms, 8) + added, STEP))
        assert found is not None
        assert abs(found.time_s - time) <= max(found.tau_s, 2 * STEP)
        assert found.tau_s <= tau or terms is not NOISES[0]
        assert found.ratio > running_sum.THRESHOLD


def test_chunks_and_the_thinned_record_see_the_same(monkeypatch: pytest.MonkeyPatch):
    """A step that the short spans of a chunk do not show."""
    x = noise({"white": 1.0}, 9) + np.where(TIME > 3000, 3.5, 0.0)
    whole = sudden_change(from_samples(x, STEP))
    monkeypatch.setattr(running_sum, "CHUNK", 8192)
    monkeypatch.setattr(running_sum, "_LONGEST_IN_CHUNK", 64)
    cut = sudden_change(from_samples(x, STEP))
    assert whole is not None
    assert cut is not None
    assert abs(cut.time_s - whole.time_s) <= max(cut.tau_s, whole.tau_s)


def test_gaps_are_no_changes_and_hide_none():
    x = 1000.0 + noise({"white": 1.0}, 10)
    x[20_000:22_000] = np.nan
    x[np.random.default_rng(11).uniform(size=SAMPLES) < 0.01] = np.nan
    assert sudden_change(from_samples(x, STEP)) is None
    x[50_000] = 1060.0
    found = sudden_change(from_samples(x, STEP))
    assert found is not None
    assert found.time_s == pytest.approx(5000.0, abs=2 * STEP)


def test_an_output_that_repeats_its_last_value_has_no_scale():
    x = np.zeros(SAMPLES)
    x[::50] = 1.0
    found = sudden_change(from_samples(x, STEP))
    assert found is None or found.tau_s > 50 * STEP

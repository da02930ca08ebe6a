"""The rate of a recorded temperature: exact up to the corners of ramps, steady on a coarse thermometer."""

import numpy as np
import pytest

from imubayes.procedures.ambient import rate_of_change, resolution

RATES = np.repeat([0.0, 1.0, -1.0, 0.0, 0.5], 12) / 60
EDGES = np.concatenate([[0.0], np.cumsum(30 * RATES)])
TIME = 30.0 * np.arange(60) + 15
RAMPS = 25 + (EDGES[1:] + EDGES[:-1]) / 2  # means over rows of 30 s


@pytest.mark.parametrize(("noise", "error"), [(0.0, 1e-9), (0.003, 0.003), (0.01, 0.01)])
def test_ramps_keep_their_corners(noise: float, error: float) -> None:
    found = rate_of_change(TIME, RAMPS + np.random.default_rng(1).normal(0, noise, 60))
    assert found is not None
    assert np.sqrt(np.mean((found - RATES) ** 2)) * 60 < error


@pytest.mark.parametrize("step", [0.1, 0.0625, 0.01])
@pytest.mark.parametrize("rate", [0.01, 0.03, 0.1])
def test_a_coarse_thermometer_has_no_corners(rate: float, step: float) -> None:
    time = 30.0 * np.arange(400)
    found = rate_of_change(time, step * np.round((25 + rate * time / 60) / step))
    assert found is not None
    assert np.sqrt(np.mean((60 * found / rate - 1) ** 2)) < 0.08


def test_the_resolution_is_the_step_between_repeated_values() -> None:
    slow = 25 + 0.001 * np.arange(400)
    assert resolution(np.round(slow, 1)) == pytest.approx(0.1)
    assert resolution(slow) == 0
    assert resolution(RAMPS) == 0

"""Whether the intervals of a fit can be trusted: white noise raises no alarm, other noise does."""

from pathlib import Path

import numpy as np
import pytest
from null_data import fitted_to, redrawn, with_values
from scipy import stats

import imubayes
from imubayes.adequacy.noise_tests import _skew_tail, grid_step, judged_noise
from imubayes.cli.main import run
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import joint_fit


@pytest.fixture(scope="module")
def whole() -> Fit:
    return fitted_to("accel-channel", "accel-channel")


def noise_sd(fit: Fit) -> np.ndarray:
    """Return the standard deviation of the noise of each row, from the residuals of its neighbours alone."""
    values = fit.model.entries.value
    return np.full(len(values), float(np.median(np.abs(np.diff(values, 2))) / (0.6745 * np.sqrt(6))))


def kinds(fit: Fit) -> set[str]:
    return {violation.kind for violation in judged_noise(fit).violations}


@pytest.mark.parametrize("seed", range(5))
def test_white_noise_raises_no_alarm(whole, seed):
    assert not kinds(redrawn(whole, seed))


@pytest.mark.parametrize("seed", range(2))
def test_autocorrelation(whole, seed):
    assert "autocorrelation" in kinds(redrawn(whole, seed, correlation=0.6))


def test_a_random_walk(whole):
    assert kinds(_walking(whole, 1, 1.0)) & {"autocorrelation", "low_frequency"}


def _walking(fit: Fit, seed: int, step: float) -> Fit:
    """Return the fit of fresh data with a random walk in every run, so many standard deviations a row."""
    group = np.asarray(fit.model.problem.observations.group)
    steps = np.random.default_rng(1000 + seed).normal(size=len(group))
    walk = np.zeros(len(group))
    for each in np.unique(group):
        walk[group == each] = np.cumsum(steps[group == each])
    return redrawn(fit, seed, change=step * walk * noise_sd(fit))


def test_what_may_be_chance_is_suspected(whole):
    """A random walk of 0.3 a row, with which 95 % intervals hold the truth in 85 %, and white noise."""
    wandering = [judged_noise(_walking(whole, seed, 0.3)) for seed in range(10)]
    assert sum(bool(each.violations or each.suspected) for each in wandering) >= 6
    assert any(each.suspected and not each.violations for each in wandering)
    white = [judged_noise(redrawn(whole, seed)) for seed in range(10)]
    assert sum(bool(each.violations or each.suspected) for each in white) <= 2


@pytest.mark.parametrize("seed", range(2))
def test_outliers(whole, seed):
    random = np.random.default_rng(seed)
    sd = noise_sd(whole)
    hit = np.where(random.uniform(size=len(sd)) < 0.05, 10 * random.normal(size=len(sd)), 0.0)
    assert "heavy_tails" in kinds(redrawn(whole, seed, change=hit * sd))


def test_a_coarse_output(whole):
    fresh = redrawn(whole, 3)
    step = 6 * float(noise_sd(whole)[0])
    coarse = with_values(fresh, np.round(fresh.model.entries.value / step) * step)
    found = [violation for violation in judged_noise(coarse).violations if violation.kind == "quantisation"]
    assert found
    assert found[0].channels == ("ax",)
    # Rounded to far less than the noise an output is no worse.
    fine = step / 100
    assert not kinds(with_values(fresh, np.round(fresh.model.entries.value / fine) * fine))


@pytest.mark.parametrize(
    ("values", "step"),
    [
        (np.array([0.0, 0.5, 0.5, 2.0, 2.0, 1.0, 0.5]), 0.5),
        (np.array([0.1, 0.2, 0.3, 0.4, 0.5]), 0.0),
        (np.array([1.0, 1.0, 1.0]), 0.0),
        (np.array([0.0, 0.3, 0.3, 1.0, 1.0, 1.0]), 0.0),
    ],
    ids=["grid", "all different", "constant", "no common step"],
)
def test_the_step_of_a_grid(values, step):
    assert grid_step(values) == pytest.approx(step)


@pytest.mark.parametrize("skew", [0.0, 1e-6, 1e-3, 0.7, 4.0])
def test_the_tail_of_a_skew_statistic_is_that_of_pearson(skew):
    for z in (-3.0, -0.5, 0.0, 2.0, 9.0):
        assert _skew_tail(z, skew) == pytest.approx(float(stats.pearson3.sf(z, skew)), rel=1e-4, abs=1e-300)


def test_nothing_is_said_of_few_degrees_of_freedom(whole, monkeypatch):
    wandering = _walking(whole, 1, 1.0)
    assert judged_noise(wandering).violations
    monkeypatch.setattr("imubayes.adequacy.noise_tests._LEAST_FREEDOM", 1e6)
    assert not judged_noise(wandering).violations


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_nothing_is_said_of_noise_that_no_reading_is_left_to_tell(tmp_path, seed):
    """Six faces of a triad laid by hand: attitudes and sensors describe every reading."""
    random = np.random.default_rng(seed)
    faces = np.repeat(np.eye(3), 2, axis=0) * np.tile([1, -1], 3)[:, None]
    true = faces + np.radians(2) * random.normal(size=faces.shape)
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    means = [0.030, 0.004, -0.030] + true * [1.005, 1.001, 1.009] + random.normal(0, 0.004 / 1000**0.5, (6, 3))
    lines = ["ax (g),ay (g),az (g),samples", *(",".join(map(str, [*mean, 1000])) for mean in means)]
    (tmp_path / "six.csv").write_text("\n".join(lines) + "\n")
    assert run(["convert", str(tmp_path / "six.csv"), "--out", str(tmp_path / "six"), "--latitude-deg", "31"]) == 0
    model = imubayes.load_model(Path(__file__).parents[2] / "models" / "free-tumble.toml")
    fit = joint_fit(imubayes.bind(model, imubayes.load_campaign(tmp_path / "six")), None)
    judgement = judged_noise(fit)
    assert not judgement.violations
    assert not judgement.suspected

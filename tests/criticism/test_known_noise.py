"""Noise scales against what is known of them: by raw samples, priors and sister channels."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from null_data import fitted_to, redrawn, refitted, with_values
from planted_data import told, without
from test_noise_is_no_effect import offset

from imubayes.adequacy.known_noise import chance_among_sisters, compare_with_known
from imubayes.adequacy.noise_tests import projected
from imubayes.campaign import load_campaign
from imubayes.criticism.diagnose import judge
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.responses import candidate_effects

sys.path.insert(0, str(Path(__file__).parents[1] / "study"))
from lagging_converter import LaggingOffset, drawn, write

MODEL = Path(__file__).parents[2] / "models" / "accel-channel.toml"
SISTERS_LOG_SD = 0.5
"""Of the scales of equal sensors, as stated."""


def fitted(folder: Path, seed: int, hidden: LaggingOffset) -> Fit:
    model = bind(read_model(MODEL), load_campaign(write(folder / str(seed), seed, hidden)))
    found = refitted(model, *(np.zeros(size) for size in model.problem.size))
    assert found.converged
    return found


@pytest.fixture(scope="module")
def no_lag() -> Fit:
    """Runs of one channel with nothing hidden."""
    return fitted_to("accel-channel", "accel-channel")


@pytest.mark.parametrize("seed", [29, 31])
@pytest.mark.slow
def test_a_lag_outside_the_catalogue_is_never_adequate(tmp_path, monkeypatch, seed):
    """Draws whose evidence a mere suspicion of correlated noise once whitened away."""
    lags = ("_lag", "_hysteresis", "_temperature_rate")
    fit = fitted(tmp_path, seed, drawn(seed))
    known = candidate_effects.searchable(fit.model.registry)
    without(monkeypatch, *(member.name for member in known if member.name.endswith(lags)))
    found = judge(fit)
    assert found.verdict != "adequate", told(found)


def test_fitted_noise_is_compared_with_the_samples(no_lag):
    (found,) = compare_with_known(projected(no_lag)).of_rows
    assert found.source == "samples"
    assert found.recorded == pytest.approx(8.0, rel=0.05)
    assert abs(found.ratio - 1) < 3 * found.ratio_sd
    assert found.agrees
    assert not found.excessive


@pytest.mark.slow  # test_noise_is_no_effect.py has another size of noise
def test_scatter_that_samples_do_not_show_is_an_excess(no_lag):
    rows = no_lag.model.problem.observations.value
    more = np.random.default_rng(3).normal(0, 8 / np.sqrt(12), len(rows))
    fit = with_values(no_lag, np.asarray(rows) + more)
    (found,) = compare_with_known(projected(fit)).of_rows
    assert found.ratio == pytest.approx(np.sqrt(2), rel=0.12)
    assert found.excessive
    diagnosis = judge(fit)
    assert diagnosis.verdict == "noise_model", told(diagnosis)
    assert [each.channel for each in diagnosis.disagreeing_noise] == ["ax"]


def test_a_stated_noise_is_known_to_its_prior_only(no_lag):
    runs = tuple(replace(run, sample_sd=np.full_like(run.sample_sd, np.nan)) for run in no_lag.model.campaign.runs)
    model = replace(no_lag.model, campaign=replace(no_lag.model.campaign, runs=runs))
    (found,) = compare_with_known(projected(replace(no_lag, model=model))).of_rows
    assert found.source == "prior"
    assert found.recorded == 8.0
    assert found.ratio_sd == pytest.approx(0.5 * found.ratio, rel=0.05)


def contradicted(fit: Fit) -> list[tuple[str, str]]:
    """Return the scales that contradict what is known, each with the source that shows it."""
    contradicting = compare_with_known(projected(fit)).contradicted
    return [(each.parameter, each.source) for each in contradicting if each.excessive]


def test_scatter_of_one_of_three_equal_gyros_is_told_by_its_sisters():
    """Eighteen times what the prior states has a chance of 0.2 % under it, which is none among eighteen comparisons."""
    fit = fitted_to("hidden-none")
    (first, second) = compare_with_known(projected(offset(fit, 1, 1.8))).contradicted
    assert (first.parameter, first.source, first.sisters) == ("run_scatter.tau[gx]", "sisters", ("gy", "gz"))
    assert first.excessive
    assert first.ratio > 12
    # What the prior says is reported beside it, although it contradicts nothing.
    assert (second.source, second.excessive) == ("prior", False)
    # The same scatter of all three gyros is what the prior allows for.
    assert contradicted(offset(fit, 1, 1.8, channels=(0, 1, 2))) == []


@pytest.mark.slow
def test_noise_as_the_model_says_contradicts_nothing():
    fit = fitted_to("hidden-none")
    assert [contradicted(redrawn(fit, seed)) for seed in range(8)] == [[]] * 8


@pytest.mark.parametrize(("beyond", "excessive"), [(2.0, False), (3.0, False), (4.0, True), (10.0, True)])
def test_all_comparisons_are_counted(beyond, excessive):
    """One of six priors at 3 standard deviations is expected in 0.8 %; the bar is 0.5 %."""
    fit = fitted_to("hidden-none")
    names = [parameter.name for parameter in fit.model.hyper_layout.parameters]
    h = np.where([name == "run_scatter.tau[ay]" for name in names], beyond, 0.0)
    found = compare_with_known(projected(replace(fit, h=h))).comparisons
    (own,) = [each for each in found if each.parameter == "run_scatter.tau[ay]" and each.source == "prior"]
    assert own.excessive == excessive
    # Lognormal with the median 0.1 of the noise and unit spread of the logarithm.
    (noise,) = [channel.noise for channel in fit.model.campaign.channels if channel.name == "ay"]
    assert noise is not None
    assert own.recorded == pytest.approx(0.1 * noise)
    assert own.fitted == pytest.approx(0.1 * noise * np.exp(beyond))


def test_the_chance_among_sisters_is_that_of_equal_sensors():
    """Variances of three sensors whose scales differ lognormally, each of its own degrees of freedom."""
    random, count, freedom = np.random.default_rng(0), 4000, np.array([4.0, 3.0, 5.0])
    scales = np.exp(SISTERS_LOG_SD * random.normal(size=(count, 3)))
    variances = scales**2 * random.chisquare(freedom, size=(count, 3)) / freedom
    # The pooled variance of the sisters is that of their common scale: the law of a single one is a bound.
    pooled = variances[:, 1:] @ freedom[1:] / freedom[1:].sum()
    pairs = zip(variances[:, 0], pooled, strict=True)
    p = np.array([chance_among_sisters(own, 4.0, expected, 8.0, sisters=2) for own, expected in pairs])
    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=0.02)
    assert np.mean(p < 0.005) < 0.01
    # A scale ten times that of its sisters is reported.
    assert chance_among_sisters(100.0**2, 4.0, 1.0, 8.0, sisters=2) < 1e-5 < chance_among_sisters(4.0, 4, 1.0, 8.0, 2)

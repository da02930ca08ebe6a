"""A scatter between runs that its prior excludes is no adequate model: an effect between runs passes for it."""

from dataclasses import replace

import numpy as np
import pytest
from null_data import fitted_to, redrawn

from imubayes.criticism import diagnose
from imubayes.criticism.diagnose import judge
from imubayes.criticism.noise_against_prior import noise_beyond_prior
from imubayes.display.diagnosis_report import next_command
from imubayes.display.diagnosis_sentences import sentence
from imubayes.inference.fitted_model import Fit


def offset(fitted: Fit, seed: int, size: float) -> Fit:
    """Return a fit to fresh data with an offset of gx in each run, in standard deviations of one sample."""
    entries, [gx, *_] = fitted.model.entries, fitted.model.campaign.channels
    assert gx.noise is not None
    offsets = size * gx.noise * np.random.default_rng(seed).normal(size=len(fitted.model.campaign.runs))
    return redrawn(fitted, seed, change=np.where(entries.channel == 0, offsets[entries.run], 0.0))


@pytest.mark.slow
def test_an_effect_between_runs_is_never_adequate(monkeypatch):
    """The prior of the scatter has the median 0.1 in these units; the offsets are thousands of times as large."""
    fit = offset(fitted_to("hidden-none"), 1, 300.0)
    found = judge(fit)
    assert found.verdict == "noise_model", sentence(found)
    assert [each.parameter for each in found.beyond_prior] == ["run_scatter.tau[gx]"]
    assert "run_scatter.tau[gx] is" in sentence(found)
    assert "something acts between runs that the model lacks, or the prior is too narrow" in sentence(found)
    assert next_command(found) == "imubayes compare RESULT"
    # Planted fault: without the rule the fit is called adequate.
    monkeypatch.setattr(diagnose, "noise_beyond_prior", lambda _: ())
    assert judge(fit).verdict == "adequate"


def test_a_scatter_that_the_prior_expects_is_no_alarm():
    assert not any(noise_beyond_prior(offset(fitted_to("hidden-none"), seed, 0.5)) for seed in range(5))


@pytest.mark.parametrize(("beyond", "told"), [(2.0, False), (3.0, False), (4.0, True), (40.0, True)])
def test_all_parameters_are_counted(beyond, told):
    """One of six at 3 standard deviations is expected in 0.8 %; the bar is 0.5 %."""
    fitted = fitted_to("hidden-none")
    names = [parameter.name for parameter in fitted.model.hyper_layout.parameters]
    h = np.where([name == "run_scatter.tau[ay]" for name in names], beyond, 0.0)
    found = noise_beyond_prior(replace(fitted, h=h))
    assert [each.parameter for each in found] == (["run_scatter.tau[ay]"] if told else [])
    # Lognormal with the median 0.1 of the noise and unit spread of the logarithm.
    noise = fitted.model.campaign.channels[names.index("run_scatter.tau[ay]") % 6].noise
    assert noise is not None
    assert all(each.expected == pytest.approx(0.1 * noise * np.exp(1.96)) for each in found)
    assert all(each.value == pytest.approx(0.1 * noise * np.exp(beyond)) for each in found)
    white = np.where([name.startswith("white_noise") for name in names], beyond, 0.0)
    assert not noise_beyond_prior(replace(fitted, h=white))

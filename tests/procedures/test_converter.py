"""The converter's straight lines: slopes per input, Δk, and the decision at the threshold."""

from pathlib import Path

import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.procedures import classical
from imubayes.procedures.converter_temperature import converter_test
from imubayes.procedures.textbook import Estimate, Undetermined, line

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def campaign():
    return load_campaign(ROOT / "data" / "accel-channel")


def test_delta_k_is_near_the_truth_and_decided(campaign):
    found = {one.name: one for one in classical(campaign) if isinstance(one, Estimate)}
    # Truth of the shipped campaign: 86.4 % and 108.2 %.
    for name, true in (("delta_k[ax,ramp-trihedral]", 86.4), ("delta_k[ax,inject-12g]", 108.2)):
        assert abs(found[name].value - true) < 3 * found[name].sd
        assert "needs its own line" in found[name].decision


def test_the_threshold_decides(campaign):
    runs = [run for run in campaign.runs if "converter_temperature" in run.covariates]
    generous = [one for one in converter_test(campaign, runs, threshold=2.0) if isinstance(one, Estimate)]
    assert all("line applies" in one.decision for one in generous if one.name.startswith("delta_k["))


def test_a_converter_that_stays_cold_is_said(campaign):
    run = campaign.runs[0]
    still = {**run.covariates, "converter_temperature": np.full(run.rows, 25.0)}
    kept = type(run)(**{**vars(run), "covariates": still})
    (finding,) = converter_test(campaign, [kept])
    assert isinstance(finding, Undetermined)


def test_line_has_the_standard_deviations_of_the_textbook():
    x = np.arange(10.0)
    slopes, stated = [], []
    for seed in range(400):
        fitted = line(x, 2 + 3 * x + np.random.default_rng(seed).normal(size=10))
        slopes.append(fitted.slope)
        stated.append(fitted.slope_sd**2)
    assert np.var(slopes) == pytest.approx(np.mean(stated), rel=0.2)
    assert np.mean(slopes) == pytest.approx(3.0, abs=0.02)

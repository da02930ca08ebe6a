"""Combinations that the data determine, on shipped campaigns: far better known than their members, and true."""

import json

import numpy as np
import pytest
from combination_scores import ROOT, fitted, scored

from imubayes.campaign import load_campaign
from imubayes.display.classical_comparison import compare_classical
from imubayes.display.fit_quality_tables import symbol_text
from imubayes.inference.experiment_design import rank
from imubayes.procedures import classical, declared_combinations
from imubayes.procedures.textbook import Estimate
from imubayes.results.summary import CombinationSummary, Summary

SYMBOLS = {
    "polar-tumble": {"D_II-D_SS[g]", "D_F+D_II[g]"},
    "servo-table": {"D[g]", "D_O+D_IO·f_I[g]", "D_S+D_SI·f_I[g]", "D_OO-D_SS[g]"},
}


@pytest.fixture(scope="module", params=["polar-tumble", pytest.param("servo-table", marks=pytest.mark.slow)])
def result(request):
    return fitted(ROOT / "data" / request.param, request.param)


@pytest.mark.slow
def test_combinations_are_far_better_known_than_their_members_and_true(result):
    name = result.summary.campaign
    found = scored(result, ROOT / "data" / name)
    assert {each.combination.name for each in found} >= SYMBOLS[name]
    assert max(each.share for each in found) < 0.2
    assert max(abs(each.score) for each in found) < 4
    assert all(each.combination.unit and each.combination.q025 < each.combination.q975 for each in found)


@pytest.mark.slow  # compiles a sweep of its own
def test_one_polar_sweep_determines_its_mean_and_the_joint_fit_says_so():
    """D_OO, D_II and D_SS have narrow priors, hardly wider than the sum is known; it is the constant of the sweep."""
    folder = ROOT / "data" / "polar-tumble"
    result = fitted(folder, "polar-tumble", ("tumble-O-north",))
    textbook = {each.name for each in classical(result.fit.model.campaign) if isinstance(each, Estimate)}
    mean = "D_F+D_O·sinL+D_OO·sin²L+½(D_II+D_SS)·cos²L[g]"
    found = {each.combination.name: each for each in scored(result, folder)}
    assert mean in textbook & set(found)
    assert abs(found[mean].score) < 4
    # What the textbook has as a sum the joint fit has under the same symbol, and nothing beside it.
    assert set(found) == {name for name in textbook if "+" in name or "-D_" in name}


@pytest.mark.slow
def test_one_mounting_on_a_rate_table_determines_slope_and_zero_of_every_gyro():
    """Neither k nor θ, neither D_F nor the g-sensitivities: k′ = k cos θ and F₀/k, the zero of the series."""
    folder, runs = ROOT / "data" / "trihedral-imu", [f"rate-pyramid-{t}" for t in ("minus10C", "25C", "55C")]
    found = {each.combination.name: each for each in scored(fitted(folder, "trihedral-imu", tuple(runs)), folder)}
    for gyro in ("gx", "gy", "gz"):
        slope, zero = found[f"k′[{gyro},pyramid]"], found[f"F₀/k[{gyro},pyramid]"]
        assert max(abs(slope.score), abs(zero.score)) < 4
        # Of k the table's rate error, 5 ppm, is left, and of the zero the scatter between runs; D_F alone has 5 °/h.
        assert slope.combination.sd < 6e-6 * slope.combination.mean
        assert zero.combination.sd < 3.0


def test_d_of_a_servo_table_says_when_it_holds():
    """The drift changes with time: D is that in the middle of the record, and is shown with this."""
    campaign = load_campaign(ROOT / "data" / "servo-table")
    (total,) = [each for each in declared_combinations(campaign) if each.name == "D[g]"]
    (run,) = [each for each in campaign.runs if each.name == "servo-day"]
    assert total.middle_of == run.name
    assert total.weights["gyro_bias_drift.slope[g]"] == pytest.approx(np.mean(run.covariates["time"]) / 3600, rel=1e-9)
    members, weights = tuple(total.weights), tuple(total.weights.values())
    shown = {"name": total.name, "unit": total.unit, "quantities": members, "weights": weights, "standard": True}
    assert symbol_text(CombinationSummary(**shown, middle_of=run.name)) == "D[g] at mid-record of servo-day"
    assert symbol_text(CombinationSummary(**shown)) == "D[g]"
    (textbook,) = [each for each in classical(campaign) if isinstance(each, Estimate) and each.name == "D[g]"]
    assert textbook.method.endswith("in the middle of the record")


def test_what_a_further_run_leaves_of_an_angle_near_zero(result):
    """The axis along that of the table: its angle is a length, which at zero has no gradient."""
    name = "mounting_angle[g,I-north]"
    (angle,) = [each for each in result.summary.derived if each.name == name]
    assert angle.mean < 3 * angle.sd
    (lines,) = rank(result.fit, [name])
    assert lines[0].sd_before == pytest.approx(angle.sd, rel=0.05)
    # Runs on this table show nothing of the tilt of the seat; by the gradient 1e-9 of a degree would be left.
    assert all(0.5 * angle.sd < line.sd_after <= line.sd_before * (1 + 1e-9) for line in lines)


def test_they_are_stored_and_compared_with_the_classical_evaluation(result):
    stored = Summary.model_validate(json.loads(result.summary.json_text()))
    assert stored.combinations == result.summary.combinations
    comparison = compare_classical(classical(result.fit.model.campaign), result.summary)
    beside = {each.classical.name: each for each in comparison.estimates if each.joint is not None}
    for symbol in SYMBOLS[result.summary.campaign]:
        # The axes are taken as exact classically: a table that stands askew by 20 arcsec shifts an estimate.
        assert abs(beside[symbol].difference) < 5 * np.hypot(beside[symbol].classical.sd, beside[symbol].joint.sd)

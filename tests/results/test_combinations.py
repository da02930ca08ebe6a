"""Combinations that the data determine, on shipped campaigns: far better known than their members, and true."""

import json

import numpy as np
import pytest
from combination_scores import ROOT, fitted, scored

from imubayes.display.classical_comparison import compare_classical
from imubayes.procedures.classical import classical
from imubayes.results.summary import Summary

SYMBOLS = {
    "polar-tumble": {"D_II-D_SS[g]", "D_F+D_II[g]"},
    "servo-table": {"D[g]", "D_O+D_IO·f_I[g]", "D_S+D_SI·f_I[g]", "D_OO-D_SS[g]"},
}


@pytest.fixture(scope="module", params=["polar-tumble", pytest.param("servo-table", marks=pytest.mark.slow)])
def result(request):
    return fitted(ROOT / "data" / request.param, request.param)


def test_combinations_are_far_better_known_than_their_members_and_true(result):
    name = result.summary.campaign
    found = scored(result, ROOT / "data" / name)
    assert {each.combination.name for each in found} >= SYMBOLS[name]
    assert max(each.share for each in found) < 0.2
    assert max(abs(each.score) for each in found) < 4
    assert all(each.combination.unit and each.combination.q025 < each.combination.q975 for each in found)


def test_they_are_stored_and_compared_with_the_classical_evaluation(result):
    stored = Summary.model_validate(json.loads(result.summary.json_text()))
    assert stored.combinations == result.summary.combinations
    comparison = compare_classical(classical(result.fit.model.campaign), result.summary)
    beside = {each.classical.name: each for each in comparison.estimates if each.joint is not None}
    for symbol in SYMBOLS[result.summary.campaign]:
        # The axes are taken as exact classically: a table that stands askew by 20 arcsec shifts an estimate.
        assert abs(beside[symbol].difference) < 5 * np.hypot(beside[symbol].classical.sd, beside[symbol].joint.sd)

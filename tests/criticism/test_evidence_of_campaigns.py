"""The evidence of campaigns: what a free noise scale absorbs, what is wrong in the record, and complete models."""

from pathlib import Path

import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.criticism.diagnose import judge
from imubayes.criticism.evidence.relinearised_search import explain
from imubayes.criticism.explanation_records import Evidence
from imubayes.display.loop.diagnosis_report import diagnosis_lines
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.responses.candidate_effects import candidate_responses
from imubayes.responses.residual_covariates import covariates

ROOT = Path(__file__).parents[2]
CASES = ROOT.parent / "shared" / "cases"


def fit_of(campaign: Path, model: Path) -> Fit:
    declared = bind(read_model(model), load_campaign(campaign))
    mode = find_mode(declared.problem, *(np.zeros(size) for size in declared.problem.size))
    return Fit(declared, np.asarray(mode.z), np.asarray(mode.h), bool(mode.converged))


def weighed(fitted: Fit) -> Evidence:
    return explain(fitted, candidate_responses(fitted), tuple(covariates(fitted))).evidence


@pytest.mark.slow  # compiles a campaign of its own; test_hidden_effects.py has polar-tumble
@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not in this checkout")
def test_an_effect_that_the_scatter_between_runs_absorbs_is_named() -> None:
    fitted = fit_of(CASES / "evidence" / "asymmetry-two-rates", ROOT / "models" / "rotation-modulation.toml")
    found = judge(fitted)
    assert found.explanations is not None
    [slot] = found.explanations.slots
    assert {each.effect for each in slot.candidates} == {"gyro_scale_asymmetry", "gyro_scale_quadratic"}
    assert slot.channels == ("gx",)
    assert found.explanations.of("effects").probability > 0.99
    assert found.verdict == "equivalent_effects"
    assert set(found.groups[0].effects) == {"gyro_scale_asymmetry", "gyro_scale_quadratic"}
    assert found.suggested is not None
    assert any(line.startswith("Probability: an effect missing 0.99") for line in diagnosis_lines(found))


@pytest.mark.slow  # compiles a campaign of its own; test_wrong_records.py has one
@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not in this checkout")
def test_a_mistyped_angle_is_a_wrong_record_and_its_size_is_found_beyond_the_linear() -> None:
    case = CASES / "inputs" / "one-angle-typo"
    found = weighed(fit_of(case, case / "model.toml"))
    assert found.of("input").probability > 0.99
    assert found.form is not None
    assert (found.form.run, found.form.row, found.form.wrong) == ("A1", 10, True)
    assert "table_angle" in found.form.name

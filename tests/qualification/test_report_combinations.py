"""Determined combinations in `imubayes report`: estimate, budget, what determined them, and limits on them."""

import re
from pathlib import Path

import pytest

from imubayes.cli.main import run
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.results.change_records import write_diagnosis
from imubayes.results.result import read_result
from imubayes_qualification.certificate.report_record import QualificationReport
from imubayes_qualification.display.report.report_files import html_page, report_document

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow  # a fit of its own; test_uncertainty_budget.py has functions of quantities at every run
SYMBOLS = {"D_II-D_SS[g]": "deg/h/g^2", "D_II-D_OO[g]": "deg/h/g^2", "D_F+D_II[g]": "deg/h"}


@pytest.fixture(scope="module")
def fitted(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("combinations") / "result"
    campaign, model = ROOT / "data" / "polar-tumble", ROOT / "models" / "polar-tumble.toml"
    assert run(["fit", str(campaign), "--model", str(model), "--out", str(folder), "--no-sample"]) == 0
    write_diagnosis(folder, Diagnosis(verdict="adequate", result=str(folder)))
    return folder


@pytest.fixture(scope="module")
def report(fitted) -> QualificationReport:
    out = fitted.parent / "report.json"
    assert run(["report", str(fitted), "--out", str(out)]) == 0
    return QualificationReport.model_validate_json(out.read_text())


def test_the_record_has_those_of_the_fit(fitted, report):
    known = {each.name: each for each in read_result(fitted).summary.combinations}
    assert {each.name: each.unit for each in report.combinations if each.standard} == SYMBOLS
    for each in report.combinations:
        # Stored draws are rounded to a share of their standard deviation.
        assert each.estimate == pytest.approx(known[each.name].mean, abs=1e-4 * known[each.name].sd)
        assert each.standard_uncertainty == pytest.approx(known[each.name].sd, rel=0.02)
        assert each.quantities == known[each.name].quantities
        assert each.d_si is not None
        assert each.procedures == ("polar_tumble",)


def test_each_has_a_budget_that_adds_up_although_those_of_its_members_cancel(report):
    assert report.budgets is not None
    budgets = {each.name: each for each in report.budgets.quantities}
    for each in report.combinations:
        budget = budgets[each.name]
        assert abs(budget.remainder) < 0.02, each.name
        assert budget.standard_uncertainty == pytest.approx(each.standard_uncertainty, rel=0.05)
        assert all(budget.standard_uncertainty < 0.2 * budgets[name].standard_uncertainty for name in each.quantities)
        # The sweeps determine it, and no prior of a drift coefficient.
        assert sum(line.share for line in budget.lines if line.type == "A") > 0.9


def test_the_page_states_them_with_their_symbols(report):
    page = re.sub(r"<style>.*?</style>", "", html_page(report_document(report)), flags=re.DOTALL)
    said = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", page))
    assert "Determined combinations" in said
    assert "DII−DSS[g]" in said
    assert "gyro_g2_sensitivity.d_ii[g] − gyro_g2_sensitivity.d_ss[g]" in said
    assert "D_F+D_II[g]: u =" in said
    # Who reads the table of the standards learns which of its lines do not stand for themselves.
    (sentence,) = re.findall(r"Much better determined together than by themselves: ([^;]*);", said)
    assert re.findall(r"D_\w+", sentence) == ["D_F", "D_II", "D_OO", "D_SS"]
    none = html_page(report_document(report.model_copy(update={"combinations": ()})))
    assert "Determined combinations" not in none
    assert "Much better determined together" not in none


@pytest.mark.parametrize(("upper", "status"), [(0.2, 0), (0.05, 1)])
def test_a_limit_on_a_combination(fitted, tmp_path, upper, status):
    file = tmp_path / "spec.toml"
    limit = f'[[limit]]\nquantity = "D_II-D_SS[g]"\nlower = -0.2\nupper = {upper}\nunit = "deg/h/g^2"\n'
    file.write_text(f'format = 1\nname = "drift"\n{limit}')
    assert run(["report", str(fitted), "--spec", str(file), "--out", str(tmp_path / "report.json")]) == status

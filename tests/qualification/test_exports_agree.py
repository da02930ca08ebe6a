"""One result, one U: page, record, table of covariances and digital certificate give the same at one probability."""

import re
import shutil
from pathlib import Path

import pytest

import imubayes
from exported_uncertainties import disagreements, rounded_otherwise
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.foundations.errors import InputError
from imubayes.results.change_records import write_diagnosis
from imubayes_qualification.certificate.certificate import Certificate
from imubayes_qualification.certificate.report_record import QualificationReport
from imubayes_qualification.display.report.report_files import html_page, report_document

BLOCK = Certificate.model_validate(
    {
        "number": "1",
        "laboratory": {"name": "L", "address": "A", "country": "DE"},
        "customer": {"name": "C", "address": "B"},
        "signatory": [{"name": "S"}],
    }
)


SPECIFICATION = """
format = 1
name = "test"
[[limit]]
quantity = "converter_gain_drift.slope"
upper = 5
unit = "ppm/degC"
"""


NAME = "converter_gain_drift.slope[ax]"


@pytest.fixture(scope="module")
def folder(accel_channel, tmp_path_factory) -> Path:
    folder = Path(shutil.copytree(accel_channel, tmp_path_factory.mktemp("exports") / "result"))
    write_diagnosis(folder, Diagnosis(verdict="adequate", result=str(folder)))
    (folder.parent / "spec.toml").write_text(SPECIFICATION)
    return folder


@pytest.fixture(scope="module")
def report(folder) -> QualificationReport:
    return imubayes.report(folder, folder.parent / "spec.toml").model_copy(update={"certificate": BLOCK})


def test_every_export_gives_the_same_u_at_the_same_probability(report):
    assert disagreements(report) == []


@pytest.mark.parametrize("kind", [str, Path])
def test_one_file_to_write_is_a_text_or_a_path(folder, tmp_path, kind):
    found = imubayes.report(folder, out=kind(tmp_path / "x.json"))
    assert QualificationReport.model_validate_json((tmp_path / "x.json").read_text()) == found


def test_an_estimate_of_a_report_is_judged_as_the_report_judges_it(report):
    """`conformity` takes what `report` returns, and finds the same U, guard band and outcome."""
    assert report.conformity is not None
    (limit,) = report.conformity.limits
    found = imubayes.conformity(report[NAME], upper=5)
    assert (found.value, found.uncertainty) == (limit.estimate, limit.standard_uncertainty)
    assert (found.expanded, found.outcome, found.guard_band) == (
        limit.expanded_uncertainty, limit.outcome, limit.guard_band
    )  # fmt: skip
    whole = imubayes.conformity(report[NAME], upper=5, rule="ilac_g8_non_binary")
    assert whole.guard_band == limit.expanded_uncertainty
    assert found.conformance == pytest.approx(limit.conformance.from_quadrature, abs=1e-4)
    with pytest.raises(InputError, match=r"states no y ± U of 'accel_bias"):
        imubayes.conformity(report["accel_bias.bias[ax]"], upper=5)
    with pytest.raises(KeyError, match=r"no quantity 'x'"):
        report["x"]


def test_the_page_rounds_one_number_once_and_names_no_degrees_of_freedom(report):
    page = re.sub(r"<style>.*?</style>", "", html_page(report_document(report)), flags=re.DOTALL)
    said = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))
    assert rounded_otherwise(report, said) == []
    assert "it has no degrees of freedom" in said
    assert "ν" not in said.replace("χ²/ν", "")

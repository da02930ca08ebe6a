"""One result, one U: page, record, table of covariances and digital certificate give the same at one probability."""

import re
import shutil
from pathlib import Path

import pytest

import imubayes
from exported_uncertainties import disagreements, rounded_otherwise
from imubayes.display.qualification.report_files import html_page, report_document
from imubayes.qualification.certificate import Certificate
from imubayes.qualification.report_record import QualificationReport

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


@pytest.fixture(scope="module")
def report(accel_channel, tmp_path_factory) -> QualificationReport:
    folder = Path(shutil.copytree(accel_channel, tmp_path_factory.mktemp("exports") / "result"))
    specification = folder.parent / "spec.toml"
    specification.write_text(SPECIFICATION)
    return imubayes.report(folder, specification).model_copy(update={"certificate": BLOCK})


def test_every_export_gives_the_same_u_at_the_same_probability(report):
    assert disagreements(report) == []


def test_the_page_rounds_one_number_once_and_names_no_degrees_of_freedom(report):
    page = re.sub(r"<style>.*?</style>", "", html_page(report_document(report)), flags=re.DOTALL)
    said = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))
    assert rounded_otherwise(report, said) == []
    assert "no degrees of freedom belong to it" in said
    assert "ν" not in said.replace("χ²/ν", "")

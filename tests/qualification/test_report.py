"""`imubayes report`: the document says what the record holds, and no unit passes on a model that is not adequate."""

import json
import math
import re
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import pytest

import imubayes
import imubayes_qualification as qualification
from display.made_diagnoses import ASYMMETRY, QUADRATIC, diagnosis
from imubayes.cli.main import run
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.criticism.explanation_records import Verdict
from imubayes.foundations.errors import InputError
from imubayes.model import derived_quantities
from imubayes.results.change_records import write_diagnosis
from imubayes.results.result import Result, read_result
from imubayes_qualification.budgets import report_budgets, uncertainty_budget
from imubayes_qualification.certificate import report_build
from imubayes_qualification.certificate.report_record import QualificationReport
from imubayes_qualification.display.report.report_files import html_page, report_document
from kept_results import listed
from page_outline import assert_accessible, contrast

ROOT = Path(__file__).parents[2]
WIDE = '[[limit]]\nquantity = "accel_bias.bias"\nlower = -100\nupper = 100\nunit = "mg"\n'
HEAD = 'format = 1\nname = "test"\n'


@pytest.fixture(scope="module")
def fitted(accel_channel, tmp_path_factory) -> Path:
    """The result with its budgets, which a sampled fit keeps and no report computes again."""
    folder = Path(shutil.copytree(accel_channel, tmp_path_factory.mktemp("report") / "result"))
    report_budgets.keep_budgets(read_result(folder))
    return folder


@pytest.fixture
def result(fitted, tmp_path) -> Path:
    return Path(shutil.copytree(fitted, tmp_path / "result"))


def specification(folder: Path, text: str = WIDE) -> str:
    file = folder / "spec.toml"
    file.write_text(HEAD + text)
    return str(file)


def judged(result: Path, verdict: Verdict) -> None:
    write_diagnosis(result, Diagnosis(verdict=verdict, result=str(result)))


def written(result: Path, tmp_path: Path, *words: str) -> tuple[int, QualificationReport, str]:
    out = tmp_path / "report"
    status = run(["report", str(result), *words, "--out", f"{out}.json", f"{out}.html"])
    record = QualificationReport.model_validate_json(out.with_suffix(".json").read_text())
    return status, record, out.with_suffix(".html").read_text()


def visible(page: str) -> str:
    body = re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", body))


def test_an_adequate_unit_passes_and_the_page_is_made_from_the_record_alone(result, tmp_path):
    judged(result, "adequate")
    status, record, page = written(result, tmp_path, "--spec", specification(tmp_path))
    assert status == 0
    assert record.conformity is not None
    assert record.conformity.outcome == "pass"
    assert_accessible(page)
    assert len(re.findall(r'<a href="#', page)) > 5  # the sections, of a page of many screens
    kinds = {each.interval for each in record.results if each.interval is not None}
    assert "equal-tailed" not in record.interval or kinds == {"equal-tailed"}
    # Every number of the page stands in the JSON file: the page made from the file is the same to the byte.
    assert html_page(report_document(record)) == page
    again = tmp_path / "again"
    again.mkdir()
    assert written(result, again, "--spec", specification(tmp_path))[1:] == (record, page)
    assert "PASS" in visible(page)
    # Benches of this campaign state their directions: their unknowns are no part of its model.
    listed = {each.name for each in record.provenance.effects} | {each.name for each in record.measurement.inputs}
    assert not listed & {"unknown_heading", "unknown_level"}
    assert "T_ref" not in visible(page), "a subscript is one in cells as well"
    assert re.search(r"−\d", visible(page))
    assert not re.search(r"(?<![\w\-])-\d", visible(page)), "a hyphen is no minus; programs read the record"
    assert len(page.encode()) < 1.5e6


SLOPE = '[[limit]]\nquantity = "converter_gain_drift.slope"\nlower = -5\nupper = 5\nunit = "ppm/degC"\n'
CAPABILITY = '[[certificate.cmc]]\nquantity = "converter_gain_drift.slope"\nexpanded = 2\nunit = "ppm/degC"\n'


def test_no_uncertainty_is_stated_below_the_capability(result, tmp_path):
    """ILAC-P14: in every table and in the decision, and said as such."""
    judged(result, "adequate")
    _, own, _ = written(result, tmp_path, "--spec", specification(tmp_path, SLOPE))
    _, record, page = written(result, tmp_path, "--spec", specification(tmp_path, SLOPE + CAPABILITY))
    name = "converter_gain_drift.slope[ax]"
    assert own.conformity is not None
    assert record.conformity is not None
    assert record.budgets is not None
    before, limit = own.conformity.limits[0], record.conformity.limits[0]
    line = next(each for each in record.results if each.name == name)
    budget = next(each for each in record.budgets.quantities if each.name == name)
    assert before.expanded_uncertainty is not None
    assert before.expanded_uncertainty < 1
    for each in (limit, line, budget):
        assert each.expanded_uncertainty == pytest.approx(2, rel=1e-6)
        assert each.standard_uncertainty == pytest.approx(2 / (each.coverage_factor or 0), rel=1e-6)
    assert sum(each.share for each in budget.lines) + budget.remainder == pytest.approx(1, abs=1e-6)
    # Standard normal, of the margin to the nearer limit: the decision is of the stated uncertainty.
    margin = (5 + (limit.estimate or 0)) / (limit.standard_uncertainty or 0)
    assert limit.conformance.from_quadrature == pytest.approx(0.5 * (1 + math.erf(margin / 2**0.5)), abs=0.01)
    assert before.conformance.from_quadrature > 0.9999
    assert [(each.name, each.expanded) for each in record.floors] == [(name, 2.0)]
    assert "the CMC is stated in its place (ILAC-P14), for converter_gain_drift.slope ax: 0.49 → 2.0 ppm/°C" in visible(
        page
    )
    # One that is smaller than U changes nothing.
    small = CAPABILITY.replace("expanded = 2", "expanded = 1e-3")
    _, record, page = written(result, tmp_path, "--spec", specification(tmp_path, SLOPE + small))
    assert record.conformity == own.conformity.model_copy(update={"sha256": record.conformity.sha256})
    assert "CMC" not in visible(page)
    wrong = CAPABILITY.replace("ppm/degC", "deg/h").replace("slope", "slop")
    assert (
        run(["report", str(result), "--spec", specification(tmp_path, SLOPE + wrong), "--out", f"{tmp_path}/x.json"])
        == 2
    )


def test_nothing_passes_on_an_expired_standard(result, tmp_path):
    judged(result, "adequate")
    table = next(run.table for run in read_result(result).fit.model.campaign.runs if run.table)
    block = f'[[certificate.standard]]\nname = "plate"\nequipment = ["{table}"]\ncertificate = "A 1"\nvalid_until = '
    for valid, outcome in (("2000-01-01", "withheld"), ("2100-01-01", "pass")):
        text = f"{WIDE}{block}{valid}\n"
        status, record, page = written(result, tmp_path, "--spec", specification(tmp_path, text))
        assert record.conformity is not None
        assert record.conformity.outcome == outcome
        assert {each.outcome for each in record.conformity.limits} == {outcome}, "no row passes where the unit cannot"
        assert ("None of the limits" in visible(page)) == (outcome == "withheld")
        assert "End of the certificate." in visible(page)
        assert status == (outcome == "withheld")
        assert ("had expired when runs used it" in visible(page)) == (outcome == "withheld")


def traceability(report: QualificationReport) -> imubayes.ReportSection:
    """A section of the user's own, in one file outside the package."""
    rows = (("rate table", "NMI 2026-117", "2027-03-01"), (report.subject.campaign, "–", "–"))
    return imubayes.ReportSection(title="Traceability", head=("equipment", "certificate", "due"), rows=rows)


def test_a_section_of_the_user_is_in_every_form_and_marked_as_theirs(result, tmp_path):
    files = [tmp_path / "report.json", tmp_path / "report.html", tmp_path / "report.pdf"]
    record = imubayes.report(result, sections=[traceability], out=files)
    assert QualificationReport.model_validate_json(files[0].read_text()) == record
    page = files[1].read_text()
    assert files[2].read_bytes().startswith(b"%PDF")
    assert html_page(report_document(record)) == page
    assert "Traceability Stated by the author of this report; imubayes computed none of it." in visible(page)
    assert "NMI 2026-117" in visible(page)
    assert "Traceability" not in visible(written(result, tmp_path / "without")[2])


def test_adding_to_a_result_that_was_not_diagnosed_says_so_and_what_to_do(result):
    (result / "diagnosis.json").unlink(missing_ok=True)
    with pytest.raises(InputError, match=r"the result was not diagnosed") as caught:
        imubayes.add(result)
    assert "imubayes diagnose" in caught.value.issues[0].remedy


@pytest.mark.parametrize(
    "made", [None, imubayes.ReportSection(title="x", head=("a", "b"), rows=(("1",),))], ids=["nothing", "narrow rows"]
)
def test_what_is_no_section_is_refused(result, made):
    with pytest.raises(InputError, match=r"rows that are not as wide|a NoneType"):
        imubayes.report(result, sections=[lambda _: made])


def test_the_quantities_of_the_standards_have_posteriors(result, tmp_path):
    _, record, page = written(result, tmp_path)
    symbols = {each.symbol: each for each in record.standards}
    for symbol in ("K_0", "K_1", "K_2"):
        if symbol in symbols:
            assert symbols[symbol].standard_uncertainty
            low, middle, high = (getattr(symbols[symbol], end) for end in ("low", "estimate", "high"))
            assert low < middle < high
    assert "K_0" in symbols
    missing = {each.symbol: each for each in record.not_estimated}
    assert set(missing) & {"K_oo", "K_pp", "K_ip"}
    # The injected current, whose gain nobody knows, says next to nothing of the scale factor.
    assert "K_1" not in symbols
    assert (missing["K_1"].reason, missing["K_1"].labels) == ("not_measured", ("ax",))
    assert missing["K_1"].from_data is not None
    assert missing["K_1"].from_data < 0.1
    assert "not measured" in visible(page)
    assert symbols["K_0"].d_si is not None
    assert symbols["K_0"].d_si.unit == r"\metre\per\second\tothe{2}"
    assert symbols["K_0"].d_si.factor == pytest.approx(record.subject.gravity_m_s2 * 1e-6)
    assert all(angle.estimate is not None for angle in record.mounting_angles)
    assert all(each.within is not None for each in record.thermal_linearity)
    assert record.provenance.data_sha256 in re.sub(r"\s", "", visible(page))


def test_every_quantity_has_a_budget_that_adds_up(result, tmp_path):
    _, record, page = written(result, tmp_path)
    assert record.budgets is not None
    budgets = {each.name: each for each in record.budgets.quantities}
    assert {line.name for line in record.results if line.kind == "derived" and line.monte_carlo} <= set(budgets)
    for each in budgets.values():
        lines = sum(line.contribution**2 for line in each.lines)
        assert lines == pytest.approx(each.contributed**2, rel=1e-9)
        assert lines + each.remainder * each.standard_uncertainty**2 == pytest.approx(each.standard_uncertainty**2)
        assert abs(each.remainder) < 0.02, each.name
        assert sum(line.share for line in each.lines) == pytest.approx(1 - each.remainder)
        for line in each.lines:
            if line.sensitivity is not None:
                assert line.input_uncertainty is not None
                assert abs(line.sensitivity) * line.input_uncertainty == pytest.approx(line.contribution)
    bias = budgets["accel_bias.bias[ax]"]
    assert bias.coverage_factor * bias.standard_uncertainty == pytest.approx(bias.expanded_uncertainty)
    assert {line.type for line in bias.lines} >= {"A", "B"}
    assert bias.halved[0].standard_uncertainty < bias.standard_uncertainty
    matrix = record.budgets.correlation
    assert [len(row) for row in matrix.rows] == list(range(1, len(budgets) + 1))
    assert all(row[-1] == 1.0 for row in matrix.rows)
    said = visible(page)
    assert "Uncertainty budgets" in said
    assert "Improve first" in said
    assert f"{100 * bias.lines[0].share:.1f} %" in said


def test_a_report_of_a_fit_evaluates_no_model(result, tmp_path, monkeypatch, capsys):
    """A sampled fit, which has the model compiled, keeps the budgets: its first report is as quick as the next."""
    report_budgets.keep_budgets(read_result(result))

    def refused(*_):
        raise AssertionError("the model is evaluated")

    for module, name in (
        (uncertainty_budget, "budget_of"),
        (report_budgets, "expected_deviations"),
        (derived_quantities, "_derive_batch"),
    ):
        monkeypatch.setattr(module, name, refused)
    _, record, _ = written(result, tmp_path)
    assert record.budgets is not None
    (result / "budgets.json").unlink()
    again = tmp_path / "again.json"
    run(["report", str(result), "--out", str(again)])
    assert "the model is evaluated" in capsys.readouterr().err
    assert not again.exists()


@pytest.mark.slow
def test_budgets_that_are_kept_are_those_of_the_result(result, tmp_path):
    file = result / "budgets.json"
    _, first, _ = written(result, tmp_path)
    kept = json.loads(file.read_text())
    kept["budgets"]["quantities"] = kept["budgets"]["quantities"][:1]
    file.write_text(json.dumps(kept))
    listed(result)
    again = written(result, tmp_path)[1].budgets
    assert again is not None
    assert len(again.quantities) == 1, "what is kept is not computed again"
    file.write_text(json.dumps(kept | {"method": 0}))
    listed(result)
    assert written(result, tmp_path)[1] == first
    file.write_text(json.dumps(kept))  # of another result, by its manifest
    assert written(result, tmp_path)[1] == first


def test_a_result_that_was_never_diagnosed_cannot_pass(result, tmp_path):
    status, record, page = written(result, tmp_path, "--spec", specification(tmp_path))
    assert status == 1
    assert record.conformity is not None
    assert record.conformity.outcome == "withheld"
    assert "never diagnosed" in visible(page)[:1500]


@pytest.mark.parametrize("verdict", ["missing_effect", "unexplained_structure", "noise_model"])
def test_an_inadequate_model_cannot_pass(result, tmp_path, verdict):
    judged(result, verdict)
    status, record, page = written(result, tmp_path, "--spec", specification(tmp_path))
    assert record.conformity is not None
    assert (status, record.conformity.outcome) == (1, "withheld")
    assert {(limit.outcome, limit.withheld) for limit in record.conformity.limits} == {("withheld", "obstacle")}
    assert "The model is inadequate" in visible(page)[:1500]


def test_the_probabilities_of_the_diagnosis_stand_in_the_record_and_on_the_page(result, tmp_path):
    write_diagnosis(result, diagnosis())
    _, record, page = written(result, tmp_path)
    assert record.adequacy.explanations is not None
    assert record.adequacy.explanations.of("effects").probability == 0.998
    assert record.adequacy.missing == (ASYMMETRY, QUADRATIC)
    shares = f"({ASYMMETRY} or {QUADRATIC} on gx, shares 0.54, 0.46)"
    assert f"Probability: an effect missing 0.998 {shares}" in visible(page)


def test_a_fit_that_did_not_converge_says_so_and_cannot_pass(result, tmp_path):
    judged(result, "adequate")
    file = result / "summary.json"
    summary = json.loads(file.read_text())
    for line in (*summary["parameters"], *summary["derived"]):
        line |= dict.fromkeys(("mean", "sd", "q025", "q975", "from_data"))
    file.write_text(json.dumps(summary | {"converged": False, "message": "The gradient did not vanish.", "chi2": None}))
    listed(result)
    status, record, page = written(result, tmp_path, "--spec", specification(tmp_path))
    assert (status, record.accepted) == (1, False)
    assert record.conformity is not None
    assert record.conformity.obstacles == ("not_converged",)
    assert "The fit did not converge" in visible(page)[:1500]
    assert "The gradient did not vanish." in visible(page)[:1500]
    assert "None is stated: the fit did not converge." in visible(page)
    assert record.not_estimated == ()
    assert run(["report", str(result), "--out", str(tmp_path / "plain.json")]) == 1


def test_a_unit_outside_its_limits_fails(result, tmp_path):
    judged(result, "adequate")
    narrow = '[[limit]]\nquantity = "accel_bias.bias"\nlower = 1\nupper = 2\nunit = "ug"\n'
    status, record, page = written(result, tmp_path, "--spec", specification(tmp_path, narrow))
    assert record.conformity is not None
    assert (status, record.conformity.outcome) == (1, "fail")
    assert " FAIL " in visible(page)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('[[limit]]\nquantity = "accel_biass.bias"\nupper = 1\nunit = "ug"\n', "no quantity 'accel_biass.bias'"),
        ('[[limit]]\nquantity = "accel_bias.bias"\nlower = 2\nupper = 1\nunit = "ug"\n', "crossed"),
        ('[[limit]]\nquantity = "accel_bias.bias"\nupper = 1\nunit = "deg/h"\n', "unit 'deg/h'"),
        (
            '[[limit]]\nquantity = "accel_bias.bias"\nupper = 1\nunit = "ug"\ntemperature_degC = [-90, 55]\n',
            "there are no data",
        ),
    ],
)
def test_a_specification_that_cannot_be_used_is_refused_in_four_parts(result, tmp_path, capsys, text, what):
    out = tmp_path / "report.html"
    assert run(["report", str(result), "--spec", specification(tmp_path, text), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert what in said
    assert "spec.toml:" in said
    # A slow machine says how it gets on, "evaluating the posterior · 1 s".
    assert len([line for line in said.strip().splitlines() if not re.fullmatch(r".* · \d+ s", line)]) == 4
    assert not out.exists()


def test_the_pdf_has_the_record_attached_and_is_the_same_every_time(result, tmp_path):
    pytest.importorskip("typst", reason="typst is not installed")
    judged(result, "adequate")
    once, again = tmp_path / "once.pdf", tmp_path / "again.pdf"
    for file in (once, again):
        assert run(["report", str(result), "--spec", specification(tmp_path), "--out", str(file)]) == 0
    assert once.read_bytes() == again.read_bytes()
    assert once.read_bytes().startswith(b"%PDF-1.7")
    for mark in (b"/AFRelationship/Data", b"report.json", b"pdfaid:part>3<"):
        assert mark in once.read_bytes().replace(b" /", b"/").replace(b"AFRelationship /", b"AFRelationship/"), mark


CERTIFICATE = """
format = 1

[certificate]
number = "2026-0117"
date = 2026-11-20

accreditation = "Accredited as D-K"

[certificate.laboratory]
name = "Example Laboratory"

[[certificate.standard]]
name = "dividing head"
valid_until = 2026-01-01
"""


def pages(file: Path) -> int:
    return max(int(count) for count in re.findall(rb"/Count (\d+)", file.read_bytes()))


@pytest.mark.slow
def test_a_certificate_has_two_pages_its_date_and_what_is_missing(result, tmp_path):
    pytest.importorskip("typst", reason="typst is not installed")
    judged(result, "adequate")
    (tmp_path / "certificate.toml").write_text(CERTIFICATE)
    common = [
        "report",
        str(result),
        "--spec",
        specification(tmp_path),
        "--certificate",
        str(tmp_path / "certificate.toml"),
    ]
    sizes = {}
    for annex in ("none", "results", "all"):
        file = tmp_path / f"{annex}.pdf"
        assert run([*common, "--annex", annex, "--out", str(file)]) == 1, "a standard had expired"
        sizes[annex] = pages(file)
        assert b"/CreationDate(D:20261120000000Z)" in file.read_bytes()
    assert sizes["none"] <= 2
    assert sizes["none"] < sizes["results"] < sizes["all"]
    status, record, page = written(result, tmp_path, *common[2:], "--annex", "none")
    assert status == 1
    said = visible(page)
    for text in ("Calibration certificate 2026-0117", "Example Laboratory", "Missing from this certificate"):
        assert text in said
    assert "Uncertainty budgets" not in said
    missing = sum(each.required for each in record.missing)
    assert {each.item for each in record.missing} >= {"method", "signatories", "customer_name", "expired"}
    first, _, rest = said.partition("Limits of the specification")
    assert f"ISO/IEC 17025 requires {missing} more items" in first
    assert "2026-01-01: expired" in rest
    assert "Accredited as D-K" not in said
    assert b"<rdf:li>Example Laboratory</rdf:li>" in (tmp_path / "all.pdf").read_bytes(), "the author of a certificate"
    assert f"1 g = {record.subject.gravity_m_s2:.6f} m/s²" in said
    assert record.budgets is not None, "the record has everything"


def test_no_accreditation_on_a_result_that_was_never_diagnosed(result, tmp_path):
    (tmp_path / "certificate.toml").write_text(CERTIFICATE)
    given = ("--certificate", str(tmp_path / "certificate.toml"))
    _, record, page = written(result, tmp_path, *given)
    assert "validity" in {each.item for each in record.missing}
    assert "no diagnosis found its model adequate" in visible(page)
    judged(result, "adequate")
    assert "validity" not in {each.item for each in written(result, tmp_path, *given)[1].missing}


def test_what_a_format_lacks_is_told_before_any_file_is_written(result, tmp_path):
    """A DCC needs a certificate block."""
    judged(result, "adequate")
    files = [str(tmp_path / name) for name in ("r.json", "r.html", "r.xml")]
    assert run(["report", str(result), "--spec", specification(tmp_path), "--out", *files]) == 2
    assert not list(tmp_path.glob("r.*"))


def test_an_unknown_annex_is_refused(result, tmp_path):
    with pytest.raises(InputError, match="no annex 'budget'"):
        imubayes.report(result, annexes=["budget"], out=[tmp_path / "x.html"])


def test_annexes_and_certificate_are_checked_before_anything_is_computed(result, tmp_path, monkeypatch):
    def computed(_: Result) -> None:
        raise AssertionError("the budgets are computed")

    monkeypatch.setattr(report_build, "unit_with_budgets", computed)
    file = tmp_path / "certificate.toml"
    file.write_text("format = 1\n")
    with pytest.raises(InputError, match="no annex 'budget'"):
        imubayes.report(result, annexes=["budget"], out=[tmp_path / "x.html"])
    with pytest.raises(InputError, match="no 'certificate'"):
        imubayes.report(result, certificate=file)


def test_an_unknown_ending_is_refused_before_anything_is_computed(result, tmp_path, capsys):
    assert run(["report", str(result), "--out", str(tmp_path / "report.doc")]) == 2
    assert ".html" in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_the_page_asks_for_nothing_and_says_nothing_on_the_console(result, tmp_path):
    judged(result, "adequate")
    _, _, page = written(result, tmp_path, "--spec", specification(tmp_path))
    assert browser_log(tmp_path, page) == []
    planted = page.replace(
        "</body>", '<img src="http://images.invalid/x.png"><script>console.error("planted")</script></body>'
    )
    assert len(browser_log(tmp_path, planted)) >= 2


@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_no_page_of_a_phone_scrolls_sideways(result, tmp_path):
    judged(result, "adequate")
    _, _, page = written(result, tmp_path, "--spec", specification(tmp_path))
    assert width_on_phone(tmp_path, page) == 390
    assert width_on_phone(tmp_path, page.replace("</main>", '<p style="width: 600px">planted</p></main>')) > 390


def test_a_page_is_read_in_both_themes_and_printed_on_white():
    """Every ink has a contrast of 4.5 on its ground, in the light theme and in the dark one, which no print has."""
    source = Path(qualification.__file__).parent / "display" / "templates" / "qualification.html.j2"
    themes = re.findall(r"(@media [^{]*)?\{?\s*:root \{([^}]*)\}", source.read_text())
    assert [media.split("(")[-1].strip(" )") for media, _ in themes] == ["", "prefers-color-scheme: dark"]
    assert "screen" in themes[1][0]
    for _, declared in themes:
        colours = dict(re.findall(r"--([\w-]+): (#\w+);", declared))
        pairs = [(ink, "page") for ink in ("ink", "quiet", "good", "weak", "bad", "link")]
        pairs += [(ink, f"{mood}-ground") for mood in ("good", "weak", "bad") for ink in ("ink", mood)]
        assert min(contrast(colours[ink], colours[ground]) for ink, ground in pairs) >= 4.5


def width_on_phone(folder: Path, page: str) -> int:
    """Return the width of a page in a frame of 390 px, as Chromium lays it out."""
    (folder / "page.html").write_text(page)
    frame = '<iframe id="f" src="page.html" style="border: 0; width: 390px; height: 800px"></iframe><output></output>'
    measure = 'document.querySelector("output").textContent = f.contentDocument.documentElement.scrollWidth'
    (folder / "phone.html").write_text(f"<!doctype html>{frame}<script>f.onload = () => {{ {measure} }}</script>")
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files"]
    command += ["--hide-scrollbars", "--virtual-time-budget=5000", "--dump-dom", f"file://{folder / 'phone.html'}"]
    said = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    found = re.search(r"<output>(\d+)</output>", said)
    assert found is not None, said[-300:]
    return int(found[1])


def browser_log(folder: Path, page: str) -> list[str]:
    """Return console messages and requests beyond those of an empty page, from Chromium's log of the network."""
    console, asked = browsed(folder, page)
    return console + sorted(asked - browsers_own())


@cache
def browsers_own() -> set[str]:
    """Return the hosts that Chromium asks with an empty page."""
    with tempfile.TemporaryDirectory() as folder:
        return browsed(Path(folder), "<!doctype html>")[1]


def browsed(folder: Path, page: str) -> tuple[list[str], set[str]]:
    """Return console messages and hosts asked, the browser's own among them."""
    file, log = folder / "page.html", folder / "net.json"
    file.write_text(page)
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--v=0"]
    command += ["--disable-background-networking", "--disable-component-update", f"--log-net-log={log}", "--dump-dom"]
    said = subprocess.run([*command, f"file://{file}"], capture_output=True, text=True, timeout=60, check=False).stderr
    console = [line for line in said.splitlines() if "CONSOLE" in line]
    return console, set(re.findall(r'"url":"https?://([^/"]*)', log.read_text()))


def test_an_upper_limit_below_every_possible_value_is_unusable_input(result, capsys):
    text = '[[limit]]\nquantity = "white_noise.sigma"\nupper = -1\nunit = "output"\n'
    out = result.parent / "negative.json"
    assert run(["report", str(result), "--spec", specification(result.parent, text), "--out", str(out)]) == 2
    assert "cannot be negative" in capsys.readouterr().err
    assert not out.exists()

"""The certificate block: what a laboratory states is on the pages, what ISO/IEC 17025 asks beside it is listed."""

import bisect
import datetime
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from imubayes.display.layout import Cell, Sheet
from imubayes.foundations.campaign_data import Campaign, Channel, Run, SetAside, Site
from imubayes.foundations.earth import normal_gravity
from imubayes.foundations.errors import InputError
from imubayes.results.posterior_quantities import PosteriorQuantities
from imubayes.results.summary import Quantity
from imubayes.results.temperature_range import ThermalModel
from imubayes_qualification.budgets.budget_parts import QuantityBudget, UncertaintyBudgets
from imubayes_qualification.budgets.report_budgets import UnitWithBudgets
from imubayes_qualification.budgets.taken_as_exact import TakenAsExact
from imubayes_qualification.budgets.unit_under_test import TestedUnit
from imubayes_qualification.certificate.capability import with_capability
from imubayes_qualification.certificate.certificate import (
    REQUIRED,
    Certificate,
    Missing,
    MissingItem,
    is_placeholder,
    missing_items,
    read_certificate,
)
from imubayes_qualification.certificate.report_record import (
    Adequacy,
    QualificationReport,
    ReportedConvergence,
    StatisticalScope,
)
from imubayes_qualification.certificate.report_subject import Provenance, Subject
from imubayes_qualification.certificate.specification import read_specification
from imubayes_qualification.display.report.certificate_pages import (
    certificate_facts,
    certificate_section,
    missing_section,
    statements,
)
from imubayes_qualification.display.report.document import (
    Banner,
    Block,
    Drawing,
    Drawings,
    Heading,
    Items,
    Paragraph,
    ReportDocument,
    typeset,
    without_empty_columns,
)
from imubayes_qualification.display.report.first_page import alarms
from imubayes_qualification.display.report.pdf_file import (
    _blocks,
    _content,
    _members,
    breakable,
    missing_characters,
    shown_by_code_points,
)
from imubayes_qualification.display.report.report_files import html_page
from small_campaign import channels

TEMPLATE = files("imubayes_qualification.display").joinpath("templates/qualification.typ")

WHOLE = """
format = 1

[certificate]
number = "2026-0117"
date = 2026-11-20
method = "WI-12"
location = "laboratory 2"

[certificate.laboratory]
name = "Example Laboratory"
address = "Street 1, 12345 Example Town"

[certificate.customer]
name = "Customer"
address = "Street 2, 12345 Example Town"

[certificate.item]
description = "inertial measurement unit"
received = 2026-10-28

[[certificate.standard]]
name = "rate table"
equipment = ["rate"]
certificate = "NMI 2026-0815"
valid_until = 2027-11-02

[certificate.environment]
temperature_degC = [22.6, 23.4]

[[certificate.signatory]]
name = "A. Example"
"""
TABLE = WHOLE[WHOLE.index("[[certificate.standard]]") : WHOLE.index("[certificate.environment]")]
RUNS = ("2026-11-01T08:00:00+00:00", "2026-11-04T08:00:00+00:00")


def written(folder: Path, text: str) -> Path:
    file = folder / "certificate.toml"
    file.write_text(text, encoding="utf-8")
    return file


def campaign_of(serial: str = "U7", runs: Sequence[str | None] = RUNS, tables: Sequence[str] = ("rate",)) -> Campaign:
    """A campaign of runs on tables, of which the names and the dates matter; the last one has no table."""
    site = Site(latitude=0.8, height=500.0, gravity=9.81)
    made = [
        Run(f"r{place}", "static_record" if not table else "rate_table", table or None, None, {}, np.zeros((1, 1)),
            np.ones(1), np.zeros((1, 1)), start)
        for place, (start, table) in enumerate(zip(runs, (*tables, ""), strict=False))
    ]  # fmt: skip
    return Campaign("c", site, (), {}, {}, tuple(made), serial)


def digital(unit: str = "LSB") -> tuple[Channel, ...]:
    """Channels of which the unit itself gives the numbers, or with another unit of the outputs."""
    return tuple(replace(each, output_unit=unit) for each in channels())


def lacking(block: Certificate, campaign: Campaign | None = None) -> set[tuple[str, str]]:
    return {(each.item, each.of) for each in missing_items(block, campaign or campaign_of())}


def test_a_whole_certificate_lacks_nothing(tmp_path):
    block, _ = read_certificate(written(tmp_path, WHOLE))
    assert block.date == datetime.date(2026, 11, 20)
    assert lacking(block) == set()
    assert list(missing_section(missing_items(block, campaign_of()))) == []
    # The same block in a specification.
    limits = '\n[[limit]]\nquantity = "accel_bias.bias"\nupper = 1\nunit = "mg"\n'
    spec = tmp_path / "spec.toml"
    spec.write_text(WHOLE.replace("format = 1", 'format = 1\nname = "x"') + limits)
    assert read_specification(spec)[0].certificate == block


@pytest.mark.parametrize(
    ("line", "item"),
    [
        ('number = "2026-0117"', "number"), ("date = 2026-11-20", "date"), ('method = "WI-12"', "method"),
        ('location = "laboratory 2"', "location"), ('name = "Example Laboratory"', "laboratory_name"),
        ('address = "Street 1, 12345 Example Town"', "laboratory_address"), ('name = "Customer"', "customer_name"),
        ('address = "Street 2, 12345 Example Town"', "customer_address"),
        ('description = "inertial measurement unit"', "item_description"), ("received = 2026-10-28", "received"),
        ('certificate = "NMI 2026-0815"', "standard_certificate"), ("valid_until = 2027-11-02", "standard_validity"),
        ("temperature_degC = [22.6, 23.4]", "environment"),
    ],
)  # fmt: skip
def test_what_is_not_stated_is_missing_on_the_last_page(tmp_path, line, item):
    assert line in WHOLE
    block, _ = read_certificate(written(tmp_path, WHOLE.replace(line, "", 1)))
    assert {name for name, _ in lacking(block)} == {item}
    *_, items = missing_section(missing_items(block, campaign_of()))
    assert isinstance(items, Items)
    assert len(items.items) == 1
    # 7.8 asks for no number and no date of a standard's certificate.
    assert ("(7.8." in items.items[0]) == (item in REQUIRED) == (not item.startswith("standard_"))


def test_requires_stands_beside_what_the_standard_requires_alone():
    """Contradictions, capabilities and dates of standards are no content that ISO/IEC 17025, 7.8, asks for."""
    items: tuple[MissingItem, ...] = get_args(MissingItem)
    blocks = list(missing_section([Missing(item=item, of="x") for item in items]))
    first, required, second, others = (
        block.text if isinstance(block, Heading) else block for block in blocks if not isinstance(block, Paragraph)
    )
    assert (first, second) == ("Missing from this certificate", "Not in order")
    assert isinstance(required, Items)
    assert isinstance(others, Items)
    assert all("(7.8." in text for text in required.items)
    assert not any("7.8" in text for text in others.items)
    assert len(required.items) == len(REQUIRED)
    assert len(required.items) + len(others.items) == len(items)
    said = [alarm for alarm in alarms(_report(Missing(item="cmc"), Missing(item="date"))) if "requires" in alarm]
    assert said == [
        "No certificate of an accredited laboratory: ISO/IEC 17025 requires 1 more item, listed at the end."
    ]
    assert alarms(_report(Missing(item="cmc"))) == ["Not in order: 1 item, listed at the end."]


def _report(*missing: Missing) -> QualificationReport:
    return QualificationReport.model_construct(
        convergence=ReportedConvergence.model_construct(converged=True), missing=missing, certificate=Certificate(),
        adequacy=Adequacy.model_construct(verdict="adequate", intervals_valid=True, prior_conflicts=()),
        conformity=None, standards=(), floors=(), unused_capabilities=(), subject=_SUBJECT, exact=TakenAsExact(),
        provenance=Provenance.model_construct(effects=()),
        scope=StatisticalScope.model_construct(first_start=None, last_start=None),
    )  # fmt: skip


def test_readings_that_the_model_leaves_out_are_stated_first():
    whole = _report()
    left = SetAside(run="hot", rows=(3, 4), reason="the door was open")
    found = whole.model_copy(update={"adequacy": whole.adequacy.model_copy(update={"set_aside": (left,)})})
    assert alarms(found)[0] == "Readings of hot are set aside: see model adequacy."
    assert not any("set aside" in alarm for alarm in alarms(whole))


_SUBJECT = Subject.model_construct(
    serial="U7", campaign="c", latitude_deg=34.0, height_m=400.0, gravity_m_s2=9.8, gravity_is_normal=False,
    gravity_uncertainty_ug=None,
)  # fmt: skip


def test_signatures_stand_on_no_page_alone(tmp_path):
    """However long what stands before them is: on paper, the last statements are with them."""
    typst = pytest.importorskip("typst", reason="typst is not installed")
    block, _ = read_certificate(written(tmp_path, WHOLE))
    template = TEMPLATE.read_text(encoding="utf-8")
    (tmp_path / "main.typ").write_text(template, encoding="utf-8")
    (tmp_path / "report.json").write_text("{}", encoding="utf-8")
    certified = list(certificate_section(_report().model_copy(update={"certificate": block})))
    assert [each.kept for each in certified if isinstance(each, Paragraph)][-3:] == [False, True, True]

    def pages(lines: int, blocks: Sequence[Block]) -> list[bytes]:
        document = ReportDocument("t", "s", Banner("", "", ""), (), (), (*[Paragraph("x")] * lines, *blocks))
        content = _content(document, None) | {"families": []}
        (tmp_path / "document.json").write_text(json.dumps(content, default=_members), encoding="utf-8")
        made = typst.compile(str(tmp_path / "main.typ"), root=str(tmp_path), format="svg", ignore_system_fonts=True)
        return made if isinstance(made, list) else [made]

    alone = [replace(each, kept=False) if isinstance(each, Paragraph) else each for each in certified]
    # The first number of lines with which the signatures have no room on the first page.
    full = bisect.bisect_left(range(40), True, key=lambda lines: len(pages(lines, alone)) > 1)
    letters = [pages(full, blocks)[-1].count(b"<use") for blocks in (alone, certified)]
    assert letters[1] > letters[0] + 300, "the last statements go with the signatures"


OTHERS = """
customer_data = "limits of the specification"
sampling = "one of a lot of 20, drawn by the customer"

[certificate.amendment]
of = "2026-0101"
changes = "serial number"
reason = "misread"

[[certificate.external]]
provider = "Centrifuge Laboratory"
results = "runs c1 to c4"
"""


def test_a_reissue_results_of_others_data_of_the_customer_and_sampling_are_stated(tmp_path):
    """ISO/IEC 17025, 7.8.8, 7.8.2.1 p and k, 7.8.2.2."""
    text = WHOLE.replace("\n[certificate.laboratory]", OTHERS + "\n[certificate.laboratory]", 1)
    block, _ = read_certificate(written(tmp_path, text))
    said = "\n".join(statements(_report(), block))
    for part in (
        "Replaces certificate 2026-0101. Changed: serial number; reason: misread.",
        "Results of an external provider, Centrifuge Laboratory: runs c1 to c4.",
        "Provided by the customer: limits of the specification. The laboratory is not responsible for this",
        "Sampling: one of a lot of 20",
    ):
        assert part in said
    assert dict(certificate_facts(_report(), block))["Amendment"].startswith("Replaces certificate 2026-0101")
    part = read_certificate(written(tmp_path, text.replace('reason = "misread"', "replaces = false")))[0]
    assert "Amendment to certificate 2026-0101. Changed: serial number." in "\n".join(statements(_report(), part))
    with pytest.raises(InputError, match=r"a number of its own"):
        read_certificate(written(tmp_path, text.replace('of = "2026-0101"', 'of = "2026-0117"')))


def test_serial_and_dates_are_of_the_campaign(tmp_path):
    block, _ = read_certificate(written(tmp_path, WHOLE))
    assert lacking(block, campaign_of(serial="", runs=(None, None))) == {("serial", ""), ("performed", "")}
    nothing = {name for name, _ in lacking(Certificate())}
    assert {"standards", "signatories", "number", "environment"} <= nothing
    # Dates in an impossible order.
    late, _ = read_certificate(written(tmp_path, WHOLE.replace("2026-10-28", "2026-11-02")))
    early, _ = read_certificate(written(tmp_path, WHOLE.replace("date = 2026-11-20", "date = 2026-11-03")))
    assert lacking(late) == {("received_late", "")}
    assert lacking(early) == {("issued_early", "")}


def test_standards_are_held_against_the_equipment_of_the_runs(tmp_path):
    def of(text: str, **campaign) -> set[tuple[str, str]]:
        return lacking(read_certificate(written(tmp_path, WHOLE.replace(TABLE, text)))[0], campaign_of(**campaign))

    assert TABLE in WHOLE
    # The table was used on the first day alone: it may expire on the next.
    assert of(TABLE.replace("2027-11-02", "2026-11-02")) == set()
    assert of(TABLE.replace("2027-11-02", "2026-10-31")) == {("expired", "rate table")}
    # A standard of all runs, of no equipment by name, is asked for at the last run.
    other = TABLE.replace('equipment = ["rate"]', 'serial = "2"').replace("2027-11-02", "2026-11-03")
    assert of(TABLE + other) == {("expired", "rate table")}
    assert of(other) == {("expired", "rate table"), ("untraced", "rate")}
    # Named as the table is, it needs no list.
    assert of(TABLE.replace('equipment = ["rate"]', "").replace('"rate table"', '"rate"')) == set()
    assert of(TABLE, tables=("rate", "head")) == {("untraced", "head")}
    assert of(TABLE.replace('["rate"]', '["rate", "head", "gravity"]')) == {("unused", "rate table: head")}
    *_, items = missing_section([Missing(item="untraced", of="head"), Missing(item="unused", of="rate table: head")])
    assert isinstance(items, Items)
    assert "rate table: head" in items.items[0]
    *_, items = missing_section([Missing(item="untraced", of="head")])
    assert isinstance(items, Items)
    assert "head, which runs used" in items.items[0]


def test_gravity_by_its_formula_is_claimed_by_no_standard(tmp_path):
    """A campaign without gravity_m_s2 takes normal gravity, whatever certificate of gravity a laboratory has."""
    gravity = '\n[[certificate.standard]]\nname = "gravity"\nequipment = ["gravity"]\ncertificate = "G-12"\n'
    gravity += "valid_until = 2027-11-02\n"
    block, _ = read_certificate(written(tmp_path, WHOLE + gravity))
    measured = replace(campaign_of(), channels=digital())
    assert lacking(block, measured) == set()
    formula = replace(measured, site=replace(measured.site, gravity=normal_gravity(0.8, 500.0)))
    assert lacking(block, formula) == {("normal_gravity", ""), ("unused", "gravity: gravity")}
    # A standard whose name alone claims it.
    named, _ = read_certificate(written(tmp_path, (WHOLE + gravity).replace('equipment = ["gravity"]\n', "")))
    assert lacking(named, formula) == lacking(block, formula)
    # Gyros alone have no result that gravity enters.
    assert lacking(read_certificate(written(tmp_path, WHOLE))[0], replace(formula, channels=digital()[:1])) == set()


def test_what_is_read_beside_the_outputs_needs_its_standard(tmp_path):
    """Coefficients per °C are certified: the thermometer is equipment, if an effect of the model reads it."""
    block, _ = read_certificate(written(tmp_path, WHOLE))
    campaign = campaign_of()
    covariates = {"temperature": np.zeros(1), "time": np.zeros(1)}
    campaign = replace(campaign, runs=tuple(replace(run, covariates=covariates) for run in campaign.runs))

    def of(found: Certificate, *read: str) -> set[tuple[str, str]]:
        return {(each.item, each.of) for each in missing_items(found, campaign, read)}

    assert of(block) == set()
    assert of(block, "temperature_rate", "turning", "converter_temperature") == {("untraced", "temperature")}
    assert of(block, "temperature", "campaign_time") == {("untraced", "temperature"), ("untraced", "time")}
    both = 'equipment = ["rate", "temperature"]'
    traced, _ = read_certificate(written(tmp_path, WHOLE.replace('equipment = ["rate"]', both)))
    assert of(traced, "temperature") == set()
    assert of(traced) == set(), "read by no effect, and yet recorded"
    other = WHOLE.replace('equipment = ["rate"]', 'equipment = ["rate", "converter_temperature"]')
    assert of(read_certificate(written(tmp_path, other))[0]) == {("unused", "rate table: converter_temperature")}
    assert of(read_certificate(written(tmp_path, WHOLE.replace("2027-11-02", "2026-11-02")))[0], "temperature") == {
        ("untraced", "temperature")
    }


def test_a_thermometer_with_a_name_is_traced_by_it(tmp_path):
    campaign = campaign_of()
    first, *others = (replace(run, covariates={"temperature": np.zeros(1)}) for run in campaign.runs)
    campaign = replace(campaign, runs=(replace(first, thermometer="Pt 7"), *others))
    named = WHOLE.replace('equipment = ["rate"]', 'equipment = ["rate", "Pt 7"]')
    for runs, text, missing in (
        (campaign.runs[:1], named, set()),
        (campaign.runs[:1], WHOLE, {("untraced", "Pt 7")}),
        (campaign.runs[:1], WHOLE.replace('equipment = ["rate"]', 'equipment = ["rate", "temperature"]'),
         {("untraced", "Pt 7"), ("unused", "rate table: temperature")}),
        (campaign.runs, named, {("untraced", "temperature")}),
    ):  # fmt: skip
        block, _ = read_certificate(written(tmp_path, text))
        found = missing_items(block, replace(campaign, runs=runs), ("temperature",))
        assert {(each.item, each.of) for each in found} == missing


def test_accelerometers_need_a_traced_gravity_and_an_accreditation_its_capabilities(tmp_path):
    block, _ = read_certificate(written(tmp_path, WHOLE))
    accelerometers = replace(campaign_of(), channels=digital())
    assert {channel.kind for channel in accelerometers.channels} == {"gyro", "accelerometer"}
    assert lacking(block, accelerometers) == {("untraced", "gravity")}
    gravity = 'equipment = ["rate", "gravity"]'
    traced, _ = read_certificate(written(tmp_path, WHOLE.replace('equipment = ["rate"]', gravity)))
    assert lacking(traced, accelerometers) == set()
    accredited, _ = read_certificate(written(tmp_path, WHOLE.replace("number =", 'accreditation = "D-K"\nnumber =')))
    assert lacking(accredited) == {("cmc", "")}


def test_one_quantity_has_one_capability_under_both_of_its_names(tmp_path):
    """30 ppm of the error of a scale factor of 1000 are 0.03 of the scale factor; k stays."""
    entry = '[[certificate.cmc]]\nquantity = "gyro_scale_factor.scale"\nexpanded = 30\nunit = "ppm"\n'
    block, ledger = read_certificate(written(tmp_path, WHOLE + entry))
    error = 3.0 * np.random.default_rng(4).standard_normal(4000)
    own, other, angle = "gyro_scale_factor.scale[gx]", "scale_factor[gx]", "gyro_bias.bias[gx]"
    draws = {own: error, other: 1000 * (1 + 1e-6 * error), angle: error + 0.1 * error[::-1]}
    units = {own: "ppm", other: "pulse/s per deg/s", angle: "deg/h"}
    entries = {
        name: Quantity(name=name, unit=units[name], mean=x.mean(), sd=x.std(), from_data=0.99)
        for name, x in draws.items()
    }
    known = PosteriorQuantities(entries, draws, dict.fromkeys(draws, 4000.0))
    unit = TestedUnit(known, channels()[:1], {}, 9.8, None, ThermalModel({}, {}, 25.0))
    budgets = UncertaintyBudgets.model_construct(
        quantities=tuple(
            QuantityBudget.model_construct(
                name=name, standard_uncertainty=x.std(), monte_carlo_error=0.0, lines=(), contributed=x.std(),
                remainder=0.0, coverage_factor=1.96, interval="symmetric", expanded_uncertainty=1.96 * x.std(),
            )
            for name, x in draws.items()
        )
    )  # fmt: skip
    made, applied = with_capability(UnitWithBudgets(unit, budgets, TakenAsExact()), block.cmc, ledger)
    assert {each.name: each.expanded for each in applied.floors} == pytest.approx({own: 30, other: 0.03})
    assert made.unit.coverage(other).expanded == pytest.approx(0.03)
    assert made.unit.coverage(angle).expanded == unit.coverage(angle).expanded
    error_budget, _, bias_budget = made.budgets.quantities
    assert error_budget.expanded_uncertainty == pytest.approx(30, rel=1e-3)
    assert made.unit.coverage(own).factor == unit.coverage(own).factor
    assert bias_budget == budgets.quantities[2]


def test_a_laboratory_has_one_list_of_capabilities_for_all_its_units(tmp_path):
    """Quantities that other units have are unused; a name that no unit has is a mistake."""
    entry = '[[certificate.cmc]]\nquantity = "{}"\nexpanded = 30\nunit = "{}"\n'
    names = (("gyro_bias.bias", "deg/h"), ("converter_gain_drift.slope", "ppm/degC"), ("scale_factor[g7]", "1"))
    block, ledger = read_certificate(written(tmp_path, WHOLE + "".join(entry.format(*each) for each in names)))
    bias = 3.0 * np.random.default_rng(4).standard_normal(4000)
    name = "gyro_bias.bias[gx]"
    entries = {name: Quantity(name=name, unit="deg/h", mean=0.0, sd=3.0, from_data=0.99)}
    known = PosteriorQuantities(entries, {name: bias}, {name: 4000.0})
    unit = TestedUnit(known, channels()[:1], {}, 9.8, None, ThermalModel({}, {}, 25.0))
    found = UnitWithBudgets(unit, UncertaintyBudgets.model_construct(quantities=()), TakenAsExact())
    _, applied = with_capability(found, block.cmc, ledger)
    assert [each.name for each in applied.floors] == [name]
    assert applied.unused == ("converter_gain_drift.slope", "scale_factor[g7]")
    wrong, ledger = read_certificate(written(tmp_path, WHOLE + entry.format("converter_gain_drift.slop", "ppm/degC")))
    with pytest.raises(InputError, match=r"no quantity 'converter_gain_drift\.slop'"):
        with_capability(found, wrong.cmc, ledger)


def test_a_standard_that_is_listed_twice_and_a_number_of_two_issuers_are_named(tmp_path):
    def of(text: str) -> set[tuple[str, str]]:
        return lacking(read_certificate(written(tmp_path, WHOLE.replace(TABLE, text)))[0])

    issued = TABLE.replace("valid_until", 'issued_by = "NMI"\nvalid_until')
    assert of(TABLE + TABLE) == {("repeated_standard", "rate table")}
    other = TABLE.replace('name = "rate table"', 'name = "rate table"\nserial = "2"')
    assert of(TABLE + other) == set(), "two tables of one name, told apart by their serial numbers"
    second = issued.replace("rate table", "head").replace('NMI"', 'Maker"')
    assert of(issued + second) == {("shared_certificate", "NMI 2026-0815: NMI, Maker")}
    blank = second.replace("NMI 2026-0815", "nmi 2026-0815 ")
    assert blank != second
    assert of(issued + blank) == {("shared_certificate", "NMI 2026-0815: NMI, Maker")}
    assert of(issued + second.replace('"Maker"', '"nmi"')) == set()
    assert of(issued + issued.replace("rate table", "head")) == set(), "one certificate for two standards"
    *_, items = missing_section([Missing(item="repeated_standard", of="head")])
    assert isinstance(items, Items)
    assert items.items[0] == "one standard is listed more than once — head"


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (WHOLE.replace("number =", "nummer ="), "unknown key 'nummer'"),
        (WHOLE.replace("2026-11-20", '"next week"'), "date"),
        (WHOLE.replace("[22.6, 23.4]", "[23.4, 22.6]"), "the lowest comes first"),
        (WHOLE.replace('"WI-12"', '"  "'), "it is blank"),
        (WHOLE + '[[certificate.cmc]]\nquantity = "accel_bias.bias"\nexpanded = 0\nunit = "ug"\n', "expanded"),
        ("format = 1\n", "certificate"),
    ],
)
def test_a_block_that_cannot_be_read_is_refused(tmp_path, text, what):
    with pytest.raises(InputError) as caught:
        read_certificate(written(tmp_path, text))
    assert what in f"{caught.value.issues[0].what} {caught.value.issues[0].where}"


@pytest.mark.parametrize("number", ["67.245", "-0.00052 ± 0.00060", "≥ 0.99", "1,234.5", "1.2e-05", "12.5 … 13.25"])
def test_numbers_have_nothing_in_them(number):
    assert breakable(number) == number
    assert breakable(f"gyro_misalignment.toward_o[gz,flat] = {number}").endswith(f" = {number}")
    assert "\u200b" in breakable("gyro_misalignment.toward_o[gz,flat]")
    assert breakable("gx,gy") == "gx,gy"
    symbols = "guard band, w = 1.65 u, for D_F, K_oo and ΔK_1"
    assert breakable(symbols) == symbols


def test_figures_are_numbered_and_cells_are_plain():
    drawing = Drawing("<svg/>", 4.0, "x")
    rows = [[Cell("gyro_misalignment.toward_o[gx]"), Cell("67.245 ± 0.12")]]
    made = Sheet("t", ("a", "b"), rows)

    blocks = (Heading("x"), Drawings([drawing], "First."), made, Drawings([drawing], "Second."))
    parts = list(_blocks(ReportDocument("t", "s", Banner("", "", ""), (), (), blocks)))
    captions = [part["caption"] for part in parts if part["type"] == "drawings"]
    assert captions == ["Figure 1. First.", "Figure 2. Second."]
    table = next(part for part in parts if part["type"] == "table")
    assert [cell["text"].replace("\u200b", "|") for cell in table["rows"][0]] == [
        "gyro_|misalignment.|toward_|o[|gx]",
        "67.245\u00a0±\u00a00.12",
    ]


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("-22.4 ± 1.8", "−22.4 ± 1.8"), ("41 [-12; 131]", "41 [−12; 131]"), ("-20 … 20", "−20 … 20"), ("-.5", "−.5"),
        ("1.2e-05", "1.2e-05"), ("-1.2e-05", "−1.2e-05"),
        ("2026-11-20", "2026-11-20"), ("WI-12, D-K-00000-01", "WI-12, D-K-00000-01"),
        ("head-flat--20", "head-flat--20"), ("gain[-20C]", "gain[-20C]"), ("x[a,-20]", "x[a,-20]"),
        ("normal(-3, 5)", "normal(-3, 5)"), ("run `imubayes fit -1` at -1 °C", "run `imubayes fit -1` at −1 °C"),
        ("(-3 dB)", "(−3 dB)"),
    ],
)  # fmt: skip
def test_negative_numbers_have_a_minus_sign_on_the_page(text, printed):
    """And names, dates, commands and priors that are copied stay as they are."""
    table = Sheet("t", ("a",), [[Cell(text)]], note=text)
    made = typeset(ReportDocument("t", "s", Banner("", text, ""), [text], [("a", text)], (Paragraph(text), table)))
    paragraph, sheet = made.blocks
    assert isinstance(paragraph, Paragraph)
    assert isinstance(sheet, Sheet)
    found = {made.banner.sentence, made.alarms[0], made.facts[0][1], paragraph.text, sheet.rows[0][0].text, sheet.note}
    assert found == {printed}


def test_characters_without_a_font_are_found():
    assert missing_characters("Gerät-Ü7 测试 №1 µg/g² ≤ Θ") == ["测", "试"]
    # Nothing has a private character: it stands as its code point.
    assert shown_by_code_points("A\ue123B") in ((), ("\ue123",))


def test_symbols_in_prose_have_subscripts_and_names_and_commands_stay():
    blocks = (Items(["for D_F, ΔK_1/K_1 and γ (2 limits), gyro_bias of run_a: `d_ss x`"]),)
    page = html_page(ReportDocument("t", "s", Banner("", "", ""), (), (), blocks))
    for text in ("for D<sub>F</sub>, ΔK<sub>1</sub>/K<sub>1</sub> and γ", "gyro_bias of run_a: <code>d_ss x</code>"):
        assert text in page
    names = html_page(ReportDocument("t", "s", Banner("", "", ""), (), (), (Items(["d_i – normal; k_ip; x.d_o[gx]"]),)))
    assert "d_i – normal; k_ip; x.d_o[gx]" in names, "a parameter that is copied has its name"


def test_names_break_and_parameters_have_no_subscripts_on_paper():
    """In the template of PDF files: a name breaks where U+200B stands, and only symbols have subscripts."""
    typst = pytest.importorskip("typst", reason="typst is not installed")
    template = TEMPLATE.read_text(encoding="utf-8")
    symbols = template[template.index("#let symbols") : template.index("// Commands stand")]

    def drawn(content: str, width: str = "9cm") -> str:
        text = f"{symbols}\n#set page(width: {width}, height: auto)\n#set par(leading: 9pt)\n#{content}"
        return typst.compile(text.encode(), format="svg").decode()

    def height(text: str) -> float:
        found = re.search(r'viewBox="0 0 \S+ (\S+)"', drawn(f'symbols("{text}")', "7cm"))
        assert found is not None
        return float(found[1])

    assert height("accel_bias_\u200btemperature_\u200bquadratic") > height("accel_bias") + 10
    for name in ("d_i", "k_ip", "gyro_g_sensitivity.d_o"):
        assert drawn(f'symbols("{name}")') == drawn(f'"{name}"')
    assert drawn('symbols("D_F")') != drawn('"D_F"')


def test_an_empty_column_is_left_out():
    made = Sheet("t", ("symbol", "a", "b"), [[Cell(""), Cell("1"), Cell("")], [Cell(""), Cell("2"), Cell("3")]], (0, 2))
    shown = without_empty_columns(made)
    assert (shown.head, shown.left) == (["a", "b"], (1,))


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("2026-11-20", "0.0", "is not a date"),  # seconds since 1970 to pydantic
        ("2026-11-20", "20261120", "is not a date"),
        ("[22.6, 23.4]", '["22.6", "23.4"]', "number"),
        ("[22.6, 23.4]", "[-300, 23.4]", "-273.15"),
        ("temperature_degC = [22.6, 23.4]", "humidity_percent = [40, 400]", "100"),
        ('"WI-12"', '"WI\\u0007"', "WI"),  # neither XML nor PDF has control characters
        ('"WI-12"', '"\\u200b\\u200b"', "blank"),
        ('name = "Customer"', 'name = "Customer"\ncountry = "de"', "'de' is not allowed here"),
        ('name = "Customer"', 'name = "Customer"\ncountry = "UK"', "not a country of ISO 3166-1"),
    ],
)
def test_hostile_values_are_refused_with_their_place(tmp_path, old, new, what):
    assert old in WHOLE
    with pytest.raises(InputError) as caught:
        read_certificate(written(tmp_path, WHOLE.replace(old, new, 1)))
    issue = caught.value.issues[0]
    assert what in f"{issue.what} {issue.allowed}"
    assert "certificate.toml:" in issue.where


def test_a_country_that_there_is_not_is_told_what_one_is(tmp_path):
    with pytest.raises(InputError) as caught:
        read_certificate(written(tmp_path, WHOLE.replace('name = "Customer"', 'name = "Customer"\ncountry = "UK"')))
    assert caught.value.issues[0].allowed == "two capital letters, ISO 3166-1"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('number = "2026-0117"', 'number = "n/a"'), ('number = "2026-0117"', 'number = "-"'),
        ('number = "2026-0117"', 'number = "2026-XXXX"'), ('number = "2026-0117"', 'number = "0000"'),
        ('"NMI 2026-0815"', '"TBD"'), ('"NMI 2026-0815"', '"xxx"'), ('"NMI 2026-0815"', '"NMI tbd"'),
        ('name = "Customer"', 'name = "To be determined"'), ('name = "A. Example"', 'name = "N.A."'),
        ('name = "Example Laboratory"', 'name = "?"'), ('name = "rate table"', 'name = "unknown"'),
        ('method = "WI-12"', 'method = "todo"'), ('"inertial measurement unit"', '"…"'),
    ],
)  # fmt: skip
def test_a_placeholder_is_no_name_and_no_number(tmp_path, old, new):
    assert old in WHOLE
    with pytest.raises(InputError, match="is a placeholder") as caught:
        read_certificate(written(tmp_path, WHOLE.replace(old, new, 1)))
    (issue,) = caught.value.issues
    assert "certificate.toml:" in issue.where


@pytest.mark.parametrize(
    "name", ["Xsens", "NA-17", "TBA-X1 GmbH", "None Such Labs", "MAXXX", "100", "K-0000-1", "Pending Systems", "X-2"]
)
def test_a_name_that_looks_like_a_placeholder_in_part_is_one(name):
    """Of what is written in part, only words that stand for nothing else are refused."""
    assert is_placeholder(name) == (name == "TBA-X1 GmbH")


def test_a_serial_number_that_is_a_placeholder_is_missing(tmp_path):
    block, _ = read_certificate(written(tmp_path, WHOLE))
    for serial in ("TBD", "n/a", "xxxx", "-"):
        assert lacking(block, campaign_of(serial=serial)) == {("serial", "")}


def test_a_certificate_is_not_traceable_to_itself(tmp_path):
    """Its own number for a standard, and a standard that the laboratory certified for itself."""

    def of(text: str) -> set[tuple[str, str]]:
        return lacking(read_certificate(written(tmp_path, WHOLE.replace(TABLE, text)))[0])

    assert of(TABLE.replace("NMI 2026-0815", " 2026-0117")) == {("own_number", "rate table")}
    own = TABLE.replace("valid_until", 'issued_by = "example  laboratory"\nvalid_until')
    assert of(own) == {("own_standard", "rate table")}
    assert of(own.replace("example  laboratory", "NMI")) == set()
    traceable = "traceable to the SI"
    for text, said in ((own, False), (TABLE, True)):
        block, _ = read_certificate(written(tmp_path, WHOLE.replace(TABLE, text)))
        report = _report(*missing_items(block, campaign_of()))
        assert (traceable in " ".join(statements(report, block))) == said


def test_a_standard_is_calibrated_before_it_is_used_and_until_it_is_due(tmp_path):
    def of(dates: str, **campaign) -> set[tuple[str, str]]:
        text = WHOLE.replace("valid_until = 2027-11-02", dates)
        return lacking(read_certificate(written(tmp_path, text))[0], campaign_of(**campaign))

    valid = "valid_until = 2027-11-02"
    # The table was used on the first day alone.
    assert of(f"calibrated = 2026-11-01\n{valid}") == set()
    assert of(f"calibrated = 2026-11-02\n{valid}") == {("calibrated_late", "rate table")}
    assert of(f"calibrated = 2026-11-02\n{valid}", runs=(None, None)) == {("performed", "")}
    with pytest.raises(InputError, match="which is after valid_until"):
        of(f"calibrated = 2027-12-01\n{valid}")


@pytest.mark.parametrize(("unit", "instrument"), [("pulse/s", "time"), ("mV", "meter"), ("LSB", None), ("deg/s", None)])
def test_what_outputs_are_counted_or_measured_by_needs_its_standard(tmp_path, unit, instrument):
    gravity = '\n[[certificate.standard]]\nname = "gravity"\nequipment = ["gravity"]\ncertificate = "G"\n'
    block, _ = read_certificate(written(tmp_path, WHOLE + gravity + "valid_until = 2027-11-02\n"))
    counted = replace(campaign_of(), channels=digital(unit))
    assert lacking(block, counted) == ({("untraced", instrument)} if instrument else set())

"""The digital calibration certificate: its structure, its numbers and units, and the table of covariances."""

import csv
import io
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from lxml import etree

from exported_uncertainties import disagreements
from imubayes.foundations.errors import InputError
from imubayes.results.summary import SoftwareVersion
from imubayes_qualification.budgets.budget_parts import CorrelationMatrix, QuantityBudget, UncertaintyBudgets
from imubayes_qualification.budgets.standard_quantities import DigitalUnit, digital_unit
from imubayes_qualification.budgets.taken_as_exact import QuantityShift, TakenAsExact
from imubayes_qualification.certificate.certificate import Certificate, CertifiedItem, Environment, Missing
from imubayes_qualification.certificate.report_record import (
    Adequacy,
    Conformity,
    LimitOutcome,
    MonteCarloError,
    MountingAngle,
    QualificationReport,
    ReportedCombination,
    ReportedConvergence,
    ResultLine,
    StandardEstimate,
    StatisticalScope,
    ThermalLinearity,
)
from imubayes_qualification.certificate.report_subject import Provenance, Subject
from imubayes_qualification.display.report.calibration_xml import COLUMNS, DCC, SI, covariance_file, dcc_file

WRITTEN = Path(__file__).parent / "dcc_written.rng"
BLOCK = Certificate.model_validate(
    {
        "number": "2026-0117", "date": "2026-11-20", "method": "WI-12",
        "laboratory": {"name": "Laboratory", "address": "Street 1 & 2", "country": "DE", "email": "a@b.invalid"},
        "customer": {"name": "测试 <customer>", "address": "Street 3"},
        "item": {"description": "unit", "manufacturer": "Maker", "model": "M 1", "received": "2026-10-30"},
        "accreditation": "Accredited as D-K",
        "standard": [{"name": "rate table", "certificate": "NMI 2026-0815", "issued_by": "NMI",
                      "valid_until": "2027-03-01"}],
        "environment": {"temperature_degC": [22.6, 23.4]},
        "signatory": [{"name": "A. Example", "function": "head"}, {"name": "B. Example"}],
    }
)  # fmt: skip
G = 9.79


def estimate(symbol: str, label: str, y: float, u: float, unit: DigitalUnit | None, **others) -> StandardEstimate:
    error = MonteCarloError(
        estimate=u / 100, standard_uncertainty=u / 1000, low=u / 50, high=u / 50, effective=1e4, digits=2,
        tolerance=u / 10, worst="low", draws_needed=0.1,
    )  # fmt: skip
    known = {
        "estimate": y, "standard_uncertainty": u, "low": y - 2 * u, "high": y + 2 * u, "interval": "symmetric",
        "coverage_factor": 2.0, "expanded_uncertainty": 2 * u, "monte_carlo": error,
    }  # fmt: skip
    return StandardEstimate.model_validate(
        {
            "name": f"{symbol}[{label}]", "unit": "ug", "d_si": unit, "key": symbol, "symbol": symbol,
            "quantity": "bias", "standard": "IEEE Std 1293", "term": symbol, "label": label, "members": ("m",),
            **(known | others),
        }
    )  # fmt: skip


MICRO_G = DigitalUnit(unit=r"\metre\per\second\tothe{2}", factor=1e-6 * G)
STANDARDS = (
    estimate("K_0", "ax", 100.0, 2.0, MICRO_G),
    estimate("K_0", "ay", -50.0, 3.0, MICRO_G),
    estimate("K_9", "ax", 1.0, 0.1, None),
    estimate("Θ", "ax", 4.0, 1.0, DigitalUnit(unit=r"\arcsecond"), interval="shortest", low=3.0, high=7.0),
)


def report(**changes) -> QualificationReport:
    names = tuple(each.name for each in STANDARDS)
    budgets = UncertaintyBudgets.model_construct(
        quantities=tuple(
            QuantityBudget.model_construct(
                name=each.name,
                standard_uncertainty=each.standard_uncertainty,
                interval=each.interval,
                coverage_factor=each.coverage_factor,
                expanded_uncertainty=each.expanded_uncertainty,
            )
            for each in STANDARDS
        ),
        correlation=CorrelationMatrix(names=names, rows=((1.0,), (0.75, 1.0), (0, 0, 1.0), (0.1, 0, 0, 1.0))),
    )
    known = {
        "subject": Subject.model_construct(
            serial="U7", campaign="c", latitude_deg=34.0, height_m=400.0, gravity_m_s2=G, gravity_is_normal=True,
            gravity_uncertainty_ug=50.0,
        ),
        "convergence": ReportedConvergence.model_construct(converged=True),
        "adequacy": Adequacy.model_construct(verdict="adequate", intervals_valid=True, prior_conflicts=()),
        "mounting_angles": (), "combinations": (), "results": (), "thermal_linearity": (),
        "provenance": Provenance.model_construct(
            model="m", data_sha256="d" * 64, software=(SoftwareVersion(package="imubayes", version="1"),)
        ),
        "scope": StatisticalScope.model_construct(first_start="2026-11-01T08:00:00", last_start="2026-11-04T08:00:00"),
        "conformity": Conformity(specification="FQ", sha256="", outcome="conditional_pass", obstacles=(), limits=()),
        "standards": STANDARDS, "budgets": budgets, "certificate": BLOCK, "missing": (), "exact": TakenAsExact(),
    }  # fmt: skip
    return QualificationReport.model_construct(**(known | changes))


def faults(document: bytes) -> list[str]:
    """What a certificate breaks of the rules for what is written."""
    rules = etree.RelaxNG(etree.parse(WRITTEN))
    rules.validate(etree.fromstring(document))
    return [f"{each.line}: {each.message}" for each in rules.error_log]


def test_a_certificate_keeps_the_rules_of_what_it_writes():
    assert faults(dcc_file(report())) == []
    bare = BLOCK.model_copy(
        update={"standard": (), "environment": Environment(), "date": None, "item": CertifiedItem()}
    )
    assert faults(dcc_file(report(certificate=bare, conformity=None))) == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<dcc:mainSigner>true</dcc:mainSigner>", "<dcc:mainSigner>first</dcc:mainSigner>"),
        (' lang="en"', ""),
        ("<dcc:endPerformanceDate>2026-11-04<", "<dcc:endPerformanceDate>4.11.2026<"),
        ("<dcc:conformity>conditionalPass<", "<dcc:conformity>passed<"),
        (r"<si:unit>\arcsecond<", "<si:unit>arcsec<"),
        (r"\per\second\tothe{2}", r"/\second^2"),
        ("<dcc:value>U7<", "<dcc:value> <"),
        ("<dcc:countryCodeISO3166_1>DE</dcc:countryCodeISO3166_1>", ""),
        ("<si:coverageProbability>0.95<", "<si:coverageProbability>95 %<"),
        ('schemaVersion="3.3.0"', 'schemaVersion="3.4.0"'),
    ],
)
def test_the_rules_find_what_is_broken(old, new):
    document = dcc_file(report()).decode()
    assert old in document
    assert faults(document.replace(old, new, 1).encode())


def test_the_rules_find_elements_in_another_order():
    root = etree.fromstring(dcc_file(report()))
    quantity = root.find(f".//{{{DCC}}}results//{{{DCC}}}quantity")
    assert quantity is not None
    quantity.append(quantity[0])
    assert faults(etree.tostring(root))


def test_numbers_are_in_d_si_units_with_their_coverage():
    root = ElementTree.fromstring(dcc_file(report()))
    found = [each for each in root.iter(f"{{{DCC}}}quantity") if each.find(f"{{{DCC}}}description") is not None]
    assert len(found) == 3, "a quantity without a D-SI unit is left out"
    (bias, other, angle) = found
    real = bias.find(f"{{{SI}}}real")
    assert real is not None
    assert float(real.findtext(f"{{{SI}}}value") or "nan") == pytest.approx(100e-6 * G)
    assert real.findtext(f"{{{SI}}}unit") == r"\metre\per\second\tothe{2}"
    expanded = real.find(f".//{{{SI}}}expandedMU")
    assert expanded is not None
    assert [float(child.text or "nan") for child in expanded] == pytest.approx([4e-6 * G, 2.0, 0.95])
    assert other.find(f".//{{{SI}}}expandedMU") is not None
    # A posterior that is not symmetric has u and its interval.
    assert angle.find(f".//{{{SI}}}expandedMU") is None
    interval = angle.find(f".//{{{SI}}}coverageIntervalMU")
    assert interval is not None
    assert [float(child.text or "nan") for child in interval] == [1.0, 3.0, 7.0, 0.95]
    text = "".join(root.itertext())
    assert "bias K_9 of ax in ug" in text, "what is left out is named"
    assert "测试 <customer>" in text
    assert [each.text for each in root.iter(f"{{{DCC}}}conformity")] == ["conditionalPass"]
    assert root.findtext(f".//{{{DCC}}}receiptDate") == "2026-10-30"
    assert "Maker" in text
    # A mark of accreditation stands on no certificate that lacks what ISO/IEC 17025 requires.
    assert "Accredited as D-K" in text
    lacking = dcc_file(report(missing=(Missing(item="location"),))).decode()
    assert "Accredited as D-K" not in lacking


def test_statements_are_those_of_the_pages():
    """Decision rule, conformity to each limit, traceability, and what stands against the certificate."""
    limit = LimitOutcome.model_construct(
        name="K_0[ax]", symbol="K_0", label="ax", unit="ug", lower=-101.0, upper=101.0, temperature_range=(10.0, 45.0),
        estimate=100.0, standard_uncertainty=2.0, expanded_uncertainty=4.0, coverage_factor=2.0, d_si=MICRO_G,
        low=96.0, high=104.0,
        monte_carlo=STANDARDS[0].monte_carlo, rule="ilac_g8_non_binary", outcome="conditional_pass",
        guard_band=4.0,
    )  # fmt: skip
    found = Conformity(specification="FQ", sha256="", outcome="conditional_pass", obstacles=(), limits=(limit,))

    def said(**changes) -> str:
        document = dcc_file(report(conformity=found, **changes))
        assert faults(document) == []
        return "\n".join(ElementTree.fromstring(document).itertext())

    whole = said()
    for text in (
        "Decision rule: ILAC-G8 non-binary, w = U (pass within the limits less w, fail beyond the limits plus w",
        "K_0 of ax from 10 °C to 45 °C: 100.0 ± 4.0, limits −101 … 101 µg",
        "metrologically traceable to the SI through the standards used", "Adjustment: not stated.",
        "1 g = 9.790000 m/s²", "2027-03-01", "NMI",
    ):  # fmt: skip
        assert text in whole, text
    assert "No certificate of an accredited laboratory" not in whole
    assert "U omits" not in whole
    lacking = said(
        missing=(Missing(item="untraced", of="gravity"),),
        adequacy=Adequacy.model_construct(verdict=None, intervals_valid=True, prior_conflicts=()),
        exact=TakenAsExact(unstated=(QuantityShift(name="K_0[ax]", value=2.0),)),
    )
    for text in (
        "No certificate of an accredited laboratory: ISO/IEC 17025 requires 1 more item",
        "Missing from this certificate: traceability of gravity, which runs used: no standard names it (7.8.4.1 c)",
        "The model was never diagnosed",
        "Known contributions that U omits would multiply it by 1.41.",
    ):  # fmt: skip
        assert text in lacking, text
    assert "metrologically traceable" not in lacking


@pytest.mark.parametrize(
    ("unit", "written", "factor"),
    [
        ("deg/h/degC", r"\degree\per\hour\kelvin", 1.0),
        ("ug/g^2", r"\second\tothe{2}\per\metre", 1e-6 / G),
        ("deg/h/g", r"\degree\second\tothe{2}\per\hour\metre", 1 / G),
        ("ug/degC", r"\metre\per\second\tothe{2}\kelvin", 1e-6 * G),
        ("ppm", r"\ppm", 1.0),
    ],
)
def test_a_unit_of_d_si_has_one_line_of_fraction(unit, written, factor):
    """D-SI knows one ``\\per``, and all that follows is below the line; a second one is no unit."""
    found = digital_unit(unit, G)
    assert found is not None
    assert found.unit == written
    assert found.factor == pytest.approx(factor)
    document = dcc_file(report()).decode().replace(r"\metre\per\second\tothe{2}", found.unit, 1)
    assert faults(document.encode()) == []
    wrong = document.replace(found.unit, found.unit + r"\per\kelvin\per\hour", 1)
    assert faults(wrong.encode())


def test_every_certified_quantity_has_a_result():
    """Limits at their worst temperature, mounting angles, combinations and Δk beside those of the standards."""
    made = {"interval": "equal-tailed", "low": 1.0, "high": 4.0, "estimate": 2.0, "standard_uncertainty": 0.8}
    made |= {"monte_carlo": STANDARDS[0].monte_carlo, "withheld": None, "unit": "deg"}
    limit = LimitOutcome.model_construct(
        name="K_0[ax]", symbol="K_0", label="ax", lower=None, upper=101.0, temperature_range=(10.0, 45.0),
        coverage_factor=2.0, expanded_uncertainty=1.6, rule="simple_acceptance", outcome="pass", guard_band=0.0,
        d_si=MICRO_G, **(made | {"interval": "symmetric", "unit": "ug"}),
    )  # fmt: skip
    degree, one = DigitalUnit(unit=r"\degree", factor=-1.0), DigitalUnit(unit=r"\one")
    angle = MountingAngle.model_construct(
        name="mounting_angle[gx,up]", channel="gx", mounting="up", d_si=degree, **made
    )
    together = ReportedCombination.model_construct(
        name="a+b", quantities=("a", "b"), weights=(1.0, 1.0), constant=0.0, middle_of="", d_si=one, **made
    )
    linear = ThermalLinearity.model_construct(name="delta_k[ax,r]", channel="ax", run="r", d_si=one, **made)
    drift, bias = (
        ResultLine.model_construct(name=name, kind="parameter", d_si=one, **made)
        for name in ("converter_gain_drift.slope[ax]", "accel_bias.bias[ax]")
    )
    document = dcc_file(
        report(
            conformity=Conformity(specification="FQ", sha256="", outcome="pass", obstacles=(), limits=(limit,)),
            mounting_angles=(angle,), combinations=(together,), thermal_linearity=(linear,), results=(drift, bias),
        )
    )  # fmt: skip
    assert faults(document) == []
    results = ElementTree.fromstring(document).findall(f".//{{{DCC}}}result")
    names = {
        each.findtext(f"{{{DCC}}}name/{{{DCC}}}content"): [
            quantity.findtext(f"{{{DCC}}}name/{{{DCC}}}content") for quantity in each.iter(f"{{{DCC}}}quantity")
        ]
        for each in results
    }
    assert names["Limits of the specification"] == ["K_0 of ax, worst from 10 °C to 45 °C"]
    assert names["True mounting angles"] == ["true angle of gx in up"]
    assert names["Determined combinations"] == ["a + b"]
    assert names["Thermal linearity"] == ["Δk of ax in r"]
    assert names["Converters"] == ["converter_gain_drift.slope[ax]"]
    (interval,) = results[-4].iter(f"{{{SI}}}coverageIntervalMU")
    assert [float(child.text or "nan") for child in interval] == [0.8, -4.0, -1.0, 0.95], "in a unit of another sign"


def test_what_a_dcc_needs_is_asked_for_at_once():
    lacking = BLOCK.model_copy(update={"number": None, "signatory": ()})
    with pytest.raises(InputError) as caught:
        dcc_file(report(certificate=lacking))
    assert [each.what for each in caught.value.issues] == [
        "a digital calibration certificate needs 'number', which is not stated",
        "a digital calibration certificate needs 'signatory', which is not stated",
    ]
    with pytest.raises(InputError):
        dcc_file(report(certificate=None))


def test_the_covariance_is_that_of_the_quantities_in_their_units():
    rows = list(csv.reader(io.StringIO(covariance_file(report()).decode())))
    head, *lines = rows
    own = len(COLUMNS)
    assert tuple(head[:own]) == COLUMNS
    names = [line[0] for line in lines]
    assert head[own:] == names == ["K_0[ax]", "K_0[ay]", "Θ[ax]"]
    covariance = np.array([[float(cell) for cell in line[own:]] for line in lines])
    u = np.array([float(line[3]) for line in lines])
    np.testing.assert_allclose(u, [2e-6 * G, 3e-6 * G, 1.0])
    np.testing.assert_allclose(covariance, covariance.T)
    np.testing.assert_allclose(np.diag(covariance), u**2)
    assert covariance[0, 1] == pytest.approx(0.75 * u[0] * u[1])


def test_one_quantity_has_one_expanded_uncertainty_in_all_forms():
    """Student's t with the degrees of freedom of the table makes the U of the pages: GTC forms t u."""
    assert disagreements(report()) == []
    table = list(csv.DictReader(io.StringIO(covariance_file(report()).decode())))
    # k of the posterior is 2.00; the scatter of 11 degrees of freedom in u would make it 2.20 a second time.
    assert [float(row["degrees_of_freedom"] or "nan") for row in table[:2]] == pytest.approx([60.4, 60.4], rel=1e-2)
    assert (table[2]["interval"], table[2]["degrees_of_freedom"]) == ("shortest", "")
    assert [float(table[2][end]) for end in ("low", "high")] == [3.0, 7.0]
    # Planted fault: u of one form is that of another evaluation.
    broken = STANDARDS[0].model_copy(update={"standard_uncertainty": 2.2})
    assert len(disagreements(report(standards=(broken, *STANDARDS[1:])))) == 1

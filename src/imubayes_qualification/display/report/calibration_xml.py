"""The certificate as a Digital Calibration Certificate (PTB, DCC 3.3.0) with D-SI units, and covariances as a table.

A DCC is XML: administrative data from the certificate block and the campaign, then every quantity that the pages
certify: those of the standards that were measured, each limit at its worst temperature, true mounting angles,
determined combinations and Δk.  A D-SI `real` has U, k and the coverage probability (`expandedMU`); if the interval
is not symmetric, u with the ends of the interval (`coverageIntervalMU`).  The statements are those of the pages:
decision rules, conformity to each limit, traceability, what stands against the certificate, what it lacks and what U
omits.  A quantity without a unit in D-SI is left out and named.

The table of covariances is for programs that propagate uncertainty (GTC, METAS UncLib): a CSV file with a line for each
quantity: its name, D-SI unit, value and standard uncertainty, what the pages state of it, and its row of the
covariance.  Degrees of freedom are those with which Student's t gives the k of the pages
(`evaluation.coverage`): `ureal(value, u, degrees)` of GTC has their U.  Of several quantities together
GTC's `multiple_ureal` takes one number, infinity, and `set_correlation` their correlations; UncLib's `ulinprop` takes
values and covariance alone.  u of a function of them is right, and k, between 1.96 and 2.00, is that of a normal
distribution.  A quantity whose interval is not symmetric has neither k, U nor degrees of freedom.
"""

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from imubayes.display.fit_quality_tables import members_text
from imubayes.display.numbers_and_labels import pretty, ratio_text, with_minus
from imubayes.foundations.errors import Issue, refuse
from imubayes_qualification.certificate.certificate import Certificate, Party
from imubayes_qualification.certificate.report_record import QualificationReport, ReportedEstimate, StandardEstimate
from imubayes_qualification.display.report.certificate_pages import all_statements
from imubayes_qualification.display.report.exact_tables import CONVERTER, omissions, omitted_beside, omitted_factor
from imubayes_qualification.display.report.words import Stated, limits_text, value_text
from imubayes_qualification.evaluation.coverage import COVERAGE_PROBABILITY, IntervalShape, equivalent_degrees
from imubayes_qualification.evaluation.decision_rules import Outcome

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
SCHEMA_VERSION = "3.3.0"
_LOCATION = f"{DCC} {DCC}/v{SCHEMA_VERSION}/dcc.xsd"
_SCHEMA_INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"
_CONFORMITY: dict[Outcome, str] = {
    "pass": "pass", "conditional_pass": "conditionalPass", "conditional_fail": "conditionalFail", "fail": "fail",
    "withheld": "noPass",
}  # fmt: skip
_PROBABILITY = f"{COVERAGE_PROBABILITY:g}"
COLUMNS = (
    "name", "unit", "value", "standard_uncertainty", "coverage_factor", "expanded_uncertainty", "degrees_of_freedom",
    "interval", "low", "high", "coverage_probability",
)  # fmt: skip
"""Columns of the table of covariances before those of the covariance."""


def dcc_file(report: QualificationReport) -> bytes:
    """Return the report as a Digital Calibration Certificate.

    Raises
    ------
    InputError
        with everything that a DCC requires and the certificate block or the campaign does not state.
    """
    block = _complete(report)
    for prefix, space in (("dcc", DCC), ("si", SI), ("xsi", _SCHEMA_INSTANCE)):
        ElementTree.register_namespace(prefix, space)
    root = ElementTree.Element(f"{{{DCC}}}digitalCalibrationCertificate", schemaVersion=SCHEMA_VERSION)
    root.set(f"{{{_SCHEMA_INSTANCE}}}schemaLocation", _LOCATION)
    _administrative(_child(root, "administrativeData"), report, block)
    _measured(_child(root, "measurementResults"), report, block)
    ElementTree.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="utf-8") + b"\n"


def _complete(report: QualificationReport) -> Certificate:
    """Return the certificate block, which has all that a DCC requires."""
    block = report.certificate or Certificate()
    needed = {
        "number": block.number,
        "laboratory.name": block.laboratory.name,
        "laboratory.address": block.laboratory.address,
        "laboratory.country": block.laboratory.country,
        "customer.name": block.customer.name,
        "customer.address": block.customer.address,
        "signatory": block.signatory,
    }
    issues = [
        Issue(
            f"a digital calibration certificate needs '{key}', which is not stated", f"[certificate], key '{key}'",
            "see `imubayes schema certificate`", "state it in the specification, or in the file of --certificate",
        )
        for key, given in needed.items()
        if not given
    ]  # fmt: skip
    if not report.scope.first_start or not report.scope.last_start:
        where, allowed = "campaign.toml, [[run]] start", "date and time of the runs"
        issues.append(
            Issue("a digital calibration certificate needs the dates of the runs", where, allowed, "add them")
        )
    if not any(each.d_si is not None for each in report.standards):
        issues.append(
            Issue("there is no measured quantity with a D-SI unit", "the result", "one or more", "measure one")
        )
    refuse(issues)
    return block


def _child(parent: ElementTree.Element, name: str, text: str | None = None, space: str = DCC) -> ElementTree.Element:
    found = ElementTree.SubElement(parent, f"{{{space}}}{name}")
    found.text = None if text is None else " ".join(text.split())
    return found


def _text(parent: ElementTree.Element, name: str, text: str) -> ElementTree.Element:
    """Add an element of text with a language."""
    found = _child(parent, name)
    _child(found, "content", text).set("lang", "en")
    return found


def _administrative(parent: ElementTree.Element, report: QualificationReport, block: Certificate) -> None:
    software = _child(parent, "dccSoftware")
    for each in report.provenance.software:
        own = _child(software, "software")
        _text(own, "name", each.package)
        _child(own, "release", each.version)
    core = _child(parent, "coreData")
    _child(core, "countryCodeISO3166_1", block.laboratory.country)
    _child(core, "usedLangCodeISO639_1", "en")
    _child(core, "mandatoryLangCodeISO639_1", "en")
    _child(core, "uniqueIdentifier", block.number)
    if block.item.received is not None:
        _child(core, "receiptDate", block.item.received.isoformat())
    _child(core, "beginPerformanceDate", str(report.scope.first_start)[:10])
    _child(core, "endPerformanceDate", str(report.scope.last_start)[:10])
    _child(core, "performanceLocation", "laboratory")
    if block.date is not None:
        _child(core, "issueDate", block.date.isoformat())
    item = _child(_child(parent, "items"), "item")
    _text(item, "name", block.item.description or report.subject.campaign)
    if block.item.manufacturer:
        _text(_child(item, "manufacturer"), "name", block.item.manufacturer)
    if block.item.model:
        _child(item, "model", block.item.model)
    identifications = _child(item, "identifications")
    _identified(identifications, "manufacturer", report.subject.serial or "none stated", "serial number")
    _identified(identifications, "other", report.provenance.data_sha256, "SHA-256 of the data")
    _contact(_child(_child(parent, "calibrationLaboratory"), "contact"), block.laboratory)
    persons = _child(parent, "respPersons")
    for place, each in enumerate(block.signatory):
        own = _child(persons, "respPerson")
        _text(_child(own, "person"), "name", each.name)
        if each.function:
            _child(own, "role", each.function)
        _child(own, "mainSigner", "false" if place else "true")
    _contact(_child(parent, "customer"), block.customer)
    _statements(_child(parent, "statements"), report, block)


def _identified(parent: ElementTree.Element, issuer: str, value: str, name: str) -> None:
    own = _child(parent, "identification")
    _child(own, "issuer", issuer)
    _child(own, "value", value)
    _text(own, "name", name)


def _contact(parent: ElementTree.Element, party: Party) -> None:
    _text(parent, "name", party.name or "")
    if party.email:
        _child(parent, "eMail", party.email)
    location = _child(parent, "location")
    _text(location, "further", party.address or "")
    if party.country:
        _child(location, "countryCode", party.country)


def _statements(parent: ElementTree.Element, report: QualificationReport, block: Certificate) -> None:
    for text in all_statements(report, block):
        _text(_child(parent, "statement"), "declaration", text)
    found = report.conformity
    if found is None:
        return
    judged: list[tuple[str, Outcome]] = [(f"Conformity to the specification {found.specification}", found.outcome)]
    for each in found.limits:
        over = "" if each.temperature_range is None else " from {:g} °C to {:g} °C".format(*each.temperature_range)
        what = f"{each.symbol or each.name} of {each.label}{over}: {value_text(each)}, limits {limits_text(each)}"
        judged.append((f"{what} {pretty(each.unit)}", each.outcome))
    for text, outcome in judged:
        own = _child(parent, "statement")
        _text(own, "declaration", with_minus(text))
        _child(own, "conformity", _CONFORMITY[outcome])


def _measured(parent: ElementTree.Element, report: QualificationReport, block: Certificate) -> None:
    result = _child(parent, "measurementResult")
    _text(result, "name", f"Quantities of unit {report.subject.serial or report.subject.campaign}")
    listed = list(_certified(report))
    left_out = [each for each in listed if each.stated.d_si is None or _is_withheld(each.stated)]
    if left_out:
        named = ", ".join(f"{each.name} in {each.stated.unit}" for each in left_out)
        _text(result, "description", f"Without a D-SI unit or withheld, and left out here: {named}.")
    method = _child(_child(result, "usedMethods"), "usedMethod")
    _text(method, "name", block.method or report.provenance.model)
    for standard in dict.fromkeys(each.standard for each in report.standards):
        _child(method, "norm", standard)
    _equipment(result, block)
    _conditions(result, block)
    _results(_child(result, "results"), [each for each in listed if each not in left_out])


def _results(parent: ElementTree.Element, shown: Sequence["_Certified"]) -> None:
    for group in dict.fromkeys(each.group for each in shown):
        own = _child(parent, "result")
        _text(own, "name", group)
        data = _child(own, "data")
        for each in shown:
            if each.group == group:
                _quantity(data, each)


@dataclass(frozen=True)
class _Certified:
    """A quantity that the pages certify: the result that it is listed under, its name, what it is, and its estimate."""

    group: str
    name: str
    description: str
    stated: Stated


def _certified(report: QualificationReport) -> Iterator[_Certified]:
    """Yield every quantity that the pages certify; those of the standards have what U omits in their description."""
    ratios = {(each.symbol, each.label): each.ratio for each in omissions(report) if each.kind == "standard"}
    for each in report.standards:
        ratio = ratios.get((each.symbol, each.label))
        lacks = "" if ratio is None else f" Known contributions that U omits would multiply it by {ratio_text(ratio)}."
        yield _Certified(each.standard, f"{each.quantity} {each.symbol} of {each.label}", f"{each.term}.{lacks}", each)
    yield from _limits(report)
    yield from _of_other_tables(report)


def _limits(report: QualificationReport) -> Iterator[_Certified]:
    for limit in report.conformity.limits if report.conformity is not None else ():
        span = limit.temperature_range
        where = "at the reference temperature" if span is None else "worst from {:g} °C to {:g} °C".format(*span)
        name = f"{limit.symbol or limit.name} of {limit.label}, {where}"
        said = f"limits {limits_text(limit)} {pretty(limit.unit)}{_lacks(omitted_factor(limit.omitted_ratio))}"
        yield _Certified("Limits of the specification", name, said, limit)


def _lacks(factor: str) -> str:
    """Return that U omits contributions, which would multiply it; empty for nothing."""
    return f"; known contributions that U omits would multiply it by {factor[2:]}" if factor else ""


def _of_other_tables(report: QualificationReport) -> Iterator[_Certified]:
    beside = omitted_beside(report)
    tables = (
        ("True mounting angles", ((f"true angle of {e.channel} in {e.mounting}", e) for e in report.mounting_angles)),
        ("Determined combinations", ((members_text(e), e) for e in report.combinations)),
        ("Converters", ((e.name, e) for e in report.results if e.name.startswith(CONVERTER))),
        ("Thermal linearity", ((f"Δk of {e.channel} in {e.run}", e) for e in report.thermal_linearity)),
    )
    for group, estimates in tables:
        for name, each in estimates:
            yield _Certified(group, name, f"{each.name}{_lacks(beside.get(each.name, ''))}", each)


def _is_withheld(stated: Stated) -> bool:
    """Return whether no number of an estimate is stated: for too few draws, or as it has no uncertainty."""
    withheld = isinstance(stated, ReportedEstimate) and stated.withheld is not None
    few = stated.monte_carlo is None or stated.monte_carlo.digits == 0
    return withheld or few or stated.interval is None or stated.low is None


def _equipment(parent: ElementTree.Element, block: Certificate) -> None:
    if not block.standard:
        return
    equipment = _child(parent, "measuringEquipments")
    for each in block.standard:
        own = _child(equipment, "measuringEquipment")
        _text(own, "name", each.name)
        until = None if each.valid_until is None else each.valid_until.isoformat()
        known = {
            "serial number": each.serial, "certificate": each.certificate, "certificate issued by": each.issued_by,
            "calibrated": None if each.calibrated is None else each.calibrated.isoformat(),
            "certificate valid until": until,
        }  # fmt: skip
        if any(known.values()):
            listed = _child(own, "identifications")
            for name, value in known.items():
                if value:
                    _identified(listed, "other", value, name)


def _conditions(parent: ElementTree.Element, block: Certificate) -> None:
    found = block.environment
    ranges = (
        ("air temperature", found.temperature_degC, r"\degreecelsius"),
        ("relative humidity", found.humidity_percent, r"\percent"),
        ("air pressure", found.pressure_hPa, r"\hecto\pascal"),
    )
    known = [(name, span, unit) for name, span, unit in ranges if span is not None]
    if not known:
        return
    conditions = _child(parent, "influenceConditions")
    for name, span, unit in known:
        own = _child(conditions, "influenceCondition")
        _text(own, "name", name)
        data = _child(own, "data")
        for which, value in zip(("lowest", "highest"), span, strict=True):
            quantity = _child(data, "quantity")
            _text(quantity, "name", which)
            real = _child(quantity, "real", space=SI)
            _child(real, "value", repr(float(value)), SI)
            _child(real, "unit", unit, SI)


def _quantity(parent: ElementTree.Element, certified: _Certified) -> None:
    each = certified.stated
    assert each.d_si is not None, "quantities without a D-SI unit are left out"
    factor, own = each.d_si.factor, _child(parent, "quantity")
    _text(own, "name", certified.name)
    symmetric = each.interval == "symmetric" and each.expanded_uncertainty is not None
    shape = "" if symmetric else f" The 95 % interval is {_SHAPES[each.interval or 'equal-tailed']}."
    _text(own, "description", with_minus(f"{certified.description}{shape}"))
    real = _child(own, "real", space=SI)
    _child(real, "value", _number(each.estimate, factor), SI)
    _child(real, "unit", each.d_si.unit, SI)
    uncertainty = _child(real, "measurementUncertaintyUnivariate", space=SI)
    if symmetric:
        expanded = _child(uncertainty, "expandedMU", space=SI)
        _child(expanded, "valueExpandedMU", _number(each.expanded_uncertainty, abs(factor)), SI)
        _child(expanded, "coverageFactor", _number(each.coverage_factor, 1.0), SI)
        _child(expanded, "coverageProbability", _PROBABILITY, SI)
        return
    interval = _child(uncertainty, "coverageIntervalMU", space=SI)
    _child(interval, "valueStandardMU", _number(each.standard_uncertainty, abs(factor)), SI)
    for name, end in zip(("intervalMin", "intervalMax"), ends_in(each, factor), strict=True):
        _child(interval, name, _number(end, 1.0), SI)
    _child(interval, "coverageProbability", _PROBABILITY, SI)


_SHAPES: dict[IntervalShape, str] = {
    "symmetric": "symmetric", "equal-tailed": "that of equal tails", "shortest": "the shortest one",
}  # fmt: skip


def ends_in(each: Stated, factor: float) -> tuple[float, float]:
    """Return the ends of an interval in a unit of which one of the estimate's has so many, the lower one first."""
    assert each.low is not None, "withheld numbers are left out"
    assert each.high is not None, "withheld numbers are left out"
    first, last = sorted((each.low * factor, each.high * factor))
    return first, last


def _number(value: float | None, factor: float) -> str:
    assert value is not None, "withheld numbers are left out"
    return f"{value * factor:.12g}"


def covariance_file(report: QualificationReport) -> bytes:
    """Return values and covariance of the quantities of the standards with D-SI units, as a table."""
    budgets = report.budgets
    found = [] if budgets is None else list(_with_budget(report))
    rows = {} if budgets is None else dict(zip(budgets.correlation.names, budgets.correlation.rows, strict=True))
    order = {name: place for place, name in enumerate(rows)}

    def correlation(first: str, second: str) -> float:
        low, high = sorted((first, second), key=lambda name: order[name])
        return rows[high][order[low]]

    buffer = io.StringIO()
    table = csv.writer(buffer, lineterminator="\n")
    names = [each.name for each, _, _ in found]
    table.writerow([*COLUMNS, *names])
    u = np.array([uncertainty for _, _, uncertainty in found])
    for k, (each, known, uncertainty) in enumerate(found):
        line = [float(uncertainty * u[j] * correlation(known, other)) for j, (_, other, _) in enumerate(found)]
        line[k] = float(uncertainty**2)
        table.writerow([*_stated(each), *(f"{v:.12g}" for v in line)])
    return buffer.getvalue().encode()


def _with_budget(report: QualificationReport) -> Iterator[tuple[StandardEstimate, str, float]]:
    """Yield the quantities with a D-SI unit, the name of the budget of each, and its uncertainty in that unit."""
    known = () if report.budgets is None else report.budgets.correlation.names
    for each in report.standards:
        own = each.name if each.name in known else each.members[0]
        if each.d_si is not None and each.standard_uncertainty and each.withheld is None and own in known:
            yield each, own, each.standard_uncertainty * abs(each.d_si.factor)


def _stated(each: StandardEstimate) -> list[str]:
    """Return what is stated of a quantity, in its D-SI unit, in the order of the columns."""
    assert each.d_si is not None, "quantities without a D-SI unit are left out"
    factor = each.d_si.factor
    symmetric = [""] * 3
    if each.interval == "symmetric" and each.coverage_factor is not None:
        k, u = each.coverage_factor, each.expanded_uncertainty
        symmetric = [f"{k:.12g}", _number(u, abs(factor)), f"{equivalent_degrees(k):.12g}"]
    ends = ((end, 1.0) for end in ends_in(each, factor))
    numbers = (each.estimate, factor), (each.standard_uncertainty, abs(factor)), *ends
    value, uncertainty, low, high = (_number(*pair) for pair in numbers)
    return [each.name, each.d_si.unit, value, uncertainty, *symmetric, str(each.interval), low, high, _PROBABILITY]

"""The certificate block in words: head of the first page, second page, and what is missing on the last one."""

from collections.abc import Iterator, Sequence

from imubayes.display.layout import Cell, Sheet, cells
from imubayes.display.numbers_and_labels import pretty, significant
from imubayes.model.model_file import GRAVITY
from imubayes_qualification.budgets.standard_quantities import standard_symbol
from imubayes_qualification.certificate import certificate as certificates
from imubayes_qualification.certificate.report_record import QualificationReport
from imubayes_qualification.display.report.document import Block, Heading, Items, Paragraph, without_empty_columns
from imubayes_qualification.display.report.first_page import alarms, rules_text

_NOT_STATED = "not stated"
_OF_STANDARDS: tuple[certificates.MissingItem, ...] = (
    "standard_certificate",
    "standard_validity",
    "expired",
    "untraced",
    "unused",
    "normal_gravity",
    "repeated_standard",
    "shared_certificate",
    "own_number",
    "own_standard",
    "calibrated_late",
)
_MISSING: dict[certificates.MissingItem, str] = {
    "number": "unique identification of the certificate (7.8.2.1 d)",
    "date": "date of issue (7.8.2.1 j)",
    "laboratory_name": "name of the laboratory (7.8.2.1 b)",
    "laboratory_address": "address of the laboratory (7.8.2.1 b)",
    "location": "location of the calibration (7.8.2.1 c)",
    "customer_name": "name of the customer (7.8.2.1 e)",
    "customer_address": "contact information of the customer (7.8.2.1 e)",
    "method": "identification of the method (7.8.2.1 f)",
    "item_description": "description of the item (7.8.2.1 g)",
    "serial": "unambiguous identification of the item: `serial` of the campaign (7.8.2.1 g)",
    "received": "date of receipt of the item, if it matters to the results (7.8.2.1 h)",
    "performed": "dates of the calibration: `start` of the runs (7.8.2.1 i)",
    "environment": "conditions under which the calibration was made (7.8.4.1 b)",
    "standards": "a statement of traceability: the standards used (7.8.4.1 c)",
    "untraced": "traceability of {of}, which runs used: no standard names it (7.8.4.1 c)",
    "normal_gravity": "traceability of gravity: the campaign uses the formula of normal gravity, not a measured "
    "`gravity_m_s2` of the site (7.8.4.1 c)",
    "signatories": "persons who authorise the certificate (7.8.2.1 o)",
    "standard_certificate": "the certificate of {of} has no number",
    "standard_validity": "the date until which the certificate of {of} is valid is not stated",
    "expired": "the certificate of {of} expired before the last run that used it (ISO/IEC 17025, 6.5)",
    "unused": "no run used the equipment for which this standard is claimed — {of}",
    "repeated_standard": "one standard is listed more than once — {of}",
    "shared_certificate": "certificates of several issuers have the same number — {of}",
    "own_number": "the certificate of {of} has the number of this certificate",
    "own_standard": "the certificate of {of} was issued by this laboratory, and states no traceability beyond it (6.5)",
    "calibrated_late": "{of} was calibrated after the first run that used it (ISO/IEC 17025, 6.5)",
    "received_late": "the date of receipt is after the first run",
    "issued_early": "the date of issue is before the last run",
    "validity": "the fit did not converge, or no diagnosis found its model adequate (ISO/IEC 17025, 7.2.2 and 7.7.1)",
    "cmc": "the laboratory states an accreditation but no capabilities (CMC), the lower limit of U (ILAC-P14)",
    "omitted": "U of {of} omits known contributions, which are listed on the first page (ISO/IEC 17025, 7.6.1)",
}


# Statements that stand on the page of the signatures, at least.
_WITH_SIGNATURES = 2
# What has no standard, in words: of gravity by its formula the item has no name.
_USED = {
    "": "gravity, by the formula of normal gravity", "temperature": "temperature of the unit",
    "converter_temperature": "temperature of the converter", "time": "time and counting", "meter": "volt- or ammeter",
    "reference_gyro": "reference gyro", "current_injection": "injected current",
}  # fmt: skip


def certificate_facts(report: QualificationReport, found: certificates.Certificate) -> list[tuple[str, str]]:
    """Return the head of a certificate: number, laboratory, customer, item and dates."""
    scope, item = report.scope, found.item
    named = ", ".join(filter(None, (item.description, item.manufacturer, item.model)))
    start, end = (None if each is None else each[:10] for each in (scope.first_start, scope.last_start))
    return [
        ("Certificate", f"{found.number or 'number ' + _NOT_STATED}, issued {found.date or _NOT_STATED}"),
        *([("Amendment", _amendment(found.amendment))] if found.amendment else []),
        ("Laboratory", _party(found.laboratory)),
        ("Customer", _party(found.customer) + (f"; order {found.order}" if found.order else "")),
        ("Item", f"{named or _NOT_STATED}; serial number {report.subject.serial or _NOT_STATED}"),
        ("Received", f"{item.received or _NOT_STATED}" + (f", {item.condition}" if item.condition else "")),
        ("Calibrated", f"{start or _NOT_STATED} to {end or _NOT_STATED}, at {found.location or _NOT_STATED}"),
    ]


def _party(found: certificates.Party) -> str:
    return ", ".join(filter(None, (found.name, found.address, found.country, found.email))) or _NOT_STATED


def certificate_section(report: QualificationReport) -> Iterator[Block]:
    """Return method, traceability, conditions, statements and signatures; without a block the unit g alone."""
    found = report.certificate
    if found is None:
        yield Paragraph(unit_g_text(report))
        return
    yield Heading("Method, traceability and conditions")
    yield Paragraph(_method(found))
    if found.standard:
        yield _standards_table(report, found.standard)
    said = list(statements(report, found))
    for place, text in enumerate(said):
        # A page with signatures alone could be added to any certificate.
        yield Paragraph(text, kept=bool(found.signatory) and place >= len(said) - _WITH_SIGNATURES)
    if found.signatory:
        rows = [cells(each.name, each.function or "–", "_" * 14, "_" * 36) for each in found.signatory]
        yield Sheet("Authorised by", ("name", "function", "date", "signature"), rows, (0, 1, 2, 3))


def _method(found: certificates.Certificate) -> str:
    return f"Method: {found.method or _NOT_STATED}." + (f" Deviations: {found.deviations}." * bool(found.deviations))


def all_statements(report: QualificationReport, found: certificates.Certificate) -> list[str]:
    """Return what a certificate states in words, with what stands against it and what it lacks."""
    rules = [] if report.conformity is None else rules_text(report.conformity.limits)
    lacks = [
        f"{said}: {'; '.join(missing_texts(own))}."
        for said, required in (("Missing from this certificate", True), ("Not in order", False))
        for own in ([each for each in report.missing if each.required == required],)
        if own
    ]
    return [*alarms(report), *lacks, *rules, _method(found), *statements(report, found)]


def statements(report: QualificationReport, found: certificates.Certificate) -> Iterator[str]:
    """Yield traceability, conditions, capability, what results and U are of, remarks and accreditation."""
    yield from _traceability(report, found)
    yield f"Conditions: {_conditions(found.environment)}. Adjustment: {found.adjustment or _NOT_STATED}."
    yield unit_g_text(report)
    yield from _floors(report)
    yield (
        "The results relate only to the item calibrated, at the time and under the conditions of the calibration. The "
        "expanded uncertainty U is the standard uncertainty times the coverage factor k, which for the posterior of "
        "the quantity corresponds to a coverage probability of 95 %; no degrees of freedom may be applied to it. It "
        "was evaluated by JCGM 100 and JCGM 101 and contains no contribution of long-term stability. This certificate "
        "may be reproduced only in full."
    )
    if found.amendment is not None:
        yield f"{_amendment(found.amendment)}."
    yield from _of_others(found)
    if found.remarks:
        yield f"Remarks: {found.remarks}"
    if found.accreditation and not report.missing:
        used = (each.quantity for each in found.cmc if each.quantity not in report.unused_capabilities)
        covered = dict.fromkeys(" ".join(standard_symbol(quantity)).strip() for quantity in used)
        yield (
            f"{found.accreditation.rstrip('.')}. The accreditation covers the quantities with a CMC: "
            f"{', '.join(covered)}. Other results are outside its scope."
        )


def _amendment(found: certificates.Amendment) -> str:
    """Return what an issued certificate becomes, as a sentence without its full stop."""
    what = "Replaces certificate" if found.replaces else "Amendment to certificate"
    reason = "" if found.reason is None else f"; reason: {found.reason.rstrip('.')}"
    return f"{what} {found.of}. Changed: {found.changes.rstrip('.')}{reason}"


def _of_others(found: certificates.Certificate) -> Iterator[str]:
    """Yield what the laboratory did not obtain by itself, and how the item was sampled."""
    for each in found.external:
        yield f"Results of an external provider, {each.provider}: {each.results.rstrip('.')}."
    if found.customer_data:
        yield (
            f"Provided by the customer: {found.customer_data.rstrip('.')}. The laboratory is not responsible for this "
            "information, which can affect the validity of the results."
        )
    if found.sampling:
        yield f"Sampling: {found.sampling.rstrip('.')}."


def _traceability(report: QualificationReport, found: certificates.Certificate) -> Iterator[str]:
    """Yield what the results are traceable through, or what no standard traces."""
    if found.standard and not any(each.item in _OF_STANDARDS for each in report.missing):
        yield "The results are metrologically traceable to the SI through the standards used."
    untraced = [_USED.get(each.of, each.of) for each in report.missing if each.item in ("untraced", "normal_gravity")]
    if untraced:
        yield (
            f"No standard provides traceability for {', '.join(untraced)}. The traceability of results that depend on "
            "these is not shown."
        )


def _floors(report: QualificationReport) -> Iterator[str]:
    """Yield which U are the capability of the laboratory; nothing if none is."""
    if report.floors:
        own = {each.members[0]: (each.symbol, each.label) for each in report.standards if len(each.members) == 1}
        named = "; ".join(
            f"{' '.join(own.get(each.name) or standard_symbol(each.name))}: {significant(each.own, 2)} → "
            f"{significant(each.expanded, 2)} {pretty(each.unit)}"
            for each in report.floors
        )
        yield (
            "U by the budget is smaller than the calibration and measurement capability (CMC) of the laboratory, and "
            f"the CMC is stated in its place (ILAC-P14), for {named}."
        )
    if report.unused_capabilities:
        listed = ", ".join(report.unused_capabilities)
        yield f"Capabilities (CMC) that do not apply, because the certificate has no such quantity: {listed}."


def _standards_table(report: QualificationReport, standards: Sequence[certificates.MeasurementStandard]) -> Sheet:
    expired = {each.of for each in report.missing if each.item == "expired"}
    rows = [
        cells(each.name, ", ".join(each.equipment) or "–", each.serial or "–", each.certificate or _NOT_STATED,
              each.issued_by or "–", str(each.calibrated or ""), _validity(each, each.name in expired))
        for each in standards
    ]  # fmt: skip
    head = ("standard", "in the campaign", "serial number", "certificate", "issued by", "calibrated", "valid until")
    return without_empty_columns(Sheet("Standards used", head, rows, (0, 1, 2, 3, 4, 5, 6)))


def _validity(standard: certificates.MeasurementStandard, expired: bool) -> Cell:
    until = str(standard.valid_until or _NOT_STATED)
    return Cell(f"{until}: expired", "bad") if expired else Cell(until)


def unit_g_text(report: QualificationReport) -> str:
    """Return what 1 g stands for in this document, where it comes from, and its standard uncertainty."""
    subject = report.subject
    place = f"{subject.latitude_deg:.4g}°, {subject.height_m:.4g} m"
    source = "normal gravity" if subject.gravity_is_normal else "gravity as the campaign states it"
    taken = next((each for each in report.exact.inputs if each.effect == GRAVITY), None)
    if subject.gravity_uncertainty_ug is not None:
        known = f"; u = {significant(subject.gravity_uncertainty_ug, 2)} µg, stated"
    elif any(effect.name == GRAVITY for effect in report.provenance.effects):
        known = "; its error is a parameter of the model"
    elif taken is not None:
        known = f"; u = {significant(taken.size, 2)} {pretty(taken.unit)}, assumed" + (
            "" if taken.included else " and not in U"
        )
    else:
        known = ""
    return f"1 g = {subject.gravity_m_s2:.6f} m/s² ({source} at {place}{known})."


def _conditions(found: certificates.Environment) -> str:
    ranges = (
        ("air temperature", found.temperature_degC, "°C"),
        ("relative humidity", found.humidity_percent, "%"),
        ("air pressure", found.pressure_hPa, "hPa"),
    )
    said = [f"{what} {span[0]:g} … {span[1]:g} {unit}" for what, span, unit in ranges if span is not None]
    return ", ".join([*said, *filter(None, (found.text,))]) or _NOT_STATED


def missing_section(missing: Sequence[certificates.Missing]) -> Iterator[Block]:
    """Return what ISO/IEC 17025 requires of a certificate and this one lacks, and what else stands against it."""
    required = [each for each in missing if each.required]
    others = [each for each in missing if not each.required]
    if required:
        yield Heading("Missing from this certificate")
        yield Paragraph(
            "ISO/IEC 17025:2017 requires the following items, which are missing. Without them, "
            "this document is not a certificate of an accredited laboratory.",
            "weak",
        )
        yield Items(missing_texts(required))
    if others:
        yield Heading("Not in order")
        yield Paragraph(
            "The following statements of this certificate do not agree with the campaign, or are not sufficient:",
            "weak",
        )
        yield Items(missing_texts(others))


def missing_texts(missing: Sequence[certificates.Missing]) -> list[str]:
    """Return each thing that is missing or not in order, with the clause that requires it."""
    return [_MISSING[each.item].format(of=each.of) for each in missing]

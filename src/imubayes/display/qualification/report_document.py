"""From the record of a report to its document: all that is said and drawn comes from the record."""

from collections.abc import Iterator

from imubayes.display.qualification.budget_sections import budget_section
from imubayes.display.qualification.document import Block, Heading, Paragraph, ReportDocument
from imubayes.display.qualification.error_drawings import error_drawings, worst_drawing
from imubayes.display.qualification.first_page import alarms, banner, facts, limits_table, risk_table
from imubayes.display.qualification.forest_drawings import forest_drawings
from imubayes.display.qualification.model_sections import (
    adequacy_section,
    convergence_section,
    equipment_section,
    left_out_section,
    provenance_section,
    scope_section,
)
from imubayes.display.qualification.mounting_drawings import angle_drawings, mounting_drawings
from imubayes.display.qualification.result_sections import (
    combination_section,
    converter_section,
    mounting_section,
    result_section,
    standards_section,
)
from imubayes.qualification.report_record import QualificationReport


def report_document(report: QualificationReport) -> ReportDocument:
    """Return the report as a document."""
    serial = report.subject.serial or report.subject.campaign
    made = report.provenance
    return ReportDocument(
        title="Uncertainty report for qualification",
        subtitle=f"Unit {serial}",
        banner=banner(report),
        alarms=alarms(report),
        facts=facts(report),
        blocks=tuple(_blocks(report)),
        footer=f"Unit {serial} · data {made.data_sha256[:12]} · model {made.model_sha256[:12]}",
    )


def _blocks(report: QualificationReport) -> Iterator[Block]:
    conformity, pictures = report.conformity, report.pictures
    if conformity is not None and conformity.limits:
        yield limits_table(conformity.limits)
    yield Heading("Errors of the unit")
    drawn = error_drawings(pictures)
    if drawn is not None:
        yield drawn
    else:
        yield Paragraph("There is nothing to draw: the fit did not converge, or the runs vary nothing.")
    if conformity is not None:
        yield Heading("Conformity to the specification")
        yield Paragraph(f"Specification “{conformity.specification}”, SHA-256 {conformity.sha256}.")
        if conformity.limits:
            yield risk_table(conformity.limits)
    yield from standards_section(report)
    yield from mounting_section(report.mounting_angles)
    for drawings in (mounting_drawings(pictures), angle_drawings(pictures)):
        if drawings is not None:
            yield drawings
    yield from combination_section(report.combinations)
    yield from converter_section(report.thermal_linearity, report.results)
    yield from budget_section(report)
    yield from adequacy_section(report.adequacy)
    if pictures.worst is not None:
        yield worst_drawing(pictures.worst)
    yield from convergence_section(report.convergence)
    yield from left_out_section(report.left_out)
    yield from scope_section(report.scope)
    yield from result_section(report)
    forest = forest_drawings(report.results)
    if forest is not None:
        yield forest
    yield from equipment_section(report.subject)
    yield from provenance_section(report.provenance)

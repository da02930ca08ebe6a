"""The qualification report as a document, and its files: HTML, PDF, JSON, DCC (XML) and covariances (CSV).

All that is said and drawn comes from the record of the report.  The ending of a file chooses its format.  The document
is a certificate of two pages, and annexes: results, budgets, and the evidence for the model.

The HTML page has no script and no link to anything outside; pictures are inline SVG.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Literal, get_args

from markupsafe import Markup, escape

from imubayes.display.layout import Sheet, render
from imubayes.foundations.errors import Issue, closest_first, input_error, refuse
from imubayes.foundations.files import only_writer, refuse_existing, replacing
from imubayes_qualification.certificate.report_record import QualificationReport
from imubayes_qualification.display.report import (
    exact_tables,
    first_page,
    model_sections,
    result_sections,
    unit_drawings,
    words,
)
from imubayes_qualification.display.report.budget_sections import budget_section
from imubayes_qualification.display.report.calibration_xml import covariance_file, dcc_file
from imubayes_qualification.display.report.certificate_pages import (
    certificate_facts,
    certificate_section,
    missing_section,
)
from imubayes_qualification.display.report.document import Block, Heading, Items, Paragraph, ReportDocument, typeset
from imubayes_qualification.display.report.equations import measurement_section
from imubayes_qualification.display.report.pdf_file import pdf_file
from imubayes_qualification.display.report.quantity_drawings import forest_drawings

Layout = tuple[tuple[str, ...], tuple[int, ...]]


def html_page(document: ReportDocument) -> str:
    """Return a document as an HTML page."""
    headings = [block for block in document.blocks if block.type == "heading" and block.level <= 2]
    # Drawings are SVG that this package made; all else is escaped.
    layouts = list(dict.fromkeys(_layout(block) for block in document.blocks if isinstance(block, Sheet)))
    page = render(
        "qualification", "imubayes_qualification.display",
        document=document, headings=headings, drawing=Markup, anchor=_anchor, formula=_formula,
        prose=_prose, breakable=_breakable,
        column_styles=Markup("\n".join(_column_style(place, layout) for place, layout in enumerate(layouts))),
        layout_of=lambda table: layouts.index(_layout(table)),
    )  # fmt: skip
    return page.lstrip() + "\n"


def _layout(table: Sheet) -> Layout:
    return tuple(table.head), tuple(table.left)


def _column_style(place: int, layout: Layout) -> str:
    """Return the rules for tables with the same columns: alignment, and on a phone the name beside each number.

    One rule for a column in place of an attribute of each cell halves the size of the page.
    """
    head, left = layout
    rules = []
    for column, name in enumerate(head, 1):
        cell = f".t{place} td:nth-child({column})"
        if column - 1 in left:
            rules.append(f"@media not (max-width: 640px) {{ {cell} {{ text-align: left; }} }}")
        quoted = name.replace("\\", "\\\\").replace('"', '\\"').replace("<", "\\3c ")
        rules.append(f'@media (max-width: 640px) {{ {cell}::before {{ content: "{quoted}"; }} }}')
    return "\n".join(rules)


def _formula(text: str) -> Markup:
    """Return a formula with its subscripts; everything else in it is escaped."""
    return Markup(re.sub(r"_([^\W²³]+′?)", r"<sub>\1</sub>", str(escape(text))))


def _breakable(text: str) -> Markup:
    """Return the text of a cell, escaped, whose names may break between their parts, and hashes anywhere."""
    parts = re.sub(r"(?<=[a-z])\.(?=[a-z])", ".<wbr>", _symbols(str(escape(text)))).replace("[", "<wbr>[")
    return Markup(re.sub(r"(\w{16})(?=\w{24})", r"\1<wbr>", parts))


def _prose(text: str) -> Markup:
    """Return prose, its commands between backticks set as code, its symbols with subscripts, all else escaped."""
    parts = re.split(r"`([^`]+)`", str(escape(text)))
    return Markup("".join(f"<code>{part}</code>" if place % 2 else _symbols(part) for place, part in enumerate(parts)))


def _symbols(text: str) -> str:
    """Return escaped text with the subscripts of symbols of one letter, ``D_F``, ``ΔK_1``; names, ``d_i``, stay."""
    return re.sub(r"\b(Δ?[^\W\d_dk])_(\w{1,3})\b(?!\[)", r"\1<sub>\2</sub>", text)


def _anchor(heading: str) -> str:
    return "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in heading.lower())


Annex = Literal["results", "budgets", "evidence"]
ANNEXES: tuple[Annex, ...] = get_args(Annex)
_TITLES: dict[Annex, str] = {
    "results": "results",
    "budgets": "uncertainty budgets",
    "evidence": "model, convergence and record",
}
# Annex that has the table of a kind of quantity; those of the standards are in all.
_ANNEX_OF: dict[exact_tables.Kind, Annex] = {
    "angle": "results", "combination": "results", "converter": "results", "result": "evidence",
}  # fmt: skip


def report_document(report: QualificationReport, annexes: Sequence[Annex] = ANNEXES) -> ReportDocument:
    """Return the report as a document: certificate, then the annexes."""
    serial, block = report.subject.serial or report.subject.campaign, report.certificate
    made = report.provenance
    number = f"{block.number} · " if block is not None and block.number else ""
    of = "" if block is None else f" {block.number or ''}".rstrip()
    own = () if block is None else certificate_facts(report, block)
    document = ReportDocument(
        title="Uncertainty report for qualification" if block is None else f"{block.title}{of}",
        subtitle=f"Unit {serial}",
        banner=first_page.banner(report),
        alarms=first_page.alarms(report),
        facts=(*own, *first_page.facts(report)),
        blocks=tuple(filter(None, _blocks(report, annexes))),
        author=(block and block.laboratory.name) or "imubayes",
        footer=f"{number}Unit {serial} · data {made.data_sha256[:12]} · model {made.model_sha256[:12]}",
    )
    return typeset(document)


def _blocks(report: QualificationReport, annexes: Sequence[Annex]) -> Iterator[Block | None]:
    """Yield the blocks in order; None for a drawing that has nothing to show."""
    conformity = report.conformity
    if conformity is not None and conformity.limits:
        yield first_page.limits_table(
            conformity.limits, first_page.components_of(report), words.reference_temperature(report)
        )
    omitted = exact_tables.omissions(report)
    yield exact_tables.omitted_table([each for each in omitted if _ANNEX_OF.get(each.kind) in (None, *annexes)])
    yield exact_tables.included_table(report)
    if conformity is None:  # then the quantities themselves are what is certified
        note = exact_tables.omitted_note(omitted, "standard")
        yield from result_sections.standards_section(report, note, exact_tables.omitted_beside(report))
    else:
        yield Heading("Conformity to the specification")
        yield Paragraph(f"Specification “{conformity.specification}”, SHA-256 {conformity.sha256}.")
        yield Items(first_page.rules_text(conformity.limits))
    yield from certificate_section(report)
    for each in report.supplied:
        yield from result_sections.supplied_section(each)
    made: dict[Annex, Callable[[], Iterator[Block | None]]] = {
        "results": partial(_results, report, omitted),
        "budgets": partial(budget_section, report),
        "evidence": partial(_evidence, report, omitted),
    }
    chosen: list[Annex] = [each for each in ANNEXES if each in annexes]
    for letter, annex in zip("ABC", chosen, strict=False):
        yield Heading(f"Annex {letter}: {_TITLES[annex]}", 1)
        yield from made[annex]()
    yield from missing_section(report.missing)
    name = "report" if report.certificate is None else f"certificate {report.certificate.number or ''}".rstrip()
    yield Paragraph(f"End of the {name}.", "dim")


def _results(report: QualificationReport, omitted: Sequence[exact_tables.Omission]) -> Iterator[Block | None]:
    pictures, beside = report.pictures, exact_tables.omitted_beside(report)
    if report.conformity is not None:
        yield from result_sections.standards_section(report, exact_tables.omitted_note(omitted, "standard"), beside)
    yield exact_tables.sensitivity_table(report)
    yield Heading("Errors of the unit")
    nothing = Paragraph("There is nothing to draw: the fit did not converge, or no quantity varies in the runs.")
    yield unit_drawings.error_drawings(pictures) or nothing
    yield from result_sections.mounting_section(
        report.mounting_angles, exact_tables.omitted_note(omitted, "angle"), beside
    )
    yield unit_drawings.mounting_drawings(pictures)
    yield unit_drawings.angle_drawings(pictures)
    yield from result_sections.combination_section(
        report.combinations, exact_tables.omitted_note(omitted, "combination"), beside
    )
    yield from result_sections.converter_section(
        report.thermal_linearity, report.results, exact_tables.omitted_note(omitted, "converter"), beside
    )
    if report.conformity is not None and report.conformity.limits:
        yield first_page.risk_table(report.conformity.limits)
    yield from measurement_section(report.measurement)
    yield from model_sections.scope_section(report.scope)


def _evidence(report: QualificationReport, omitted: Sequence[exact_tables.Omission]) -> Iterator[Block | None]:
    yield from model_sections.adequacy_section(report.adequacy)
    if report.pictures.worst is not None:
        yield unit_drawings.worst_drawing(report.pictures.worst)
    yield from model_sections.convergence_section(report.convergence)
    yield from model_sections.left_out_section(report.left_out)
    note = exact_tables.omitted_note(omitted, "result")
    yield from result_sections.result_section(report, note, exact_tables.omitted_beside(report))
    yield forest_drawings(report.results)
    yield from model_sections.equipment_section(report.subject)
    yield from model_sections.provenance_section(report.provenance)


def _pdf(report: QualificationReport, annexes: Sequence[Annex] | None) -> bytes:
    document = report_document(report, ("results",) if annexes is None else annexes)
    return pdf_file(document, report.json_text(), None if report.certificate is None else report.certificate.date)


def _page(report: QualificationReport, annexes: Sequence[Annex] | None) -> bytes:
    return html_page(report_document(report, ANNEXES if annexes is None else annexes)).encode()


def known_annexes(asked: Sequence[str] | None) -> tuple[Annex, ...] | None:
    """Return the annexes that are asked for by name, `all` or `none`; None if nothing is asked for.

    Raises
    ------
    InputError
        for a name that is none.
    """
    if asked is None:
        return None
    for name in asked:
        if name not in (*ANNEXES, "all", "none"):
            allowed = closest_first(name, (*ANNEXES, "all", "none"))
            raise input_error(f"there is no annex '{name}'", "annexes", allowed, "name an annex")
    return tuple(each for each in ANNEXES if each in asked or "all" in asked)


_Writer = Callable[[QualificationReport, Sequence[Annex] | None], bytes]
_WRITERS: dict[str, tuple[_Writer, bytes]] = {
    ".html": (_page, b"<!doctype html>"),
    ".pdf": (_pdf, b"%PDF"),
    ".xml": (lambda report, chosen: dcc_file(report), b"<?xml"),
    ".csv": (lambda report, chosen: covariance_file(report), b"name,unit,value,standard_uncertainty,"),
    ".json": (lambda report, chosen: report.json_text().encode(), b'{\n "format": 1,\n "interval":'),
}
"""Ending → what makes the file, and how such a file begins."""


@contextmanager
def places_held(files: Sequence[Path]) -> Iterator[None]:
    """Hold files for a report until the block ends, before anything is computed.

    Raises
    ------
    InputError
        for an ending that is unknown, a file that exists and is no report, and one that another process writes.
    """
    _check_places(files)
    with ExitStack() as held:
        for file in dict.fromkeys(file.resolve() for file in files):
            held.enter_context(only_writer(file))
        yield


def _check_places(files: Sequence[Path]) -> None:
    refuse(
        Issue(
            f"the extension of '{file.name}' is not that of a report", "option --out",
            closest_first(file.suffix, _WRITERS),
            "choose one of these",
        )
        for file in files if file.suffix.lower() not in _WRITERS
    )  # fmt: skip
    for file in files:
        start = _WRITERS[file.suffix.lower()][1]
        refuse_existing(file, but=lambda content, start=start: content.startswith(start))


def write_report(report: QualificationReport, files: Sequence[Path], annexes: Sequence[Annex] | None = None) -> None:
    """Write a report to files, each replaced atomically.

    Parameters
    ----------
    annexes : of page and PDF; None for all of a page, and for the results alone of a PDF.
    """
    # What a format lacks is reported before any file is written.
    contents = [_WRITERS[file.suffix.lower()][0](report, annexes) for file in files]
    for file, content in zip(files, contents, strict=True):
        file.parent.mkdir(parents=True, exist_ok=True)
        with replacing(file) as scratch:
            scratch.write_bytes(content)

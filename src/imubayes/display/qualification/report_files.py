"""The qualification report as a document, and its files: HTML, PDF and JSON.

All that is said and drawn comes from the record of the report.  The ending of a file chooses its format.

The HTML page has no script and no link to anything outside; pictures are inline SVG.  The PDF file is PDF/A-3, set by
Typst, with the record attached as `report.json`.  Fonts are those that come with Typst and with Matplotlib, so that the
same input gives the same bytes everywhere.
"""

import json
import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import lazy_loader
import matplotlib as mpl
from markupsafe import Markup, escape

from imubayes.display.layout import render
from imubayes.display.qualification import model_sections, result_sections, unit_drawings
from imubayes.display.qualification.budget_sections import budget_section
from imubayes.display.qualification.document import (
    Block,
    Drawings,
    Heading,
    Paragraph,
    ReportDocument,
    ReportTable,
)
from imubayes.display.qualification.first_page import (
    alarms,
    banner,
    components_of,
    exact_table,
    facts,
    limits_table,
    risk_table,
)
from imubayes.display.qualification.quantity_drawings import forest_drawings
from imubayes.foundations.errors import InputError, Issue, closest_first, input_error
from imubayes.foundations.files import only_writer, refuse_existing, replacing
from imubayes.qualification.report_record import QualificationReport

Layout = tuple[tuple[str, ...], tuple[int, ...]]


def html_page(document: ReportDocument) -> str:
    """Return a document as an HTML page."""
    headings = [block.text for block in document.blocks if block.type == "heading" and block.level == 2]
    # Drawings are SVG that this package made; all else is escaped.
    layouts = list(dict.fromkeys(_layout(block) for block in document.blocks if isinstance(block, ReportTable)))
    page = render(
        "qualification", document=document, headings=headings, drawing=Markup, anchor=_anchor, formula=_formula,
        prose=_prose, breakable=_breakable,
        column_styles=Markup("\n".join(_column_style(place, layout) for place, layout in enumerate(layouts))),
        layout_of=lambda table: layouts.index(_layout(table)),
    )  # fmt: skip
    return page.lstrip() + "\n"


def _layout(table: ReportTable) -> Layout:
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
    parts = re.sub(r"(?<=[a-z])\.(?=[a-z])", ".<wbr>", str(escape(text))).replace("[", "<wbr>[")
    return Markup(re.sub(r"(\w{16})(?=\w{24})", r"\1<wbr>", parts))


def _prose(text: str) -> Markup:
    """Return prose with its commands, which stand between backticks, set as code; everything else is escaped."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def _anchor(heading: str) -> str:
    return "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in heading.lower())


typst: Any = lazy_loader.load("typst")
# A column whose longest text is shorter than this keeps its width; wider ones share what is left.  All keep theirs
# where a row of the longest texts, with the gap beside each, fits the page.
_NARROW, _WIDEST, _GAP, _PAGE = 24, 60, 2, 125


def pdf_file(document: ReportDocument, record: str) -> bytes:
    """Return a document as PDF.

    Parameters
    ----------
    record : JSON text of the record, which is attached.

    Raises
    ------
    InputError
        where Typst is not installed.
    """
    _need_typst()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        template = files("imubayes.display").joinpath("templates/qualification.typ").read_text(encoding="utf-8")
        (folder / "main.typ").write_text(template, encoding="utf-8")
        (folder / "document.json").write_text(
            json.dumps(_content(document), ensure_ascii=False, default=_members), encoding="utf-8"
        )
        (folder / "report.json").write_text(record, encoding="utf-8")
        return typst.compile(
            str(folder / "main.typ"),
            root=scratch,
            font_paths=[str(Path(mpl.get_data_path()) / "fonts" / "ttf")],
            ignore_system_fonts=True,
            pdf_standards=["a-3a"],
            timestamp=0,
        )


def _need_typst() -> None:
    try:
        typst.compile  # noqa: B018  (the module is loaded when it is first used)
    except ModuleNotFoundError as error:
        what, without = "PDF files need the package 'typst'", "an .html or .json file without it"
        raise input_error(what, "option --out", without, "pip install 'imubayes[pdf]'") from error


def _content(document: ReportDocument) -> dict[str, Any]:
    """Return the document for the template, with the widths of columns and drawings."""
    content = _members(document) | {"blocks": [_members(block) for block in document.blocks]}
    for part, block in zip(content["blocks"], document.blocks, strict=True):
        if isinstance(block, ReportTable):
            part["widths"] = _widths(block)
        elif isinstance(block, Drawings):
            part["drawings"] = [_members(each) | {"wide": each.wide} for each in block.drawings]
    return content


def _members(value: Any) -> dict[str, Any]:
    """Return the fields of a dataclass."""
    return {field.name: getattr(value, field.name) for field in fields(value)}


def _widths(table: ReportTable) -> list[int]:
    """Return the share of each column in the free width; 0 for a column as wide as its content."""
    longest = [
        max(len(head), *(len(row[column].text) for row in table.rows), 0) for column, head in enumerate(table.head)
    ]
    if sum(length + _GAP for length in longest) <= _PAGE:
        return [0] * len(longest)
    return [0 if length <= _NARROW else min(length, _WIDEST) for length in longest]


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
        blocks=tuple(filter(None, _blocks(report))),
        footer=f"Unit {serial} · data {made.data_sha256[:12]} · model {made.model_sha256[:12]}",
    )


def _blocks(report: QualificationReport) -> Iterator[Block | None]:
    """Yield the blocks in order; None for a drawing that has nothing to show."""
    conformity, pictures = report.conformity, report.pictures
    if conformity is not None and conformity.limits:
        yield limits_table(conformity.limits, components_of(report))
    yield exact_table(report)
    yield Heading("Errors of the unit")
    nothing = Paragraph("There is nothing to draw: the fit did not converge, or the runs vary nothing.")
    yield unit_drawings.error_drawings(pictures) or nothing
    if conformity is not None:
        yield Heading("Conformity to the specification")
        yield Paragraph(f"Specification “{conformity.specification}”, SHA-256 {conformity.sha256}.")
        if conformity.limits:
            yield risk_table(conformity.limits)
    yield from result_sections.standards_section(report)
    yield from result_sections.mounting_section(report.mounting_angles)
    yield unit_drawings.mounting_drawings(pictures)
    yield unit_drawings.angle_drawings(pictures)
    yield from result_sections.combination_section(report.combinations)
    yield from result_sections.converter_section(report.thermal_linearity, report.results)
    yield from budget_section(report)
    yield from model_sections.adequacy_section(report.adequacy)
    if pictures.worst is not None:
        yield unit_drawings.worst_drawing(pictures.worst)
    yield from model_sections.convergence_section(report.convergence)
    yield from model_sections.left_out_section(report.left_out)
    yield from model_sections.scope_section(report.scope)
    yield from result_sections.result_section(report)
    yield forest_drawings(report.results)
    for each in report.supplied:
        yield from result_sections.supplied_section(each)
    yield from model_sections.equipment_section(report.subject)
    yield from model_sections.provenance_section(report.provenance)


_WRITERS: dict[str, tuple[Callable[[QualificationReport], bytes], bytes]] = {
    ".html": (lambda report: html_page(report_document(report)).encode(), b"<!doctype html>"),
    ".pdf": (lambda report: pdf_file(report_document(report), report.json_text()), b"%PDF"),
    ".json": (lambda report: report.json_text().encode(), b'{\n "format": 1,\n "interval":'),
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
    issues = [
        Issue(
            f"'{file.name}' has no ending of a report", "option --out", closest_first(file.suffix, _WRITERS),
            "choose one of these",
        )
        for file in files if file.suffix.lower() not in _WRITERS
    ]  # fmt: skip
    if issues:
        raise InputError(issues)
    for file in files:
        start = _WRITERS[file.suffix.lower()][1]
        refuse_existing(file, but=lambda content, start=start: content.startswith(start))


def write_report(report: QualificationReport, files: Sequence[Path]) -> None:
    """Write a report to files, each replaced atomically."""
    for file in files:
        content = _WRITERS[file.suffix.lower()][0](report)
        file.parent.mkdir(parents=True, exist_ok=True)
        with replacing(file) as scratch:
            scratch.write_bytes(content)

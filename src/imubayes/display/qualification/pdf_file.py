"""The report as a PDF file (PDF/A-3), set by Typst; the record is attached as `report.json`.

Fonts are those that come with Typst and with Matplotlib, so that the same input gives the same bytes everywhere.
"""

import json
import tempfile
from dataclasses import fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import lazy_loader
import matplotlib as mpl

from imubayes.display.qualification.document import Drawings, ReportDocument, ReportTable
from imubayes.errors import InputError, Issue

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
        raise InputError(
            Issue(
                "PDF files need the package 'typst'",
                "option --out",
                "an .html or .json file without it",
                "pip install 'imubayes[pdf]'",
            )
        ) from error


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

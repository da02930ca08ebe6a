"""A document as PDF/A-3, set by Typst, with the record attached as `report.json`.

Fonts are those that come with Typst and with Matplotlib, so that the same input gives the same bytes everywhere.  They
have no Chinese, Japanese or Korean characters: if a document has such, as in a serial number, a font of the system
that has them is taken as well; if there is none, each stands as its code point, U+6D4B.
"""

import json
import re
import tempfile
from collections.abc import Iterator
from dataclasses import fields
from datetime import UTC, date, datetime
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.font_manager import findSystemFonts
from matplotlib.ft2font import FT2Font

from imubayes.display.layout import Sheet
from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import input_error
from imubayes_qualification.display.report.document import Drawings, ReportDocument

typst: Any = DeferredModule("typst")
# A column whose longest text is shorter than this keeps its width; wider ones share what is left.  All keep theirs
# if a row of the longest texts, with the gap beside each, fits the page.
_NARROW, _WIDEST, _GAP, _PAGE = 24, 60, 2, 125
_BREAK = "\u200b"
# Names of quantities may break at their dots, underscores and brackets; a number has none before a letter, and a symbol
# of one letter, D_F, stays whole.  The template makes a break of the mark and keeps it out of the text.
_PART_OF_NAME = re.compile(r"(?<=[A-Za-z\]])([.\[,]|_(?<=[A-Za-z]{2}_))(?=[A-Za-z])")
_SHAPES = "DejaVu"


def pdf_file(document: ReportDocument, record: str, issued: date | None = None) -> bytes:
    """Return a document as PDF.

    Parameters
    ----------
    record : JSON text of the record, which is attached.
    issued : date of the document; the first of January 1970 if None, so that the same input gives the same bytes.

    Raises
    ------
    InputError
        if Typst is not installed.
    """
    _need_typst()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        template = (
            files("imubayes_qualification.display").joinpath("templates/qualification.typ").read_text(encoding="utf-8")
        )
        (folder / "main.typ").write_text(template, encoding="utf-8")
        text = json.dumps(_content(document, issued), ensure_ascii=False, default=_members)
        fonts = [each for each in map(_system_font, missing_characters(text)) if each is not None]
        families = list(dict.fromkeys(FT2Font(font).family_name for font in fonts))
        content = json.loads(_with_code_points(text)) | {"families": families}
        (folder / "document.json").write_text(json.dumps(content, ensure_ascii=False), encoding="utf-8")
        (folder / "report.json").write_text(record, encoding="utf-8")
        at = datetime(issued.year, issued.month, issued.day, tzinfo=UTC) if issued is not None else None
        return typst.compile(
            str(folder / "main.typ"),
            root=scratch,
            font_paths=[str(_own_fonts()), *sorted({str(Path(font).parent) for font in fonts})],
            ignore_system_fonts=True,
            pdf_standards=["a-3a"],
            timestamp=0 if at is None else int(at.timestamp()),
        )


def _need_typst() -> None:
    try:
        typst.compile  # noqa: B018  (the module is loaded when it is first used)
    except ModuleNotFoundError as error:
        what, without = "PDF files need the package 'typst'", "an .html or .json file without it"
        raise input_error(what, "option --out", without, "pip install 'imubayes[pdf]'") from error


def _own_fonts() -> Path:
    return Path(mpl.get_data_path()) / "fonts" / "ttf"


@cache
def _own_characters() -> frozenset[int]:
    """Return the code points that the fonts of Matplotlib have; those of Typst have no others that text needs."""
    known = (FT2Font(str(font)).get_charmap() for font in _own_fonts().glob(f"{_SHAPES}Sans*.ttf"))
    return frozenset(point for each in known for point in each)


def missing_characters(text: str) -> list[str]:
    """Return the characters of a text that no font of the package has, in the order of their code points."""
    return sorted({each for each in text if each.isprintable() and ord(each) not in _own_characters()} - {_BREAK})


@cache
def _system_fonts() -> tuple[str, ...]:
    return tuple(sorted(findSystemFonts()))


@cache
def _system_font(character: str) -> str | None:
    """Return a font file of the system that has a character, the first by name; None if there is none."""
    return next((font for font in _system_fonts() if ord(character) in _characters_of(font)), None)


@cache
def _characters_of(font: str) -> frozenset[int]:
    try:
        return frozenset(FT2Font(font).get_charmap())
    except (RuntimeError, OSError):  # no outline font
        return frozenset()


def shown_by_code_points(text: str) -> tuple[str, ...]:
    """Return the characters that neither the package nor the system has a font for."""
    return tuple(each for each in missing_characters(text) if _system_font(each) is None)


def _with_code_points(text: str) -> str:
    for each in shown_by_code_points(text):
        text = text.replace(each, f"U+{ord(each):04X} ")
    return text


def breakable(text: str) -> str:
    """Return a text whose long names may break between their parts; short ones and numbers stay as they are."""
    if len(text) <= _NARROW:
        return text
    return _PART_OF_NAME.sub(rf"\1{_BREAK}", text)


def _kept(text: str) -> str:
    """Return a text whose estimates stand on one line with their uncertainties."""
    return text.replace(" ± ", "\u00a0±\u00a0")


def _content(document: ReportDocument, issued: date | None) -> dict[str, Any]:
    """Return the document for the template, with the widths of columns and drawings, and numbers of figures."""
    content = _members(document) | {"blocks": list(_blocks(document))}
    return content | {"issued": None if issued is None else [issued.year, issued.month, issued.day]}


def _blocks(document: ReportDocument) -> Iterator[dict[str, Any]]:
    figures = 0
    for block in document.blocks:
        part = _members(block)
        if isinstance(block, Sheet):
            part = {name: getattr(block, name) for name in ("type", "title", "head", "left", "note")}
            part["widths"] = _widths(block)
            part["rows"] = [
                [_members(cell) | {"text": cell.text if cell.formula else _kept(breakable(cell.text))} for cell in row]
                for row in block.rows
            ]
        elif isinstance(block, Drawings):
            figures += 1
            part["caption"] = f"Figure {figures}. {block.caption}"
            part["drawings"] = [_members(each) | {"wide": each.wide} for each in block.drawings]
        elif block.type == "items":
            part["items"] = [breakable(item) for item in block.items]
        yield part


def _members(value: Any) -> dict[str, Any]:
    """Return the fields of a dataclass."""
    return {field.name: getattr(value, field.name) for field in fields(value)}


def _widths(table: Sheet) -> list[int]:
    """Return the share of each column in the free width; 0 for a column as wide as its content.

    Every column has room for the longest part of it that does not break; longer ones share what is left.
    """
    columns = [[head, *(row[column].text for row in table.rows)] for column, head in enumerate(table.head)]
    longest = [max(map(len, texts)) for texts in columns]
    if sum(length + _GAP for length in longest) <= _PAGE:
        return [0] * len(longest)
    wide = {place: min(length, _WIDEST) for place, length in enumerate(longest) if length > _NARROW}
    parts = {place: max(map(_longest_part, columns[place])) for place in wide}
    narrow = sum(length for place, length in enumerate(longest) if place not in wide) + _GAP * len(longest)
    spare = max(_PAGE - narrow - sum(parts.values()), 0) / max(sum(wide.values()), 1)
    return [round(parts[place] + spare * wide[place]) if place in wide else 0 for place in range(len(longest))]


def _longest_part(text: str) -> int:
    """Return the length of the longest part of a text that does not break."""
    return max(map(len, re.split(f"[ {_BREAK}]", _kept(breakable(text)))))

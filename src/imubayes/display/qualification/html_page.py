"""The report as one HTML page: no script, no link to anything outside, pictures as inline SVG."""

import re

from markupsafe import Markup, escape

from imubayes.display.qualification.document import ReportDocument
from imubayes.display.templates import render


def html_page(document: ReportDocument) -> str:
    """Return a document as an HTML page."""
    headings = [block.text for block in document.blocks if block.type == "heading" and block.level == 2]
    # Drawings are SVG that this package made; all else is escaped.
    page = render(
        "qualification", document=document, headings=headings, drawing=Markup, anchor=_anchor, formula=_formula
    )
    return page.lstrip() + "\n"


def _formula(text: str) -> Markup:
    """Return a formula with its subscripts; everything else in it is escaped."""
    return Markup(re.sub(r"_(\w+′?)", r"<sub>\1</sub>", str(escape(text))))


def _anchor(heading: str) -> str:
    return "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in heading.lower())

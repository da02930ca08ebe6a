"""The report as one HTML page: no script, no link to anything outside, pictures as inline SVG."""

import re

from markupsafe import Markup, escape

from imubayes.display.qualification.document import ReportDocument, ReportTable
from imubayes.display.templates import render

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

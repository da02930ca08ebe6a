"""A document independent of the medium: headings, paragraphs, facts, tables and SVG drawings, in order.

Drawings are small figures as SVG text that is the same for the same input.  They are embedded in one page, so names
inside an SVG get a prefix of their own.  Text stays text: it can be searched, and is a tenth of the size of its
outlines.
"""

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from imubayes.display.figure_style import HUES, INK, STYLE, FewTicks
from imubayes.display.layout import Sheet, of_columns
from imubayes.display.numbers_and_labels import with_minus

Mood = Literal["", "good", "weak", "bad", "dim"]
# Width of a picture that stands beside another, at most; inches.
_HALF_PAGE = 5.0


@dataclass(frozen=True)
class Heading:
    """A heading; level 1 begins an annex on a page of its own, level 2 a section, level 3 a part of it."""

    text: str
    level: Literal[1, 2, 3] = 2
    type: Literal["heading"] = "heading"


@dataclass(frozen=True)
class Paragraph:
    """A paragraph; one that is kept stands on the page of what follows."""

    text: str
    mood: Mood = ""
    kept: bool = False
    type: Literal["paragraph"] = "paragraph"


@dataclass(frozen=True)
class Items:
    """A list of short statements."""

    items: Sequence[str]
    type: Literal["items"] = "items"


def without_empty_columns(table: Sheet, of: str | None = None) -> Sheet:
    """Return a table without empty columns, such as the unit of an input if all inputs are runs; `of` one head."""
    kept = (
        place
        for place, head in enumerate(table.head)
        if of not in (None, head) or any(row[place].text for row in table.rows)
    )
    return of_columns(table, list(kept))


@dataclass(frozen=True)
class Drawing:
    """A picture as SVG, with its width in inches."""

    svg: str
    width: float
    words: str

    @property
    def wide(self) -> bool:
        """Whether it takes the width of the page, alone."""
        return self.width > _HALF_PAGE


@dataclass(frozen=True)
class Drawings:
    """Pictures beside each other with one caption, which says what a good result looks like."""

    drawings: Sequence[Drawing]
    caption: str
    type: Literal["drawings"] = "drawings"


@dataclass(frozen=True)
class Equations:
    """Equations one below the other: as MathML, as the mathematics of Typst, and in words for who does not see them."""

    mathml: Sequence[str]
    typst: Sequence[str]
    words: Sequence[str]
    type: Literal["equations"] = "equations"


Block = Heading | Paragraph | Items | Sheet | Drawings | Equations


@dataclass(frozen=True)
class Banner:
    """The outcome in words and colour."""

    word: str
    sentence: str
    mood: Mood


@dataclass(frozen=True)
class ReportDocument:
    """A document.

    Attributes
    ----------
    title, subtitle : of the first page.
    banner : outcome.
    alarms : what stands against the use of the numbers.
    facts : label and value.
    blocks : everything that follows.
    footer : at the foot of each page.
    author : in the metadata.
    """

    title: str
    subtitle: str
    banner: Banner
    alarms: Sequence[str]
    facts: Sequence[tuple[str, str]]
    blocks: Sequence[Block] = field(default=())
    footer: str = ""
    author: str = "imubayes"


def typeset(document: ReportDocument) -> ReportDocument:
    """Return a document with its texts as they are printed."""
    banner = replace(document.banner, sentence=with_minus(document.banner.sentence))
    return replace(
        document,
        banner=banner,
        alarms=[with_minus(each) for each in document.alarms],
        facts=[(label, with_minus(value)) for label, value in document.facts],
        blocks=[_typeset(block) for block in document.blocks],
    )


def _typeset(block: Block) -> Block:
    match block:
        case Sheet():
            rows = [[replace(cell, text=with_minus(cell.text)) for cell in row] for row in block.rows]
            return block.changed(title=with_minus(block.title), note=with_minus(block.note), rows=rows)
        case Paragraph():
            return replace(block, text=with_minus(block.text))
        case Items():
            return replace(block, items=[with_minus(item) for item in block.items])
        case Drawings():
            return replace(block, caption=with_minus(block.caption))
    return block


WIDTH = 4.4
LINES: tuple[Literal["-", "--", "-.", ":"], ...] = ("-", "--", "-.", ":")
_STYLE = STYLE.copy()
_STYLE.update({"svg.fonttype": "none", "svg.hashsalt": "imubayes", "axes.unicode_minus": True})
_REFERENCE = re.compile(r"(?<=#)[A-Za-z][\w-]*")
_IDENTITY = re.compile(r' id="([^"]+)"')
_HEADER = re.compile(r"^.*?(?=<svg)|<metadata>.*?</metadata>|<!--.*?-->\n?", re.DOTALL)


def drawn(name: str, words: str, height: float, draw: Callable[[Figure], None], width: float = WIDTH) -> Drawing:
    """Return what `draw` puts on a figure.

    Parameters
    ----------
    name : prefix of the names in the SVG, different for every drawing of a document.
    words : what is drawn, for readers who do not see it.
    height, width : inches.
    """
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height))
        canvas = FigureCanvasSVG(figure)
        draw(figure)
        buffer = io.StringIO()
        canvas.print_svg(buffer, metadata={"Date": None, "Creator": None})
    return Drawing(_cleaned(buffer.getvalue(), name), width, words)


def _cleaned(svg: str, name: str) -> str:
    """Return an SVG without header and unused names, and with a prefix before the others."""
    svg = _HEADER.sub("", svg)
    used = set(_REFERENCE.findall(svg))
    svg = _IDENTITY.sub(lambda found: f' id="{name}-{found[1]}"' if found[1] in used else "", svg)
    return _REFERENCE.sub(lambda found: f"{name}-{found[0]}" if not _is_colour(found[0]) else found[0], svg).strip()


def _is_colour(name: str) -> bool:
    return re.fullmatch(r"[0-9a-fA-F]{6}|[0-9a-fA-F]{3}", name) is not None


def place(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Return axes at a place in inches."""
    across, up = figure.get_size_inches()
    axes = figure.add_axes((left / across, bottom / up, width / across, height / up))
    axes.yaxis.set_major_locator(FewTicks())
    return axes


def title(figure: Figure, text: str) -> None:
    """Write a title at the upper left."""
    width, height = figure.get_size_inches()
    figure.text(0.06 / width, 1 - 0.06 / height, text, va="top", weight="bold", color=INK)


def hue(place_: int) -> str:
    """Return the colour of a channel by its place."""
    return HUES[place_ % len(HUES)]


def line(place_: int) -> Literal["-", "--", "-.", ":"]:
    """Return the line style of a channel by its place: channels can be distinguished without colour."""
    return LINES[place_ % len(LINES)]


def legend(figure: Figure, handles: Sequence) -> None:
    """Put a legend in one line below the title."""
    width, height = figure.get_size_inches()
    figure.legend(
        handles=list(handles), loc="upper left", bbox_to_anchor=(0.06 / width, 1 - 0.25 / height), ncols=len(handles),
        columnspacing=1.0, handlelength=1.8, handletextpad=0.4,
    )  # fmt: skip

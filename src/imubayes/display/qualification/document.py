"""A document independent of the medium: headings, paragraphs, facts, tables and drawings, in order."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

Mood = Literal["", "good", "weak", "bad", "dim"]
_HYPHEN_AS_MINUS = re.compile(r"(?<![\w.\-+])-(?=\d)")
# Width of a picture that stands beside another, at most; inches.
_HALF_PAGE = 5.0


@dataclass(frozen=True)
class Text:
    """Text with its emphasis; in a formula an underscore begins a subscript, ``K_oo``.

    The sign of a negative number is a minus sign.
    """

    text: str
    mood: Mood = ""
    formula: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", _HYPHEN_AS_MINUS.sub("−", self.text))


@dataclass(frozen=True)
class Heading:
    """A heading; level 2 begins a section, level 3 a part of it."""

    text: str
    level: Literal[2, 3] = 2
    type: Literal["heading"] = "heading"


@dataclass(frozen=True)
class Paragraph:
    """A paragraph."""

    text: str
    mood: Mood = ""
    type: Literal["paragraph"] = "paragraph"


@dataclass(frozen=True)
class Items:
    """A list of short statements."""

    items: Sequence[str]
    type: Literal["items"] = "items"


@dataclass(frozen=True)
class ReportTable:
    """A table; its first column names the row.

    Attributes
    ----------
    caption : what it holds.
    head, rows : content.
    left : left-aligned columns; the others are right-aligned.
    note : explanation below it.
    """

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[Text]]
    left: Sequence[int] = (0,)
    note: str = ""
    type: Literal["table"] = "table"


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


Block = Heading | Paragraph | Items | ReportTable | Drawings


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
    """

    title: str
    subtitle: str
    banner: Banner
    alarms: Sequence[str]
    facts: Sequence[tuple[str, str]]
    blocks: Sequence[Block] = field(default=())
    footer: str = ""

"""The index page of a comparison: the five figures that matter first, all others folded, and the tables.

One file beside the folder `figures`, without scripts or external styles; its pictures are the files of that folder.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from imubayes.display.summary_html import summary_html
from imubayes.display.templates import render
from imubayes.results.summary import Summary

FIRST = 5
"""Number of figures that are shown unfolded."""


@dataclass(frozen=True)
class PageFigure:
    """A figure of the page: its file, relative to the page, and its caption."""

    file: str
    caption: str


def comparison_page(summary: Summary, ranked: Sequence[str], captions: Mapping[str, str], notes: Sequence[str]) -> str:
    """Return the page.

    Parameters
    ----------
    ranked : files in `figures`, those that matter most first.
    captions : of each file.
    notes : what was left out.
    """
    shown = [PageFigure(f"figures/{name}", captions[name]) for name in ranked]
    page = {"first": shown[:FIRST], "others": shown[FIRST:], "notes": notes, "tables": Markup(summary_html(summary))}
    return render("comparison", title=f"{summary.campaign}, model {summary.model}", **page).lstrip() + "\n"

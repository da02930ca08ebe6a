"""The text and HTML by which records show themselves in a terminal and in a notebook; registered by importing this."""

from imubayes.display.html import summary_html
from imubayes.display.terminal import summary_text
from imubayes.results.presentation import html_of, text_of
from imubayes.results.result import Result


@text_of.register
def _(record: Result) -> str:
    return summary_text(record.summary.model_dump())


@html_of.register
def _(record: Result) -> str:
    return summary_html(record.summary.model_dump())

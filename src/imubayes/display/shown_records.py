"""The one place where a record is given its headline, its text and its HTML."""

from collections.abc import Callable
from typing import Any

from imubayes.display.layout import Report, report_html, report_text
from imubayes.foundations.records import headline_of, html_of, text_of


def shown_as(record: type, headline: Callable[[Any], str], report: Callable[[Any], Report]) -> None:
    """Register how the records of a class show themselves in terminal and notebook.

    Parameters
    ----------
    record : the class.
    headline : record → its one line.
    report : record → its report, from which text and HTML are made.
    """
    headline_of.register(record, headline)
    text_of.register(record, lambda found: report_text(report(found)))
    html_of.register(record, lambda found: report_html(report(found)))

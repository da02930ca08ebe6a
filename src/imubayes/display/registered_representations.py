"""The text and HTML by which records present themselves in a terminal and a notebook, registered on import."""

from functools import partial

from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.display.change_report import change_report
from imubayes.display.diagnosis_report import diagnosis_report
from imubayes.display.fit_report import summary_report
from imubayes.display.headlines import (
    change_headline,
    diagnosis_headline,
    result_headline,
    tree_headline,
    trials_headline,
)
from imubayes.display.history_table import history_report
from imubayes.display.injection_report import injection_report
from imubayes.display.report_layout import report_html, report_text
from imubayes.display.summary_html import summary_html
from imubayes.loop.injection_recovery import Trials
from imubayes.loop.model_history import Tree
from imubayes.representation import headline_of, html_of, text_of
from imubayes.results.model_change import ModelChange
from imubayes.results.result import Result

_REPORTS = {
    ModelChange: partial(change_report, verbose=True),
    Diagnosis: partial(diagnosis_report, verbose=True),
    Tree: history_report,
    Trials: injection_report,
}
for _record, _report in _REPORTS.items():
    text_of.register(_record, lambda record, report=_report: report_text(report(record)))
    html_of.register(_record, lambda record, report=_report: report_html(report(record)))

headline_of.register(ModelChange, change_headline)
headline_of.register(Diagnosis, diagnosis_headline)
headline_of.register(Tree, tree_headline)
headline_of.register(Trials, trials_headline)
headline_of.register(Result, result_headline)


@text_of.register
def _(record: Result) -> str:
    return report_text(summary_report(record.summary))


@html_of.register
def _(record: Result) -> str:
    return summary_html(record.summary)

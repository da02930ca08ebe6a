"""A result as self-contained HTML for a notebook: no scripts, links or external styles; all text is escaped."""

from imubayes.display.combination_tables import combination_sheet, weak_sheet
from imubayes.display.fit_cautions import alarm_of, notices
from imubayes.display.fit_quality_tables import contribution_sheet, next_run_sheet, run_sheet
from imubayes.display.provenance_line import provenance_line
from imubayes.display.quantity_tables import derived_sheet, parameter_sheet
from imubayes.display.templates import render
from imubayes.results.summary import Summary


def summary_html(summary: Summary) -> str:
    """Return the whole result: convergence, parameters, derived quantities, runs and what is weakly determined."""
    optional = (
        (summary.derived, derived_sheet),
        (summary.runs, run_sheet),
        (summary.combinations, combination_sheet),
        (summary.weak_directions, weak_sheet),
        (summary.next_runs, next_run_sheet),
        (summary.contributions, contribution_sheet),
    )
    sheets = [parameter_sheet(summary), *(sheet(summary) for content, sheet in optional if content)]
    origin = provenance_line(summary.provenance)
    shown = {"alarm": alarm_of(summary), "notices": notices(summary), "sheets": sheets, "origin": origin}
    return render("summary", summary=summary, **shown)

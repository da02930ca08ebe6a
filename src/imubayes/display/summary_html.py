"""A result as self-contained HTML for a notebook: no scripts, links or external styles; all text is escaped."""

from imubayes.display.calibration_sheet import axis_sheet, calibration_sheets
from imubayes.display.fit_cautions import alarm_of, notices
from imubayes.display.fit_report import every_table, weak_lines
from imubayes.display.goodness_of_fit import chi2_text
from imubayes.display.provenance_line import provenance_line
from imubayes.display.quantity_tables import scale_and_angle_sheet
from imubayes.display.templates import render
from imubayes.results.summary import Summary


def summary_html(summary: Summary) -> str:
    """Return the whole result: convergence and calibration; folded, every table of the fit."""
    at_a_glance = [*calibration_sheets(summary), axis_sheet(summary), scale_and_angle_sheet(summary)]
    tables = (at_a_glance, every_table(summary, nuisance=False))
    shown, folded = ([block for sheet in sheets for block in sheet.blocks()] for sheets in tables)
    return render(
        "summary",
        summary=summary,
        alarm=alarm_of(summary),
        notices=notices(summary),
        chi2=chi2_text(summary),
        # Without a channel of its own, such as a result of equipment alone, the parameters stand open.
        shown=shown or folded[:1],
        weak=weak_lines(summary),
        folded=folded if shown else folded[1:],
        origin=provenance_line(summary.provenance),
    )

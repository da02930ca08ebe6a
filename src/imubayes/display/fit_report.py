"""A fit and its classical evaluation as reports for the terminal."""

from imubayes.display.classical_comparison import (
    ClassicalComparison,
    classical_sheet,
    decision_sheet,
    undetermined_sheet,
)
from imubayes.display.combination_tables import combination_sheet, weak_sheet
from imubayes.display.fit_cautions import alarm_of, notices
from imubayes.display.fit_quality_tables import contribution_sheet, next_run_sheet, run_sheet
from imubayes.display.prior_conflicts import conflict_sheet
from imubayes.display.quantity_tables import derived_sheet, is_undetermined, parameter_sheet
from imubayes.display.report_layout import Report
from imubayes.display.table_layout import without_alarm
from imubayes.results.summary import Summary

_FEW_COMBINATIONS, _MANY_COMBINATIONS = 8, 24


def summary_report(summary: Summary, verbose: bool = False) -> Report:
    """Return a summary; nuisance parameters, such as attitudes of poses, and single runs only where `verbose`."""
    most = _MANY_COMBINATIONS if verbose else _FEW_COMBINATIONS
    sheets = [parameter_sheet(summary, nuisance=verbose), derived_sheet(summary)]
    sheets += [run_sheet(summary)] if verbose else []
    sheets += [combination_sheet(summary, most)] if summary.combinations else []
    sheets += [
        weak_sheet(summary),
        conflict_sheet(summary.prior_conflicts),
        next_run_sheet(summary),
        contribution_sheet(summary),
    ]
    chi2 = "–" if summary.chi2 is None else f"{summary.chi2:.1f}"
    closing = (
        f"{_outcome(summary)} chi2 {chi2} for {summary.dof:.0f} degrees of freedom; "
        f"fit {summary.seconds.fit:.1f} s, sampling {summary.seconds.sample:.1f} s; "
        f"intervals are {summary.interval}; uncertainty is the {summary.uncertainty}"
    )
    # A warning stands on the first line, above the first table; nothing comes before it.
    said = notices(summary)
    if not alarm_of(summary):
        return Report(said, sheets, (closing,))
    shown = [sheet for sheet in sheets if sheet.rows]
    return Report((), [*shown[:1], *(without_alarm(sheet) for sheet in shown[1:])], (*said, closing))


def _outcome(summary: Summary) -> str:
    """Return what the first line said, for a reader who sees only the last ones."""
    if summary.implausible or summary.unexplained:
        return "The fit failed; the first line says why."
    if not summary.converged:
        return "The fit did not converge; the first line says why."
    if alarm_of(summary):
        return "Converged, but the intervals cannot be trusted; the first line says why."
    undetermined = sum(map(is_undetermined, summary.parameters))
    determined = (
        "every parameter" if not undetermined else f"all but {undetermined} of {len(summary.parameters)} parameters"
    )
    return f"Converged; the data determined {determined}."


def classical_report(comparison: ClassicalComparison) -> Report:
    """Return classical estimates, and what they leave undetermined."""
    sheets = (classical_sheet(comparison.estimates), decision_sheet(comparison), undetermined_sheet(comparison))
    none = "No classical evaluation applies to these runs."
    return Report((), sheets, () if comparison.estimates else (none,))

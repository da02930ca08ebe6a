"""The classical evaluation of a campaign as a report for the terminal."""

from imubayes.display.classical_comparison import (
    ClassicalComparison,
    classical_sheet,
    decision_sheet,
    undetermined_sheet,
)
from imubayes.display.layout import Report


def classical_report(comparison: ClassicalComparison) -> Report:
    """Return classical estimates, and what they leave undetermined."""
    sheets = (classical_sheet(comparison.estimates), decision_sheet(comparison), undetermined_sheet(comparison))
    none = "No classical evaluation applies to these runs."
    return Report((), sheets, () if comparison.estimates else (none,))

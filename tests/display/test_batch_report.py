"""Units without estimates, on a narrow terminal and a wide one; a unit with several calibrations in the picture."""

import datetime
from pathlib import Path

import polars as pl
import pytest

from imubayes.display.layout import report_text
from imubayes_archive.display.batch_report import batch_report
from imubayes_archive.display.figures.batch import campaign_names
from imubayes_archive.unit_fits.run_batch import BatchProgress

REASON = "line 14 of runs.csv: the temperature is not a number"
FILE = "/archive/2024/units/QA202-2024-05-03.imb"
UNITS = pl.DataFrame(
    {
        "unit": ["QA201", "QA202", "QA202"],
        "date": [datetime.date(2024, 1, 9), datetime.date(2024, 5, 3), datetime.date(2025, 5, 7)],
        "digest": ["a", "b", "c"],
        "status": ["fitted", "failed", "fitted"],
        "reason": ["", REASON, ""],
        "file": ["", FILE, ""],
    }
)


@pytest.mark.parametrize("width", [80, 160])
def test_reason_and_file_stay_readable(width):
    report = batch_report(BatchProgress("key", 3, 0, 3, 1, 4.0), UNITS, Path("results"))
    lines = report_text(report, width).splitlines()
    assert any(REASON in line for line in lines)
    assert any(FILE in line for line in lines)


def test_calibrations_of_one_unit_are_told_apart():
    assert list(campaign_names(UNITS).values()) == ["QA201", "QA202 2024-05", "QA202 2025-05"]

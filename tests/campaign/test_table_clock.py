"""The clock of a table apart from that of the unit is named in a raw log, and other delays are not taken for it."""

from pathlib import Path

import numpy as np
import pytest
from bench_logs import Bench, Unit, rate_log
from test_raw_logs import drawn, write

from imubayes.campaign import inspect_campaign
from imubayes.campaign.reduction import BlockBuilder, clock_offset
from imubayes.campaign.reduction.log_survey import BlockSurvey
from imubayes.campaign.run_tables import RowBatch

RATES, BENCH = (0.0, 50.0, -50.0, 100.0, -100.0, 30.0, 0.0), Bench(column="measured", hold=12.0, hz=50.0, delay=0.0)


def surveyed(columns: dict[str, np.ndarray]) -> BlockSurvey:
    builder = BlockBuilder(tuple(columns))
    builder.push(RowBatch(0, len(columns["time_s"]), columns, {}, {}))
    return builder.finish()


def late(seconds: float, bench: Bench = BENCH) -> dict[str, np.ndarray]:
    """Columns of a log whose unit answers the table after some seconds, which may be negative."""
    columns = rate_log(bench, Unit(), np.random.default_rng(4), RATES)
    columns.pop("a")
    rows = round(seconds * bench.hz)
    moved = {name: np.roll(values, -rows) for name, values in columns.items() if name.startswith("table")}
    kept = slice(max(0, -rows), len(columns["time_s"]) - max(0, rows))
    return {name: moved.get(name, values)[kept] for name, values in columns.items()}


@pytest.mark.parametrize("seconds", [-8.0, -0.3, 0.06, 1.0, 8.0])
def test_the_offset_is_found(seconds: float) -> None:
    found = clock_offset(surveyed(late(seconds)), ["g"])
    assert found is not None
    assert found.seconds == pytest.approx(seconds, abs=0.02)
    assert found.level == pytest.approx(12.0, rel=0.3)


def test_no_offset_is_found_where_there_is_none() -> None:
    columns = late(0.0)
    exact = columns | {"g": 1000.0 * columns["table_rate_deg_s"]}
    for each in (columns, exact):
        found = clock_offset(surveyed(each), ["g"])
        assert found is None or abs(found.seconds) < 0.02


@pytest.mark.parametrize("seed", range(20))
def test_a_table_that_follows_its_command_slowly_is_no_offset(seed: int) -> None:
    bench = drawn(seed)
    found = clock_offset(surveyed(rate_log(bench, Unit(), np.random.default_rng(seed))), ["g"])
    assert found is None or abs(found.seconds) < 0.5 or bench.delay > 0.4


@pytest.mark.parametrize(("seconds", "severity"), [(0.2, None), (1.0, "warning"), (-8.0, "error"), (8.0, "error")])
def test_the_finding_names_the_seconds(tmp_path: Path, seconds: float, severity: str | None) -> None:
    found = inspect_campaign(write(tmp_path, late(seconds))).findings
    named = [finding for finding in found if finding.name == "time_shift"]
    assert [finding.severity for finding in named] == ([severity] if severity else [])
    for finding in named:
        assert f"{abs(seconds):.3g} s {'later' if seconds > 0 else 'earlier'} than" in finding.what
    assert {"channel_unit", "setup_disagrees", "scale_far_from_nominal"}.isdisjoint(each.name for each in found)


def test_rows_of_changing_rate_need_one_clock(tmp_path: Path) -> None:
    columns = late(0.2, Bench(column="measured", hold=12.0, hz=50.0, delay=0.0, angle=True))
    file = write(tmp_path, columns) / "campaign.toml"
    file.write_text(file.read_text().replace('file = "runs', 'transitions = true\nfile = "runs'))
    named = [finding for finding in inspect_campaign(tmp_path).findings if finding.name == "time_shift"]
    assert [finding.severity for finding in named] == ["error"]
    assert "the outputs are 0.2 s later than the columns of the table" in named[0].what

"""Raw logs become rows: the right spans, exactly whole turns, and memory that does not grow with the log."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest

from imubayes.campaign.column_layout import ColumnLayout
from imubayes.campaign.reduction import BlockBuilder, SegmentTracker, Span, constant_spans, reduce_log
from imubayes.campaign.reduction import log_survey as blocks_module
from imubayes.campaign.reduction.span_means import accumulate
from imubayes.campaign.run_tables import TableSource
from imubayes.procedures import PROCEDURES


def reduce_columns(tmp_path: Path, columns: dict, procedure: str = "rate_table"):
    file = tmp_path / "log.parquet"
    pq.write_table(pa.table(columns), file)
    texts = tuple(name for name in columns if name == "segment")
    numbers = tuple(name for name in columns if name not in texts)
    channels = tuple(name for name in numbers if name in ("g", "a"))
    source = TableSource(file, ColumnLayout(tuple(columns), numbers, texts, channels, ()))
    builder, tracker = BlockBuilder(numbers), SegmentTracker()
    rows = 0
    for batch in source:
        builder.push(batch)
        rows += batch.rows
        if texts:
            tracker.push(batch)
    spans = tracker.spans() if texts else None
    return reduce_log(source, PROCEDURES[procedure].reduction, rows, builder.finish(), spans)


def rate_log(hz: float = 100.0, seed: int = 0, noise: float = 0.0) -> dict:
    """0, 36, −90, 0.5 deg/s and 0, each for twenty seconds; a channel swings with the angle."""
    rng = np.random.default_rng(seed)
    time = np.arange(0, 105, 1 / hz)
    knots = [0, 20, 21, 41, 42, 62, 63, 83, 84, 105]
    rate = np.interp(time, knots, [0, 0, 36, 36, -90, -90, 0.5, 0.5, 0, 0])
    angle = np.cumsum(np.concatenate([[0], 0.5 * (rate[1:] + rate[:-1]) / hz]))
    swing = 5 * np.cos(np.deg2rad(angle + 20))
    return {
        "time_s": time,
        "table_rate_deg_s": rate,
        "table_angle_deg": np.mod(angle, 360),
        "g": 10 * rate + 1 + swing + rng.normal(size=len(time)) * noise,
        "a": 7 + rng.normal(size=len(time)) * 0.1,
    }


def test_rates_and_whole_turns(tmp_path: Path) -> None:
    rows = reduce_columns(tmp_path, rate_log())
    np.testing.assert_allclose(rows.numbers["table_rate_deg_s"], [0, 36, -90, 0.5, 0], atol=1e-3)
    # Over whole turns the swing is gone; 36 deg/s makes two turns in 20 s, 90 deg/s makes five less the end.
    assert rows.numbers["g"][1] == pytest.approx(361, abs=2e-6)
    assert rows.numbers["g"][2] == pytest.approx(-899, abs=2e-5)
    np.testing.assert_array_equal(np.isnan(rows.numbers["table_angle_deg"]), [False, True, True, False, False])
    np.testing.assert_allclose(rows.numbers["table_angle_span_deg"][[0, 1, 2, 4]], [0, 360, 1440, 0])
    assert rows.numbers["table_angle_span_deg"][3] == pytest.approx(10, rel=0.02)
    assert rows.numbers["a_sd"] == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("form", ["rows", "cells"])
def test_no_turn_leads_across_a_hole(tmp_path: Path, form: str) -> None:
    log = rate_log()
    hole = (log["time_s"] > 22) & (log["time_s"] < 26)  # 144 deg of the first turn at 36 deg/s
    if form == "rows":
        log = {name: values[~hole] for name, values in log.items()}
    else:
        log["g"] = np.where(hole, np.nan, log["g"])
    rows = reduce_columns(tmp_path, log)
    # One turn is whole behind the hole; the sum over all that is there would be off by the swing.
    assert rows.numbers["g"][1] == pytest.approx(361, abs=1e-4)
    assert rows.numbers["table_angle_span_deg"][1] == 360
    assert rows.numbers["g"][2] == pytest.approx(-899, abs=2e-5)
    assert any("1 means are over the turns between the gaps" in note for note in rows.notes)


def test_what_has_no_whole_turn_between_holes_is_left_out(tmp_path: Path) -> None:
    log = rate_log()
    holes = (log["time_s"] > 21) & (log["time_s"] < 41) & (np.mod(log["time_s"], 8) < 2)
    rows = reduce_columns(tmp_path, {name: values[~holes] for name, values in log.items()})
    assert np.isnan(rows.numbers["g"][1])
    assert np.isfinite(np.delete(rows.numbers["g"], 1)).all()
    assert any("1 left out for lack of a whole turn" in note for note in rows.notes)


def test_a_lost_sample_here_and_there_costs_nothing(tmp_path: Path) -> None:
    log = rate_log()
    kept = np.random.default_rng(1).random(len(log["time_s"])) > 0.2
    rows = reduce_columns(tmp_path, {name: values[kept] for name, values in log.items()})
    # Summed without regard to what is missing the swing of 5 would leave 0.04.
    assert rows.numbers["g"][1] == pytest.approx(361, abs=2e-3)
    assert rows.numbers["g"][2] == pytest.approx(-899, abs=2e-3)


def test_partial_turn_keeps_its_angle(tmp_path: Path) -> None:
    log = rate_log()
    rows = reduce_columns(tmp_path, log)
    angle, span = (np.deg2rad(rows.numbers[name][3]) for name in ("table_angle_deg", "table_angle_span_deg"))
    swing = 5 * np.cos(angle + np.deg2rad(20)) * np.sinc(span / 2 / np.pi)
    assert rows.numbers["g"][3] == pytest.approx(10 * 0.5 + 1 + swing, abs=2e-4)


def test_turns_are_found_without_an_angle_column(tmp_path: Path) -> None:
    log = rate_log()
    del log["table_angle_deg"]
    rows = reduce_columns(tmp_path, log)
    assert rows.numbers["g"][1] == pytest.approx(361, abs=1e-4)
    np.testing.assert_array_equal(np.isnan(rows.numbers["table_angle_deg"]), [False, True, True, True, False])
    assert rows.numbers["table_angle_span_deg"][3] < 11


def test_rate_from_the_angle_column(tmp_path: Path) -> None:
    log = rate_log()
    del log["table_rate_deg_s"]
    rows = reduce_columns(tmp_path, log)
    np.testing.assert_allclose(rows.numbers["table_rate_deg_s"], [0, 36, -90, 0.5, 0], rtol=1e-3, atol=1e-3)
    assert rows.numbers["g"][1] == pytest.approx(361, abs=1e-2)


def test_commanded_rate_runs_ahead_of_the_table(tmp_path: Path) -> None:
    log = rate_log(noise=0.05)
    true = log["table_rate_deg_s"]
    commanded = np.select(
        [log["time_s"] < 20, log["time_s"] < 41, log["time_s"] < 62, log["time_s"] < 83], [0, 36, -90, 0.5]
    )
    del log["table_angle_deg"]
    log |= {"table_rate_deg_s": commanded, "g": 10 * true + 1 + np.random.default_rng(1).normal(size=len(true)) * 0.05}
    rows = reduce_columns(tmp_path, log)
    np.testing.assert_allclose(rows.numbers["g"], [1, 361, -899, 6, 1], atol=0.02)


def test_noisy_measured_rate(tmp_path: Path) -> None:
    log = rate_log()
    log["table_rate_deg_s"] = log["table_rate_deg_s"] + np.random.default_rng(2).normal(size=len(log["g"])) * 0.02
    rows = reduce_columns(tmp_path, log)
    np.testing.assert_allclose(rows.numbers["table_rate_deg_s"], [0, 36, -90, 0.5, 0], atol=5e-3)


def test_dividing_head_positions(tmp_path: Path) -> None:
    hz, hold, move = 20, 10, 3
    angle = np.concatenate(
        [np.r_[np.full(hold * hz, 30.0 * k), np.linspace(30 * k, 30 * k + 30, move * hz)] for k in range(12)]
    )
    columns = {
        "time_s": np.arange(len(angle)) / hz,
        "table_angle_deg": np.mod(angle, 360),
        "a": np.cos(np.deg2rad(angle)),
    }
    rows = reduce_columns(tmp_path, columns, "dividing_head")
    np.testing.assert_allclose(rows.numbers["table_angle_deg"], 30.0 * np.arange(12), atol=1e-6)
    np.testing.assert_allclose(rows.numbers["a"], np.cos(np.deg2rad(30.0 * np.arange(12))), atol=1e-6)
    assert "left out" in rows.notes[0]


def test_angle_at_rest_across_the_full_turn(tmp_path: Path) -> None:
    flicker = np.where(np.arange(400) % 2, 359.999, 0.001)
    columns = {"time_s": np.arange(400) / 20, "table_angle_deg": flicker, "a": np.ones(400)}
    rows = reduce_columns(tmp_path, columns, "dividing_head")
    assert np.mod(rows.numbers["table_angle_deg"][0] + 180, 360) == pytest.approx(180, abs=1e-6)


def test_temperature_bins(tmp_path: Path) -> None:
    time = np.arange(0.0, 3600.0, 0.1)
    temperature = 20 + time / 120 + np.random.default_rng(3).normal(size=len(time)) * 0.05
    columns = {"time_s": time, "converter_temperature_degC": temperature, "a": temperature}
    rows = reduce_columns(tmp_path, columns, "thermal_ramp")
    steps = np.diff(rows.numbers["converter_temperature_degC"])
    assert np.all(steps < 0.35)
    assert np.all(np.diff(rows.numbers["time_s"]) < 61)
    assert 110 < len(steps) < 140
    np.testing.assert_allclose(rows.numbers["a"], rows.numbers["converter_temperature_degC"])
    assert rows.numbers["samples"].sum() == len(time)


def test_a_fast_ramp_keeps_its_rows(tmp_path: Path) -> None:
    """A quarter of a degree in less than a second, and a channel that follows: nothing of it is a transient."""
    time = np.arange(0.0, 400.0, 0.1)
    temperature = 25 - 45 * np.cos(time * 2 * np.pi / 400)
    columns = {"time_s": time, "temperature_degC": temperature, "a": 1 + 1e-3 * temperature}
    rows = reduce_columns(tmp_path, columns, "thermal_ramp")
    assert rows.numbers["samples"].sum() > 0.99 * len(time)
    assert np.ptp(rows.numbers["temperature_degC"]) == pytest.approx(90, abs=0.5)


def test_static_log_without_table_columns(tmp_path: Path) -> None:
    columns = {"time_s": np.arange(0, 100, 0.01), "a": np.ones(10000)}
    rows = reduce_columns(tmp_path, columns)
    assert rows.numbers["samples"] == [10000]


def test_segments(tmp_path: Path) -> None:
    labels = ["a"] * 30 + [None] * 10 + ["b"] * 20 + ["a"] * 5
    columns = {"time_s": np.arange(65.0), "table_rate_deg_s": np.r_[np.zeros(40), np.full(25, 2.0)]}
    columns |= {"g": np.arange(65.0), "segment": labels}
    rows = reduce_columns(tmp_path, columns)
    np.testing.assert_array_equal(rows.numbers["samples"], [30, 20, 5])
    np.testing.assert_allclose(rows.numbers["g"], [14.5, 49.5, 62.0])
    assert rows.unsteady == ()
    columns["segment"] = ["a"] * 65
    assert reduce_columns(tmp_path, columns).unsteady == (0,)


def test_single_rows_stay_single(tmp_path: Path) -> None:
    columns = {"table_angle_deg": 30.0 * np.arange(12), "a": np.arange(12.0)}
    rows = reduce_columns(tmp_path, columns, "dividing_head")
    np.testing.assert_array_equal(rows.numbers["a"], np.arange(12.0))
    assert "each of the 12 rows" in rows.notes[0]


def test_missing_cells(tmp_path: Path) -> None:
    values = np.tile([1.0, 3.0], 100)
    cells = pa.array([None if i % 10 == 0 else v for i, v in enumerate(values)])
    rows = reduce_columns(tmp_path, {"time_s": np.arange(200) / 20, "a": cells})
    assert rows.numbers["a"][0] == pytest.approx(np.mean([v for i, v in enumerate(values) if i % 10]))
    assert "empty cells" in rows.notes[-1]


@pytest.mark.parametrize("sizes", [[1] * 40, [7] * 6, [40], [39, 1], [1, 39]])
def test_batches_do_not_matter(sizes: list[int]) -> None:
    log = rate_log(hz=5)
    names = list(log)
    stop = np.cumsum([round(size / sum(sizes) * len(log["g"])) for size in sizes])
    batches = []
    for start, end in zip([0, *stop[:-1]], [*stop[:-1], len(log["g"])], strict=True):
        numbers = {name: values[start:end] for name, values in log.items()}
        batches.append(blocks_module.RowBatch(int(start), int(end - start), numbers, {}, {}))
    whole = [blocks_module.RowBatch(0, len(log["g"]), log, {}, {})]
    spans = [Span(3, 95), Span(110, 200, True), Span(215, 305, True)]
    for one, other in zip(accumulate(batches, spans, names, 0.2), accumulate(whole, spans, names, 0.2), strict=True):
        np.testing.assert_allclose(one.mean, other.mean, rtol=1e-12)
        np.testing.assert_allclose(one.sd, other.sd, rtol=1e-9, atol=1e-12)
        assert (one.samples, one.turns) == (other.samples, other.turns)


def test_merged_blocks_find_the_same_spans(monkeypatch: pytest.MonkeyPatch) -> None:
    log = rate_log()
    batch = blocks_module.RowBatch(0, len(log["g"]), log, {}, {})

    def spans_with(most: int) -> list[Span]:
        monkeypatch.setattr(blocks_module, "MOST_BLOCKS", most)
        builder = BlockBuilder(list(log))
        builder.push(batch)
        return constant_spans(builder.finish(), ("g",)).spans

    fine, coarse = spans_with(10**6), spans_with(600)
    assert len(fine) == len(coarse) == 5
    for a, b in zip(fine, coarse, strict=True):
        assert abs(a.start - b.start) <= 40
        assert abs(a.stop - b.stop) <= 40


def write_log(file: Path, rows: int) -> None:
    rng = np.random.default_rng(0)
    names = ("time_s", "table_rate_deg_s", "gx", "gy", "gz", "ax", "ay", "az")
    schema = pa.schema([(name, pa.float64()) for name in names])
    with (pq.ParquetWriter if file.suffix == ".parquet" else pacsv.CSVWriter)(file, schema) as writer:
        for start in range(0, rows, 100_000):
            time = (start + np.arange(100_000)) / 1000.0
            rate = 10.0 * np.mod(np.floor(time / 50.0), 7) * (np.mod(time, 50.0) > 1.0)
            noise = np.round(rng.normal(size=(6, len(time))), 3)
            columns = [time, rate, noise[0], noise[1], 1000 * rate + noise[2], noise[3], noise[4], 20000 + noise[5]]
            writer.write_table(pa.table([pa.array(column) for column in columns], schema=schema))


LOAD_LOG = """
import resource, sys
from imubayes.campaign import load_campaign
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
run = load_campaign(sys.argv[1]).runs[-1]
print(run.rows, int(run.samples.sum()), (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


def python(code: str, *words: str) -> str:
    return subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("form", ["parquet", pytest.param("csv", marks=pytest.mark.slow)])
def test_memory_does_not_grow_with_the_log(small: Path, form: str) -> None:
    toml = small / "campaign.toml"
    text = toml.read_text()
    head, _, tail = text.partition('[[run]]\nname = "rates"')
    last = tail[tail.index('[[run]]\nname = "raw"') :].replace("raw.csv", f"raw.{form}")
    toml.write_text(head + last)
    grown = []
    for rows in (300_000, 1_500_000):
        write_log(small / "runs" / f"raw.{form}", rows)
        found, samples, megabytes = map(int, python(LOAD_LOG, str(small)).split())
        assert found == rows // 50_000
        assert samples > 0.8 * rows
        grown.append(megabytes)
    assert grown[1] < 250, f"{grown} MB"
    assert grown[1] - grown[0] < 40, f"{grown} MB"

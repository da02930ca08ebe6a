"""Rows with clipped samples are left out and reported; rows that only repeat a code of a coarse converter are kept."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.csv as pacsv
import pytest
from small_files import GRAVITY, write_csv
from tumble_files import NAMES, channels, tumble_log

from imubayes.campaign import check_campaign, load_campaign
from imubayes.campaign.reduction.free_tumble import reduce_tumble
from imubayes.campaign.stream_checks import _Repeat
from imubayes.foundations.errors import InputError

LIMIT = 80_000.0
RATES = "runs/rates.csv"


def change_columns(file: Path, changed: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]) -> None:
    """Write a table again with some of its columns changed."""
    table = pacsv.read_csv(file)
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    write_csv(file, columns | changed(columns))


def test_means_with_clipped_samples_are_left_out(small: Path) -> None:
    whole = load_campaign(small).runs[-1]
    change_columns(small / "runs/raw.csv", lambda columns: {"gz": np.minimum(columns["gz"], LIMIT)})
    campaign = load_campaign(small)
    run, gz = campaign.runs[-1], [channel.name for channel in campaign.channels].index("gz")
    beyond = whole.observed[:, gz] > LIMIT
    assert 0 < beyond.sum() < run.rows
    np.testing.assert_array_equal(np.isnan(run.observed[:, gz]), beyond)
    np.testing.assert_array_equal(np.isnan(run.sample_sd[:, gz]), beyond)
    np.testing.assert_array_equal(run.observed[~beyond], whole.observed[~beyond])
    np.testing.assert_array_equal(np.delete(run.observed, gz, axis=1), np.delete(whole.observed, gz, axis=1))
    assert f"'gz' is clipped at 80000: {beyond.sum()} of {run.rows} means left out" in run.notes
    (finding,) = check_campaign(small)
    assert (finding.name, finding.severity) == ("saturated_channel", "warning")
    assert "clipped" in finding.what


@pytest.mark.parametrize("limit", [50_000.0, 100_000.0])
def test_clipped_means_of_a_table_are_left_out(small: Path, limit: float) -> None:
    """At several inputs, or at one input in each direction, if the samples do not scatter."""
    whole = load_campaign(small).runs[0]
    gx = 0
    beyond = np.abs(whole.observed[:, gx]) > limit
    assert 0 < beyond.sum() < whole.rows

    def clipped(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {"gx": np.clip(columns["gx"], -limit, limit), "gx_sd": np.where(beyond, 0.0, columns["gx_sd"])}

    change_columns(small / RATES, clipped)
    run = load_campaign(small).runs[0]
    np.testing.assert_array_equal(np.isnan(run.observed[:, gx]), beyond)
    np.testing.assert_array_equal(run.observed[~beyond], whole.observed[~beyond])
    np.testing.assert_array_equal(run.observed[:, 1:], whole.observed[:, 1:])
    (finding,) = check_campaign(small)
    assert (finding.name, finding.severity) == ("saturated_channel", "warning")
    assert f"{beyond.sum()} of {whole.rows} means left out" in finding.what
    assert "rates.csv, column 'gx'" in finding.where
    assert "range" in finding.allowed


def test_a_coarse_output_at_rest_is_not_clipped(small: Path) -> None:
    """At rest, the end of the range here, a coarse converter repeats one code."""
    whole = load_campaign(small).runs[0]
    at_rest = np.abs(whole.covariates["table_rate"]) == np.abs(whole.covariates["table_rate"]).min()

    def one_sided(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        positive = {name: np.abs(columns[name]) for name in ("gx", "gy", "gz", "table_rate_deg_s")}
        return positive | {"gx_sd": np.where(at_rest, 0.0, columns["gx_sd"])}

    change_columns(small / RATES, one_sided)
    assert np.isfinite(load_campaign(small).runs[0].observed).all()


def seen(*parts: np.ndarray) -> _Repeat:
    repeat = _Repeat()
    for part in parts:
        repeat.add(part)
    return repeat


@pytest.mark.parametrize("cut", [1, 40, 90, 130])
def test_a_plateau_at_the_limit_is_clipping_and_a_steady_input_of_a_coarse_converter_is_none(cut: int) -> None:
    ramp = np.arange(120.0)
    clipped = np.concatenate([ramp, np.full(40, 120.0), ramp[::-1]])
    assert seen(*np.split(clipped, [cut])).plateaus(all_move=False) == [(120.0, 40)]
    steady = np.concatenate([np.full(30, 0.0), ramp[1:], np.full(40, 120.0), ramp[::-1], np.full(35, -3.0)])
    assert seen(*np.split(steady, [cut])).plateaus(all_move=False) == []
    assert seen(*np.split(steady, [cut])).plateaus(all_move=True) == [(-3.0, 35), (120.0, 40)]


def clipped_tumble(limit: float) -> dict[str, np.ndarray]:
    columns, _ = tumble_log()
    return columns | {name: np.clip(columns[name], -limit, limit) for name in NAMES[3:]}


def limits_of(columns: dict[str, np.ndarray], limit: float) -> dict[str, tuple[float, ...]]:
    found = {name: tuple(side for side in (-limit, limit) if (columns[name] == side).any()) for name in NAMES[3:]}
    return {name: sides for name, sides in found.items() if sides}


def test_turns_in_which_a_gyro_is_clipped_are_left_out() -> None:
    whole = reduce_tumble(tumble_log()[0], channels(), GRAVITY, None, "log.csv").tumble
    fastest = np.sort(np.abs(whole.readings[:, :, 3:]).max(axis=(1, 2)))
    limit = float(0.5 * (fastest[-3] + fastest[-4]))
    columns = clipped_tumble(limit)
    reduced = reduce_tumble(columns, channels(), GRAVITY, None, "log.csv", limits_of(columns, limit))
    kept = np.abs(whole.readings[:, :, 3:]).max(axis=(1, 2)) < limit
    # A sample may be clipped if the mean of its step is not.
    assert set(reduced.tumble.start) <= set(whole.start[kept])
    assert len(reduced.tumble.start) >= kept.sum() - 2
    assert len(reduced.tumble.step) == len(reduced.tumble.readings) == len(reduced.tumble.start)
    assert any("is clipped at" in note and "transitions left out" in note for note in reduced.notes)
    place = list(whole.start).index(reduced.tumble.start[0])
    width = reduced.tumble.step.shape[1]
    np.testing.assert_array_equal(reduced.tumble.readings[0], whole.readings[place][:width])


def test_a_tumble_clipped_throughout_is_refused() -> None:
    columns = clipped_tumble(0.05)
    with pytest.raises(InputError, match="clipped in every transition"):
        reduce_tumble(columns, channels(), GRAVITY, None, "log.csv", limits_of(columns, 0.05))

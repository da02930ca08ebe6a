"""From campaign folders to the questions asked of an archive, on campaigns of the independent generator."""

from importlib import import_module
from pathlib import Path

import polars as pl
import pytest

from imubayes.cli.main import run
from imubayes_archive.dataset import campaign_folders, pack
from imubayes_archive.population.parameter_population import populations
from imubayes_archive.unit_fits.fit_chunk import in_process
from imubayes_archive.unit_fits.pooled_discovery import pooled_discovery
from imubayes_archive.unit_fits.posterior_table import read_parameters, read_units
from imubayes_archive.unit_fits.run_batch import run_batch
from imubayes_archive.unit_fits.unit_scores import complete_scores, read_unit_scores

unit_archive = import_module("unit_archive")
ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow
UNITS = 24


@pytest.fixture(scope="module")
def batch(tmp_path_factory) -> tuple[Path, dict]:
    """Return the results of a batch of units, those on one table with a hidden effect, and the truth."""
    folder = tmp_path_factory.mktemp("archive")
    hidden = unit_archive.Hidden(size=0.08, table="plate-b")
    truth = unit_archive.generate(folder / "campaigns", UNITS, 5, hidden)
    pack(campaign_folders([folder / "campaigns"]), folder / "archive")
    run_batch(folder / "archive", ROOT / "models" / "accel-channel.toml", folder / "results", in_process)
    return folder / "results", truth


def test_the_fault_of_one_table_is_found_and_its_units_named(batch):
    results, truth = batch
    scores = complete_scores(results)
    assert scores.issues == ()
    found = pooled_discovery(scores.table, read_units(results))
    assert "converter_gain_drift_quadratic" in found.findings[0].effects
    carriers = {unit for unit, each in truth.items() if each["hidden"]}
    named = set(found.findings[0].named)
    assert len(named & carriers) >= 0.8 * len(named)
    assert [each.equipment and (each.equipment.kind, each.equipment.name) for each in found.findings] == [
        ("table", "plate-b")
    ]
    # Beside what may stand in its place, the size is the one that was planted.
    if found.findings[0].effects[0] == "converter_gain_drift_quadratic":
        (coefficient,) = found.findings[0].coefficients
        assert abs(coefficient.value - 0.08) < 3 * coefficient.sd


def test_scores_are_computed_once(batch):
    results, _ = batch
    complete_scores(results)
    before = {file: file.stat().st_mtime_ns for file in results.glob("model-*/scores-*.parquet")}
    complete_scores(results)
    assert {file: file.stat().st_mtime_ns for file in results.glob("model-*/scores-*.parquet")} == before
    assert read_unit_scores(results).filter(pl.col("effect").is_null())["digest"].is_unique().all()


def test_the_population_is_that_of_the_generator(batch):
    results, _ = batch
    found = {each.parameter: each for each in populations(read_parameters(results), read_units(results))[0].parameters}
    bias = found["accel_bias.bias[ax]"]
    mean, spread = unit_archive.POPULATION["accel_bias.bias[ax]"]
    assert bias.mean is not None
    assert bias.mean_sd is not None
    assert bias.spread_interval is not None
    # The latest calibration of every third unit has drifted.
    assert abs(bias.mean - mean - unit_archive.DRIFT_UG_PER_YEAR / 3) < 3 * bias.mean_sd
    assert bias.spread_interval[0] < spread < bias.spread_interval[1]


def test_commands_answer_and_draw(batch, tmp_path, capsys):
    results, _ = batch
    assert run(["batch", "population", str(results), "--picture", str(tmp_path / "p.png")]) == 0
    assert run(["batch", "prior", str(results), "--out", str(tmp_path / "next.toml")]) == 0
    assert run(["batch", "drift", str(results), "--picture", str(tmp_path / "t.png")]) == 0
    assert run(["batch", "compare", str(results), str(results), "--picture", str(tmp_path / "c.png")]) == 0
    assert run(["batch", "diagnose", str(results), "--picture", str(tmp_path / "e.png")]) == 0
    assert all((tmp_path / f"{name}.png").stat().st_size > 10_000 for name in "ptce")
    assert "table plate-b" in capsys.readouterr().out
    campaigns = ROOT / "data" / "accel-channel"
    assert run(["check", str(campaigns), "--model", str(tmp_path / "next.toml")]) == 0

"""A good campaign comes out in SI, complete, and with what was filled in said."""

import math
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest
from small_files import DEGREE, GRAVITY, MODEL

from imubayes.campaign import inspect_campaign, load_campaign, read_model_file
from imubayes.campaign.column_layout import layout_of_outputs
from imubayes.campaign.equipment import complete_axes
from imubayes.campaign.file_schemas import RunEntry, ThermometerEntry
from imubayes.campaign.toml_documents import key_lines, line_of
from imubayes.foundations.campaign_data import Instruments, Thermometer
from imubayes.foundations.errors import InputError
from imubayes.foundations.units import to_si
from imubayes.procedures import PROCEDURES


def test_everything_is_in_si(small: Path) -> None:
    campaign = load_campaign(small)
    assert campaign.name == "small"
    assert campaign.serial == "SN1"
    assert campaign.site.latitude == pytest.approx(math.pi / 4)
    assert campaign.site.gravity == GRAVITY
    gyro, accelerometer = campaign.channels[0], campaign.channels[3]
    assert gyro.scale_si == pytest.approx(1000 / DEGREE)
    assert accelerometer.scale_si == pytest.approx(20000 / GRAVITY)
    assert gyro.noise == 2.0
    assert campaign.tables["head"].elevation == 0
    assert campaign.tables["rate"].axis_uncertainty == pytest.approx(20 * DEGREE / 3600)
    assert campaign.mountings["flat"].uncertainty == pytest.approx(5 * DEGREE / 60)
    assert len(campaign.digest) == 64


def test_covariates(small: Path) -> None:
    rates, positions, ramp, _ = load_campaign(small).runs
    assert rates.covariates["table_rate"][1] == pytest.approx(300 * DEGREE)
    assert np.isnan(rates.covariates["table_angle"][1])
    assert rates.covariates["table_angle"][0] == 0
    assert rates.covariates["table_angle_span"][1] == pytest.approx(2 * math.pi)
    assert (rates.covariates["temperature"] == 25).all()
    assert rates.start == "2026-03-01T08:00:00+00:00"
    assert positions.covariates["table_angle"][1] == pytest.approx(30 * DEGREE)
    assert (positions.covariates["table_rate"] == 0).all()
    assert (positions.covariates["temperature"] == 24).all()
    assert ramp.covariates["converter_temperature"][0] == pytest.approx(20.1, abs=0.03)
    assert "temperature" not in ramp.covariates
    assert np.isnan(positions.sample_sd).all()


def test_thermometers_and_instruments(small: Path, edit: Callable[[str, str, str], None]) -> None:
    stated = '[[thermometer]]\nname = "Pt"\noffset_uncertainty_degC = 0.1\ngain_uncertainty_percent = 0.2\n'
    edit("campaign.toml", "[unit]", f"{stated}\n[instruments]\nmeter_uncertainty_ppm = 8\n\n[unit]")
    edit("campaign.toml", "temperature_degC = 25.0", 'temperature_degC = 25.0\nthermometer = "Pt"')
    campaign = load_campaign(small)
    assert campaign.thermometers == {"Pt": Thermometer("Pt", 0.1, 0.2 * to_si("%"))}
    assert campaign.instruments == Instruments(meter=8 * to_si("ppm"))
    assert [run.thermometer for run in campaign.runs] == ["Pt", None, None, None]


def test_the_example_of_the_page_on_temperatures_is_read() -> None:
    page = (Path(__file__).parents[2] / "src" / "docs" / "how-to" / "temperature.md").read_text(encoding="utf-8")
    content = tomllib.loads(page.partition("```toml\n")[2].partition("```")[0])
    assert ThermometerEntry.model_validate(content["thermometer"][0]).gain_uncertainty_percent == 0.05
    assert {RunEntry.model_validate(run).thermometer for run in content["run"]} == {"Pt100 No. 7"}


def test_noise_comes_from_scatter_within_means(small: Path) -> None:
    campaign = load_campaign(small)
    assert campaign.channels[1].noise == pytest.approx(2.0, rel=0.1)
    assert any("noise of channel 'gy'" in note for note in campaign.notes)


def test_nothing_is_found_in_a_good_campaign(small: Path) -> None:
    assert inspect_campaign(small).findings == ()


def test_empty_cell_is_a_missing_value(small: Path) -> None:
    lines = (small / "runs/rates.csv").read_text().splitlines()
    cells = lines[3].split(",")
    cells[4] = ""
    lines[3] = ",".join(cells)
    (small / "runs/rates.csv").write_text("\n".join(lines))
    assert np.isnan(load_campaign(small).runs[0].observed[2, 0])


def test_ignored_column(small: Path, edit: Callable[[str, str, str], None]) -> None:
    edit("runs/rates.csv", '"gx_sd"', '"comment"')
    with pytest.raises(InputError, match="'comment' is neither known"):
        load_campaign(small)
    edit("campaign.toml", 'file = "runs/rates.csv"', 'file = "runs/rates.csv"\nignore = ["comment"]')
    assert np.isnan(load_campaign(small).runs[0].sample_sd[:, 0]).all()


def test_parquet_and_csv_read_alike(small: Path, edit: Callable[[str, str, str], None]) -> None:
    before = load_campaign(small).runs[0]
    pq.write_table(pacsv.read_csv(small / "runs/rates.csv"), small / "runs/rates.parquet")
    edit("campaign.toml", "runs/rates.csv", "runs/rates.parquet")
    after = load_campaign(small).runs[0]
    np.testing.assert_array_equal(before.observed, after.observed)
    np.testing.assert_array_equal(before.covariates["table_angle"], after.covariates["table_angle"])


@pytest.mark.parametrize(("delimiter", "decimal"), [(";", ","), (";", "."), ("\t", ","), ("|", ".")])
def test_tables_of_spreadsheets_are_read_alike(small: Path, delimiter: str, decimal: str) -> None:
    """Spreadsheets write semicolons between numbers with decimal commas."""
    before = load_campaign(small)
    for file in (small / "runs").glob("*.csv"):
        text = file.read_text().replace(",", delimiter)
        header, rest = text.split("\n", 1)
        file.write_text(header + "\n" + rest.replace(".", decimal))
    after = load_campaign(small)
    for run, other in zip(after.runs, before.runs, strict=True):
        np.testing.assert_array_equal(run.observed, other.observed)
        for covariate, values in other.covariates.items():
            np.testing.assert_array_equal(run.covariates[covariate], values)


def test_digest_follows_the_data(small: Path, edit: Callable[[str, str, str], None]) -> None:
    before = load_campaign(small).digest
    assert load_campaign(small / "campaign.toml").digest == before
    edit("runs/rates.csv", "300", "300.0")
    assert load_campaign(small).digest != before


def test_unused_columns_are_named(small: Path, edit: Callable[[str, str, str], None]) -> None:
    lines = (small / "runs/positions.csv").read_text().splitlines()
    (small / "runs/positions.csv").write_text("\n".join([lines[0] + ",i_axis", *(line + ",U" for line in lines[1:])]))
    (finding,) = inspect_campaign(small).findings
    assert (finding.name, finding.severity) == ("unused_columns", "warning")


def test_a_procedure_is_known_by_its_registration(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert load_campaign(small).runs
    monkeypatch.delitem(PROCEDURES, "thermal_ramp")
    with pytest.raises(InputError, match="thermal_ramp"):
        load_campaign(small)


def test_axes() -> None:
    np.testing.assert_allclose(complete_axes(np.array([2.0, 0, 0]), None), np.eye(3))
    rows = complete_axes(np.array([0, 0, -1.0]), None)
    np.testing.assert_allclose(rows, [[0, 0, -1], [1, 0, 0], [0, -1, 0]])
    skew = complete_axes(np.array([1.0, 1.0, 1.0]), np.array([1.0, -1.0, 0.001]))
    np.testing.assert_allclose(skew @ skew.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(skew) == pytest.approx(1)


def test_model_file(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(MODEL)
    model = read_model_file(tmp_path / "m.toml")
    assert [effect.name for effect in model.effect] == ["gyro_scale_factor", "gyro_bias_temperature", "white_noise"]
    assert model.effect[0].channels == ["gx", "gz"]
    assert model.effect[0].prior == {"scale": "normal(0, 2000 ppm)"}
    assert model.effect[1].options == {"reference_degC": 25.0}


def test_lines_of_keys() -> None:
    text = 'a = 1\n[t]\nb = [\n  1, # x = 2\n  2,\n]\nc = """\nd = 1\n"""\n'
    text += '[[e]]\nf = "[[e]]"\n[[e]]\n"g h" = 1\n[e.sub]\ni.j = 2\n'
    lines = key_lines(text)
    expected = {("a",): 1, ("t",): 2, ("t", "b"): 3, ("t", "c"): 7, ("e", 0): 10, ("e", 0, "f"): 11, ("e", 1): 12}
    expected |= {("e", 1, "g h"): 13, ("e", 1, "sub"): 14, ("e", 1, "sub", "i", "j"): 15}
    assert lines == expected
    assert line_of(("e", 1, "missing"), lines) == 12
    assert line_of(("e",), lines) == 10
    assert line_of(("nowhere",), lines) is None


def test_import_is_light() -> None:
    code = "import sys, imubayes.campaign, imubayes_recordings.convert; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_check_loads_no_more_than_it_needs() -> None:
    """JAX and the libraries of figures and splines take longer to load than a campaign."""
    code = (
        "import sys\n"
        "from imubayes.cli.main import run\n"
        "status = run(['check', sys.argv[1]])\n"
        "heavy = {'jax', 'equinox', 'arviz_stats', 'matplotlib', 'scipy.interpolate'} & set(sys.modules)\n"
        "sys.exit(status or ', '.join(sorted(heavy)) or 0)\n"
    )
    campaign = Path(__file__).parents[2] / "data" / "accel-channel"
    done = subprocess.run([sys.executable, "-c", code, str(campaign)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_table_of_outputs_keeps_what_it_does_not_know_and_refuses_a_repeated_column() -> None:
    layout = layout_of_outputs(("time_s", "gx", "note", "gx_sd"), ("gx", "gy"), "log.csv")
    assert (layout.numbers, layout.texts) == (("time_s", "gx", "gx_sd"), ("note",))
    assert (layout.channels, layout.deviations) == (("gx",), ("gx",))
    with pytest.raises(InputError, match="column 'gx' is repeated"):
        layout_of_outputs(("gx", "gx"), ("gx",), "log.csv")

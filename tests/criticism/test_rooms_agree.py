# pyright: reportMissingImports=false
"""Set-up check, caution of a fit and diagnosis name the same run, with the same value, of a wrong record."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "campaign"))
from campaign_files import Files
from fresh_setups import KINDS, write_campaign
from record_mistakes import RECORD_MISTAKES, changed, temperatures

from imubayes.adequacy.weighed_records import doubted_runs
from imubayes.campaign import inspect_campaign, load_campaign
from imubayes.criticism.diagnose import judge
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "bench", "seed", "form", "quantity"),
    [
        ("heater_off", "imu", 5, "offset", "temperature_degC"),
        ("thermometer_off", "imu", 2, "offset", "temperature_degC"),
        ("temperatures_exchanged", "imu", 5, "exchange", "temperature_degC"),
        ("other_unit", "imu", 5, "unit", "unit"),
        ("rate_off", "gyro", 1, "factor", "table_rate_deg_s"),
        ("output_off", "triad", 3, "output_offset", "ay"),
    ],
)
def test_check_fit_and_diagnosis_say_the_same(
    kind: str, bench: str, seed: int, form: str, quantity: str, tmp_path: Path
) -> None:
    folder = tmp_path / "campaign"
    write_campaign(folder, bench, seed)
    plant = RECORD_MISTAKES.get(kind) or KINDS[kind]
    assert plant(Files(folder), np.random.default_rng([seed, 5])) is not None
    checked = inspect_campaign(folder)
    text = " ".join(map(str, (*checked.issues, *checked.findings)))
    fitted = joint_fit(bind(read_model(folder / "model.toml"), load_campaign(folder, judge_setup=False)), None)
    (doubted,) = doubted_runs(fitted)
    (told,) = judge(fitted).disagreeing
    cautioned, best = doubted.causes[0], told.causes[0]
    assert (doubted.run, cautioned.form, cautioned.quantity) == (told.run, best.form, best.quantity)
    assert (best.form, best.quantity) == (form, quantity)
    assert f"'{told.run}'" in text
    if form in ("offset", "factor", "output_offset"):
        apart = abs(cautioned.agreeing[0] - best.agreeing[0])
        assert apart < 4 * float(np.hypot(cautioned.sd[0], best.sd[0]))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6, 9])
def test_a_temperature_that_scatter_between_runs_would_absorb_is_told_with_its_value(seed: int, tmp_path: Path) -> None:
    """About the fit its linear response is wrong by what the fit made of the coefficients."""
    folder = tmp_path / "campaign"
    write_campaign(folder, "triad", seed)
    files = Files(folder)
    run = files.runs[-1]
    true = float(temperatures(files, run).mean())
    changed(files, run, "temperature_degC", lambda celsius: celsius - 15)
    fitted = joint_fit(bind(read_model(folder / "model.toml"), load_campaign(folder, judge_setup=False)), None)
    (told,) = judge(fitted).disagreeing
    best = told.causes[0]
    assert (told.run, best.form, best.quantity) == (run["name"], "offset", "temperature_degC")
    assert abs(best.agreeing[0] - true) < 4 * best.sd[0]

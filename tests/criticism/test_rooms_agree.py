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

from imubayes.adequacy.weighed_findings import weighed
from imubayes.adequacy.weighed_records import doubted_runs
from imubayes.campaign import Inspection, inspect_campaign, load_campaign
from imubayes.criticism.diagnose import judge
from imubayes.foundations.wrong_records import WrongRecord, agreement_text
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model


def samples_too_many(files: Files, draw: np.random.Generator) -> tuple[str, ...]:
    """State a hundred times as many samples in each row of a run as its means were made of."""
    run = files.runs[draw.integers(len(files.runs))]
    changed(files, run, "samples", lambda count: 100 * count)
    return (str(run["name"]),)


def written(folder: Path, kind: str, bench: str, seed: int) -> None:
    write_campaign(folder, bench, seed)
    plant = {"samples_too_many": samples_too_many}.get(kind) or RECORD_MISTAKES.get(kind) or KINDS[kind]
    assert plant(Files(folder), np.random.default_rng([seed, 5])) is not None


def judged(folder: Path) -> tuple[Inspection, Fit]:
    """Return what `check` says without a model, and the fit of the campaign as recorded."""
    model = bind(read_model(folder / "model.toml"), load_campaign(folder, judge_setup=False))
    return inspect_campaign(folder), joint_fit(model, None)


def in_agreement(checked: Inspection, fitted: Fit) -> WrongRecord:
    """Return what fit and diagnosis say is wrong; `check` names the same, or nothing of the record of any run."""
    (doubted,) = doubted_runs(fitted)
    (told,) = judge(fitted).disagreeing
    cautioned, best = doubted.causes[0], told.causes[0]
    assert cautioned.agrees_with(best), (cautioned, best)
    records = [each.record for each in checked.findings if each.record is not None]
    for record in records:
        assert any(each.agrees_with(record) for each in (*doubted.causes, *told.causes)), (record, best)
    return best


@pytest.mark.parametrize(
    ("kind", "bench", "seed", "form", "quantity"),
    [("rate_off", "gyro", 1, "factor", "table_rate_deg_s"), ("samples_too_many", "triad", 9101, "samples", "samples")],
)
def test_check_fit_and_diagnosis_name_the_same_record(
    kind: str, bench: str, seed: int, form: str, quantity: str, tmp_path: Path
) -> None:
    written(tmp_path / "campaign", kind, bench, seed)
    checked, fitted = judged(tmp_path / "campaign")
    best = in_agreement(checked, fitted)
    assert (best.form, best.quantity) == (form, quantity)
    # `check --model` says it too, once, and in the words of the fit.
    said = [each for each in weighed(checked, fitted).findings if best.run in (each.run, *_runs(each.record))]
    assert len(said) == 1
    assert agreement_text(doubted_runs(fitted)[0].causes[0]) in said[0].what


def _runs(record: WrongRecord | None) -> tuple[str, ...]:
    return () if record is None else (record.run, record.other)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "bench", "seed", "form", "quantity"),
    [
        ("heater_off", "imu", 5, "offset", "temperature_degC"),
        ("thermometer_off", "imu", 2, "offset", "temperature_degC"),
        ("temperatures_exchanged", "imu", 5, "exchange", "temperature_degC"),
        ("other_unit", "imu", 5, "unit", "unit"),
        ("output_off", "triad", 3, "output_offset", "ay"),
        ("samples_too_many", "imu", 9102, "samples", "samples"),
    ],
)
def test_the_three_agree_over_many_mistakes(
    kind: str, bench: str, seed: int, form: str, quantity: str, tmp_path: Path
) -> None:
    written(tmp_path / "campaign", kind, bench, seed)
    best = in_agreement(*judged(tmp_path / "campaign"))
    assert (best.form, best.quantity) == (form, quantity)


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

"""Where the intervals of a fit cannot be trusted, its diagnosis does not call the model adequate."""

import math
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import imubayes.api
from imubayes.criticism import diagnose
from imubayes.adequacy.noise_assumptions import NoiseJudgement
from imubayes.display.diagnosis_sentences import sentence
from imubayes.display.fit_cautions import alarm_of

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "models" / "accel-channel.toml"


def rounded(folder: Path, steps: float) -> Path:
    """Write the shipped campaign with outputs rounded to so many standard deviations of a row, and the noise seen."""
    shutil.copytree(ROOT / "data" / "accel-channel", folder)
    tables = {file: pl.read_csv(file) for file in sorted(folder.glob("**/*.csv"))}
    noise = [float(np.median(np.abs(np.diff(each["ax"].to_numpy(), 2)))) for each in tables.values()]
    step = steps * min(noise) / (0.6745 * np.sqrt(6))
    for file, table in tables.items():
        table.with_columns((pl.col("ax") / step).round() * step).drop("ax_sd").write_csv(file)
    stated = folder / "campaign.toml"
    scatter = math.sqrt(8.0**2 + 12 * step**2 / 12)  # of a sample, as the rounded means of twelve show it
    stated.write_text(stated.read_text(encoding="utf-8").replace("noise = 8.0", f"noise = {scatter:.1f}"))
    return folder


def test_an_output_too_coarse_for_its_noise_is_told_by_both(tmp_path, monkeypatch):
    result = imubayes.api.fit(rounded(tmp_path / "campaign", 6.0), MODEL, sample=False)
    assert "quantised too coarsely" in alarm_of(result.summary)
    found = imubayes.api.diagnose(result)
    assert found.verdict == "noise_model"
    assert "quantised too coarsely" in sentence(found)
    # Planted fault: the diagnosis looks at candidates alone.
    monkeypatch.setattr(diagnose, "judged_noise_in", lambda _: NoiseJudgement((), ()))
    assert imubayes.api.diagnose(result).verdict == "adequate"


@pytest.mark.parametrize("steps", [0.0001, 0.5])
def test_an_output_that_its_noise_smooths_is_not(tmp_path, steps):
    result = imubayes.api.fit(rounded(tmp_path / "campaign", steps), MODEL, sample=False)
    assert not alarm_of(result.summary)
    assert imubayes.api.diagnose(result).verdict == "adequate"

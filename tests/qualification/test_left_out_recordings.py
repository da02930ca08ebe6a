"""Rests that the fit has not seen: `apply` brings their specific force to g within the stated uncertainty."""

import shutil
import tomllib
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from imubayes.api import fit
from imubayes_qualification.api.calibrated_unit import correct

ROOT = Path(__file__).parents[2]
DESK = ROOT / "data" / "desk-imu"
TRUTH = tomllib.loads((DESK / "truth.toml").read_text())
G = 9.807983  # m/s² at 48° and 520 m, WGS 84 normal gravity
# Rests are cut so far from the moves, s.
MARGIN = 0.1


def rests() -> list[tuple[float, float]]:
    """Return start and end of every rest of the recording, s."""
    starts, ends = TRUTH["nuisance"]["move_start_s"], TRUTH["nuisance"]["move_end_s"]
    return list(zip([0.0, *ends], [*starts, np.inf], strict=True))


def part(folder: Path, low: float, high: float) -> Path:
    """Return a campaign folder with the rows of the recording between two times, s."""
    shutil.copytree(DESK, folder)
    file = folder / "runs" / "tumble.parquet"
    table = pl.read_parquet(file).filter(pl.col("time_s").is_between(low, high))
    table.with_columns(pl.col("time_s") - table["time_s"][0]).write_parquet(file)
    return folder


def scores(table: pl.DataFrame, chosen: list[tuple[float, float]]) -> np.ndarray:
    """Return the deviation of the mean length from g in each rest over its standard uncertainty."""
    found = []
    for start, end in chosen:
        rest = table.filter(pl.col("time_s").is_between(start + MARGIN, end - MARGIN))
        random = rest["force_norm_random_sd_m_s2"].to_numpy()
        systematic = rest["force_norm_systematic_sd_m_s2"].to_numpy()[0]
        deviation = rest["force_norm_m_s2"].to_numpy().mean() - G
        found.append(deviation / np.hypot(systematic, random[0] / np.sqrt(len(rest))))
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("half", ["first", "last"])
def test_rests_that_were_left_out_have_the_length_of_gravity(tmp_path, half):
    """Fitted on two thirds of the rests, corrected in the other third."""
    known = rests()
    cut = 19 if half == "first" else 9
    # In the middle of a rest, so that the campaign begins or ends at rest.
    middles = [(start + min(end, start + 2.0)) / 2 for start, end in known]
    seen = (0.0, middles[cut]) if half == "first" else (middles[cut], np.inf)
    unseen = known[cut + 1 :] if half == "first" else known[:cut]
    assert all(before[1] < after[0] for before, after in pairwise(unseen))
    result = fit(part(tmp_path / "campaign", *seen), ROOT / "models" / "desk-imu.toml", sample=False)
    assert result.converged
    correct(result, DESK, tmp_path / "corrected.parquet")
    found = scores(pl.read_parquet(tmp_path / "corrected.parquet"), unseen)
    print(f"{len(found)} rests left out: largest |z| {np.abs(found).max():.2f}, rms {np.sqrt(np.mean(found**2)):.2f}")
    assert len(found) >= 8
    assert np.abs(found).max() < 4
    assert 0.3 < np.mean(found**2) < 2.5
    # Fault planted: a fifth of the uncertainty would not cover the errors.
    assert np.abs(5 * found).max() > 4

"""200 units, fitted for real, 5 % of them damaged: killed at 20 random moments, the table at the end is the same."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from killed_process import kill_after
from polars.testing import assert_frame_equal
from small_units import DAMAGE, MODEL, make_units

from imubayes_archive.unit_fits.posterior_table import read_parameters, read_units

UNITS, KILLS = 200, 20
BATCH = Path(__file__).parent / "fitted_batch.py"


@pytest.fixture(scope="module")
def archive(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("archive")
    units = make_units(folder, UNITS)
    for unit, damage in zip(units[3 :: UNITS // len(DAMAGE)], DAMAGE.values(), strict=True):
        damage(unit)
    return folder


def started(archive: Path, out: Path, environment: dict[str, str]) -> subprocess.Popen:
    command = [sys.executable, str(BATCH), str(archive), str(MODEL), str(out)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True, env=environment)


def finished(archive: Path, out: Path, environment: dict[str, str]) -> None:
    process = started(archive, out, environment)
    process.communicate()
    assert process.returncode == 0


def killed(archive: Path, out: Path, environment: dict[str, str], random: np.random.Generator) -> int:
    """Start the batch, kill it after up to three chunks and a part of the next; return the parts found then."""
    kill_after(started(archive, out, environment), random.integers(0, 4), random.uniform(0.0, 1.0))
    return len(list(out.glob("model-*/part-*")))


@pytest.mark.slow
def test_kills_at_random_moments_lose_nothing_and_double_nothing(archive, tmp_path, command_environment):
    whole, resumed = tmp_path / "whole", tmp_path / "resumed"
    finished(archive, whole, command_environment)
    random = np.random.default_rng(9)
    parts = [killed(archive, resumed, command_environment, random) for _ in range(KILLS)]
    assert parts == sorted(parts)
    assert len(set(parts)) > KILLS // 3  # most runs had gone on before they were killed
    finished(archive, resumed, command_environment)

    units, expected = read_units(resumed), read_units(whole)
    assert units.height == units["digest"].n_unique() == UNITS
    assert_frame_equal(units.drop("seconds"), expected.drop("seconds"), rel_tol=1e-9)
    ours, theirs = read_parameters(resumed), read_parameters(whole)
    assert ours.select("digest", "parameter").equals(theirs.select("digest", "parameter"))
    apart = np.abs(ours["mean"].to_numpy() - theirs["mean"].to_numpy()) / theirs["sd"].to_numpy()
    assert np.nanmax(apart) < 1e-6
    refused = units.filter(pl.col("status") != "fitted")
    assert refused.height == refused["reason"].n_unique() == len(DAMAGE)
    assert not list(resumed.glob("model-*/.part-*"))

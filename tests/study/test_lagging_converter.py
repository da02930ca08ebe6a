"""A converter offset that lags its temperature, with the lags of the catalogue and without: never adequate."""

import sys
from pathlib import Path

import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.criticism.diagnose import judge
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.responses import candidate_effects

sys.path.insert(0, str(Path(__file__).parent))
from lagging_converter import drawn, lagged, write

MODEL = Path(__file__).parents[2] / "models" / "accel-channel.toml"
SEEDS = range(101, 125)
LAGS = ("converter_offset_lag", "converter_offset_hysteresis", "converter_offset_temperature_rate")


def diagnosed(folder: Path, seed: int) -> Diagnosis:
    model = bind(read_model(MODEL), load_campaign(write(folder / str(seed), seed, drawn(seed))))
    mode = find_mode(model.problem, *(np.zeros(size) for size in model.problem.size))
    return judge(Fit(model, np.asarray(mode.z), np.asarray(mode.h), bool(mode.converged)))


def test_the_lag_is_that_of_a_ramp():
    """Behind a ramp it settles to the rate times the time constant."""
    time = np.arange(0.0, 200.0, 0.5)
    assert (time - lagged(time, time, 20.0))[-1] == pytest.approx(20.0, abs=1e-2)


@pytest.mark.slow
def test_a_lag_in_the_catalogue_comes_first(tmp_path):
    found = [diagnosed(tmp_path, seed) for seed in SEEDS]
    assert not [each for each in found if each.verdict in ("adequate", "noise_model")]
    named = [bool(each.groups) and bool(set(each.groups[0].effects) & set(LAGS)) for each in found]
    assert np.mean(named) >= 0.95


@pytest.mark.slow
def test_a_lag_outside_the_catalogue_is_never_adequate(tmp_path, monkeypatch):
    searchable, ends = candidate_effects.searchable, ("_lag", "_hysteresis", "_temperature_rate")
    monkeypatch.setattr(
        candidate_effects, "searchable", lambda known: (m for m in searchable(known) if not m.name.endswith(ends))
    )
    assert not [seed for seed in SEEDS if diagnosed(tmp_path, seed).verdict == "adequate"]

"""A second mode that holds next to nothing of the posterior is no start of an ensemble; one that holds mass is."""

from pathlib import Path

import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.inference import run_fit
from imubayes.inference.chains import Settings
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import read_model

ROOT = Path(__file__).parents[2]
SEED = 1002
"""A fit from one of its dispersed starts ends at a heading half a turn away, with a ten-thousandth of the evidence."""


@pytest.fixture(scope="module")
def tumble() -> Model:
    return bind(read_model(ROOT / "models" / "desk-imu.toml"), load_campaign(ROOT / "data" / "desk-imu"))


@pytest.mark.slow
def test_no_ensemble_begins_in_a_mode_without_mass(tumble: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    mode, ends = run_fit._best_start(tumble.problem, Settings(seed=SEED), None, lambda text: None)

    def others() -> list[np.ndarray]:
        return [end for end in ends if not run_fit._negligible(tumble.problem, end, mode)]

    assert others() == []
    # Planted fault: every lower mode is a start, and the ensemble that begins there does not leave it.
    monkeypatch.setattr(run_fit, "NEGLIGIBLE", np.inf)
    (second,) = others()
    monkeypatch.setattr(run_fit, "NEGLIGIBLE", 20.0)
    assert len(others()) == 1
    heading = tumble.layout.names.index("tumble_heading.heading[tumble]")
    assert abs(second[heading]) > 1

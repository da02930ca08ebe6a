"""Fresh campaigns whose record is wrong in one run by what `check` cannot know: a diagnosis names run and quantity."""

# pyright: reportMissingImports=false
from pathlib import Path

import numpy as np
import pytest
from fresh_setup_shares import BENCHES, KINDS, Files, write_campaign

from imubayes.campaign import load_campaign
from imubayes.criticism.diagnose import judge
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed", "quantity"),
    [
        ("rate_off", 701, "table_rate_deg_s"), ("rate_off", 710, "table_rate_deg_s"),
        ("thermometer_off", 701, "temperature_degC"), ("thermometer_off", 713, "temperature_degC"),
    ],
)  # fmt: skip
def test_run_and_quantity_are_named(kind: str, seed: int, quantity: str, tmp_path: Path) -> None:
    """Of two runs about one axis the prior of the scale factor decides which is wrong; the other is reported, too."""
    folder = tmp_path / "campaign"
    write_campaign(folder, BENCHES[seed % len(BENCHES)], seed)
    planted = KINDS[kind](Files(folder), np.random.default_rng([seed, 7]))
    assert planted is not None
    found = judge(joint_fit(bind(read_model(folder / "model.toml"), load_campaign(folder)), None))
    assert found.verdict == "run_disagrees"
    (told,) = found.disagreeing
    assert (f"'{told.run}'", told.row) == (planted.named[0], None)
    assert told.causes[0].quantity == quantity

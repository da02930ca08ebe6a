"""An effect of the user's own, in one file beside the model, is screened, proposed and added like any other."""

import shutil
from pathlib import Path

import numpy as np
import polars
import pytest

from imubayes.api import add, diagnose, fit

ROOT = Path(__file__).parents[2]
SOURCE = '''
"""Response that sets in with the rate."""

import jax.numpy as jnp

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.types import Scalar

ONSET = 50 * 0.017453292519943295  # 50 deg/s


class HouseOnset(SignalEffect):
    """signal + s·(1 − exp(−(rate / 50 deg/s)²))."""

    name = "house_onset"
    stage, order, kinds, needs = Stage.SENSOR, Order.BIAS, ("gyro",), ("turning",)
    reference = "definition"
    size: Scalar = parameter("deg/h", "normal(0, 30 deg/h)", (0.1, 100), "the response at high rates")

    def apply(self, signal, sample):
        return signal + self.size * (1 - jnp.exp(-((sample.rate[0] / ONSET) ** 2)))
'''
PLANTED = 20.0  # deg/h
# Cosine between the input axis of g1 and the table's axis, by mounting: (√⅔, 0, 1/√3) in body axes.
COSINE = {"x-up": np.sqrt(2 / 3), "y-up": 0.0, "z-up": np.sqrt(1 / 3)}
SCALE = 20.0  # pulse/s per deg/s


@pytest.fixture(scope="module")
def added(tmp_path_factory):
    folder = tmp_path_factory.mktemp("house")
    campaign = folder / "campaign"
    shutil.copytree(ROOT / "data" / "redundant-imu", campaign)
    for file in (campaign / "runs").glob("*.csv"):
        table = polars.read_csv(file)
        rate = COSINE[file.stem[5:9]] * table["table_rate_deg_s"].to_numpy()
        change = SCALE * PLANTED / 3600 * (1 - np.exp(-((rate / 50) ** 2)))
        table.with_columns((table["g1"] + polars.Series(change)).alias("g1")).write_csv(file)
    (folder / "house.py").write_text(SOURCE)
    model = (ROOT / "models" / "redundant-imu.toml").read_text()
    first = model.index("[[effect]]")
    (folder / "model.toml").write_text(model[:first] + 'files = ["house.py"]\n\n' + model[first:])
    before = fit(campaign, folder / "model.toml", folder / "before", sample=False)
    document = diagnose(folder / "before").json
    return before, document, add(folder / "before", ["house_onset"], folder / "after", channels=["g1"])


def test_it_is_screened_and_proposed(added):
    _, document, _ = added
    assert any(line["effect"] == "house_onset" for line in document["ranking"])
    assert "house_onset" in document["groups"][0]["effects"]
    assert "g1" in document["groups"][0]["channels"]


def test_it_is_added_and_the_error_falls(added):
    before, _, addition = added
    after = addition.result
    found = next(one for one in after.summary["parameters"] if one["name"] == "house_onset.size[g1]")
    assert abs(found["mean"] - PLANTED) < 4 * found["sd"] + 1.0

    def error(result) -> float:
        lines = [one for one in result.summary["runs"] if one["channel"] == "g1"]
        return float(np.sqrt(np.mean([one["rms"] ** 2 for one in lines])))

    assert error(after) < 0.8 * error(before)

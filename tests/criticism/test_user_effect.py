"""An effect of the user's own, in one file beside the model, is screened, proposed and added like any other."""

import shutil
from pathlib import Path

import numpy as np
import polars
import pytest
from null_data import refitted

from imubayes.api import add, fit
from imubayes.campaign import load_campaign
from imubayes.criticism.diagnose import judge
from imubayes.display.loop.diagnosis_report import diagnosis_json
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model

ROOT = Path(__file__).parents[2]
SOURCE = '''
"""A regulator that comes on when the converter is warm."""

import jax.numpy as jnp

from imubayes import Order, Scalar, SignalEffect, Stage, parameter


class HouseRegulator(SignalEffect):
    """signal + s·½·(1 + tanh((T_c − 30 °C) / 1.5 °C))."""

    name = "house_regulator"
    stage, order, kinds, needs = Stage.CONVERTER, Order.OFFSET, ("accelerometer",), ("converter_temperature",)
    reference = "definition"
    size: Scalar = parameter("output", "normal(0, 1e-3 scale)", (1e-3, 1e3), "the offset once it is on")

    def apply(self, signal, sample):
        warmth = (sample.ambient.converter_temperature - 30.0) / 1.5
        return signal + self.size * (1 + jnp.tanh(warmth)) / 2
'''
PLANTED = 15.0  # pulse/s, of 20 000 pulse/s per g


@pytest.fixture(scope="module")
def house(tmp_path_factory) -> Path:
    """A campaign in which the regulator is planted, and a model beside it that knows it without having it."""
    folder = tmp_path_factory.mktemp("house")
    campaign = folder / "campaign"
    shutil.copytree(ROOT / "data" / "accel-channel", campaign)
    for file in (campaign / "runs").glob("*.csv"):
        table = polars.read_csv(file)
        share = 1 / (1 + np.exp(-2 * (table["converter_temperature_degC"].to_numpy() - 30) / 1.5))
        table.with_columns((table["ax"] + polars.Series(PLANTED * share)).alias("ax")).write_csv(file)
    (folder / "house.py").write_text(SOURCE)
    model = (ROOT / "models" / "accel-channel.toml").read_text()
    first = model.index("[[effect]]")
    (folder / "model.toml").write_text(model[:first] + 'files = ["house.py"]\n\n' + model[first:])
    return folder


@pytest.mark.slow
def test_it_is_screened_and_proposed(house):
    declared = bind(read_model(house / "model.toml"), load_campaign(house / "campaign"))
    document = diagnosis_json(judge(refitted(declared, *(np.zeros(size) for size in declared.problem.size))))
    assert any(line["effect"] == "house_regulator" for line in document["ranking"])
    assert document["groups"][0]["effects"] == ["house_regulator"], document["sentence"]


@pytest.mark.slow  # every run proposes it above, and test_trusted_effects.py fits one
def test_a_model_that_has_it_is_fitted(house, tmp_path):
    """It finds the planted size, and the result keeps the file."""
    text = (house / "model.toml").read_text() + '\n[[effect]]\nname = "house_regulator"\n'
    shutil.copyfile(house / "house.py", tmp_path / "house.py")
    (tmp_path / "model.toml").write_text(text)
    result = fit(house / "campaign", tmp_path / "model.toml", tmp_path / "out", sample=False)
    found = result["house_regulator.size[ax]"]
    assert abs(found.mean - PLANTED) < 4 * found.sd
    assert (tmp_path / "out" / "house.py").read_text() == SOURCE
    assert read_model(tmp_path / "out" / "model.toml").files == (str(tmp_path / "out" / "house.py"),)


@pytest.mark.slow
def test_it_is_added_and_the_error_falls(house):
    before = fit(house / "campaign", house / "model.toml", house / "before", sample=False)
    after = add(house / "before", ["house_regulator"], house / "after", channels=["ax"]).result
    found = next(line for line in after.summary.parameters if line.name == "house_regulator.size[ax]")
    assert abs(found.mean - PLANTED) < 4 * found.sd

    def error(result) -> float:
        return float(np.sqrt(np.mean([run.rms**2 for run in result.summary.runs])))

    assert error(after) < 0.8 * error(before)

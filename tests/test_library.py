"""imubayes as a library: campaigns of arrays and data frames, models of mappings and classes, one value for several."""

import copy
import re
import tomllib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import imubayes
from imubayes import Scalar, parameter
from imubayes.procedures import PROCEDURES

ANGLE = np.arange(0.0, 360.0, 15.0)
BIAS, QUADRATIC = 0.7e-3, 300e-6
CONTENT: dict[str, Any] = {
    "name": "bench",
    "site": {"latitude_deg": 48.1, "height_m": 520.0},
    "channel": [
        {"name": "ax", "kind": "accelerometer", "input_axis": np.array([1.0, 0.0, 0.0]), "output_unit": "V",
         "scale": 2.5, "per": "g", "noise": 2e-5}
    ],
    "table": [{"name": "head", "elevation_deg": 0.0}],
    "mounting": [{"name": "flat", "preset": "aligned", "uncertainty_arcmin": 5.0}],
    "run": [{"name": "tumble", "procedure": "dividing_head", "table": "head", "mounting": "flat"}],
}  # fmt: skip
DATA = Path(__file__).parents[1] / "data"
# Of all procedures together.
SHIPPED = (
    "centrifuge", "desk-imu", "full-qualification", "geographic-tumble", "multi-axis-table", "rotation-modulation",
    "servo-table", "static-record",
)  # fmt: skip
EFFECTS = ["mounting_error", "accel_bias", "accel_scale_factor", "white_noise"]


def outputs(quadratic: float = 0.0) -> np.ndarray:
    """Volts of an accelerometer whose axis, x of the table, sinks with the angle; independent of the models."""
    force = -np.sin(np.radians(ANGLE))
    return 2.5 * (force + BIAS + quadratic * force**2) + np.random.default_rng(3).normal(0, 2e-5, len(ANGLE))


def columns(quadratic: float = 0.0) -> dict[str, np.ndarray]:
    return {"table_angle_deg": ANGLE, "ax": outputs(quadratic)}


@pytest.fixture(scope="module")
def campaign() -> imubayes.Campaign:
    return imubayes.build_campaign(CONTENT, {"tumble": columns(QUADRATIC)})


def test_arrays_and_data_frames_of_any_library_make_the_same_campaign(campaign):
    for frame in (pl.DataFrame, pd.DataFrame, pa.table):
        other = imubayes.build_campaign(CONTENT, {"tumble": frame(columns(QUADRATIC))})
        assert other.digest == campaign.digest
        np.testing.assert_array_equal(other.runs[0].observed, campaign.runs[0].observed)
    assert imubayes.build_campaign(CONTENT, {"tumble": columns()}).digest != campaign.digest


def test_a_campaign_that_is_written_is_that_of_its_folder(campaign, tmp_path):
    written = imubayes.build_campaign(CONTENT, {"tumble": columns(QUADRATIC)}, tmp_path / "bench")
    read = imubayes.load_campaign(tmp_path / "bench")
    assert written.folder == str(tmp_path / "bench")
    for each in (written, read):
        np.testing.assert_array_equal(each.runs[0].observed, campaign.runs[0].observed)
    assert written.digest == read.digest


def test_a_campaign_with_an_error_is_not_written(tmp_path):
    for content in ({"name": "bench"}, changed(channel={"scal": 1.0})):
        with pytest.raises(imubayes.InputError, match="content"):
            imubayes.build_campaign(content, {}, tmp_path / "bench")
        assert not (tmp_path / "bench").exists()


def test_a_missing_value_is_missing_and_an_infinite_one_is_an_error(campaign):
    some = columns()
    some["ax"][3] = np.nan
    found = imubayes.build_campaign(CONTENT, {"tumble": some})
    assert np.flatnonzero(np.isnan(found.runs[0].observed[:, 0])).tolist() == [3]
    some["ax"][3] = np.inf
    with pytest.raises(imubayes.InputError, match=r"columns of run 'tumble', row 4, column 'ax'"):
        imubayes.build_campaign(CONTENT, {"tumble": some})


def changed(**entries: Any) -> dict[str, Any]:
    content = copy.deepcopy(CONTENT)
    for section, values in entries.items():
        content[section][0].update(values)
    return content


@pytest.mark.parametrize(
    ("content", "runs", "words"),
    [
        (5, {}, ["of type int", "imubayes.load_campaign"]),
        (changed(channel={"scal": 1.0}), {"tumble": columns()}, ["unknown key 'scal'", "channel[0].scal"]),
        (CONTENT, 5, ["of type int", "names of runs"]),
        (CONTENT, {}, ["run 'tumble' has no columns", "run[0].name"]),
        (CONTENT, {"tumbel": columns()}, ["there is no run 'tumbel'", "tumble"]),
        (CONTENT, {"tumble": 5}, ["of type int", "runs['tumble']"]),
        (CONTENT, {"tumble": {**columns(), "ax": outputs()[:3]}}, ["columns of different shapes: 'ax' 3"]),
        (CONTENT, {"tumble": {**columns(), "axx": outputs()}}, ["column 'axx'", "columns of run 'tumble'"]),
        (CONTENT, {"tumble": {**columns(), "ax": ["a"] * len(ANGLE)}}, ["column 'ax' holds string, not numbers"]),
        (CONTENT, {"tumble": {**columns(), "ax": 10 * outputs()}}, ["channel 'ax' is 10 times too large"]),
        (CONTENT, {"tumble": {**columns(), "ax": -outputs()}}, ["channel 'ax' is reversed in sign"]),
    ],
)
def test_what_is_wrong_is_said_with_its_place(content, runs, words):
    with pytest.raises(imubayes.InputError) as caught:
        imubayes.build_campaign(content, runs)
    for word in words:
        assert word in str(caught.value)


def test_a_campaign_in_memory_is_checked_as_its_folder(campaign):
    assert imubayes.check_campaign(campaign) == ()
    run = campaign.runs[0]
    reversed_ = imubayes.Run(**{**vars(run), "observed": -run.observed})
    wrong = imubayes.Campaign(**{**vars(campaign), "runs": (reversed_,)})
    said = [(each.name, each.severity) for each in imubayes.check_campaign(wrong)]
    assert ("channel_reversed", "error") in said or ("table_reversed", "error") in said, said


@pytest.mark.slow
def test_a_model_of_a_mapping_predicts_and_differentiates(campaign):
    model = imubayes.bind(imubayes.build_model({"name": "bench", "effect": EFFECTS}), campaign)
    z = jnp.zeros(len(model.parameter_names))
    force = -np.sin(np.radians(ANGLE))
    np.testing.assert_allclose(model.predict(z), 2.5 * force, atol=1e-12)
    dense = jax.jacfwd(model.predict)(z)[:, : len(model.layout)]
    np.testing.assert_allclose(model.jacobian(z), dense, atol=1e-12)
    many = jax.jit(jax.vmap(model.predict))(jnp.stack([z, z + 0.1]))
    np.testing.assert_allclose(many[1], model.predict(z + 0.1), atol=1e-12)
    table = model.outputs
    assert table.columns == ["run", "row", "channel", "observed"]
    np.testing.assert_array_equal(table["observed"], outputs(QUADRATIC))
    assert table.row(1)[:3] == ("tumble", 2, "ax")


class OwnQuadratic(imubayes.SignalEffect):
    """A quadratic response."""

    name = "own_quadratic"
    stage = imubayes.Stage.SENSOR
    kinds = ("accelerometer",)
    coefficient: Scalar = parameter("ug/g^2", "normal(0, 500 ug/g^2)", (1, 500), "the quadratic coefficient")

    def apply(self, signal: Scalar, sample: imubayes.Sample) -> Scalar:
        return signal + self.coefficient * signal**2


def test_an_effect_of_this_session_is_fitted_and_not_kept(campaign, tmp_path):
    own = imubayes.build_model({"name": "bench", "effect": [*EFFECTS, OwnQuadratic]})
    fitted = imubayes.fit(campaign, own, sample=False)
    found = fitted["own_quadratic.coefficient[ax]"]
    assert abs(found.mean - QUADRATIC * 1e6) < 4 * found.sd
    assert found.sd < 10
    with pytest.raises(imubayes.InputError) as caught:
        imubayes.fit(campaign, own, tmp_path / "out", sample=False)
    assert "'OwnQuadratic' is defined in this session" in str(caught.value)
    assert "the campaign 'bench' is in no folder" in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("bench.toml", "imubayes.load_model"),
        ({"name": "bench"}, "has no 'effect'"),
        ({"name": "bench", "effect": [{"name": "accel_bias", "prior": {"bias": "norm(0, 1 mg)"}}]}, "is not a prior"),
        ({"name": "bench", "effect": [int]}, "the class int is not an effect"),
        ({"name": "bench", "effect": ["acel_bias"]}, "there is no effect 'acel_bias'"),
    ],
)
def test_a_model_that_cannot_be_is_refused(campaign, content, words):
    with pytest.raises(imubayes.InputError, match=words):
        imubayes.bind(imubayes.build_model(content), campaign)


def test_two_effect_files_of_one_name_are_refused(campaign, tmp_path):
    source = "import imubayes\nclass {0}(imubayes.SignalEffect):\n    name = '{0}'\n    kinds = ('accelerometer',)\n"
    source += "    stage = imubayes.Stage.SENSOR\n"
    source += "    c: imubayes.Scalar = imubayes.parameter('ug', 'normal(0, 1 ug)', (1, 2), 'a bias')\n"
    files = [tmp_path / folder / "own.py" for folder in "ab"]
    for file in files:
        file.parent.mkdir()
        file.write_text(source.format(f"own_{file.parent.name}"))
    spec = imubayes.build_model({"name": "bench", "effect": EFFECTS})
    with pytest.raises(imubayes.InputError, match=r"two effect files are named 'own\.py'"):
        imubayes.bind(imubayes.ModelSpec(spec.name, spec.effects, tuple(map(str, files))), campaign)


@pytest.mark.slow
def test_the_page_about_the_library_runs_as_written():
    page = Path(__file__).parents[1] / "src" / "docs" / "how-to" / "library.md"
    cells = re.findall(r"^```\{code-cell\} ipython3\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)
    code = [re.sub(r"^:tags:.*$", "", cell, flags=re.MULTILINE) for cell in cells]
    names: dict[str, Any] = {"__name__": "page"}
    for cell in code:
        if "docs_session" not in cell:
            exec(compile(cell, str(page), "exec"), names)
    assert names["found"].sd < 10


LARGE = {"full-qualification", "rotation-modulation"}


@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=pytest.mark.slow) if each in LARGE else each for each in SHIPPED]
)
def test_every_shipped_campaign_is_that_of_its_columns(name):
    """All procedures, from means and raw logs alike."""
    folder = DATA / name
    content = tomllib.loads((folder / "campaign.toml").read_text())
    files = {run["name"]: folder / run["file"] for run in content["run"]}
    runs = {
        run: pl.read_parquet(file) if file.suffix == ".parquet" else pl.read_csv(file, infer_schema_length=None)
        for run, file in files.items()
    }
    found, expected = imubayes.build_campaign(content, runs), imubayes.load_campaign(folder)
    assert [vars(channel)["noise"] for channel in found.channels] == [
        vars(channel)["noise"] for channel in expected.channels
    ]
    for run, other in zip(found.runs, expected.runs, strict=True):
        np.testing.assert_array_equal(run.observed, other.observed)
        for covariate, values in other.covariates.items():
            np.testing.assert_array_equal(run.covariates[covariate], values)


def test_the_shipped_campaigns_have_all_procedures():
    contents = [tomllib.loads((DATA / name / "campaign.toml").read_text()) for name in SHIPPED]
    in_motion = {"free_rotation", "slow_motion"}  # recordings of a hand, which are made by tests
    assert {run["procedure"] for content in contents for run in content["run"]} >= set(PROCEDURES) - in_motion

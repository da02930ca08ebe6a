"""A result folder is enough to go on from: what is read back is what was fitted, and a changed campaign is noticed."""

import json
import shutil
import tomllib
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import h5py
import numpy as np
import pytest

from imubayes.api import Result, fit
from imubayes.campaign import campaign_reader
from imubayes.foundations.errors import InputError
from imubayes.inference.run_fit import model_hash
from imubayes.model.likelihood import residuals
from imubayes.results.result import read_result, residuals_of
from kept_results import listed

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fit")
    shutil.copytree(ROOT / "data" / "accel-channel", folder / "campaign")
    return folder


@pytest.fixture(scope="module")
def result(place) -> Result:
    return fit(place / "campaign", ROOT / "models" / "accel-channel.toml", place / "result", sample=False, seed=3)


@pytest.fixture
def copy(place, result, tmp_path) -> Path:
    shutil.copytree(place / "campaign", tmp_path / "campaign")
    shutil.copytree(place / "result", tmp_path / "result")
    # What the record says of the campaign's place has to be wrong for the copy to be the one that is found.
    file = tmp_path / "result" / "fit.json"
    record = json.loads(file.read_text())
    record["campaign"]["absolute"] = record["campaign"]["given"] = str(tmp_path / "elsewhere")
    file.write_text(json.dumps(record))
    listed(tmp_path / "result")
    return tmp_path


def test_the_fit_comes_back(place, result):
    found, was = read_result(place / "result").fit, result.fit
    assert found.model.layout.names == was.model.layout.names
    assert np.array_equal(found.z, was.z)
    assert np.array_equal(found.h, was.h)
    assert (found.converged, found.message) == (True, "")
    assert model_hash(found.model) == model_hash(was.model)
    whitened = np.asarray(residuals(found.model.problem, found.z, found.h))
    assert np.allclose(whitened, np.asarray(residuals(was.model.problem, was.z, was.h)), rtol=0, atol=1e-12)
    assert json.loads((place / "result" / "fit.json").read_text())["seed"] == 3


def test_residuals_have_the_angle_that_the_scale_reads(result):
    campaign = result.fit.model.campaign
    turned = {name: replace(table, zero_angle=np.radians(90.0)) for name, table in campaign.tables.items()}
    model = replace(result.fit.model, campaign=replace(campaign, tables=turned))
    read, counted = (residuals_of(each).table for each in (replace(result.fit, model=model), result.fit))
    apart = (read["table_angle_deg"] - counted["table_angle_deg"]).drop_nulls()
    assert len(apart)
    assert np.allclose(apart, 90.0)
    assert read.drop("table_angle_deg").equals(counted.drop("table_angle_deg"))


def test_the_set_up_is_judged_once(copy, monkeypatch):
    judged = []
    monkeypatch.setattr(campaign_reader, "setup_findings", lambda *given: judged.append(given) or [])
    file = copy / "result" / "fit.json"
    record = json.loads(file.read_text())
    record["campaign_notes"] = [*record["campaign_notes"], "what the gate said"]
    file.write_text(json.dumps(record))
    listed(copy / "result")
    assert read_result(copy / "result").fit.model.campaign.notes[-1] == "what the gate said"
    assert not judged
    del record["campaign_notes"]  # of an earlier version
    file.write_text(json.dumps(record))
    listed(copy / "result")
    assert read_result(copy / "result").fit.model.campaign.notes[-1:] != ("what the gate said",)
    assert len(judged) == 1


def test_the_summary_says_what_the_fit_comes_from(place, result):
    written = json.loads((place / "result" / "summary.json").read_text())["provenance"]
    record = json.loads((place / "result" / "fit.json").read_text())
    campaign = tomllib.loads((place / "campaign" / "campaign.toml").read_text())
    assert written["serial"] == campaign["unit"]["serial"] != ""
    starts = sorted(run["start"].isoformat() for run in campaign["run"])
    assert [datetime.fromisoformat(written[key]) for key in ("first_run", "last_run")] == [
        datetime.fromisoformat(starts[0]), datetime.fromisoformat(starts[-1])
    ]  # fmt: skip
    assert (written["data_sha256"], written["model_sha256"]) == (record["data_hash"], record["model_hash"])
    with h5py.File(place / "result" / "posterior.nc") as posterior:
        assert posterior["posterior"].attrs["data_sha256"] == record["data_hash"]
    assert written["seed"] == 3
    assert {"package": "numpy", "version": np.__version__} in written["software"]
    shown = result._repr_html_()
    assert written["serial"] in shown
    assert written["data_sha256"][:12] in shown


def test_a_result_that_moved_with_its_campaign_is_found(copy):
    assert Path(read_result(copy / "result").fit.model.campaign.folder).resolve() == copy / "campaign"


def refused(folder: Path) -> str:
    with pytest.raises(InputError) as error:
        _ = read_result(folder).fit
    assert all(part in str(error.value) for part in ("error: ", "  where:   ", "  allowed: ", "  do:      "))
    return str(error.value)


def test_a_campaign_that_changed_is_refused(copy):
    run = sorted((copy / "campaign" / "runs").iterdir())[0]
    text = run.read_text()
    last = text.rstrip("\n").rpartition("\n")[0]
    run.write_text(last + "\n")
    assert "no longer the one that was fitted" in refused(copy / "result")


def test_a_campaign_that_is_gone_is_refused(copy):
    shutil.rmtree(copy / "campaign")
    assert "is not at" in refused(copy / "result")


@pytest.mark.parametrize(
    ("text", "said"),
    [("{", "cannot be read: Invalid JSON"), ('{"format": 1}', "key data_hash"), (None, "fit.json cannot be read")],
)
def test_a_damaged_record_is_refused(copy, text, said):
    file = copy / "result" / "fit.json"
    file.unlink()
    if text is not None:
        file.write_text(text)
    listed(copy / "result")
    assert said in refused(copy / "result")


def test_another_model_is_refused(copy):
    file = copy / "result" / "model.toml"
    text = file.read_text()
    assert '\n[[effect]]\nname = "accel_bias"' in text
    file.write_text(text + '\n[[effect]]\nname = "accel_quadratic"\n')
    listed(copy / "result")
    assert "other parameters" in refused(copy / "result")

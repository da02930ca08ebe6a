"""A result that is opened: its readings first, its diagnosis from the folder if one is, another result reported."""

import http.client
import json
import shutil
import threading

import numpy as np
import pytest
from explore_client import Client, framed, settled, wait_for

from imubayes.criticism.explanation_records import ProbableEffect, WeighedSoFar
from imubayes.display.quantity_tables import derived_sheet, parameter_sheet
from imubayes.foundations.errors import InputError
from imubayes.results.folder_files import MANIFEST
from imubayes.results.result import read_result
from imubayes_explorer.calibration import calibration_facts
from imubayes_explorer.open_model import opened, told, weighed
from imubayes_explorer.session import Session
from imubayes_explorer.session_state import id_of
from imubayes_explorer.start import explore
from imubayes_explorer.worker import TaskOutcome

HIDDEN = "gyro_scale_asymmetry"


@pytest.fixture
def apart(explored, first, tmp_path):
    """A copy of the first result, with its diagnosis."""
    return shutil.copytree(explored.session.place_of(first), tmp_path / "apart")


def without_diagnosis(folder):
    (folder / "diagnosis.json").unlink()
    manifest = json.loads((folder / MANIFEST).read_text())
    (folder / MANIFEST).write_text(json.dumps(manifest | {"added": []}))


def test_map_and_residuals_are_there_before_the_explanations(apart, explored, first, client, monkeypatch):
    """While the explanations are weighed, all that does not rest on them is answered, with the numbers of later."""
    without_diagnosis(apart)
    go, ready = threading.Event(), explored.session.require(first)

    def weigh(_fit, _folder, _tell, heard):
        effect = ProbableEffect(effect=HIDDEN, channels=("gz",), probability=0.7)
        heard(WeighedSoFar(hypotheses=12, inclusion=(effect,)))
        go.wait(60)
        return ready.view.explained

    monkeypatch.setattr("imubayes_explorer.open_model.explained_fit", weigh)
    begun = explore(apart)
    own = Client(begun.address)
    try:
        [seen] = wait_for(lambda: [each for each in own.json("state")["opened"] if each["so_far"]])
        assert seen["stage"] == "read"
        assert seen["so_far"]["hypotheses"] == 12
        assert [each["effect"] for each in seen["so_far"]["inclusion"]] == [HIDDEN]
        facts, later = own.json("model", {"model": seen["id"]}), client.json("model", {"model": first})
        assert facts["verdict"] is None
        assert facts["causes"] == []
        for now, then in zip(facts["cells"], later["cells"], strict=True):
            assert now["chi2"] == pytest.approx(then["chi2"], rel=1e-6)
        wanted = {"channel": "gz", "x": "rate_i"}
        _, points = framed(own, {"model": seen["id"], **wanted})
        np.testing.assert_allclose(points["y"], framed(client, {"model": first, **wanted})[1]["y"], rtol=1e-4)
        brush = {"brushes": [{"channels": ["gz"], "runs": ["rate-z-up"]}]}
        early, whole = (c.json("selection", {"model": m, **brush}) for c, m in ((own, seen["id"]), (client, first)))
        assert early["chi2"] == pytest.approx(whole["chi2"], rel=1e-6)
        assert early["nothing"] is None
        assert "still being weighed" in early["sentence"]
        status, said = own.ask("preview", {"model": seen["id"], "effects": [HIDDEN]})
        assert status == 400
        assert b"still being weighed" in said
        # A page that is saved now holds what is there.
        saved = own.ask("session.html")[1].decode()
        [kept] = json.loads(saved.partition('id="kept">')[2].partition("</script>")[0])["models"]
        assert (kept["facts"]["stage"], kept["previews"]) == ("read", [])
        assert kept["count"] > 100
        go.set()
        wait_for(lambda: own.json("state")["opened"][0]["stage"] == "ready")
        assert own.json("model", {"model": seen["id"]})["sentence"] == later["sentence"]
        assert own.json("state")["opened"][0]["so_far"] is None
    finally:
        go.set()
        begun.stop()


def test_a_diagnosis_that_the_folder_holds_is_shown_and_not_made_again(apart, explored, first, monkeypatch):
    ready, file = explored.session.require(first), apart / "diagnosis.json"
    before = file.stat().st_mtime_ns
    found = opened("apart", read_result(apart), lambda _: None)
    assert found.stage == "told"
    assert found.facts().sentence == ready.facts().sentence
    assert found.facts().named == (HIDDEN,)
    explained = ready.view.explained
    monkeypatch.setattr("imubayes_explorer.open_model.explained_fit", lambda *_: explained)
    monkeypatch.setattr(type(explained), "diagnosis", lambda _: pytest.fail("made again"))
    assert told(found, weighed(found, lambda _: None, lambda _: None)).told is found.told
    assert file.stat().st_mtime_ns == before


def test_a_result_that_is_being_fitted_is_not_opened_beside(apart):
    """The page asks for it as soon as the folder is there: the fit at work opens it, and nothing is weighed twice."""
    session, go = Session(apart), threading.Event()

    def fits(_tell):
        go.wait(60)
        return TaskOutcome("")

    session.worker.submit("fit", "fit", "", fits)
    try:
        assert session.get(id_of(str(apart))) is None
        assert [each.kind for each in session.worker.tasks] == ["fit"]
    finally:
        go.set()
        session.close()
        assert session.worker.stop(60)


def test_a_diagnosis_of_another_result_is_not_shown(apart):
    file = apart / "diagnosis.json"
    file.write_text(file.read_text().replace(HIDDEN, "gyro_scale_quadratic"))
    assert opened("apart", read_result(apart), lambda _: None).stage == "read"


def test_another_result_in_the_folder_is_told_and_opened_when_asked(apart, explored, first, accel_channel, monkeypatch):
    explained = explored.session.require(first).view.explained
    monkeypatch.setattr("imubayes_explorer.open_model.explained_fit", lambda *_: explained)
    begun = explore(apart)
    own = Client(begun.address)
    try:
        settled(begun)
        [model] = own.json("state")["opened"]
        assert not model["replaced"]
        shutil.rmtree(apart)
        shutil.copytree(accel_channel, apart)
        monkeypatch.undo()
        [after] = own.json("state")["opened"]
        assert after["replaced"]
        assert own.json("model", {"model": model["id"]})["identity"] == model["identity"]  # shown until it is asked for
        own.json("reload", {"model": model["id"]})
        now = wait_for(lambda: own.json("state")["opened"])[0]
        assert now["identity"] != model["identity"]
        assert not now["replaced"]
        assert own.json("model", {"model": model["id"]})["campaign"] == "accel-channel"
    finally:
        begun.stop()


def test_windows_are_told_of_another_result_without_being_asked(apart, explored, first, accel_channel, monkeypatch):
    """Nothing happens in the session: the stream looks at the folder by itself."""
    explained = explored.session.require(first).view.explained
    monkeypatch.setattr("imubayes_explorer.open_model.explained_fit", lambda *_: explained)
    begun = explore(apart)
    try:
        settled(begun)
        own = Client(begun.address)
        connection = http.client.HTTPConnection(*own.host.split(":"), timeout=30)
        connection.request("GET", f"/{own.token}/events", headers={"Host": own.host})
        answer = connection.getresponse()

        def replaced():
            line = b""
            while not line.startswith(b"data: "):
                line = answer.readline()
            return json.loads(line[6:])["opened"][0]["replaced"]

        assert not replaced()
        shutil.rmtree(apart)
        shutil.copytree(accel_channel, apart)
        assert replaced()
        connection.close()
    finally:
        begun.stop()


def test_one_reading_is_told_in_words(client, explored, first):
    """Run, row, settings and value are those of the table of residuals; the noise is the one known beforehand."""
    table = explored.session.require(first).result.residuals.table
    _, points = framed(client, {"model": first, "channel": "gz", "x": "table_rate_deg_s"})
    k = int(np.argmax(np.abs(points["y"])))
    entry = int(points["entry"][k])
    found, row = client.json("point", {"model": first, "entry": entry}), table.row(entry, named=True)
    assert (found["run"], found["row"], found["channel"]) == (row["run"], row["row"] + 1, "gz")
    values = dict(found["values"])
    value, _, noise = values["gz"].removesuffix(" pulse/s").partition(" ± ")
    wanted = {"model": first, "channel": "gz", "x": "table_rate_deg_s", "y": "input"}
    head, inputs = framed(client, wanted)
    misfit = inputs["y"][k] / head["y_factor"] * row["residual"] / row["input_residual"]
    noise = float(noise)
    assert float(values["model"].split()[0]) == pytest.approx(float(row["observed"] - misfit), abs=noise / 10)
    assert float(values["residual"].split()[0].replace("−", "-")) == pytest.approx(float(misfit), abs=noise / 10)
    assert float(values["over known noise"].replace("−", "-")) == pytest.approx(points["y"][k], rel=0.01)
    assert float(value) == pytest.approx(row["observed"], abs=noise / 10)
    assert float(values["table rate"].split()[0].replace("−", "-")) == pytest.approx(row["table_rate_deg_s"], rel=1e-4)
    # Its noise is that of which the summary has the rms, and which the fit does not raise.
    shown = explored.session.require(first)
    here = shown.readings.entries & (shown.table.channel == "gz")
    own = [shown.table.noise(n) for n in np.flatnonzero(here).tolist()]
    told = next(each for each in shown.result.summary.known_noise.channels if each.channel == "gz")
    scale = abs(row["residual"] / row["input_residual"])
    assert np.sqrt(np.mean(np.square(own))) / scale == pytest.approx(told.noise, rel=1e-6)
    assert noise == pytest.approx(shown.table.noise(entry), rel=0.05)
    brush = {"channels": ["gz"], "runs": [found["run"]], "rows": [found["row"]]}
    chosen = client.json("selection", {"model": first, "brushes": [brush]})
    assert chosen["n"] == 1
    assert chosen["sentence"].startswith("1 reading: ")
    assert "explains them" not in chosen["sentence"]
    with pytest.raises(AssertionError, match="no reading"):
        client.json("point", {"model": first, "entry": 10**7})


def test_the_estimates_are_those_of_the_tables(client, explored, first):
    """Every parameter that the command prints, with its digits; a preview has the digits of the estimate."""
    summary = explored.session.require(first).result.summary
    found = client.json("estimates", {"model": first})
    printed = [row for sheet in (parameter_sheet(summary), derived_sheet(summary)) for row in sheet.rows]
    assert [line["name"] for line in found["lines"]] == [row[0].text for row in printed]
    assert [(line["estimate"], line["sd"]) for line in found["lines"]] == [
        (row[1].text, row[2].text) for row in printed
    ]
    assert all(line["unit"] and line["from_data"] for line in found["lines"])
    assert found["before"] == ""
    lines = {line["name"]: line for line in found["lines"]}
    moved = client.json("preview", {"model": first, "effects": [HIDDEN]})["moved"]
    assert moved
    for each in moved:
        line = lines[each["name"]]
        assert len(each["after"].partition(".")[2]) == len(line["estimate"].partition(".")[2])
        sd = float(line["sd"])
        shift = (float(each["after"]) - float(line["estimate"])) / sd
        assert shift == pytest.approx(each["in_sd"], abs=0.15 * abs(each["in_sd"]) + 0.1)


def test_beside_a_parent_stands_the_estimate_before(explored, first):
    after = explored.session.require(first).result.summary
    name = "gyro_bias.bias[gz]"
    moved = [
        each.model_copy(update={"mean": each.mean - 3 * each.sd}) if each.name == name else each
        for each in after.parameters
    ]
    found = calibration_facts(after, after.model_copy(update={"parameters": tuple(moved)}), "the first")
    [line] = [each for each in found.lines if each.name == name]
    assert line.in_sd == pytest.approx(3)
    assert line.before != line.estimate
    assert found.before == "the first"
    others = [each for each in found.lines if each.name != name and each.in_sd is not None]
    assert others
    assert all(abs(each.in_sd) < 1e-9 for each in others)


def test_a_model_that_is_not_open_yet_refuses_what_rests_on_its_explanations(apart):
    without_diagnosis(apart)
    found = opened("apart", read_result(apart), lambda _: None)
    with pytest.raises(InputError, match="still being weighed"):
        found.preview([HIDDEN], "out")
    with pytest.raises(InputError, match="still being weighed"):
        found.formula("gz")

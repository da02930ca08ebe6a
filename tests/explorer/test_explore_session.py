"""What a session keeps, and what its windows receive while others work on the same results."""

import asyncio
import json
import shlex
import shutil
import threading
import time
from collections.abc import AsyncGenerator
from contextlib import suppress
from dataclasses import replace

import pytest
from explore_client import settled, wait_for
from starlette.requests import Request

from imubayes.cli.main import run
from imubayes.foundations.campaign_data import SetAside
from imubayes.foundations.errors import InputError, NotKept
from imubayes.foundations.files import only_writer
from imubayes.foundations.progress import Tell
from imubayes.model.nodes_and_entries import join_entries
from imubayes.model.set_aside import without
from imubayes.results.history_tree import read_tree, select
from imubayes.results.stored_tables import read_summary_and_residuals
from imubayes_explorer.edited_model import prior_text, with_aside, with_prior
from imubayes_explorer.kept_session import KeptSession
from imubayes_explorer.messages import Brush, ChangeWanted, LockWanted
from imubayes_explorer.open_model import told
from imubayes_explorer.server import _Answers
from imubayes_explorer.session import Session
from imubayes_explorer.worker import TaskOutcome, Worker


def test_what_cannot_be_kept_is_not_lost(tmp_path):
    """A folder that nobody may write to is explored all the same."""
    session = Session(tmp_path / "first")
    (tmp_path / "first.explore.json").mkdir()  # nothing can be put in its place
    with pytest.warns(NotKept, match="nothing of this is kept"):
        session.keep("imubayes diagnose first")
    with pytest.warns(NotKept):
        session.lock(LockWanted(effect="accel_cubic", lock="out"))
    state = session.state()
    assert state.commands == ("imubayes diagnose first",)
    assert state.locks == {"accel_cubic": "out"}


def test_a_result_whose_diagnosis_cannot_be_kept_is_opened(explored, first, monkeypatch):
    def refused(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    wait_for(lambda: explored.session.require(first).linear is not None)  # it may have been opened anew
    model = explored.session.require(first)
    monkeypatch.setattr("imubayes_explorer.open_model.write_diagnosis", refused)
    with pytest.warns(NotKept, match="Permission denied"):
        found = told(replace(model, told=None, linear=None), model.view.explained)
    assert found.diagnosis.verdict == model.diagnosis.verdict


@pytest.fixture
def copied(explored, tmp_path):
    """A session on a copy of the first result, apart from all others."""
    folder = tmp_path / "copied"
    shutil.copytree(explored.session.root, folder)
    return Session(folder)


def test_the_tree_is_read_again_where_a_manifest_has_changed(copied, monkeypatch):
    read = []
    monkeypatch.setattr("imubayes_explorer.session.read_tree", lambda folders: read.append(1) or read_tree(folders))
    before = copied.state()
    assert copied.state().tree == before.tree
    assert len(read) == 1
    select(copied.root)
    shutil.copytree(copied.root, copied.root.with_name("beside"))
    copied.state()
    assert len(read) == 2
    assert copied.state().tree == before.tree
    shutil.rmtree(copied.root)
    assert copied.state().tree == ()


def test_windows_stay_where_the_tree_is_damaged_and_go_on_once_it_is_mended(copied):
    async def silent() -> dict[str, str]:
        await asyncio.sleep(60)
        return {"type": "http.disconnect"}

    file = copied.root / "manifest.json"
    whole = file.read_bytes()

    async def told() -> list[str]:
        stream = _Answers(copied)._states(Request({"type": "http"}, silent))
        assert isinstance(stream, AsyncGenerator)
        found = [await anext(stream)]
        for content in (b"{", whole):
            file.write_bytes(content)
            copied.changed()
            found.append(await anext(stream))
        await stream.aclose()
        return found

    first, damaged, mended = asyncio.run(told())
    assert damaged.startswith(": ")
    assert json.loads(first.removeprefix("data: "))["tree"] == json.loads(mended.removeprefix("data: "))["tree"] != []


def test_two_windows_that_ask_at_once_begin_one_change(explored, first, monkeypatch):
    """Of changes that were all checked before the first was queued, one is taken."""
    session, together, begun = explored.session, threading.Barrier(2, timeout=10), list[object]()
    submit = session.worker.submit

    def slowly(*told: object) -> object:
        with suppress(threading.BrokenBarrierError):
            together.wait(0.5)
        return submit(*told)

    monkeypatch.setattr(session.worker, "submit", slowly)

    def ask() -> None:
        with suppress(InputError):
            begun.append(session.change(ChangeWanted(model=first, add=("gyro_scale_asymmetry",))))

    windows = [threading.Thread(target=ask) for _ in range(2)]
    for each in windows:
        each.start()
    for each in windows:
        each.join()
    for each in begun:
        session.worker.cancel(each)
    settled(explored)
    assert len(begun) == 1


def test_tasks_that_wait_are_told_however_many_there_are():
    worker, go = Worker(lambda: None), threading.Event()

    def work(tell: Tell) -> TaskOutcome:
        go.wait(10)
        return TaskOutcome("", ("done",))

    for n in range(12):
        worker.submit("open", f"open {n}", str(n), work)
    assert [each.of for each in worker.tasks] == list(map(str, range(12)))
    go.set()
    wait_for(lambda: not worker.busy)
    assert [each.of for each in worker.tasks] == list(map(str, range(4, 12)))


def test_what_a_cancelled_task_has_written_is_told():
    """Cancelled before it reported what it wrote, and after: what was written is there."""
    worker, at_work, go = Worker(lambda: None), threading.Event(), threading.Event()

    def work(tell: Tell) -> TaskOutcome:
        at_work.set()
        go.wait(10)
        worker.say(("Added: an effect.",))
        tell("diagnosing")
        return TaskOutcome("never", ())

    number = worker.submit("change", "add an effect", "", work)
    at_work.wait(10)
    worker.cancel(number)
    go.set()
    wait_for(lambda: not worker.busy)
    [task] = worker.tasks
    assert (task.state, task.lines, task.made) == ("cancelled", ("Added: an effect.",), "")


def test_a_script_selects_again_what_was_selected_before():
    kept = KeptSession()
    for command, again in (("diagnose a", False), ("select a", True), ("select b", True), ("diagnose a", False),
                           ("select a", True), ("select a", True)):  # fmt: skip
        kept = kept.with_command(command, again=again)
    assert kept.commands == ("diagnose a", "select a", "select b", "select a")


def chosen(model, **brush):
    return model.table.chosen([Brush(**brush)])


def test_a_selection_is_set_aside_as_run_channels_or_rows(explored, first):
    """The readings that a campaign loses by what is written are those that were selected."""
    model = explored.session.require(first)
    fitted = model.view.fit.model
    for brush in (
        {"runs": ("rate-z-up",)},
        {"channels": ("gx", "gz")},
        {"runs": ("head-z-up", "rate-z-up"), "channels": ("ax",)},
        {"channels": ("gz",), "x": "rate_i", "x_low": 0.0, "x_high": 1e9},
        {"runs": ("rate-z-up",), "x": "rate_i", "x_low": 10.0, "x_high": 1e9},
    ):
        some = chosen(model, **brush)
        assert some.any()
        wanted = with_aside(model, some, "why not").set_aside
        assert {each.reason for each in wanted} == {"why not"}
        left = join_entries(without(fitted.campaign, wanted, "here"))
        names = [run.name for run in fitted.campaign.runs]
        kept = {run.name for run in without(fitted.campaign, wanted, "here").runs}
        there = [name for name in names if name in kept]
        own, whole = ({(runs[r], row, k) for r, row, k in zip(e.run.tolist(), e.row.tolist(), e.channel.tolist(),
                       strict=True)} for runs, e in ((there, left), (names, fitted.entries)))  # fmt: skip
        taken = zip(fitted.entries.run[some], fitted.entries.row[some], fitted.entries.channel[some], strict=True)
        assert whole - own == {(names[r], int(row), int(k)) for r, row, k in taken}
    whole_run = with_aside(model, chosen(model, runs=("rate-z-up",)), "x")
    assert whole_run.set_aside == (SetAside(run="rate-z-up", reason="x"),)
    with pytest.raises(InputError, match="no reading is selected"):
        with_aside(model, chosen(model, runs=("nowhere",)), "x")


def test_the_prior_of_a_parameter_is_checked_with_its_unit(explored, first):
    fitted = explored.session.require(first).view.fit.model
    name = "gyro_bias.bias[gz]"
    spec = with_prior(fitted, name, "normal(0, 2 deg/h)")
    [entry] = [each for each in spec.effects if each.name == "gyro_bias"]
    assert entry.prior["bias"] == "normal(0, 2 deg/h)"
    assert with_prior(fitted, name, "").effects != spec.effects
    every = [each for each in fitted.parameter_names if prior_text(fitted, each)]
    assert every == list(fitted.parameter_names)
    for each in every:
        with_prior(fitted, each, prior_text(fitted, each))
    assert prior_text(fitted, "scale_factor[gz]") == ""
    for wrong in ("normal(0, 2 mg)", "normal(0)", "2 deg/h", "lognormal(", "normal(0, -1 deg/h)"):
        with pytest.raises(InputError) as error:
            with_prior(fitted, name, wrong)
        assert "prior of bias" in str(error.value)
    with pytest.raises(InputError, match="no parameter"):
        with_prior(fitted, "gyro_bias.bais[gz]", "normal(0, 2 deg/h)")


@pytest.mark.slow
def test_another_prior_is_a_branch_that_its_command_makes_again(explored, first, client, tmp_path):
    """The refit is that of `imubayes refit`, whose file stays beside the results; what is set aside needs a reason."""
    refused = client.ask("change", {"model": first, "aside": [{"runs": ["rate-z-up"]}], "reason": " "})
    assert refused[0] == 400
    assert b"no reason is given" in refused[1]
    name, prior = "gyro_bias.bias[gz]", "normal(0, 0.001 deg/h)"
    written = lambda model: client.json("corner", {"model": model, "names": [name]})["quantities"][0]["written"]  # noqa: E731
    assert written(first).startswith("normal(0, ")
    task = client.json("change", {"model": first, "prior_of": name, "prior": prior})["task"]
    settled(explored)
    state = client.json("state")
    done = next(each for each in state["tasks"] if each["number"] == task)
    assert done["state"] == "done", done["issues"]
    assert f"Prior of gyro_bias.bias: {prior}." in done["lines"]
    line = next(each for each in state["tree"] if each["id"] == done["made"])
    assert (line["parent"], line["title"]) == (first, "prior of gyro_bias.bias")
    assert written(done["made"]) == prior
    command = shlex.split(next(each for each in state["commands"] if each.startswith("imubayes refit")))
    again = tmp_path / "again"
    assert run([*command[1:-1], str(again)]) == 0
    both = [read_summary_and_residuals(each)[0].parameters for each in (explored.session.place_of(done["made"]), again)]
    own, by_command = ({each.name: each.mean for each in parameters} for parameters in both)
    assert own == pytest.approx(by_command, rel=1e-9, abs=1e-12)
    free = {each.name: each.mean for each in read_summary_and_residuals(explored.session.root)[0].parameters}
    assert abs(own[name]) < 0.1 * abs(free[name])
    client.json("select", {"model": first})


def test_a_folder_that_a_killed_fit_has_left_is_removed_and_one_at_work_stays(tmp_path):
    left, held, own = (tmp_path / f"first-{name}" for name in ("left", "held", "own"))
    for folder in (left, held, own):
        folder.mkdir()
        (folder / ".lock").write_text("999999999\n")
    (own / "notes.txt").write_text("of the user\n")
    with only_writer(held):
        Session(tmp_path / "first")
        assert not left.exists()
        assert held.exists()
    assert (own / "notes.txt").exists()


def test_a_session_that_ends_waits_for_the_step_at_work():
    """The interpreter must not end while the thread computes; a task that waits never begins."""
    worker, at_work, did = Worker(lambda: None), threading.Event(), list[str]()

    def work(tell: Tell) -> TaskOutcome:
        at_work.set()
        time.sleep(0.3)
        did.append("a step")
        tell("the next step")
        return TaskOutcome("never", ())

    numbers = [worker.submit("change", "add an effect", "", work) for _ in range(2)]
    at_work.wait(10)
    assert not worker.stop(0.0)
    assert worker.stop(10.0)
    assert did == ["a step"]
    assert [each.state for each in worker.tasks if each.number in numbers] == ["cancelled", "cancelled"]


def test_the_news_of_a_window_end_with_the_session(copied):
    async def silent() -> dict[str, str]:
        await asyncio.sleep(60)
        return {"type": "http.disconnect"}

    async def told() -> list[str]:
        stream = _Answers(copied)._states(Request({"type": "http"}, silent))
        first = await anext(stream)
        copied.close()
        return [first, *[each async for each in stream]]

    assert len(asyncio.run(asyncio.wait_for(told(), 10))) <= 2

"""What a session keeps, and what its windows are told while others work on the same results."""

import asyncio
import json
import shutil
from collections.abc import AsyncGenerator

import pytest
from starlette.requests import Request

from imubayes.explorer.messages import LockWanted
from imubayes.explorer.open_model import opened
from imubayes.explorer.server import _Answers
from imubayes.explorer.session import Session
from imubayes.foundations.errors import NotKept
from imubayes.results.history_tree import read_tree, select


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

    model = explored.session.require(first)
    monkeypatch.setattr("imubayes.explorer.open_model.write_diagnosis", refused)
    monkeypatch.setattr("imubayes.explorer.open_model.explained_fit", lambda *_: model.view.explained)
    with pytest.warns(NotKept, match="Permission denied"):
        found = opened(first, model.result, lambda _: None)
    assert found.diagnosis.verdict == model.diagnosis.verdict


@pytest.fixture
def copied(explored, tmp_path):
    """A session on a copy of the first result, apart from all others."""
    folder = tmp_path / "copied"
    shutil.copytree(explored.session.root, folder)
    return Session(folder)


def test_the_tree_is_read_again_where_a_manifest_has_changed(copied, monkeypatch):
    read = []
    monkeypatch.setattr("imubayes.explorer.session.read_tree", lambda folders: read.append(1) or read_tree(folders))
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

"""What a session keeps, and what its windows are told while others work on the same results."""

import pytest

from imubayes.explorer.messages import LockWanted
from imubayes.explorer.open_model import opened
from imubayes.explorer.session import Session
from imubayes.foundations.errors import NotKept


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

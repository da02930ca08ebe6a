"""The effects behind differences of classical estimates are found once for a fit, and again for another one."""

from types import SimpleNamespace

import polars as pl
import pytest

from imubayes.display.loop import kept_causes
from imubayes.results import folder_files
from imubayes.results.summary import Summary

FOUND = {("scale_factor[gx]", "rate-x"): [("gyro_scale_asymmetry", 1.5), ("mounting_error", -0.25)]}


def write_result(folder, summary: str) -> None:
    with folder_files.replacing_result(folder, 0) as scratch:
        (scratch / folder_files.SUMMARY).write_text(summary)
        (scratch / folder_files.RESIDUALS).write_text("residuals")


@pytest.fixture
def searches(monkeypatch) -> list:
    """The folders whose fit was read to find the effects."""
    read: list = []
    monkeypatch.setattr(kept_causes, "fit_file", SimpleNamespace(read_fit=read.append))
    monkeypatch.setattr(kept_causes, "effects_behind", SimpleNamespace(effects_behind=lambda *_: FOUND))
    return read


def test_they_are_found_once_for_a_fit(tmp_path, searches, monkeypatch):
    write_result(tmp_path, "one")

    def asked():
        return kept_causes.causes_of(tmp_path, pl.DataFrame(), Summary.model_construct())

    assert asked() == asked() == FOUND
    assert searches == [tmp_path]
    # Those of another fit, of another method, or altered ones are not taken.
    write_result(tmp_path, "another")
    assert asked() == FOUND
    assert len(searches) == 2
    monkeypatch.setattr(kept_causes, "_METHOD", kept_causes._METHOD + 1)
    assert asked() == FOUND
    assert len(searches) == 3
    file = tmp_path / folder_files.CAUSES
    file.write_text(file.read_text().replace("1.5", "2.5"))
    assert asked() == FOUND
    assert len(searches) == 4

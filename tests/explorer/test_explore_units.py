"""A page of units and the loops that are opened from it; the loops are stand-ins, and nothing is fitted."""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest
from explore_client import Client

from imubayes.foundations.errors import input_error
from imubayes.results.unit_page import UNIT_LINK, UnitPage, UnitToExplore
from imubayes_explorer import start
from imubayes_explorer.unit_server import ServedUnits


@dataclass
class Opened:
    address: str


def gone() -> Path:
    raise input_error("the campaign is gone", "unit 'b'", "a campaign that is there", "put it back")


UNITS = {
    "a": UnitToExplore(lambda: Path("campaign"), Path("model.toml"), Path("out")),
    "b": UnitToExplore(gone, Path("model.toml"), Path("out")),
}
PAGE = UnitPage(f'<a href="{UNIT_LINK.format("a")}">a</a>', UNITS)


@pytest.fixture
def served():
    begun, ended = [], []

    def opened(unit: UnitToExplore):
        unit.campaign()
        begun.append(unit)
        return Opened(f"http://127.0.0.1:1/{len(begun)}/")

    found = ServedUnits(PAGE, opened, lambda loop, seconds: ended.append((loop.address, seconds)), 0)
    found.begin()
    yield found, begun
    found.stop(3.0)
    assert ended == [(f"http://127.0.0.1:1/{n}/", 3.0) for n in range(1, len(begun) + 1)]


def test_a_click_opens_the_loop_of_a_unit_once(served):
    page, begun = served
    client = Client(page.address)
    status, content = client.ask("")
    assert (status, content.decode()) == (200, PAGE.html)
    assert [client.ask("unit/a")[0] for _ in range(2)] == [303, 303]
    assert begun == [UNITS["a"]]
    assert page.loops["a"].address.endswith("/1/")


def test_what_cannot_be_opened_is_said(served):
    client = Client(served[0].address)
    status, content = client.ask("unit/b")
    assert status == 400
    assert b"the campaign is gone" in content
    assert b"put it back" in content
    assert client.ask("unit/c")[0] == 404
    assert client.ask("/wrong-token/unit/a", whole=True)[0] == 403


def test_the_first_page_that_knows_a_folder_is_served(monkeypatch, tmp_path):
    def entry(page):
        return SimpleNamespace(load=lambda: lambda place, progress: page if place == tmp_path else None)

    monkeypatch.setattr(start, "extensions", lambda group: {"nobody": entry(None), "units": entry(PAGE)})
    assert start.explore_units(tmp_path / "other") is None
    found = start.explore_units(tmp_path)
    assert found is not None
    try:
        assert Client(found.address).ask("")[1].decode() == PAGE.html
    finally:
        found.stop(1.0)

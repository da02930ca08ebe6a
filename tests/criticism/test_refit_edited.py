"""Readings that a model file sets aside are as if they had never been recorded; other priors: explore/."""

import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import tomlkit

from imubayes.api import Result, fit, read_result, refit
from imubayes.campaign import load_campaign
from imubayes.cli.main import run
from imubayes.display.loop.change_report import change_lines
from imubayes.foundations.campaign_data import SetAside
from imubayes.foundations.errors import InputError
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.model.set_aside import without
from imubayes.results.history_tree import read_tree

ROOT = Path(__file__).parents[2]
CAMPAIGN = ROOT / "data" / "accel-channel"
RUN, ROWS, CHANNEL = "ramp-1g", [2, 5], "ax"


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("edited")


@pytest.fixture(scope="module")
def first(place) -> Result:
    return fit(CAMPAIGN, ROOT / "models" / "accel-channel.toml", place / "first", sample=False)


def edited(first: Result, file: Path, **changes) -> Path:
    document = tomlkit.parse((first.folder / "model.toml").read_text())
    document.update(changes)
    file.write_text(tomlkit.dumps(document))
    return file


def entry(**more) -> dict:
    return {"run": RUN, "channels": [CHANNEL], "rows": ROWS, "reason": "the table slipped"} | more


@pytest.fixture(scope="module")
def aside(place, first) -> Result:
    file = edited(first, place / "aside.toml", set_aside=[entry()])
    assert run(["refit", str(first.folder), "--model", str(file), "--out", str(place / "aside")]) == 0
    return read_result(place / "aside")


@pytest.mark.slow
def test_readings_set_aside_are_as_if_they_had_not_been_recorded(place, first, aside):
    """The fit is that of a campaign whose cells are empty."""
    emptied = place / "emptied"
    shutil.copytree(CAMPAIGN, emptied)
    document = tomllib.loads((emptied / "campaign.toml").read_text())
    file = emptied / next(each["file"] for each in document["run"] if each["name"] == RUN)
    table = pl.read_csv(file, comment_prefix="#")
    empty = np.isin(np.arange(1, table.height + 1), ROWS)
    table.with_columns(pl.when(pl.Series(empty)).then(None).otherwise(pl.col(CHANNEL)).alias(CHANNEL)).write_csv(file)
    other = fit(emptied, first.folder / "model.toml", sample=False)
    assert aside.residuals.table.height == other.residuals.table.height == first.residuals.table.height - len(ROWS)
    own, theirs = ({each.name: each.mean for each in r.summary.parameters} for r in (aside, other))
    scale = {each.name: each.sd for each in other.summary.parameters}
    assert max(abs(own[name] - theirs[name]) / scale[name] for name in theirs if scale[name]) < 0.01
    assert aside.summary.known_noise.chi2 == pytest.approx(other.summary.known_noise.chi2, abs=1e-3)
    assert aside.summary.known_noise.dof == other.summary.known_noise.dof


@pytest.mark.slow  # a fit with another structure; test_explore_session.py sets readings aside at every run
def test_what_is_set_aside_is_recorded_with_its_reason(place, first, aside, capsys):
    told = SetAside(run=RUN, channels=(CHANNEL,), rows=tuple(ROWS), reason="the table slipped")
    assert aside.summary.set_aside == (told,) == read_model(aside.folder / "model.toml").set_aside
    tree = read_tree([first.folder])
    assert tree.nodes[str(aside.folder.resolve())].title == f"readings of {RUN}"
    assert tree.parents[str(aside.folder.resolve())] == str(first.folder.resolve())
    assert run(["history", str(aside.folder), "--html", str(place / "history.html")]) == 0
    assert f"Set aside: run {RUN} {CHANNEL}, rows 2, 5: the table slipped." in (place / "history.html").read_text()
    assert f"readings of {RUN}" in capsys.readouterr().out
    change = refit(aside, first.folder / "model.toml")
    assert change.taken_back == (told,)
    assert repr(change) == f"<ModelChange readings of {RUN}: taken, Δχ² –>"
    assert change.observed.delta_chi2 is None
    assert change.held_out is None
    said = "\n".join(change_lines(change))
    assert f"Taken back: run {RUN} {CHANNEL}, rows 2, 5: the table slipped." in said
    # Taken back, the fit is what it was.
    assert change.result.summary.known_noise.chi2 == pytest.approx(first.summary.known_noise.chi2, abs=1e-3)


@pytest.mark.slow
def test_a_whole_run_goes(first):
    spec = read_model(first.folder / "model.toml")
    model = bind(replace(spec, set_aside=(SetAside(run=RUN, reason="no record of the day"),)), load_campaign(CAMPAIGN))
    assert [each.name for each in model.campaign.runs] == [
        each.name for each in first.fit.model.campaign.runs if each.name != RUN
    ]
    assert len(model.entries) == sum(each.n for each in first.summary.runs if each.name != RUN)


@pytest.mark.parametrize(
    ("changes", "what", "allowed"),
    [
        ({"run": "ramp-1gg"}, "no run 'ramp-1gg'", RUN),
        ({"channels": ["axx"]}, "no channel 'axx'", "ax"),
        ({"rows": [400]}, "no row 400", "rows 1 to "),
        ({"rows": [0]}, "rows", "1"),
        ({"reason": ""}, "reason", ""),
    ],
)
def test_what_is_not_there_cannot_be_set_aside(place, first, capsys, changes, what, allowed):
    file = edited(first, place / "wrong.toml", set_aside=[entry(**changes)])
    assert run(["refit", str(first.folder), "--model", str(file), "--out", str(place / "no")]) == 2
    said = capsys.readouterr().err
    assert what in said
    assert allowed in said
    assert "Traceback" not in said
    assert not any((place / "no").glob("*"))


def test_some_run_is_left():
    campaign = load_campaign(CAMPAIGN)
    every = [SetAside(run=each.name, reason="all") for each in campaign.runs]
    with pytest.raises(InputError, match="every run of the campaign is set aside"):
        without(campaign, every, "model.toml")
    some = without(campaign, every[1:], "model.toml")
    assert [each.name for each in some.runs] == [campaign.runs[0].name]
    assert without(some, every[1:], "model.toml") is some

"""The shipped campaigns with hidden effects: each is named, with its size; nothing is found if nothing is hidden."""

import tomllib
from pathlib import Path

import pytest
from null_data import judged

from imubayes.display.loop.diagnosis_report import diagnosis_json

ROOT = Path(__file__).parents[2]
CAMPAIGNS = sorted(folder.name for folder in (ROOT / "data").glob("hidden-*"))


def _diagnosed(name: str) -> tuple[dict, dict]:
    truth = tomllib.loads((ROOT / "data" / name / "truth.toml").read_text())
    return diagnosis_json(judged(name, Path(truth["hidden"]["model"]).stem)), truth["hidden"]


def _probability(document: dict, kind: str) -> float:
    return next(each["probability"] for each in document["explanations"]["explanations"] if each["kind"] == kind)


# One at every run of the tests; each of the others compiles models of its own, and `make study` has the time.
AT_ONCE = ("hidden-two",)  # and hidden-gyro by the README
OTHERS = [one for one in CAMPAIGNS if one not in (*AT_ONCE, "hidden-none", "hidden-outside")]


@pytest.mark.parametrize("name", [*AT_ONCE, *(pytest.param(one, marks=pytest.mark.slow) for one in OTHERS)])
def test_the_hidden_effects_are_found_with_their_sizes(name):
    document, hidden = _diagnosed(name)
    assert document["verdict"] in ("missing_effect", "equivalent_effects"), document["sentence"]
    named = [set(group["effects"]) for group in document["groups"]]
    for one in hidden["effect"]:
        assert any(one["effect"] in group for group in named), (one["effect"], named)
    assert named[0] & {one["effect"] for one in hidden["effect"]}
    # The evidence names the same, each alone on its channels.
    slots = document["explanations"]["slots"]
    assert {slot["candidates"][0]["effect"] for slot in slots} == {one["effect"] for one in hidden["effect"]}
    truth = {key: value for one in hidden["effect"] for key, value in one["parameters"].items()}
    found = {
        one["name"]: one
        for group in document["groups"]
        for candidate in group["candidates"]
        for one in candidate["coefficients"]
        if one["name"] in truth
    }
    assert found
    for label, one in found.items():
        # A time constant that is scanned is not the true one: the coefficient that goes with it is a little off.
        assert abs(one["value"] - truth[label]) < 3.5 * one["sd"] + 0.1 * abs(truth[label]), (label, one, truth[label])


def test_nothing_is_found_where_nothing_is_hidden():
    document, _ = _diagnosed("hidden-none")
    assert document["verdict"] == "adequate"
    assert document["groups"] == []
    assert {one["effect"] for one in document["undetectable"]}
    assert _probability(document, "nothing") > 0.5


@pytest.mark.slow  # compiles a campaign; test_wrong_names.py has causes outside the catalogue at every run
def test_what_the_catalogue_does_not_know_is_not_named():
    document, _ = _diagnosed("hidden-outside")
    assert document["verdict"] == "unexplained_structure"
    assert document["groups"] == []
    assert _probability(document, "outside") > 0.9
    form = document["explanations"]["form"]
    assert (form["channels"], form["covariates"]) == (["gy"], ["rate_i"])
    [formula] = document["formulas"]
    assert formula["channel"] == "gy"
    [term] = formula["terms"]
    assert term["value"] == pytest.approx(12.0, rel=0.15)
    assert formula["inclusion"] > 0.5
    compile(formula["python"], "found_shape.py", "exec")

"""The shipped campaigns with hidden effects: each is named, with its size; nothing is found where nothing is hidden."""

import tomllib
from pathlib import Path

import pytest

from imubayes.api import diagnose, fit

ROOT = Path(__file__).parents[2]
CAMPAIGNS = sorted(folder.name for folder in (ROOT / "data").glob("hidden-*"))


@pytest.fixture(scope="module")
def documents():
    return {}


def _diagnosed(name: str, documents: dict) -> tuple[dict, dict]:
    truth = tomllib.loads((ROOT / "data" / name / "truth.toml").read_text())
    if name not in documents:
        result = fit(ROOT / "data" / name, ROOT / truth["hidden"]["model"], sample=False)
        assert result.converged
        documents[name] = diagnose(result).json
    return documents[name], truth["hidden"]


@pytest.mark.parametrize("name", [one for one in CAMPAIGNS if one not in ("hidden-none", "hidden-outside")])
def test_the_hidden_effects_are_found(name, documents):
    document, hidden = _diagnosed(name, documents)
    assert document["verdict"] in ("missing_effect", "equivalent_effects")
    named = [set(group["effects"]) for group in document["groups"]]
    for one in hidden["effect"]:
        assert any(one["effect"] in group for group in named), (one["effect"], named)
    first = {one["effect"] for one in hidden["effect"]}
    assert named[0] & first


@pytest.mark.parametrize("name", [one for one in CAMPAIGNS if one not in ("hidden-none", "hidden-outside")])
def test_coefficients_are_within_three_standard_deviations(name, documents):
    document, hidden = _diagnosed(name, documents)
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


def test_nothing_is_found_where_nothing_is_hidden(documents):
    document, _ = _diagnosed("hidden-none", documents)
    assert document["verdict"] == "adequate"
    assert document["groups"] == []
    assert {one["effect"] for one in document["undetectable"]}


def test_what_the_catalogue_does_not_know_is_not_named(documents):
    document, _ = _diagnosed("hidden-outside", documents)
    assert document["verdict"] == "unexplained_structure"
    assert document["groups"] == []
    best = document["structure"][0]
    assert (best["channel"], best["covariate"]) == ("gy", "rate_i")
    assert best["coefficient"]["value"] == pytest.approx(12.0, rel=0.15)
    compile(best["python"], "found_shape.py", "exec")

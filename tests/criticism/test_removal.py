"""Taking effects out again: the fit comes back to what it was, what it costs is reported, and what is needed stays."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from loop_results import LACKING

import imubayes.loop.refit as refit_module
from imubayes.api import ModelChange, Result, remove
from imubayes.cli.main import run
from imubayes.criticism.explanation_records import EffectSlot, Evidence, ProbableEffect
from imubayes.display.loop.change_report import change_lines
from imubayes.foundations.errors import InputError
from imubayes.inference.fitted_model import Fit
from imubayes.loop.cross_validation import objection, summarise_gains
from imubayes.loop.model_changes import _among, _refuse_required, _without, reduce, start_at_estimates
from imubayes.loop.model_history import removal_log_odds
from imubayes.loop.refit import NotDistinguished, correlated_owners
from imubayes.loop.warm_start import extend
from imubayes.model.effect_registry import Registry
from imubayes.model.model_file import EffectSpec, ModelSpec, PriorCorrelation
from imubayes.results.change_records import estimate_changes
from imubayes.results.history_tree import read_node, read_tree


@pytest.fixture(scope="module")
def first(lacking) -> Result:
    return lacking[0]


@pytest.fixture(scope="module")
def second(lacking) -> ModelChange:
    return lacking[1]


@pytest.fixture(scope="module")
def place(first) -> Path:
    return first.folder.parent


@pytest.fixture(scope="module")
def third(place, second) -> ModelChange:
    return remove(place / "second", [LACKING], place / "removed")


def test_the_fit_comes_back_to_what_it_was(first, second, third):
    assert second.taken
    assert third.taken
    assert third.result.fit.model.layout.names == first.fit.model.layout.names
    moved = estimate_changes(first.summary, third.result.summary)
    assert len(moved) > 5
    assert max(abs(each.in_sd) for each in moved) < 0.01


def test_an_effect_that_the_campaign_takes_as_exact_is_not_added(first):
    with pytest.raises(InputError, match="would add nothing: the campaign takes this error as exactly 0"):
        extend(first.fit, ["thermometer_error"])
    assert not extend(first.fit, ["correlated_noise"]).new.any()  # noise has no parameters but its scales


def test_what_a_removal_costs_is_the_reverse_of_what_the_addition_brought(second, third):
    assert [choice.effect for choice in third.removed] == [LACKING]
    assert third.added == ()
    assert third.observed.delta_chi2 == pytest.approx(-second.observed.delta_chi2, rel=1e-3)
    assert third.predicted.delta_chi2 == pytest.approx(third.observed.delta_chi2, rel=0.01)
    assert third.observed.coefficients == ()
    assert third.held_out.delta == pytest.approx(-second.held_out.delta, rel=1e-2)
    assert (second.held_out.verdict, third.held_out.verdict) == ("helps", "costs")
    rms = {each.channel: each for each in third.channels}
    for was in second.channels:
        assert rms[was.channel].after == pytest.approx(was.before, rel=1e-3)
    assert {each.name: each.in_sd for each in third.moved}["white_noise.sigma[ax]"] > 5
    said = "\n".join(change_lines(third))
    assert f"Removed: {LACKING}" in said
    assert "THE REMOVAL WORSENS" in said


def test_the_history_shows_both_steps(place, third):
    tree = read_tree([place / "first"])
    titles = [tree.nodes[node].title for _, node in tree.in_order()]
    assert titles == ["accel-channel", f"+ {LACKING}", f"− {LACKING}"]
    assert tree.selected == (str((place / "removed").resolve()),)
    first, last = read_node(place / "first"), read_node(place / "removed")
    assert last.model_hash == first.model_hash
    assert last.chi2 == pytest.approx(first.chi2, rel=1e-3)
    assert json.loads((place / "removed" / "change.json").read_text())["removed"][0]["effect"] == LACKING
    assert not (place / "removed" / "added_variable.parquet").exists()


@pytest.mark.slow
def test_history_and_removal_on_the_command_line(place, third, capsys):
    page = place / "history.html"
    assert run(["history", str(place / "removed"), "--html", str(page)]) == 0
    assert f"− {LACKING}" in capsys.readouterr().out
    assert f"after removing {LACKING}" in page.read_text()
    taken = ["remove", LACKING, "--from", str(place / "second"), "--out", str(place / "removed")]
    for words, what in (
        (taken, "already contains a result"),
        ([*taken[:1], "converter_offset_drfit", *taken[2:-1], str(place / "no")], f"allowed: {LACKING}"),
        (
            [*taken[:1], "white_noise", *taken[2:-1], str(place / "no")],
            "'white_noise' cannot be removed: the model has no",
        ),
        (["remove", *taken[2:]], "no effect is named"),
    ):
        assert run(words) == 2
        said = capsys.readouterr().err
        assert what in said
        assert said.count("error: ") == 1
        assert all(part in said for part in ("  where:   ", "  allowed: ", "  do:      "))
    assert not any((place / "no").glob("*"))


def test_what_stays_begins_where_it_stood(second):
    before = second.result.fit
    change = reduce(before, [LACKING])
    assert not change.new.any()
    names = before.model.layout.names
    assert set(names) - set(change.model.layout.names) == {f"{LACKING}.slope[ax]"}
    assert change.z.tolist() == [before.z[names.index(name)] for name in change.model.layout.names]


def test_a_refit_that_did_not_converge_is_not_taken(second, monkeypatch):
    def failed(after, drop, may_rise):
        return objection(Fit(after.model, after.z, after.h, False, "No."), drop, may_rise)

    monkeypatch.setattr(refit_module, "objection", failed)
    change = remove(second.result, [LACKING])
    assert not change.taken
    assert "not taken" in change.message
    assert change.moved == ()


def test_a_refit_starts_at_the_estimates_where_they_are_the_better_start(first):
    change = extend(first.fit, [LACKING])
    names = [change.model.layout.parameters[place].name for place in np.flatnonzero(change.new)]
    told = {each.name: each.value for each in change.coefficients if each.value is not None}
    assert list(told) == names
    begun = start_at_estimates(replace(change, z=change.null), told)
    np.testing.assert_allclose(begun.z[change.new], change.z[change.new], rtol=1e-9)
    np.testing.assert_allclose(begun.z, change.z, atol=1e-2)  # the others move along
    far = start_at_estimates(change, {name: -30 * value for name, value in told.items()})
    assert far.z is change.z


def test_a_refit_never_starts_where_a_prior_excludes_the_value(first):
    change = extend(first.fit, ["converter_leakage"], ["ax"])
    (name,) = (each for each in change.model.layout.names if each.startswith("converter_leakage.doubling"))
    parameter = change.model.layout.parameters[change.model.layout.names.index(name)]
    assert parameter.prior.support()[0] == 0
    assert start_at_estimates(change, {parameter.name: -1.0}) is change


def listed(*names: str) -> ModelSpec:
    return ModelSpec("unit", tuple(EffectSpec(name) for name in names), where="model.toml")


def test_what_others_require_stays():
    spec = listed("gyro_bias", "gyro_bias_temperature", "thermometer_error", "white_noise")
    with pytest.raises(InputError, match="gyro_bias_temperature requires it") as refused:
        _refuse_required(["thermometer_error"], spec, spec, Registry())
    assert "remove gyro_bias_temperature as well" in refused.value.issues[0].remedy
    # What nothing needs any more goes along.
    left = _without(spec, ["gyro_bias_temperature"], Registry())
    assert [each.name for each in left.effects] == ["gyro_bias", "white_noise"]


def test_a_correlation_of_what_stays_remains():
    block = PriorCorrelation(("a.s[x]", "b.s[x]", "a.t[x]"), ((1.0, 0.1, 0.2), (0.1, 1.0, 0.3), (0.2, 0.3, 1.0)))
    kept = _among(block, {"a"})
    assert kept is not None
    assert (kept.parameters, kept.matrix) == (("a.s[x]", "a.t[x]"), ((1.0, 0.2), (0.2, 1.0)))
    assert _among(block, {"b"}) is None


@pytest.mark.parametrize(
    ("gains", "verdict"),
    [([-3.0, -2.0, -4.0], "costs"), ([-9.0, 8.0, -4.0], "unclear"), ([1.0, -0.2, 3.0], "spares")],
)
def test_the_verdict_of_a_removal(gains, verdict):
    found = summarise_gains("run", ("a", "b", "c"), np.array(gains), removal=True)
    assert (found.verdict, found.delta) == (verdict, pytest.approx(sum(gains)))


def posterior_correlation(columns: np.ndarray, prior: float) -> np.ndarray:
    covariance = np.linalg.inv(columns.T @ columns + prior * np.eye(columns.shape[1]))
    scale = np.sqrt(np.diag(covariance))
    return covariance / np.outer(scale, scale)


def test_effects_that_do_the_same_are_not_distinguished():
    rng = np.random.default_rng(1)
    x, y, z = rng.normal(size=(3, 200, 1))
    near = 0.05 * rng.normal(size=(200, 6))
    pair = posterior_correlation(np.concatenate([x, x, y], axis=1) + near[:, :3], 0.01)
    ((effects, size),) = correlated_owners(pair, np.array([0, 1, 2]))
    assert effects == [0, 1]
    assert size == pytest.approx(pair[0, 1])
    assert size < -0.95
    # Of five that do the same, no two are correlated beyond 0.95.
    many = posterior_correlation(np.tile(x, 5) + near[:, :5], 0.01)
    assert np.max(np.abs(many - np.eye(5))) < 0.6
    ((effects, size),) = correlated_owners(many, np.arange(5))
    assert effects == [0, 1, 2, 3, 4]
    assert size > 0.95
    apart = posterior_correlation(np.concatenate([x, x, y, y, z], axis=1) + near[:, :5], 0.01)
    assert [effects for effects, _ in correlated_owners(apart, np.arange(5))] == [[0, 1], [2, 3]]
    # Coefficients of one effect may be correlated as they like.
    assert correlated_owners(pair, np.array([0, 0, 1])) == []


def test_it_is_said_what_keeps_one_alone(third):
    found = NotDistinguished(effects=("a", "b"), correlation=-0.991)
    shown = third.model_copy(update={"undistinguished": (found,), "folder": "results/both"})
    command = "imubayes remove b --from results/both --out results/both-a"
    assert f"Not distinguished: a and b, correlation −0.99; `{command}` keeps a alone." in change_lines(shown)


def evidence(*slots: dict[str, float]) -> Evidence:
    def slot(shares: dict[str, float]) -> EffectSlot:
        candidates = [ProbableEffect(effect=name, channels=("gx",), probability=p) for name, p in shares.items()]
        return EffectSlot(candidates=tuple(candidates), gain=8.0, probability=0.999)

    return Evidence.model_construct(slots=tuple(map(slot, slots)))


def test_the_odds_of_a_removal_are_those_of_the_addition():
    found = evidence({"a": 0.6, "b": 0.3}, {"c": 0.9})
    assert removal_log_odds(found, ["a"], ["x"]) == 8.0
    assert removal_log_odds(found, ["a", "c"], []) == 16.0
    assert removal_log_odds(found, ["a"], ["b"]) == pytest.approx(np.log(2))
    assert removal_log_odds(found, ["x"], []) is None
    assert removal_log_odds(found, ["a", "x"], []) is None

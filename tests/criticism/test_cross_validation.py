"""Adding an effect: what is expected is found, unseen runs agree, and what does not help is said not to."""

import json
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from loop_results import CAMPAIGN, LACKING, lacking_model
from scipy import stats

import imubayes.loop.refit as refit_module
from imubayes.api import ModelChange, Result, add, export, fit
from imubayes.criticism.diagnosis_record import CoefficientEstimate
from imubayes.criticism.explanation_records import EffectChoice
from imubayes.foundations.errors import InputError
from imubayes.inference.fitted_model import Fit
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.inference.posterior_mode import find_mode
from imubayes.loop.cross_validation import groups, objection, predict_left_out, summarise_gains, whole_fit
from imubayes.loop.warm_start import _contradicting, extend
from imubayes.model.noise_covariance import noise_distribution
from imubayes.model.problem import masked
from imubayes.parameters.declarations import Parameter
from imubayes.parameters.priors import Normal
from imubayes.results.history_tree import read_node, read_tree, select
from imubayes.results.result import read_result


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
    return add(second.result, ["accel_quadratic"], place / "third")


@pytest.mark.slow
def test_expected_is_found(second):
    assert second.taken
    expected, found = second.predicted, second.observed
    # The effect is linear in its coefficient, so the prediction is exact but for the curvature of the others.
    assert found.delta_chi2 == pytest.approx(expected.delta_chi2, rel=1e-2)
    assert expected.delta_chi2 > 36
    (guess,), (value,) = expected.coefficients, found.coefficients
    truth = tomllib.loads((CAMPAIGN / "truth.toml").read_text())["parameters"][value.name]
    assert abs(guess.value - truth) < 4 * guess.sd
    assert abs(value.value - truth) < 4 * value.sd


@pytest.mark.slow
def test_what_is_missing_helps_unseen_runs(second):
    unseen = second.held_out
    assert (unseen.verdict, unseen.by) == ("helps", "run")
    assert unseen.helped == unseen.of == 3
    assert unseen.delta == pytest.approx(sum(run.delta for run in unseen.each))


@pytest.mark.slow
def test_what_is_not_missing_is_marked_so(third):
    """The planted fault: an effect that is not in the data does not pass for one that helps."""
    assert third.taken
    assert third.held_out.verdict == "not"
    assert "DOES NOT IMPROVE" in str(third)


def test_the_error_falls_to_the_noise(second, place):
    (channel,) = second.channels
    assert channel.after < 0.7 * channel.before
    (known,) = read_node(place / "second").rms
    assert (known.channel, known.unit, known.rms) == ("ax", "g", channel.after)
    assert channel.after < 1.1 * known.noise
    # History and addition state one figure.
    before, after = (read_node(place / name) for name in ("first", "second"))
    assert before.chi2 - after.chi2 == pytest.approx(second.observed.delta_chi2)
    assert after.delta_chi2.observed == second.observed.delta_chi2


_FOUND = '''"""Found in the residuals."""

from imubayes import Order, Scalar, SignalEffect, Stage, parameter


class FoundShape(SignalEffect):
    """Signal + coefficient·(T − T₀)."""

    name = "found_accelerometer_shape"
    stage, order, kinds = Stage.CONVERTER, Order.BIAS, ("accelerometer",)
    needs = ("converter_temperature",)
    coefficient: Scalar = parameter("output/degC", "normal(0, 1 output/degC)", (0.01, 1.0), "the coefficient")

    def apply(self, signal, sample):
        return signal + self.coefficient * (sample.ambient.converter_temperature - 25.0)
'''


@pytest.mark.slow  # test_user_effect.py adds one at every run
def test_a_shape_in_a_file_is_added_like_an_effect_of_the_catalogue(second, place, tmp_path):
    """The file defines what the catalogue has too: the same Δχ², cross-validation and place in the history."""
    (start,) = copied(place, tmp_path, "first")
    file = tmp_path / "found_shape.py"
    file.write_text(_FOUND)
    own = add(start, [str(file)], tmp_path / "own")
    assert own.taken
    assert own.observed.delta_chi2 == pytest.approx(second.observed.delta_chi2, rel=0.05)
    assert own.predicted.delta_chi2 == pytest.approx(own.observed.delta_chi2, rel=0.05)
    assert own.held_out is not None
    assert own.held_out.verdict == "helps"
    assert [choice.effect for choice in read_node(tmp_path / "own").added] == ["found_accelerometer_shape"]
    assert (tmp_path / "own" / "found_shape.py").read_text() == _FOUND
    kept = read_result(tmp_path / "own").fit.model.spec
    assert [Path(name).parent for name in kept.files] == [tmp_path / "own"]
    elsewhere = tmp_path / "other"
    elsewhere.mkdir()
    (elsewhere / "found_shape.py").write_text(_FOUND)
    with pytest.raises(InputError, match="another file 'found_shape"):
        add(tmp_path / "own", [str(elsewhere / "found_shape.py")], tmp_path / "twice")


def dense_density(fitted: Fit, left_out: np.ndarray, parameters_known: bool = False) -> float:
    """Return log p(left out | rest) from whole covariance matrices, linear about the mode without."""
    problem = fitted.model.problem
    rest = masked(problem, left_out)
    mode = find_mode(rest, jnp.asarray(fitted.z), jnp.asarray(fitted.h))
    law = noise_distribution(problem, mode.h)
    own, shared = np.asarray(law.squared_scale), np.asarray(law.shared_variance)
    group = np.asarray(problem.observations.group)[left_out]
    covariance = np.diag(own[left_out]) + np.where(group[:, None] == group, shared[group][:, None], 0.0)
    jacobian = np.asarray(mode.about.jacobian)[left_out]
    if not parameters_known:
        covariance = covariance + jacobian @ np.linalg.solve(np.asarray(posterior_precision(rest, mode)), jacobian.T)
    misfit = np.asarray(mode.about.misfit)[left_out]
    _, log_determinant = np.linalg.slogdet(2 * np.pi * covariance)
    return float(-0.5 * (misfit @ np.linalg.solve(covariance, misfit) + log_determinant))


def test_the_predictive_density_is_that_of_whole_matrices(first):
    """Red without the uncertainty of the parameters: then the numbers differ by more than rounding."""
    fitted = first.fit
    _, names, masks = groups(fitted.model)
    assert names == tuple(run.name for run in fitted.model.campaign.runs)
    whole = whole_fit(fitted)
    for mask in masks[:2]:
        found = predict_left_out(whole, mask).density
        # `find_mode` ends where a step is below a thousandth, which moves this density by up to 0.005.
        assert found == pytest.approx(dense_density(fitted, mask), abs=1e-2)
        assert abs(found - dense_density(fitted, mask, parameters_known=True)) > 0.05


@pytest.mark.parametrize(
    ("gains", "verdict"),
    [([3.0, 2.0, 4.0], "helps"), ([9.0, -8.0, 4.0], "unclear"), ([-1.0, 0.2, -3.0], "not"), ([0.1, 0.1, 0.2], "not")],
)
def test_the_verdict_of_gains(gains, verdict):
    assert summarise_gains("run", ("a", "b", "c"), np.array(gains)).verdict == verdict


def test_a_gain_of_few_runs_that_no_other_run_contradicts_helps():
    """An effect of fast runs alone: the scatter among the gains is that of the runs, and no doubt about the sum."""
    gains = np.array([38.0, 24.0, 9.0, 2.0, 1.1, 0.7, 0.4, 0.2, 0.1, 0.3, 0.2, -0.2])
    names = tuple("abcdefghijkl")
    assert gains.sum() < 2 * np.sqrt(12) * gains.std(ddof=1)
    assert summarise_gains("run", names, gains).verdict == "helps"
    assert summarise_gains("run", names, gains * np.array([1, -1] * 6)).verdict != "helps"


@pytest.mark.parametrize("count", [7, 42])
def test_gains_without_a_sign_seldom_help(count):
    rng = np.random.default_rng(3)
    gains = rng.standard_t(2, (600, count))
    helps = [summarise_gains("run", ("",) * count, each).verdict == "helps" for each in gains]
    assert np.mean(helps) < 0.05
    assert np.mean([summarise_gains("run", ("",) * count, np.abs(each)).verdict == "helps" for each in gains]) > 0.9


def test_one_run_alone_has_no_standard_error():
    assert summarise_gains("run", ("a",), np.array([3.0])).se is None


def test_what_stands_in_the_model_is_not_added_again(first):
    with pytest.raises(InputError, match="already contains the effect"):
        extend(first.fit, ["white_noise"])


@pytest.mark.slow
def test_a_prior_gives_way_to_what_was_measured_beyond_doubt(first):
    """A thousand times the usual drift in the readings: held back by its prior it would not be found."""
    assert extend(first.fit, [LACKING]).widened == {}
    campaign, drift = first.fit.model.campaign, 1000.0
    runs = [
        replace(run, observed=run.observed + drift * (run.covariates["converter_temperature"][:, None] - 25.0))
        for run in campaign.runs
    ]
    fitted = fit(replace(campaign, runs=tuple(runs)), lacking_model(), sample=False).fit
    found = extend(fitted, [LACKING])
    (one,) = found.coefficients
    assert one.value == pytest.approx(drift, rel=0.01)
    assert found.widened == {f"{LACKING}.slope": "normal(0, 1000 output/degC)"}  # as a model file states it


@pytest.mark.parametrize(("sd", "prior"), [(12.0, {f"{LACKING}.slope": "normal(0, 50 output/degC)"}), (18.0, {})])
def test_what_was_diagnosed_is_within_reach_of_the_refit(first, sd, prior):
    """50 ± 12 contradicts 0 ± 2 at four standard deviations; 50 ± 18 does not at three."""
    estimate = CoefficientEstimate(name=f"{LACKING}.slope[ax]", value=50.0, sd=sd, unit="output/degC")
    assert extend(first.fit, [LACKING], estimates=[estimate]).widened == prior


@pytest.mark.parametrize("sizes", [(0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (2.0, 2.5, 2.2), (2.4, 0.5, 0.1), (3.1, 0.0, 0.0)])
def test_many_coefficients_contradict_their_prior_together(sizes):
    """The prior predictive distribution of the estimates, by its whole covariance."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(3, 3))
    squares = 1e-4 * (root @ root.T + 3 * np.eye(3))  # each determined to some hundred prior standard deviations
    covariance = np.linalg.inv(squares)
    estimate = np.array(sizes) * np.sqrt(1 + np.diag(covariance))
    priors = [Parameter("effect", f"c{k}", ("a",), "ppm", 1e-6, Normal(0.0, 2e-6)) for k in range(3)]
    found = _contradicting(priors, np.zeros(3), squares, squares @ estimate)
    score = estimate @ np.linalg.solve(np.eye(3) + covariance, estimate)
    together = stats.chi2.sf(score, 3) < 2 * stats.norm.sf(3)
    expected = (np.array(sizes) > 3) | (together & (estimate > 3))
    np.testing.assert_allclose(found, np.where(expected, 2e-6 * estimate, 0.0), rtol=1e-9, atol=1e-20)
    assert found.any() == (max(sizes) > 3 or sizes[1] > 2), "the cases are on either side"


def test_an_effect_that_does_not_exist_is_refused(first, tmp_path):
    with pytest.raises(InputError, match="accel_quadratic"):
        add(first, ["accel_quadratik"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_no_result_is_overwritten(place, first, second):
    with pytest.raises(InputError, match="already contains a result"):
        add(first, [LACKING], place / "second")


@pytest.mark.slow
def test_a_scanned_shape_begins_at_its_value(first):
    name = "converter_leakage.doubling[ax]"
    found = {}
    for value in (6.0, 14.0):
        extension = extend(first.fit, ["converter_leakage"], shape={"converter_leakage.doubling": value})
        at = extension.model.layout.index(name)
        parameter = extension.model.layout.parameters[at]
        assert float(parameter.prior.value(jnp.asarray(extension.z[at]))) / parameter.factor == pytest.approx(value)
        found[value] = extension.delta_chi2
    assert found[6.0] != pytest.approx(found[14.0], rel=0.05)


def copied(place: Path, to: Path, *names: str) -> list[Path]:
    for name in names:
        shutil.copytree(place / name, to / name)
    return [to / name for name in names]


@pytest.mark.parametrize("fault", [pytest.param("unconverged", marks=pytest.mark.slow), "worse"])
def test_a_bad_refit_is_not_taken(place, first, tmp_path, monkeypatch, fault):
    (result,) = copied(place, tmp_path, "first")
    select(result)
    if fault == "worse":
        monkeypatch.setattr(refit_module, "observed_delta_chi2", lambda *_: -3.0)
    else:
        monkeypatch.setattr(
            refit_module,
            "objection",
            lambda after, drop, _: objection(Fit(after.model, after.z, after.h, False, "No."), drop),
        )
    found = add(result, [LACKING], tmp_path / "next")
    assert not found.taken
    assert "not taken" in found.message
    node = read_node(tmp_path / "next")
    assert (node.taken, node.selected) == (False, False)
    assert read_tree([tmp_path / "next"]).selected == (str(result.resolve()),)
    with pytest.raises(InputError, match="was not taken"):
        select(tmp_path / "next")


def test_undo_selects_what_was_there_before(place, first, second, tmp_path):
    folders = copied(place, tmp_path, "first", "second")
    assert read_tree([folders[1]]).selected == (str(folders[1].resolve()),)
    tree = select(folders[0])
    assert tree.selected == (str(folders[0].resolve()),)
    export(folders[1], tmp_path / "selected.toml")
    assert (tmp_path / "selected.toml").read_text() == (folders[0] / "model.toml").read_text()


@pytest.mark.slow  # for its third fit; test_removal.py reads a tree of three at every run
def test_the_history_is_a_tree_with_one_selected(place, third, tmp_path):
    folders = copied(place, tmp_path, "first", "second", "third")
    tree = read_tree([folders[1]])
    assert set(tree.nodes) == {str(folder.resolve()) for folder in folders}
    assert [depth for depth, _ in tree.in_order()] == [0, 1, 2]
    assert tree.selected == (str(folders[2].resolve()),)
    # Undo: the parent is selected again, and exported.
    tree = select(folders[1])
    assert tree.selected == (str(folders[1].resolve()),)
    export(folders[2], tmp_path / "selected.toml")
    assert (tmp_path / "selected.toml").read_text() == (folders[1] / "model.toml").read_text()
    node = read_node(folders[1])
    assert node.added == (EffectChoice(effect=LACKING, channels=("ax",)),)
    assert node.held_out is not None
    assert node.held_out.verdict == "helps"
    assert node.data_hash == read_node(folders[0]).data_hash
    assert node.model_hash != read_node(folders[0]).model_hash


def test_the_old_result_stays(place, second):
    fitted = read_result(place / "first").fit
    assert LACKING not in {one.name for one in fitted.model.spec.effects}
    assert json.loads((place / "second" / "change.json").read_text())["taken"]

"""A missing effect is named with its size; effects that the runs do not distinguish from it are named beside it.

The planted effect is a response of the package's own, or comes from generators that share no code with it.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from null_data import fitted_to, redrawn
from planted_data import (
    member,
    names,
    of_typical,
    planted,
    probability,
    random_fit,
    signal,
    standing,
    surely_wrong,
    told,
)  # fmt: skip

from imubayes.criticism.diagnose import judge
from imubayes.criticism.evidence import relinearised_search
from imubayes.criticism.evidence.linear_problem import linear_problem
from imubayes.display.loop.diagnosis_report import diagnosis_json, diagnosis_lines, next_command
from imubayes.inference.fitted_model import Fit
from imubayes.responses.candidate_effects import LinearisationPoint, candidate_responses

BETWEEN = "gyro_magnetic_sensitivity"


def converter() -> Fit:
    return fitted_to("accel-channel", "accel-channel")


def positions() -> Fit:
    return fitted_to("geographic-tumble", "geographic-tumble")


def polar() -> Fit:
    return fitted_to("polar-tumble", "polar-tumble")


def sized(effect: str, deviations: float, seed: int) -> None:
    """Fail if an effect of one coefficient that stands so far out of the noise is not named with its size."""
    change, size = standing(converter(), effect, deviations)
    found = judge(planted(converter(), seed, change))
    assert names(found, effect), told(found)
    own = member(found, effect)
    assert own is not None
    [coefficient] = own.coefficients
    assert coefficient.value is not None
    assert coefficient.sd is not None
    assert abs(coefficient.value - size) < 3.5 * coefficient.sd, told(found)
    assert not surely_wrong(found, effect), told(found)


@pytest.mark.parametrize(
    "effect",
    ["converter_gain_temperature_rate", pytest.param("converter_offset_temperature_rate", marks=pytest.mark.slow)],
)
def test_an_effect_is_found_with_its_size(effect: str) -> None:
    sized(effect, 10.0, 3)


@pytest.mark.slow
def test_an_effect_far_beyond_its_typical_size_is_found_with_its_size() -> None:
    """A drift of the bias over three runs, most of which offsets of runs take."""
    sized("accel_bias_drift", 10.0, 3)


@pytest.mark.slow
def test_a_large_effect_leaves_none_beside_it() -> None:
    """What is left of it by its curvature and by priors that pull must not pass for a lag beside the hysteresis."""
    change, _ = standing(converter(), "converter_gain_hysteresis", 45.0, play=12.0)
    found = judge(planted(converter(), 0, change))
    assert [group.effects for group in found.groups] == [("converter_gain_hysteresis",)], told(found)
    assert found.verdict == "missing_effect"
    assert next_command(found).startswith("imubayes add converter_gain_hysteresis --to")


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 4))])
def test_nothing_is_named_where_nothing_is_missing(seed: int) -> None:
    found = judge(redrawn(converter(), seed))
    assert found.verdict == "adequate", told(found)
    assert not found.groups
    assert probability(found, "nothing") > 0.5
    assert found.ranking


@pytest.mark.slow
def test_a_fit_that_stopped_is_explained_about_where_it_stopped() -> None:
    document = diagnosis_json(judge(replace(converter(), optimised=False, message="It did not settle.")))
    assert document["verdict"] == "not_converged"
    assert document["sentence"].startswith("It did not settle.")
    assert document["explanations"] is not None
    # Asked about one effect it is no answer either.
    stopped = replace(converter(), optimised=False, message="It did not settle.")
    document = diagnosis_json(judge(stopped, effect="accel_cubic"))
    assert document["verdict"] == "not_converged"
    assert document["sentence"].startswith(
        "It did not settle. At the point at which the fit stopped, accel_cubic is missing with"
    )
    # Without a mode there is nothing to be linear about.
    nowhere = replace(converter(), z=np.full(len(converter().z), np.nan), optimised=False, message="It diverged.")
    document = diagnosis_json(judge(nowhere))
    assert (document["verdict"], document["ranking"], document["sentence"]) == ("not_converged", [], "It diverged.")


@pytest.mark.slow
def test_chains_that_did_not_converge_do_not_keep_effects_from_being_ranked() -> None:
    """The explanations are about the mode, which does not depend on the sampling; that it failed is said."""
    unsampled = replace(converter(), sampled=False, message="The chains are too short.")
    assert not unsampled.converged
    with_chains, plain = judge(unsampled), judge(converter())
    assert with_chains.ranking == plain.ranking
    assert with_chains.verdict == plain.verdict
    assert any("The sampling of this fit did not converge" in line for line in diagnosis_lines(with_chains))


@pytest.mark.parametrize(
    "share",
    [0.003, 0.1],
)
@pytest.mark.slow  # test_dead_zone.py has the gyro's at every run
def test_what_the_runs_do_not_distinguish_is_told_and_suggested_together(share: float) -> None:
    """A dead zone of the gyro or of its converter."""
    through = signal(positions())
    width = share * np.abs(through).max()
    found = judge(planted(positions(), 3, -np.clip(through, -width, width)))
    both = {"converter_dead_zone", "gyro_dead_zone"}
    assert names(found, *both), told(found)
    assert both <= set(found.groups[0].effects), told(found)
    assert not surely_wrong(found, *both), told(found)
    assert found.verdict == "equivalent_effects"
    assert found.suggested is not None
    assert set(found.suggested.effects) & both
    assert found.all_that_fit is not None
    assert both <= set(found.all_that_fit.effects)
    assert "would fit as well" in diagnosis_lines(found)[0]


@pytest.mark.slow
def test_what_acts_across_the_input_axis_is_named() -> None:
    found = judge(planted(positions(), 7, of_typical(positions(), "gyro_misalignment", 6.0)))
    assert names(found, "gyro_misalignment"), told(found)
    assert not surely_wrong(found, "gyro_misalignment"), told(found)


@pytest.mark.slow
def test_a_drift_quadratic_in_g_is_named_first(tmp_path: Path) -> None:
    """Three series of positions of a gyro: at few degrees of freedom others are as significant."""
    fitted, truth = random_fit(tmp_path / "campaign", 300007, "hidden", "geographic_tumble")
    assert truth[0].effect == "gyro_g2_sensitivity"
    found = judge(fitted)
    assert names(found, "gyro_g2_sensitivity"), told(found)
    assert len(found.groups) == 1, told(found)


@pytest.mark.slow
def test_an_effect_between_few_runs_is_not_passed_over_for_scatter() -> None:
    """Seven runs, whose scatter its prior bounds."""
    found = judge(planted(polar(), 5, of_typical(polar(), BETWEEN, 0.2)))
    assert names(found, BETWEEN), told(found)
    assert found.groups[0].effects[0] == BETWEEN
    assert len(found.groups) == 1, told(found)


@pytest.mark.slow
def test_complete_models_between_few_runs_name_nothing() -> None:
    for seed in range(8):
        found = judge(redrawn(polar(), 50 + seed))
        assert probability(found, "effects") < 0.5, told(found)
        assert not surely_wrong(found), told(found)


@pytest.mark.slow
def test_what_scatter_took_up_is_named_and_no_rest_of_it(tmp_path: Path) -> None:
    """Four runs at two rates: a rest of the asymmetry within runs is shared by effects that imitate it."""
    fitted, truth = random_fit(tmp_path / "campaign", 240018, "hidden", "rotation_modulation")
    assert truth[0].effect == "gyro_scale_asymmetry"
    assert truth[0].within < 5
    found = judge(fitted)
    assert names(found, "gyro_scale_asymmetry"), told(found)
    assert not surely_wrong(found, "gyro_scale_asymmetry"), told(found)


@pytest.mark.slow
def test_one_effect_asked_about() -> None:
    """Absent down to a size if nothing is missing, missing if it was planted."""
    effect = "converter_offset_temperature_rate"
    absent = judge(converter(), effect=effect)
    assert absent.verdict == "adequate", told(absent)
    assert absent.asked is not None
    assert absent.asked.effect == effect
    assert absent.asked.smallest_detectable is not None
    found = judge(planted(converter(), 3, standing(converter(), effect, 20.0)[0]), effect=effect)
    assert found.verdict == "missing_effect", told(found)


@pytest.mark.slow
def test_an_effect_that_is_in_doubt_is_not_called_absent() -> None:
    """A gain that depends on the row before looks like a hysteresis of little play."""
    effect = "converter_gain_hysteresis"
    found = judge(planted(converter(), 3, standing(converter(), effect, 20.0)[0]), effect=effect)
    assert found.probability(effect) > 0.05
    assert found.verdict != "adequate", told(found)


def test_a_linearisation_about_an_effect_with_a_shape_restores_what_the_fit_leaves() -> None:
    """Coefficients count from zero wherever the model is linearised, so that no other effect meets what one takes."""
    fitted = converter()
    responses = candidate_responses(fitted)
    problem = linear_problem(fitted, responses)
    lag = next(each for each in responses.candidates if each.scan.shape)
    shapes = {lag.scan.effect: {name: 1.3 * value for name, value in lag.scan.shape.items()}}
    sizes = {each.parameter.name: size for each, size in zip(problem.coefficients, problem.sizes, strict=True)}
    values = {each.parameter.name: 0.3 * sizes[each.parameter.name] for each in lag.coefficients}
    moved = relinearised_search._linearised(
        problem, relinearised_search._About(fitted, LinearisationPoint(values, shapes))
    )
    assert moved is not None
    for before, after in zip(problem.rows, moved.rows, strict=True):
        np.testing.assert_allclose(after.columns[:, -1], before.columns[:, -1], atol=1e-6)

"""What acts between few runs is evident from the scatter that its prior expects, and a complete model stays quiet."""

import math
from pathlib import Path
from typing import Any

import hidden
import numpy as np
import pytest
from null_data import fitted_to, redrawn, refitted

from imubayes.campaign import load_campaign
from imubayes.criticism import diagnose, effect_selection, effects_beside_noise, stepwise_search, thresholds
from imubayes.responses.candidate_effects import candidate_responses
from imubayes.criticism.diagnose import judge
from imubayes.criticism.marginal_evidence import evident_between_runs
from imubayes.adequacy.projection import project
from imubayes.criticism.score_test import project_responses, screen
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model

BETWEEN = "gyro_magnetic_sensitivity"


def polar() -> Fit:
    return fitted_to("polar-tumble", "polar-tumble")


def evident(fitted: Fit) -> dict[str, float]:
    """Return log B of each effect that is evident."""
    responses = candidate_responses(fitted)
    at = project(fitted, responses.misfit, responses.jacobian)
    prepared = project_responses(at, responses.candidates)
    candidates = screen(at, prepared)
    found = evident_between_runs(fitted, responses, prepared, candidates)
    return {candidates[place].effect: value for place, value in found.items()}


def planted(seed: int, **sizes: float) -> Fit:
    """Return the fit of readings with effects of so many times their typical size."""
    change = 0.0
    for name, size in sizes.items():
        truth = next(each for each in candidate_responses(polar()).candidates if each.scan.effect == name)
        typical = np.array([coefficient.typical[1] for coefficient in truth.coefficients])
        change += truth.columns @ (size * typical * np.resize((0.8, -0.6, 0.3), len(typical)))
    return redrawn(polar(), seed, change=np.asarray(change))


@pytest.mark.parametrize("verdict", ["missing_effect", "noise_model"])
def test_an_effect_between_few_runs_is_not_passed_over(monkeypatch: pytest.MonkeyPatch, verdict: Any) -> None:
    """Seven runs: the F test of their scatter says nothing of such an effect.

    Without this evidence, and without that of all explanations, it passes for scatter between runs, far beyond the
    prior of that.
    """
    if verdict == "noise_model":
        monkeypatch.setattr(effects_beside_noise, "evident_between_runs", lambda *_: {})
        monkeypatch.setattr(diagnose, "explain", lambda *_: None)
    found = judge(planted(5, **{BETWEEN: 0.2}))
    assert found.verdict == verdict
    assert [group.effects[0] for group in found.groups] == ([BETWEEN] if verdict == "missing_effect" else [])


@pytest.mark.parametrize("beside", [True, False])
def test_what_acts_within_runs_beside_it_is_selected_as_well(monkeypatch: pytest.MonkeyPatch, beside: bool) -> None:
    """Alone the effect between runs would leave a structure that an effect of the catalogue explains."""
    if not beside:
        alone = lambda at, group, *_: effects_beside_noise.only(at, group)  # noqa: E731
        monkeypatch.setattr(effects_beside_noise, "select_beside", alone)
    found = judge(planted(5, **{BETWEEN: 0.3, "table_wobble": 10.0}))
    names = [set(group.effects) for group in found.groups]
    assert (found.verdict == "missing_effect") == beside
    assert (names[:1] == [{BETWEEN}] and any("table_wobble" in each for each in names[1:])) == beside


@pytest.mark.slow
def test_complete_models_are_not_evident_of_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tenth of the bound would allow an alarm in half of these; no candidate comes near."""
    monkeypatch.setattr(thresholds, "MARGINAL_EVIDENCE", 1.0)
    monkeypatch.setattr(thresholds, "GRID_SLACK", math.inf)
    assert not [found for seed in range(8) if (found := evident(redrawn(polar(), 50 + seed)))]


@pytest.mark.slow
@pytest.mark.parametrize("outweighs", [True, False])
def test_what_scatter_took_up_outweighs_its_smaller_part_within_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, outweighs: bool
) -> None:
    """Four runs at two rates, whose generator shares no code with the package.

    A rest of the asymmetry within runs is shared by effects that imitate it: without the marginal likelihood they are
    called unexplained structure.
    """
    drawn = hidden.random_campaign(tmp_path / "campaign", 240018, "hidden", "rotation_modulation")
    assert drawn.planted[0].effect == "gyro_scale_asymmetry"
    assert drawn.planted[0].within < 5
    if not outweighs:
        # An equivalent of the leader that is tried alone explains the rest as well: neither rule.
        monkeypatch.setattr(stepwise_search, "outweighed", lambda given, at, outcome: outcome)
        monkeypatch.setattr(effect_selection, "_by_another_name", lambda at, forward, *_: forward)
    model = bind(read_model(drawn.model), load_campaign(drawn.folder))
    found = judge(refitted(model, *(np.zeros(size) for size in model.problem.size)))
    names = [effect for group in found.groups for effect in group.effects]
    assert ("gyro_scale_asymmetry" in names) == outweighs
    assert (found.verdict == "unexplained_structure") != outweighs

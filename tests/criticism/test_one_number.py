"""A diagnosis says one thing once: one prediction of a coefficient, the covariate of the effect that is named, an order
that the table shows, and no candidate that no run excites.  And what it suggests next is known to work.

Records made by hand: what is tested is how a diagnosis puts together what the screening found.
"""

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from imubayes.criticism.free_form_dependence import Structure
from imubayes.criticism.score_test import Candidate, ScoreTest
from imubayes.criticism.stepwise_search import SearchResult

from imubayes.criticism import diagnose, suggestions, thresholds
from imubayes.loop import addition
from imubayes.responses.candidate_effects import ShapeScan
from imubayes.loop.changed_model import ChangedModel
from imubayes.criticism.diagnosis_record import (
    CoefficientEstimate,
    Diagnosis,
    EffectGroup,
    RankedEffect,
    RivalExplanation,
)
from imubayes.adequacy.projection import Projection
from imubayes.responses.residual_covariates import ResidualCovariate
from imubayes.criticism.residual_evidence import following_covariate
from imubayes.criticism.verdict import EffectChoice, Suggestion
from imubayes.display import diagnosis_sentences

PPM = "ppm"


def made[Kind](kind: type[Kind], **fields: Any) -> Kind:
    """Return a record of which only these fields are read."""
    found = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(found, name, value)
    return found


def candidate(effect: str, value: float = 10.0, sd: float = 1.0, gain: float = 100.0, log_p: float = -200.0) -> Any:
    """Return a candidate on gx with one coefficient of 1 to 100 ppm."""
    parameter = SimpleNamespace(name=f"{effect}.coefficient[gx]", shown_unit=PPM)
    coefficient: Any = SimpleNamespace(parameter=parameter, owner="gx", typical=(1.0, 100.0))
    span = np.eye(4)[:, :1]
    score = ScoreTest(span, 3 * span[:, 0], 2 * gain, 2 * gain, log_p, gain, 2 * gain, 0.0, np.ones(1))
    one = np.ones(1)
    return Candidate(ShapeScan(effect, {}), (coefficient,), ("gx",), value * one, sd * one, one, score)


def search_result(leaders: tuple[Any, ...], rivals: tuple[Any, ...] = (), log_odds: float = 0.0) -> Any:
    """Return what a search found, each leader in a group of its own that is to be added together."""
    groups = tuple(SimpleNamespace(leader=each, members=(each,)) for each in leaders)
    campaign = SimpleNamespace(channels=(SimpleNamespace(name="gx"), SimpleNamespace(name="gy")))
    fitted = SimpleNamespace(model=SimpleNamespace(campaign=campaign))
    first = SimpleNamespace(projection=SimpleNamespace(fitted=fitted), candidates=(*leaders, *rivals))
    found = (SimpleNamespace(members=rivals, log_odds=log_odds),) if rivals else ()
    return made(
        SearchResult, groups=groups, first=first, rivals=found, unfinished=False, wandering="", adopted=(),
        paired=len(leaders) > 1, against_budget=lambda p: p, look_elsewhere=lambda p: min(1.0, 10 * p),
    )  # fmt: skip


def test_what_is_added_alone_is_predicted_as_the_diagnosis_did() -> None:
    """The linear model from the start of the refit is another approximation of the same coefficient."""
    told = CoefficientEstimate(name="lag.coefficient[gx]", value=248.72, sd=0.63, unit=PPM)
    linear = CoefficientEstimate(name="lag.coefficient[gx]", value=217.0, sd=36.0, unit=PPM)
    screened = RankedEffect(
        effect="lag", channels=("gx",), delta_chi2=90.0, shape={}, coefficients=(told,), dof=1, p=0.0, p_global=0.0,
        within_runs=90.0,
    )  # fmt: skip
    extension = made(ChangedModel, delta_chi2=80.0, coefficients=(linear,))
    assert addition._predicted_coefficients(extension, screened, True) == (told,)
    # Beside others its coefficient is another one: no diagnosis has estimated that.
    assert addition._predicted_coefficients(extension, screened, False) == (linear,)


@pytest.mark.parametrize(("own", "expected"), [({"table_rate"}, "table_rate"), (set[str](), "time")])
def test_the_covariate_that_is_told_is_one_of_the_effect(own: set[str], expected: str) -> None:
    """Rates in rising order go with the time; of an effect that depends on the rate the rate is told."""
    time, rate = (made(ResidualCovariate, name=name) for name in ("time", "table_rate"))
    near = np.array([[1.0], [0.1], [0.0], [0.0]]) / np.sqrt(1.01)
    structures = [
        made(Structure, channel="gx", covariates=(time,), score=SimpleNamespace(span=np.eye(4)[:, :1])),
        made(Structure, channel="gx", covariates=(rate,), score=SimpleNamespace(span=near)),
    ]
    strata = SimpleNamespace(of_row=np.zeros(4, dtype=int), channel=np.zeros(1, dtype=int))
    campaign = SimpleNamespace(channels=(SimpleNamespace(name="gx"),))
    projection = made(
        Projection, strata=strata, fitted=SimpleNamespace(model=SimpleNamespace(campaign=campaign))
    )  # fmt: skip
    found = following_covariate(projection, structures, candidate("scale_quadratic"), "gx", frozenset(own))
    assert found is not None
    assert found.name == expected


def test_what_no_run_excites_is_no_candidate() -> None:
    """An angle of 7e11 arcsec known to 5e11 is rounding error over a response of zero."""
    assert not candidate("table_wobble", 7.2e11, 5e11).plausible
    assert candidate("table_wobble", 40.0, 10.0).plausible


def test_candidates_are_in_the_order_of_the_p_value_that_is_shown() -> None:
    """A large drop of χ² against a noise scale of few degrees of freedom is worth less than a small one of many."""
    few, many = candidate("few", gain=292.0, log_p=np.log(0.02)), candidate("many", gain=12.5, log_p=np.log(4e-5))
    sure = [candidate(f"sure{k}", gain=gain, log_p=-800.0) for k, gain in enumerate((400.0, 600.0))]
    ranking = diagnose._ranking(search_result((few, many, *sure)))
    assert [line.effect for line in ranking] == ["sure1", "sure0", "many", "few"]
    assert all(a.p_global <= b.p_global for a, b in pairwise(ranking))


LEADER, SLOPE, CURVE = (candidate(name) for name in ("lag", "slope", "curvature"))


def test_a_set_that_is_decisively_likelier_is_suggested_alone() -> None:
    """Joined with the leader it would be a nearly singular model, in which the leader explains nothing."""
    even = suggestions.suggestions(search_result((LEADER,), (SLOPE, CURVE), 1.0), "equivalent_effects")
    assert even[0].effects == ("lag", "slope", "curvature")
    decided = suggestions.suggestions(search_result((LEADER,), (SLOPE, CURVE), 4060.0), "equivalent_effects")
    assert decided[0].effects == ("slope", "curvature")
    against = suggestions.suggestions(search_result((LEADER,), (SLOPE, CURVE), -1.0), "equivalent_effects")
    assert [each.effects for each in against] == [("lag", "slope", "curvature"), ("lag",)]


@pytest.mark.parametrize("failing", [0, 1, 2])
def test_what_is_suggested_is_the_first_whose_refit_converges(failing: int, monkeypatch: pytest.MonkeyPatch) -> None:
    found = search_result((LEADER,), (SLOPE, CURVE), 1.0)
    tried = suggestions.suggestions(found, "equivalent_effects")
    assert [len(each.effects) for each in tried] == [3, 2, 1]
    refits: list[tuple[str, ...]] = []

    def start(fit: Any, effects: tuple[str, ...], *_: Any) -> Any:
        refits.append(effects)
        return SimpleNamespace(model=SimpleNamespace(problem=None), z=None, h=None)

    monkeypatch.setattr(suggestions, "start_of_refit", start)
    monkeypatch.setattr(suggestions, "find_mode", lambda *_: SimpleNamespace(converged=len(refits) > failing))
    chosen = suggestions.that_converges(found, Diagnosis(verdict="equivalent_effects"), tried)
    assert chosen is not None
    assert chosen.effects == tried[failing].effects
    assert chosen.left_out == tuple(name for name in tried[0].effects if name not in chosen.effects)
    assert len(refits) == min(failing + 1, 2)


def test_it_is_said_what_is_left_out_and_which_explains_better() -> None:
    effects = (EffectChoice(effect="slope", channels=None), EffectChoice(effect="curvature", channels=None))
    group = EffectGroup.model_construct(channels=("gx",))

    def said(log_odds: float, **choice: Any) -> str:
        suggested = Suggestion(channels=None, **choice)
        found = Diagnosis(
            verdict="equivalent_effects", rivals=(RivalExplanation(effects=effects, log_odds=log_odds),),
            suggested=suggested,
        ).model_copy(update={"groups": (group,)})  # fmt: skip
        return diagnosis_sentences._rival_sentence(found)

    everything = ("lag", "slope", "curvature")
    assert "with all of them in the model holds both" in said(1.0, effects=everything)
    short = said(1.0, effects=("slope", "curvature"), left_out=("lag",))
    assert "lag is left out of the next command: the refit does not converge with all" in short
    assert "holds both" not in short
    better = said(thresholds.DECISIVE_LOG_ODDS + 10, effects=("slope", "curvature"))
    assert "slope, curvature together explain it better (log odds 13" in better
    assert "would fit as well" not in better

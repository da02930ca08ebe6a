"""Readings with something planted in them, and what a diagnosis says of it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import hidden
import jax.numpy as jnp
import numpy as np
import pytest
from null_data import redrawn, refitted

from imubayes.campaign import load_campaign
from imubayes.criticism import diagnose
from imubayes.criticism.detectability import AbsorbedResponses
from imubayes.criticism.diagnosis_record import Diagnosis, ScreenedEffect
from imubayes.criticism.evidence import relinearised_search
from imubayes.criticism.evidence.hypothesis_evidence import EvidenceOf
from imubayes.criticism.evidence.linear_problem import linear_problem
from imubayes.criticism.explanation_records import NAMED, Explanation
from imubayes.display.loop.diagnosis_report import diagnosis_lines
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.model.problem import predict
from imubayes.responses.candidate_effects import Response, candidate_responses

LEAST_SHARE = 0.05
"""Share of a group from which on an effect counts as named in it."""


def signal(fitted: Fit) -> np.ndarray:
    """Return the predicted outputs less their offset, (E,); closing rotations have none."""
    offsets = np.array([*(channel.offset for channel in fitted.model.campaign.channels), 0.0, 0.0, 0.0])
    predicted = np.asarray(predict(fitted.model.problem, jnp.asarray(fitted.z)))
    return predicted - offsets[fitted.model.entries.channel]


def fit_of(folder: Path, model: Path) -> Fit:
    """Return the fit of a campaign."""
    declared = bind(read_model(model), load_campaign(folder))
    return refitted(declared, *(np.zeros(size) for size in declared.problem.size))


def random_fit(folder: Path, seed: int, *more: str) -> tuple[Fit, tuple[hidden.Planted, ...]]:
    """Return the fit of a campaign drawn at random, whose generator shares no code with the package, and its truth."""
    drawn = hidden.random_campaign(folder, seed, *more)
    return fit_of(drawn.folder, Path(drawn.model)), tuple(drawn.planted)


def response(fitted: Fit, effect: str, **shape: float) -> Response:
    """Return the response to an effect, of a shape if one is given."""
    own = [each for each in candidate_responses(fitted).candidates if each.scan.effect == effect]
    return next(each for each in own if not shape or each.scan.shape == shape)


def of_typical(fitted: Fit, effect: str, times: float, pattern: Sequence[float] = (0.8, -0.6, 0.3)) -> np.ndarray:
    """Return what an effect of so many times its largest typical size does to the readings, (E,)."""
    found = response(fitted, effect)
    typical = np.array([each.typical[1] for each in found.coefficients])
    return found.columns @ (times * typical * np.resize(pattern, len(typical)))


def standing(fitted: Fit, effect: str, deviations: float, place: int = 0, **shape: float) -> tuple[np.ndarray, float]:
    """Return what a coefficient does to the readings that stands so far out of the noise, (E,), and its size."""
    responses = candidate_responses(fitted)
    of = EvidenceOf(linear_problem(fitted, responses))
    left, first = AbsorbedResponses(of, fitted).left, 0
    for each in responses.candidates:
        if each.scan.effect == effect and (not shape or each.scan.shape == shape):
            k = first + place
            size = float(deviations * of.problem.sizes[k] / np.sqrt(left[k]))
            return each.columns[:, place] * size, size
        first += len(each.coefficients)
    raise AssertionError(effect)


def planted(fitted: Fit, seed: int, change: np.ndarray) -> Fit:
    """Return the fit of fresh data with a change of the readings."""
    return redrawn(fitted, seed, change=change)


def without(monkeypatch: pytest.MonkeyPatch, *effects: str) -> None:
    """Take effects out of the catalogue of the diagnosis."""

    def lacking(*of: Any, **how: Any) -> Any:
        found = candidate_responses(*of, **how)
        return replace(found, candidates=tuple(each for each in found.candidates if each.scan.effect not in effects))

    monkeypatch.setattr(diagnose, "candidate_responses", lacking)
    monkeypatch.setattr(relinearised_search, "candidate_responses", lacking)


def told(found: Diagnosis) -> str:
    """Return what a diagnosis says, for a failing test."""
    groups = [({each.effect: round(each.probability, 3) for each in group.candidates}, round(group.probability, 3))
              for group in found.groups]  # fmt: skip
    return "\n".join(["", found.verdict, *diagnosis_lines(found), f"groups: {groups}"])


def probability(found: Diagnosis, kind: Explanation) -> float:
    """Return the probability of a kind of explanation."""
    assert found.explanations is not None
    return found.explanations.of(kind).probability


def member(found: Diagnosis, effect: str) -> ScreenedEffect | None:
    """Return an effect as a candidate of a group with a share worth the name; None if it is in none."""
    every = [each for group in found.groups for each in group.candidates if each.effect == effect]
    return next((each for each in every if each.probability >= LEAST_SHARE), None)


def names(found: Diagnosis, *effects: str) -> bool:
    """Return whether effects are missing rather than not, and all of these are among them."""
    return bool(found.groups) and probability(found, "effects") > 0.5 and all(member(found, each) for each in effects)


def surely_wrong(found: Diagnosis, *causes: str) -> list[tuple[str, ...]]:
    """Return the groups that are reported beyond reasonable doubt and hold none of the causes."""
    wrong = [group for group in found.groups if not set(causes) & set(group.effects)]
    return [group.effects for group in wrong if group.probability >= NAMED]

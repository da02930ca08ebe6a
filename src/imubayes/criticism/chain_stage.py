"""Whether the data tell the stage of the signal chain at which an effect acts: the sensor, or its converter.

A dead zone of a gyro and one of its converter change the outputs alike, and so do a saturation, a nonlinearity, a scale
factor error, a drift, or an effect of temperature where both devices have the same.  Each finding at one of these two
stages is therefore moved to the other on the signal path, whether or not the catalogue has an effect like it there, and
its response to all runs is compared.  A run that injects its input drives the converter alone; an effect of what acts
across the input axis, or of the motion, is none of a converter.

A curve of the input is one about the zero of its own device.  How much of the bias lies before the converter is not
known, so that what is cubic in the force is, as a curve of the converter, a cube with a square of any size.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.criticism.candidate_effects import Response, moved_responses
from imubayes.criticism.effect_covariates import INPUTS, covariates_of
from imubayes.criticism.equivalent_effects import EquivalenceGroup, indistinguishable
from imubayes.criticism.projection import Projection
from imubayes.criticism.score_test import Candidate, assess, project_responses
from imubayes.criticism.stepwise_search import SearchResult
from imubayes.effects.base import Effect, Stage
from imubayes.inference.fitted_model import Fit
from imubayes.model.bound_effects import BoundEffect, Move

_OTHER = {Stage.SENSOR: Stage.CONVERTER, Stage.CONVERTER: Stage.SENSOR}
_TEMPERATURES = (
    ("temperature", "converter_temperature"),
    ("temperature_rate", "converter_temperature_rate"),
)


@dataclass(frozen=True)
class FoundStage:
    """The stage of a finding, and whether the data tell it from the other."""

    stage: Stage
    determined: bool


def stages_of(found: SearchResult, groups: Sequence[EquivalenceGroup]) -> list[FoundStage | None]:
    """Return the stage of the leader of each group; None of an effect of table, mounting or place."""
    fitted = found.first.projection.fitted
    stages = [_stage(fitted, group.leader) for group in groups]
    names = [group.leader.effect for group, stage in zip(groups, stages, strict=True) if stage is not None]
    moved = moved_responses(fitted, names, lambda effect: _moved(fitted, effect)).candidates if names else ()
    return [
        None if stage is None else FoundStage(stage, not _same_elsewhere(found, group.leader, moved))
        for group, stage in zip(groups, stages, strict=True)
    ]


def _stage(fitted: Fit, leader: Candidate) -> Stage | None:
    member = fitted.model.registry.effects[leader.effect]
    return member.stage if issubclass(member, Effect) and member.stage in _OTHER else None


def _moved(fitted: Fit, effect: BoundEffect) -> Move:
    """Return the way of an effect to the other stage, where it reads the temperature of the device there.

    Where a run in which it acts does not record that, it may be the same for both.
    """
    member = effect.effect_class
    assert issubclass(member, Effect)
    to = _OTHER[member.stage]
    pairs = [(own, other) if to == Stage.CONVERTER else (other, own) for own, other in _TEMPERATURES]
    supplies = fitted.model.assembly.grouping.nodes.supplies
    acting = [supplied for run, supplied in enumerate(supplies) if run in effect.runs - effect.gated]
    return Move(to, tuple(pair for pair in pairs if all(pair[1] in supplied for supplied in acting)))


def _same_elsewhere(found: SearchResult, leader: Candidate, moved: Sequence[Response]) -> bool:
    """Tell whether the leader at the other stage would not be distinguished from it."""
    at = found.first.projection
    names = {coefficient.parameter.name for coefficient in leader.coefficients}
    for response in moved:
        own = [place for place, each in enumerate(response.coefficients) if each.parameter.name in names]
        if response.scan != leader.scan or not own:
            continue
        coefficients = tuple(response.coefficients[place] for place in own)
        rivals = [replace(response, coefficients=coefficients, columns=response.columns[:, own])]
        if _is_curve(at.fitted, leader):
            rivals.append(_about_any_zero(at, rivals[0]))
        there = (assess(at, each, np.arange(each.projected.shape[1])) for each in project_responses(at, rivals))
        return any(indistinguishable(at, leader, each) for each in there)
    return False


def _is_curve(fitted: Fit, leader: Candidate) -> bool:
    """Tell whether an effect goes with the input alone, by coefficients of either sign."""
    member = fitted.model.registry.effects[leader.effect]
    kinds = {channel.kind for channel in fitted.model.campaign.channels if channel.name in leader.owners}
    goes_with = {each for kind in kinds for each in covariates_of(member, kind)}
    signed = any(coefficient.sign for coefficient in leader.coefficients)
    return not signed and goes_with == {frozenset({INPUTS[kind]}) for kind in kinds}


def _about_any_zero(at: Projection, curve: Response) -> Response:
    """Return a curve with the square of the input of each of its channels beside it."""
    places = {channel.name: place for place, channel in enumerate(at.fitted.model.campaign.channels)}
    own = np.array([places[coefficient.owner] for coefficient in curve.coefficients])
    squares = np.where(at.fitted.model.entries.channel[:, None] == own, at.input[:, None] ** 2, 0.0)
    # Of the size of the curve, since directions that are small beside others are taken for rounding.
    squares *= np.linalg.norm(curve.columns, axis=0) / np.maximum(np.linalg.norm(squares, axis=0), 1e-300)
    both = (*curve.coefficients, *curve.coefficients)
    return replace(curve, coefficients=both, columns=np.concatenate([curve.columns, squares], axis=1))

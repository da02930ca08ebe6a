"""Whether the data tell the stage of the signal chain at which an effect acts: the sensor, or its converter.

A dead zone of a gyro and one of its converter change the outputs alike, and so do a saturation, a nonlinearity, a scale
factor error, a drift, or an effect of temperature where both devices have the same.  Each finding at one of these two
stages is therefore moved to the other on the signal path, whether or not the catalogue has an effect like it there, and
its response to all runs is compared.  A run that injects its input drives the converter alone; an effect of what acts
across the input axis, or of the motion, is none of a converter.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.criticism.candidate_effects import Response, moved_responses
from imubayes.criticism.equivalent_effects import EquivalenceGroup, indistinguishable
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
    for projected in project_responses(at, [each for each in moved if each.scan == leader.scan]):
        own = [coefficient.parameter.name in names for coefficient in projected.response.coefficients]
        if any(own):
            return indistinguishable(at, leader, assess(at, projected, np.flatnonzero(own)))
    return False

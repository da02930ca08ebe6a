"""The search: look, take out the best explanation, look again, until nothing is left that chance would not do."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.criticism.candidates import Responses, respond
from imubayes.criticism.chance import LookElsewhere, look_elsewhere
from imubayes.criticism.covariates import Covariate, covariates
from imubayes.criticism.groups import Group, group
from imubayes.criticism.noise import NoiseCandidate, prewhitening, screen_noise
from imubayes.criticism.projection import Projection, project
from imubayes.criticism.screen import Candidate, Projected, prepare, screen
from imubayes.criticism.structure import Laid, Structure, forms, lay, look
from imubayes.inference.fitted import Fitted

# Nominal chance of a false alarm, of effects and structure together and of noise.  Together below 5 %: where a stratum
# has few degrees of freedom its scale is judged roughly, and random plans gave more alarms than the nominal chance.
EFFECT_THRESHOLD, NOISE_THRESHOLD = 0.02, 0.005
_MOST_STEPS, _MOST_PATTERNS = 4, 8


@dataclass(frozen=True)
class Look:
    """One pass over candidates and free forms.

    Attributes
    ----------
    candidates, structures : the least likely by chance first.
    """

    projection: Projection
    prepared: tuple[Projected, ...]
    laid: tuple[Laid, ...]
    candidates: tuple[Candidate, ...]
    structures: tuple[Structure, ...]


@dataclass(frozen=True)
class Found:
    """The outcome of a search.

    Attributes
    ----------
    first : the first look, at the noise that was settled on.
    responses, covariates : what was looked at.
    groups : one per effect found, in the order of evidence.
    left : structures that remain significant after the groups were taken out, with their chance.
    noise : noise candidates as screened first.
    adopted : those that had to be taken as noise for the rest to be judged.
    chance : of the smallest p-value of all looks.
    """

    first: Look
    responses: Responses
    covariates: tuple[Covariate, ...]
    groups: tuple[Group, ...]
    structures: tuple[tuple[Structure, float], ...]
    left: tuple[tuple[Structure, float], ...]
    noise: tuple[NoiseCandidate, ...]
    adopted: tuple[NoiseCandidate, ...]
    chance: LookElsewhere


def search(fitted: Fitted) -> Found:
    """Return what is missing in a converged fit, without any refit."""
    responses, known = respond(fitted), tuple(covariates(fitted))
    projection = project(fitted, responses.misfit, responses.jacobian)
    free = forms(projection, known)
    first = _look(projection, prepare(projection, responses.candidates), lay(projection, free))
    chance = look_elsewhere([*(one.found for one in first.candidates), *(one.found for one in first.structures)])
    noise = screen_noise(projection)
    groups, last = _steps(first, chance)
    # What effects or any pattern explain is not noise; what is left after all of them may be.
    suspected = _significant(screen_noise(last.projection) if groups else noise)
    adopted = _significant(screen_noise(_stripped(last, chance).projection)) if suspected else []
    if adopted:
        offsets = any(one.effect == "run_scatter" for one in adopted)
        extra = prewhitening(projection, adopted)
        projection = project(fitted, responses.misfit, responses.jacobian, extra, offsets)
        first = _look(projection, prepare(projection, responses.candidates), lay(projection, free))
        groups, last = _steps(first, chance)
    return Found(
        first=first,
        responses=responses,
        covariates=known,
        groups=groups,
        structures=_alarming(first.structures, chance),
        left=_alarming(last.structures, chance),
        noise=tuple(noise),
        adopted=tuple(adopted),
        chance=chance,
    )


def _significant(noise: Sequence[NoiseCandidate]) -> list[NoiseCandidate]:
    return [one for one in noise if one.p * len(noise) < NOISE_THRESHOLD]


def _alarming(structures: Sequence[Structure], chance: LookElsewhere) -> tuple[tuple[Structure, float], ...]:
    judged = [(one, chance(one.found.p)) for one in structures]
    return tuple(pair for pair in judged if pair[1] < EFFECT_THRESHOLD)


def _look(projection: Projection, prepared: Sequence[Projected], laid: Sequence[Laid]) -> Look:
    candidates, structures = screen(projection, prepared), look(projection, laid)
    return Look(projection, tuple(prepared), tuple(laid), tuple(candidates), tuple(structures))


def _steps(first: Look, chance: LookElsewhere) -> tuple[tuple[Group, ...], Look]:
    """Take out the best candidate and look again, as long as one is beyond chance."""
    at, groups = first, []
    while at.candidates and len(groups) < _MOST_STEPS:
        leader = at.candidates[0]
        p = chance(leader.p)
        if p >= EFFECT_THRESHOLD:
            break
        groups.append(group(at.projection, leader, at.candidates, p))
        at = take_out(at, leader.found.span)
    return tuple(groups), at


def _stripped(at: Look, chance: LookElsewhere) -> Look:
    """Take out the patterns that are beyond chance, one after the other."""
    for _ in range(_MOST_PATTERNS):
        if not at.structures or chance(at.structures[0].found.p) >= EFFECT_THRESHOLD:
            break
        at = take_out(at, at.structures[0].found.span)
    return at


def take_out(at: Look, span: np.ndarray) -> Look:
    """Return the look after some directions, (R, d), have been taken out."""

    def less(columns: np.ndarray) -> np.ndarray:
        return columns - span @ (span.T @ columns)

    prepared = [replace(one, projected=less(one.projected)) for one in at.prepared]
    laid = [replace(one, columns=less(one.columns)) for one in at.laid]
    return _look(at.projection.without(span), prepared, laid)

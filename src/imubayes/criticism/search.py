"""The search: look, take out the best explanation, look again, until nothing is left that chance would not do."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.criticism.candidates import Responses, respond
from imubayes.criticism.chance import LookElsewhere, look_elsewhere
from imubayes.criticism.covariates import Covariate, covariates
from imubayes.criticism.details import Details, Scan, details, scan
from imubayes.criticism.groups import Group, group
from imubayes.criticism.noise import NoiseCandidate, prewhitening, screen_noise
from imubayes.criticism.projection import Projection, orthonormal, project
from imubayes.criticism.screen import Candidate, Projected, prepare, screen
from imubayes.criticism.structure import Laid, Structure, forms, lay, look
from imubayes.inference.fitted import Fitted

# Chance of a false alarm, of effects, of structure and of noise.
EFFECT_THRESHOLD, STRUCTURE_THRESHOLD, NOISE_THRESHOLD = 0.02, 0.02, 0.01
# Chances are worked out for a known noise.  Where its memory had to be estimated from the same readings, so much less
# chance is asked for.
_WITH_MEMORY = 0.1
# Noise with memory, or offsets of runs, that is so much as hinted at is allowed for before an effect is claimed: where
# it is real it passes for effects.
_NOISE_DOUBT, _DOUBTED = 0.1, ("correlated_noise", "run_scatter")
# A pattern this far beyond chance is no noise, whatever its memory.
_NO_NOISE = 1e-6
_MOST_STEPS, _MOST_PATTERNS = 4, 8
# Directions between neighbouring shapes count down to this share of their squared length.
_SAME_SHAPE = 1e-4


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
    scans: tuple[Scan, ...]
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
    adopted : those that are beyond chance once effects and patterns are taken out.
    chance : of the smallest p-value of all candidates.
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

    def look_through(at: Projection) -> Look:
        return _look(at, prepare(at, responses.candidates), lay(at, free), details(at, known))

    first = look_through(projection)
    chance = look_elsewhere([one.found for one in first.candidates])
    of_structure = look_elsewhere([one.found for one in first.structures], first.scans)
    noise = screen_noise(projection)
    groups, last = _steps(first, chance)
    alarm = bool(groups or _alarming(first.structures, of_structure))
    left, adopted, doubted, strict = last.projection, [], [], 1.0
    if alarm or _within(noise, NOISE_THRESHOLD):
        left = _without_patterns(last, of_structure, at_least=int(alarm and not groups)).projection
        remaining = screen_noise(left)
        adopted = _within(remaining, NOISE_THRESHOLD)
        hinted = [one for one in _within(remaining, _NOISE_DOUBT) if one.effect in _DOUBTED and one not in adopted]
        doubted = [*adopted, *(hinted if alarm else ())]
    if doubted:
        offsets = any(one.effect == "run_scatter" for one in doubted)
        extra = prewhitening(left, doubted)
        projection = project(fitted, responses.misfit, responses.jacobian, extra, offsets)
        first = look_through(projection)
        strict = _WITH_MEMORY if any(one.effect == "correlated_noise" for one in adopted) else 1.0
        groups, last = _steps(first, chance, strict)
    return Found(
        first=first,
        responses=responses,
        covariates=known,
        groups=groups,
        structures=_alarming(first.structures, of_structure, strict),
        left=_alarming(last.structures, of_structure, strict),
        noise=tuple(noise),
        adopted=tuple(adopted),
        chance=chance,
    )


def _within(noise: Sequence[NoiseCandidate], threshold: float) -> list[NoiseCandidate]:
    """Return the noise candidates whose chance, with all of them counted, is below a threshold."""
    return [one for one in noise if one.p * len(noise) < threshold]


def _alarming(
    structures: Sequence[Structure], chance: LookElsewhere, strict: float = 1.0
) -> tuple[tuple[Structure, float], ...]:
    judged = [(one, chance(one.found.p)) for one in structures]
    return tuple(pair for pair in judged if pair[1] < strict * STRUCTURE_THRESHOLD)


def _look(projection: Projection, prepared: Sequence[Projected], laid: Sequence[Laid], fine: Sequence[Details]) -> Look:
    scans = [scan(projection, one) for one in fine]
    candidates, structures = screen(projection, prepared), look(projection, laid, scans)
    return Look(projection, tuple(prepared), tuple(laid), tuple(scans), tuple(candidates), tuple(structures))


def _steps(first: Look, chance: LookElsewhere, strict: float = 1.0) -> tuple[tuple[Group, ...], Look]:
    """Take out the best candidate and look again, as long as one is beyond chance."""
    at, groups = first, []
    while at.candidates and len(groups) < _MOST_STEPS:
        p = chance(min(one.p for one in at.candidates))
        if p >= strict * EFFECT_THRESHOLD:
            break
        leader = next(one for one in at.candidates if chance(one.p) < strict * EFFECT_THRESHOLD)
        groups.append(group(at.projection, leader, at.candidates, p))
        at = take_out(at, whole_span(at, leader))
    return tuple(groups), at


def _without_patterns(at: Look, chance: LookElsewhere, at_least: int) -> Look:
    """Take out the strongest patterns that are no noise; the weaker ones would take the noise along."""
    for place in range(_MOST_PATTERNS):
        if not at.structures or (place >= at_least and chance(at.structures[0].found.p) >= _NO_NOISE):
            break
        at = take_out(at, at.structures[0].found.span)
    return at


def whole_span(at: Look, leader: Candidate) -> np.ndarray:
    """Return the directions of a candidate at every shape that was tried, (R, d): the true one lies between them."""
    names = {coefficient.parameter.name for coefficient in leader.coefficients}
    columns, lengths = [], []
    for one in at.prepared:
        if one.response.scan.effect == leader.effect:
            chosen = [i for i, each in enumerate(one.response.coefficients) if each.parameter.name in names]
            columns.append(one.projected[:, chosen])
            lengths.append(np.linalg.norm(one.whitened[:, chosen], axis=0))
    return orthonormal(np.concatenate(columns, axis=1), np.concatenate(lengths), _SAME_SHAPE)


def take_out(at: Look, span: np.ndarray) -> Look:
    """Return the look after some directions, (R, d), have been taken out."""

    def less(columns: np.ndarray) -> np.ndarray:
        return columns - span @ (span.T @ columns)

    prepared = [replace(one, projected=less(one.projected)) for one in at.prepared]
    laid = [replace(one, columns=less(one.columns)) for one in at.laid]
    return _look(at.projection.without(span), prepared, laid, [one.details for one in at.scans])

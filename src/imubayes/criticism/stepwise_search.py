"""The search: look, take out the best explanation, look again, until nothing is left that chance would not do."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Responses, candidate_responses
from imubayes.criticism.equivalent_effects import EquivalenceGroup, group
from imubayes.criticism.lack_of_fit import ProjectedForm, Structure, forms, lay, look
from imubayes.criticism.localised_structure import FeatureScan, FeatureSet, details, scan
from imubayes.criticism.multiple_testing import LookElsewhere, look_elsewhere
from imubayes.criticism.noise_tests import OUTLIERS, NoiseCandidate, Prewhitening, prewhitening, screen_noise
from imubayes.criticism.outliers import clustered, consecutive, deletion_residuals, find_outliers
from imubayes.criticism.projection import Projection, orthonormal, project
from imubayes.criticism.residual_covariates import ResidualCovariate, covariates
from imubayes.criticism.score_test import Candidate, ProjectedResponse, prepare, screen
from imubayes.inference.fitted import Fitted
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.problem import masked

# Noise that passes for effects where the model lacks it.
_CONFOUNDED_NOISE = ("correlated_noise", "run_scatter")


@dataclass(frozen=True)
class Screening:
    """One pass over candidates and free forms.

    Attributes
    ----------
    candidates, structures : the least likely by chance first.
    """

    projection: Projection
    prepared: tuple[ProjectedResponse, ...]
    laid: tuple[ProjectedForm, ...]
    scans: tuple[FeatureScan, ...]
    candidates: tuple[Candidate, ...]
    structures: tuple[Structure, ...]


@dataclass(frozen=True)
class Corrections:
    """Chance of so small a p-value among all that was looked at: effects, and structure."""

    of_effect: LookElsewhere
    of_structure: LookElsewhere

    def significant(self, structures: Sequence[Structure], strict: float = 1.0) -> tuple[tuple[Structure, float], ...]:
        """Return the structures beyond chance, with their chance."""
        judged = [(one, self.of_structure(one.score.p)) for one in structures]
        return tuple(pair for pair in judged if pair[1] < strict * thresholds.FALSE_ALARM_STRUCTURE)


@dataclass(frozen=True)
class SearchResult:
    """The outcome of a search.

    Attributes
    ----------
    first : the first look, at the noise that was settled on.
    responses, covariates : what was looked at.
    groups : one per effect found, in the order of evidence.
    structures : those beyond chance at the first look, with their chance.
    remaining : those that remain so after the groups were taken out.
    noise : noise candidates as screened first.
    adopted : those that are beyond chance once effects and patterns are taken out.
    outlier_sd : shape (E,), deletion residual of each outlier in standard deviations; 0 for other samples.
    look_elsewhere : correction for the smallest p-value of all candidates.
    """

    first: Screening
    responses: Responses
    covariates: tuple[ResidualCovariate, ...]
    groups: tuple[EquivalenceGroup, ...]
    structures: tuple[tuple[Structure, float], ...]
    remaining: tuple[tuple[Structure, float], ...]
    noise: tuple[NoiseCandidate, ...]
    adopted: tuple[NoiseCandidate, ...]
    outlier_sd: np.ndarray
    look_elsewhere: LookElsewhere


@dataclass(frozen=True)
class SearchInput:
    """A fit and what is looked at in it."""

    fitted: Fitted
    responses: Responses
    covariates: tuple[ResidualCovariate, ...]

    def projection(self, extra: Prewhitening | None = None, offsets: bool = False) -> Projection:
        """Return residuals and responses without what the model absorbs."""
        return project(self.fitted, self.responses.misfit, self.responses.jacobian, extra, offsets)

    def look(self, at: Projection) -> Screening:
        """Return one pass over candidates and free forms."""
        laid = lay(at, forms(at, self.covariates))
        return _look(at, prepare(at, self.responses.candidates), laid, details(at, self.covariates))


@dataclass(frozen=True)
class FirstPass:
    """What the first look shows, the noise being what the model says.

    Attributes
    ----------
    first, last : the look at all, and at what the groups leave.
    alarm : whether anything but noise is beyond chance.
    cleared : the projection without groups and without patterns that are no noise.
    """

    first: Screening
    chances: Corrections
    noise: tuple[NoiseCandidate, ...]
    groups: tuple[EquivalenceGroup, ...]
    last: Screening
    alarm: bool
    cleared: Projection


def search(fitted: Fitted) -> SearchResult:
    """Return what is missing in a converged fit; without a refit, but where readings are far off."""
    whole = SearchInput(fitted, candidate_responses(fitted), tuple(covariates(fitted)))
    at_first = _sight(whole)
    outliers, far = _outliers(whole, at_first)
    if not outliers:
        return _settled(whole, at_first)
    ground, sight, apart = whole, at_first, np.zeros(len(far))
    for _ in range(thresholds.MAX_OUTLIER_ROUNDS):
        # What an effect that is missing moves far off has a cause: only what remains so without it is left out.
        rest, apart = _without(fitted, far, 1 if sight.groups else thresholds.MAX_OUTLIER_ROUNDS)
        ground = SearchInput(rest, candidate_responses(rest), ground.covariates)
        sight = _sight(ground)
        more = find_outliers(sight.last.projection)
        if not more.any():
            break
        far = (apart != 0) | more
    if consecutive(fitted.model, apart):
        return _settled(whole, at_first)
    found = _settled(ground, sight)
    return replace(found, noise=at_first.noise, adopted=(*outliers, *found.adopted), outlier_sd=apart)


def _sight(ground: SearchInput) -> FirstPass:
    first = ground.look(ground.projection())
    chances = Corrections(
        look_elsewhere([one.score for one in first.candidates]),
        look_elsewhere([one.score for one in first.structures], first.scans),
    )
    noise = screen_noise(first.projection)
    groups, last = _steps(first, chances.of_effect)
    alarm, cleared = bool(groups or chances.significant(first.structures)), last.projection
    if alarm or _within(noise, thresholds.FALSE_ALARM_NOISE):
        cleared = _without_patterns(last, chances.of_structure, at_least=int(alarm and not groups)).projection
    return FirstPass(first, chances, tuple(noise), groups, last, alarm, cleared)


def _outliers(ground: SearchInput, sight: FirstPass) -> tuple[list[NoiseCandidate], np.ndarray]:
    """Return the outliers among the noise beyond chance, and which readings these are, (E,) bool.

    A few readings that are far off pass for a pattern, and a pattern in a few rows for readings that are far off.  A
    pattern explains more of them than it has directions, or gathers them at one value of a covariate.
    """
    before = sight.first.projection
    beyond = [one for one in _within(sight.noise, thresholds.FALSE_ALARM_NOISE) if one.effect == OUTLIERS]
    far = find_outliers(sight.last.projection)
    directions = sight.cleared.basis.shape[1] - before.basis.shape[1]
    explained = np.sum(find_outliers(before) & ~find_outliers(sight.cleared))
    if not beyond or explained > directions or clustered(sight.last.projection, far, ground.covariates):
        return [], far
    return (beyond if far.any() or not sight.alarm else []), far


def _without(fitted: Fitted, far: np.ndarray, rounds: int) -> tuple[Fitted, np.ndarray]:
    """Return the fit to all readings but those that are far off, (E,) bool, and by how much they are, (E,).

    They have made the noise look wide and neighbours look far off: once they are left out, more of them may show, and
    some that were left out come back.
    """
    z, h, rest = jnp.asarray(fitted.z), jnp.asarray(fitted.h), fitted
    apart = np.zeros(len(far))
    for _ in range(rounds):
        problem = masked(fitted.model.problem, far)
        mode = find_mode(problem, z, h)
        if not bool(mode.converged):
            break
        z, h = mode.z, mode.h
        rest = replace(fitted, model=replace(fitted.model, problem=problem), z=np.asarray(z), h=np.asarray(h))
        sizes, surprise = deletion_residuals(problem, mode)
        apart = np.where(far, sizes, 0.0)
        more = find_outliers(project(rest, np.asarray(mode.about.misfit), np.asarray(mode.about.jacobian)))
        now = more | (far & (np.abs(surprise) > thresholds.READMIT_SD))
        if np.array_equal(now, far):
            break
        far = now
    return rest, apart


def _settled(ground: SearchInput, sight: FirstPass) -> SearchResult:
    """Return what is missing once the noise is what the readings say."""
    first, chances, groups, last = sight.first, sight.chances, sight.groups, sight.last
    adopted, doubted, strict = [], [], 1.0
    if sight.alarm or _within(sight.noise, thresholds.FALSE_ALARM_NOISE):
        remaining = [one for one in screen_noise(sight.cleared) if one.effect != OUTLIERS]
        adopted = _within(remaining, thresholds.FALSE_ALARM_NOISE)
        suspected = _within(remaining, thresholds.SUSPECTED_NOISE_P)
        hinted = [one for one in suspected if one.effect in _CONFOUNDED_NOISE and one not in adopted]
        doubted = [*adopted, *(hinted if sight.alarm else ())]
    if doubted:
        offsets = any(one.effect == "run_scatter" for one in doubted)
        first = ground.look(ground.projection(prewhitening(sight.cleared, doubted), offsets))
        strict = (
            thresholds.ESTIMATED_CORRELATION_FACTOR if any(one.effect == "correlated_noise" for one in doubted) else 1.0
        )
        groups, last = _steps(first, chances.of_effect, strict)
    return SearchResult(
        first=first,
        responses=ground.responses,
        covariates=ground.covariates,
        groups=groups,
        structures=chances.significant(first.structures, strict),
        remaining=chances.significant(last.structures, strict),
        noise=sight.noise,
        adopted=tuple(adopted),
        outlier_sd=np.zeros(len(ground.responses.misfit)),
        look_elsewhere=chances.of_effect,
    )


def _within(noise: Sequence[NoiseCandidate], threshold: float) -> list[NoiseCandidate]:
    """Return the noise candidates whose chance, with all of them counted, is below a threshold."""
    return [one for one in noise if one.p * len(noise) < threshold]


def _look(
    projection: Projection,
    prepared: Sequence[ProjectedResponse],
    laid: Sequence[ProjectedForm],
    fine: Sequence[FeatureSet],
) -> Screening:
    scans = [scan(projection, one) for one in fine]
    candidates, structures = screen(projection, prepared), look(projection, laid, scans)
    return Screening(projection, tuple(prepared), tuple(laid), tuple(scans), tuple(candidates), tuple(structures))


def _steps(
    first: Screening, chance: LookElsewhere, strict: float = 1.0
) -> tuple[tuple[EquivalenceGroup, ...], Screening]:
    """Take out the best candidate and look again, as long as one is beyond chance."""
    at, groups = first, []
    while at.candidates and len(groups) < thresholds.MAX_EFFECTS:
        p = chance(min(one.p for one in at.candidates))
        if p >= strict * thresholds.FALSE_ALARM_EFFECT:
            break
        leader = next(one for one in at.candidates if chance(one.p) < strict * thresholds.FALSE_ALARM_EFFECT)
        groups.append(group(at.projection, leader, at.candidates, p))
        at = deflate(at, span_over_shapes(at, leader))
    return tuple(groups), at


def _without_patterns(at: Screening, chance: LookElsewhere, at_least: int) -> Screening:
    """Take out the strongest patterns that are no noise; the weaker ones would take the noise along."""
    for place in range(thresholds.MAX_PATTERNS):
        if not at.structures or (
            place >= at_least and chance(at.structures[0].score.p) >= thresholds.PATTERN_NOT_NOISE_P
        ):
            break
        at = deflate(at, at.structures[0].score.span)
    return at


def span_over_shapes(at: Screening, leader: Candidate) -> np.ndarray:
    """Return the directions of a candidate at every shape that was tried, (R, d): the true one lies between them."""
    names = {coefficient.parameter.name for coefficient in leader.coefficients}
    columns, lengths = [], []
    for one in at.prepared:
        if one.response.scan.effect == leader.effect:
            chosen = [i for i, each in enumerate(one.response.coefficients) if each.parameter.name in names]
            columns.append(one.projected[:, chosen])
            lengths.append(np.linalg.norm(one.whitened[:, chosen], axis=0))
    return orthonormal(np.concatenate(columns, axis=1), np.concatenate(lengths), thresholds.SHAPE_RETAINED_MIN)


def deflate(at: Screening, span: np.ndarray) -> Screening:
    """Return the look after some directions, (R, d), have been taken out."""

    def less(columns: np.ndarray) -> np.ndarray:
        return columns - span @ (span.T @ columns)

    prepared = [replace(one, projected=less(one.projected)) for one in at.prepared]
    laid = [replace(one, columns=less(one.columns)) for one in at.laid]
    return _look(at.projection.without(span), prepared, laid, [one.details for one in at.scans])

"""Stepwise search: screen, project out the best explanation and screen again, until nothing significant remains."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import Responses, candidate_responses
from imubayes.criticism.common_course import common_courses
from imubayes.criticism.effect_selection import deflate, select_effects
from imubayes.criticism.effects_beside_noise import beside_noise, beside_slow_noise, outweighed
from imubayes.criticism.equivalent_effects import EquivalenceGroup
from imubayes.criticism.known_noise import KnownNoise, compare_with_known
from imubayes.criticism.marginal_evidence import columns_of
from imubayes.criticism.multiple_testing import LookElsewhere, look_elsewhere
from imubayes.criticism.noise_tests import OUTLIERS, NoiseCandidate, prewhitening, screen_noise
from imubayes.criticism.outliers import clustered, consecutive, deletion_residuals, find_outliers
from imubayes.criticism.projection import Projection, project
from imubayes.criticism.residual_covariates import ResidualCovariate, covariates
from imubayes.criticism.rival_explanations import RivalEffects
from imubayes.criticism.search_input import Screening, SearchInput
from imubayes.criticism.search_outcome import Corrections, FirstPass, SearchOutcome, Significant
from imubayes.criticism.slow_noise_records import WanderingNoise
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.problem import masked
from imubayes.step_counter import Tell, counted, silent

# Noise that passes for effects where the model lacks it.
_CONFOUNDED_NOISE = ("correlated_noise", "run_scatter")


@dataclass(frozen=True)
class SearchResult:
    """The outcome of a search.

    Attributes
    ----------
    first : the first screening, with the noise finally adopted.
    responses, covariates : what was screened.
    groups : one per effect found, in order of evidence.
    rivals : other sets of effects that the data do not exclude, the likeliest first.
    paired : whether the first two groups were selected together.
    unfinished : whether effects are missing beside the groups, which explain most of the variance of some stratum.
    structures : those significant in the first screening, with corrected p-values; then common courses of runs.
    remaining : those still significant after the groups were projected out.
    noise : noise candidates as first screened.
    adopted : those significant after effects and structure were projected out.
    outlier_sd : shape (E,), deletion residual of each outlier in standard deviations; 0 for other samples.
    look_elsewhere : correction of the candidates' p-values.
    factor : on the budget of false alarms, where the correlation of the noise was estimated.
    wandering : whether correlated noise of another kind than the model's explains what is found as well, or instead.
    record : noise that remains after the groups, against the noise that the campaign records.
    """

    first: Screening
    responses: Responses
    covariates: tuple[ResidualCovariate, ...]
    groups: tuple[EquivalenceGroup, ...]
    rivals: tuple[RivalEffects, ...]
    paired: bool
    unfinished: bool
    structures: tuple[Significant, ...]
    remaining: tuple[Significant, ...]
    noise: tuple[NoiseCandidate, ...]
    adopted: tuple[NoiseCandidate, ...]
    outlier_sd: np.ndarray
    look_elsewhere: LookElsewhere
    factor: float
    record: KnownNoise
    wandering: WanderingNoise = ""

    def against_budget(self, p: float, share: float = thresholds.FALSE_ALARM_EFFECT) -> float:
        """Return a p-value, corrected for its own family of tests, on the scale of the whole budget.

        Below `thresholds.FALSE_ALARM` if and only if the search takes it for significant (weighted Bonferroni).
        """
        return min(1.0, p * thresholds.FALSE_ALARM / (share * self.factor))


def search(fitted: Fit, tell: Tell = silent) -> SearchResult:
    """Return what is missing in a converged fit; it is refitted only where there are outliers."""
    tell("responses of the candidates")
    given = SearchInput(fitted, candidate_responses(fitted), tuple(covariates(fitted)))
    found = _searched(given, tell)
    if not given.records or found.groups or found.structures:
        return found
    return _past_wandering_noise(given, found, _searched(replace(given, as_modelled=True), tell))


def _past_wandering_noise(given: SearchInput, found: SearchResult, as_modelled: SearchResult) -> SearchResult:
    """Return what is missing where nothing is at the likeliest noise: what is at that of the model, unless it is noise.

    Where it may be either, the effect is a rival of the noise.
    """
    if not (as_modelled.groups or as_modelled.structures):
        return as_modelled
    if as_modelled.groups:
        leader = as_modelled.groups[0].leader
        columns = columns_of(as_modelled.first.prepared, leader)
        acting = [(own, own.directions(columns)) for own in given.records.values()]
        log_odds = sum(own.log_odds(at) for own, at in acting)
        # Each of its coefficients has to be decisive: every channel has one that may follow the noise.
        if log_odds > thresholds.DECISIVE_LOG_ODDS * sum(at.shape[1] for _, at in acting):
            return replace(as_modelled, wandering="rival")
        if log_odds > -thresholds.DECISIVE_LOG_ODDS:
            found = replace(found, rivals=(RivalEffects((leader,), log_odds),))
    return replace(found, wandering="instead")


def _searched(given: SearchInput, tell: Tell) -> SearchResult:
    """Return what is missing at one noise of records with correlated noise."""
    fitted = given.fitted
    tell("screening candidates and structure")
    first = _first_pass(given)
    noise, outlying = _outliers(given, first)
    tell("judging the noise")
    if not noise:
        return _with_noise(given, first)
    current, at, sizes = given, first, np.zeros(len(outlying))
    for _ in counted(tell, "fitting without outliers", range(thresholds.MAX_OUTLIER_ROUNDS)):
        # Deviations caused by a missing effect are no outliers: only those that remain without it are rejected.
        rest, sizes = _refit_without(fitted, outlying, 1 if at.selection.groups else thresholds.MAX_OUTLIER_ROUNDS)
        current = SearchInput(rest, candidate_responses(rest), given.covariates, given.as_modelled)
        at = _first_pass(current)
        more = find_outliers(at.selection.last.projection)
        if not more.any():
            break
        outlying = (sizes != 0) | more
    # Where a great deal is missing with and without them, they are what is missing.
    if consecutive(fitted.model, sizes) or (first.selection.unfinished and at.selection.unfinished):
        return _with_noise(given, first)
    found = _with_noise(current, at)
    return replace(found, noise=first.noise, adopted=(*noise, *found.adopted), outlier_sd=sizes)


def _first_pass(given: SearchInput) -> FirstPass:
    first = given.screening()
    corrections = Corrections(
        look_elsewhere([candidate.score for candidate in first.candidates]),
        look_elsewhere([structure.score for structure in first.structures], first.scans),
    )
    noise = _screened_noise(first.projection)
    selection = select_effects(first, corrections.of_effect, given.factor)
    alarm = bool(selection.groups or corrections.significant(first.structures, given.factor))
    cleared = selection.last.projection
    if not selection.unfinished and (alarm or _significant_noise(noise, thresholds.FALSE_ALARM_NOISE)):
        at_least = int(alarm and not selection.groups)
        cleared = _without_patterns(selection.last, corrections.of_structure, at_least).projection
    return FirstPass(first, corrections, tuple(noise), selection, alarm, cleared)


def _outliers(given: SearchInput, first: FirstPass) -> tuple[list[NoiseCandidate], np.ndarray]:
    """Return the outlier candidates among the significant noise, and which samples are outliers, (E,) bool.

    A few outliers pass for a pattern, and a pattern in a few rows for outliers.  A pattern explains more of them than
    it has directions, or they cluster at one value of a covariate.
    """
    before, last = first.first.projection, first.selection.last.projection
    noise = [each for each in _significant_noise(first.noise, thresholds.FALSE_ALARM_NOISE) if each.effect == OUTLIERS]
    outlying = find_outliers(last)
    directions = first.cleared.basis.shape[1] - before.basis.shape[1]
    explained = np.sum(find_outliers(before) & ~find_outliers(first.cleared))
    if not noise or explained > directions or clustered(last, outlying, given.covariates):
        return [], outlying
    return (noise if outlying.any() or not first.alarm else []), outlying


def _refit_without(fitted: Fit, outlying: np.ndarray, rounds: int) -> tuple[Fit, np.ndarray]:
    """Return the fit without the outliers, (E,) bool, and the deletion residual of each, (E,).

    Outliers inflate the noise scale and mask one another: once they are rejected more may show, and some come back.
    """
    z, h, rest = jnp.asarray(fitted.z), jnp.asarray(fitted.h), fitted
    sizes = np.zeros(len(outlying))
    for _ in range(rounds):
        problem = masked(fitted.model.problem, outlying)
        mode = find_mode(problem, z, h)
        if not bool(mode.converged):
            break
        z, h = mode.z, mode.h
        model = replace(fitted.model, problem=problem)
        rest = Fit(model, np.asarray(z), np.asarray(h), fitted.optimised, fitted.message)
        in_noise_sd, in_predictive_sd = deletion_residuals(problem, mode)
        sizes = np.where(outlying, in_noise_sd, 0.0)
        more = find_outliers(project(rest, np.asarray(mode.about.misfit), np.asarray(mode.about.jacobian)))
        updated = more | (outlying & (np.abs(in_predictive_sd) > thresholds.READMIT_SD))
        if np.array_equal(updated, outlying):
            break
        outlying = updated
    return rest, sizes


def _with_noise(given: SearchInput, at: FirstPass) -> SearchResult:
    """Return the outcome with the noise that the residuals show, where what is missing allows to judge it."""
    if at.selection.unfinished:
        return _result(given, at, SearchOutcome(at.first, at.selection, given.factor))
    adopted, modelled = _noise_hypotheses(at)
    outcome = _under_noise(given, at, modelled) if modelled else SearchOutcome(at.first, at.selection, given.factor)
    # What runs of one input have in common is no noise, however long that remembers.
    common = tuple(common_courses((at.selection.last if outcome.groups else at.first).projection))
    judged = not given.as_modelled and not outcome.groups and not common
    if judged and (beside := beside_slow_noise(given, at)) is not None:
        outcome, adopted = beside, []
    if _silent(at, outcome) and not common and not adopted:
        outcome, suspected = _not_passed_over(at, outcome, modelled)
        if _silent(at, outcome):
            # Noise from row to row does not explain what acts between runs, and is adopted where nothing does.
            outcome = beside_noise(given, at, outcome)
            adopted = suspected if _silent(at, outcome) else []
    elif not common:
        outcome = outweighed(given, at, outcome)
    return _result(given, at, outcome, adopted, common)


def _result(
    given: SearchInput,
    at: FirstPass,
    outcome: SearchOutcome,
    adopted: Sequence[NoiseCandidate] = (),
    common: tuple[Significant, ...] = (),
) -> SearchResult:
    structures = at.corrections.significant(outcome.first.structures, outcome.factor)
    remaining = at.corrections.significant(outcome.selection.rest.structures, outcome.factor)
    return SearchResult(
        first=outcome.first,
        responses=given.responses,
        covariates=given.covariates,
        groups=outcome.groups,
        rivals=outcome.selection.rivals,
        paired=outcome.selection.paired,
        unfinished=outcome.selection.unfinished,
        structures=(*structures, *common),
        remaining=(*remaining, *common),
        noise=at.noise,
        adopted=tuple(adopted),
        outlier_sd=np.zeros(len(given.responses.misfit)),
        look_elsewhere=at.corrections.of_effect,
        factor=outcome.factor,
        record=compare_with_known((at.selection.last if outcome.groups else at.first).projection),
        wandering=outcome.wandering,
    )


def _noise_hypotheses(at: FirstPass) -> tuple[list[NoiseCandidate], list[NoiseCandidate]]:
    """Return the noise that is adopted, and that under which effects are judged: also what is only suspected."""
    if not (at.alarm or _significant_noise(at.noise, thresholds.FALSE_ALARM_NOISE)):
        return [], []
    remaining = [each for each in _screened_noise(at.cleared) if each.effect != OUTLIERS]
    adopted = _significant_noise(remaining, thresholds.FALSE_ALARM_NOISE)
    if not at.alarm:
        return adopted, adopted
    suspected = _significant_noise(remaining, thresholds.SUSPECTED_NOISE_P)
    confounded = [each for each in suspected if each.effect in _CONFOUNDED_NOISE and each not in adopted]
    return adopted, adopted + confounded


def _under_noise(given: SearchInput, at: FirstPass, modelled: Sequence[NoiseCandidate]) -> SearchOutcome:
    """Return the outcome with further noise in the model."""
    effects = {each.effect for each in modelled}
    first = given.screening(prewhitening(at.cleared, modelled), "run_scatter" in effects)
    factor = thresholds.ESTIMATED_CORRELATION_FACTOR if "correlated_noise" in effects else given.factor
    return SearchOutcome(first, select_effects(first, at.corrections.of_effect, factor), factor)


def _silent(at: FirstPass, outcome: SearchOutcome) -> bool:
    return not (outcome.groups or at.corrections.significant(outcome.first.structures, outcome.factor))


def _not_passed_over(
    at: FirstPass, outcome: SearchOutcome, modelled: list[NoiseCandidate]
) -> tuple[SearchOutcome, list[NoiseCandidate]]:
    """Return the outcome and the noise to adopt where what the first look found has vanished into suspected noise.

    A pattern that cannot be noise stays what it is; otherwise the noise that would explain it is adopted.
    """
    if at.alarm and _first_p(at) < thresholds.PATTERN_NOT_NOISE_P:
        return SearchOutcome(at.first, at.selection), []
    return outcome, modelled or _significant_noise(at.noise, thresholds.FALSE_ALARM_NOISE)


def _first_p(at: FirstPass) -> float:
    """Return the smallest corrected p-value of the first look, of effects and of structure."""
    structures = at.corrections.significant(at.first.structures)
    return min([group.p for group in at.selection.groups[:1]] + [p for _, p in structures], default=1.0)


def _screened_noise(projection: Projection) -> list[NoiseCandidate]:
    """Return the noise candidates that a member of the catalogue describes on their channels, the clearest first."""
    model = projection.fitted.model
    kinds = {channel.name: channel.kind for channel in model.campaign.channels}
    screened = screen_noise(projection)
    return [each for each in screened if kinds[each.channels[0]] in model.registry.effects[each.effect].kinds]


def _significant_noise(noise: Sequence[NoiseCandidate], threshold: float) -> list[NoiseCandidate]:
    """Return the noise candidates with a p-value below a threshold (Bonferroni)."""
    return [each for each in noise if each.p * len(noise) < threshold]


def _without_patterns(at: Screening, corrected: LookElsewhere, at_least: int) -> Screening:
    """Project out the strongest patterns that cannot be noise; the weaker ones would take noise along."""
    for place in range(thresholds.MAX_PATTERNS):
        if not at.structures:
            break
        strongest = at.structures[0].score
        if place >= at_least and corrected(strongest.p) >= thresholds.PATTERN_NOT_NOISE_P:
            break
        at = deflate(at, strongest.span)
    return at

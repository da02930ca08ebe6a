"""From a converged fit to its diagnosis: the search, the verdict, and everything that supports it."""

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp

from imubayes.campaign_data import Kind
from imubayes.criticism import thresholds
from imubayes.criticism.chain_stage import FoundStage, stages_of
from imubayes.criticism.detectability import Detectability, detectability
from imubayes.criticism.diagnosis_record import (
    AskedEffect,
    ChainStage,
    CoefficientEstimate,
    Diagnosis,
    EffectGroup,
    GroupMember,
    NearestEffect,
    NoiseFinding,
    RankedEffect,
    RivalExplanation,
    UndetectableEffect,
    UntypicalSize,
)
from imubayes.criticism.disagreement_record import Disagreement
from imubayes.criticism.discriminating_run import discriminating_run
from imubayes.criticism.equivalent_effects import EquivalenceGroup
from imubayes.criticism.evidence.evidence_record import Evidence
from imubayes.criticism.evidence.explain import explain
from imubayes.criticism.free_form_dependence import dominant_channel
from imubayes.criticism.known_noise import compare_with_known, known_scales
from imubayes.criticism.known_noise_fit import known_noise_point
from imubayes.criticism.large_effects import remainder_of_leader
from imubayes.criticism.marginal_evidence import columns_of
from imubayes.criticism.named_by_evidence import named_by_evidence
from imubayes.criticism.neglected_uncertainty import neglected_uncertainties
from imubayes.criticism.noise_assumptions import judged_noise_in
from imubayes.criticism.noise_violation import NoiseComparison, NoiseViolation
from imubayes.criticism.projection import Projection, project
from imubayes.criticism.residual_evidence import ResidualEvidence, following_covariate, residual_evidence
from imubayes.criticism.residual_findings import (
    covariate_label,
    outlying_samples,
    residual_structures,
    strongest_structure,
)
from imubayes.criticism.score_test import Candidate
from imubayes.criticism.search_outcome import Significant
from imubayes.criticism.stepwise_search import SearchResult, search
from imubayes.criticism.suggestions import suggestions, that_converges
from imubayes.criticism.unexplained_structure import (
    goes_with,
    scatter_remains,
    unexplained_structure,
)
from imubayes.criticism.unlisted_causes import Causes, unlisted_causes
from imubayes.criticism.verdict import MISSING, EffectChoice, RmsChange, Verdict
from imubayes.criticism.wrong_runs import disagreements
from imubayes.effects.base import Effect, Stage
from imubayes.errors import InputError, Issue
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_precision import Linearised
from imubayes.json_record import finite
from imubayes.step_counter import Tell, silent

# p-values below this are not told apart.
_BEYOND_DOUBT = 1e-30


def judge(fit: Fit, result: str = "RESULT", effect: str = "", progress: Tell = silent) -> Diagnosis:
    """Return the diagnosis of a fit.

    Parameters
    ----------
    fit : screened about its mode, whether or not the sampling about it converged; not screened without a mode.
    result : its result folder, for the next command.
    effect : ask about one effect only: whether it is there, absent or undetectable.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        where the effect that is asked about does not exist, is noise, or is in the model already.
    """
    if effect:
        _refuse_unknown(effect, fit)
    if not fit.optimised:
        message = fit.message or "The fit did not converge."
        return Diagnosis(verdict="not_converged", message=message, result=result)
    found = search(fit, progress)
    if effect:
        return _asked(effect, found, result)
    progress("weighing the explanations")
    evidence = explain(fit, found.responses, found.covariates)
    progress("predicting each run from the others")
    disagreeing = disagreements(fit, found.responses, [group.leader.effect for group in found.groups])
    progress("interpreting what was found")
    return _diagnosis(fit, found, evidence, disagreeing, result)


def _diagnosis(
    fit: Fit,
    found: SearchResult,
    weighed: Evidence | None,
    disagreeing: tuple[Disagreement, ...],
    result: str,
) -> Diagnosis:
    found, unexplained = _with_large_effect_fitted(named_by_evidence(found, weighed))
    unlisted = [] if unexplained else [unlisted_causes(found, group) for group in found.groups]
    as_fitted = project(found.first.projection.fitted, found.responses.misfit, found.responses.jacobian)
    # As fitted: what the search ends with may be whitened by noise that it only suspects.
    contradicted = compare_with_known(as_fitted).contradicted
    verdict = _not_adequate(_verdict(found, unexplained, unlisted, contradicted), weighed)
    violations = _violations(found, verdict, as_fitted)
    verdict = _overruled("noise_model" if violations else verdict, disagreeing)
    found = _as_named(found, verdict)
    open_question = verdict == "unexplained_structure"
    evidence = [_evidence(found, group) for group in found.groups]
    named = found.groups if verdict in MISSING else ()
    grouped = zip(named, evidence[: len(named)], unlisted[: len(named)], stages_of(found, named), strict=True)
    diagnosis = Diagnosis(
        verdict=verdict,
        result=result,
        p_global=_best(found),
        groups=tuple(_group(fit, found, *each) for each in grouped),
        ranking=_ranking(found),
        noise=_noise(found),
        undetectable=_undetectable(found),
        nearest=_nearest(found) if open_question else (),
        structure=residual_structures(found, unexplained),
        looks=found.look_elsewhere.looks,
        outliers=outlying_samples(found),
        paired=found.paired,
        unfinished=found.unfinished,
        rivals=_rivals(found),
        strongest=strongest_structure(found) if open_question else None,
        recorded_noise=found.record.of_rows,
        contradicted=contradicted,
        disagreeing=disagreeing,
        explanations=weighed,
        neglected=neglected_uncertainties(found),
        violations=violations,
        wandering=found.wandering,
        scatter_remains=verdict in MISSING and scatter_remains(found),
        more_remains=verdict in MISSING and bool(found.remaining or found.groups[1 + found.paired :]),
        message=fit.message if not fit.sampled else "",
    )
    tried = suggestions(found, "noise_model" if diagnosis.noise_outweighs else verdict)
    diagnosis = diagnosis.model_copy(update={"suggested": that_converges(found, diagnosis, tried)})
    return diagnosis.with_evidence(evidence[0] if evidence else None, found.record)


def _with_large_effect_fitted(found: SearchResult) -> tuple[SearchResult, Sequence[Significant]]:
    """Return the outcome with the structure that no effect explains, after a refit where a large effect is doubted."""
    unexplained = unexplained_structure(found)
    # One effect is refitted: of several that explain together it would leave most.
    alone = not (found.unfinished or found.paired)
    doubted = alone and (unexplained or (found.groups and scatter_remains(found)))
    left = remainder_of_leader(found) if doubted else None
    if left is None:
        return found, unexplained
    if not unexplained:
        return replace(found, record=left.record), []
    if not left.small:
        return found, unexplained
    # What else the linear search found beside a large effect is its curvature, or waits until it is fitted.
    return replace(found, groups=found.groups[:1], remaining=left.structures, record=left.record), []


def _refuse_unknown(effect: str, fit: Fit) -> None:
    where = f"effect '{effect}'"
    member = fit.model.registry.find(effect, where)
    if not issubclass(member, Effect):
        raise InputError(
            Issue(f"'{effect}' is noise, not an effect", where, "an effect", "ask without it: noise is always judged")
        )
    if any(spec.name == effect and spec.channels is None for spec in fit.model.spec.effects):
        raise InputError(
            Issue(
                f"'{effect}' is in the model already",
                fit.model.spec.where,
                "an effect that the model lacks",
                "see its estimate in the summary of the fit",
            )
        )


def _verdict(
    found: SearchResult,
    unexplained: Sequence[Significant],
    unlisted: Sequence[Causes],
    contradicted: Sequence[NoiseComparison],
) -> Verdict:
    if unexplained:
        return "unexplained_structure"
    if found.groups:
        doubtful = bool(unlisted[0] or found.wandering or found.rivals or found.unfinished) or scatter_remains(found)
        alone = len(found.groups[0].members) == 1 and not doubtful
        return "missing_effect" if alone else "equivalent_effects"
    noisy = found.adopted or found.record.contradicted or contradicted or found.wandering
    return "noise_model" if noisy else "adequate"


def _not_adequate(verdict: Verdict, weighed: Evidence | None) -> Verdict:
    """Return the verdict where the evidence excludes that nothing is missing, and no test says what is."""
    excluded = weighed is not None and weighed.excludes_nothing_missing
    return "noise_model" if verdict == "adequate" and excluded else verdict


def _overruled(verdict: Verdict, disagreeing: Sequence[Disagreement]) -> Verdict:
    """Return the verdict beside a wrong record of a run, which passes for effects and noise: these are judged after."""
    return "run_disagrees" if any(each.leads for each in disagreeing) else verdict


def _as_named(found: SearchResult, verdict: Verdict) -> SearchResult:
    """Return the outcome without what concerns effects that are named, where none is."""
    if verdict in MISSING:
        return found
    return replace(found, rivals=found.rivals if found.wandering else (), paired=False, unfinished=False)


def _violations(found: SearchResult, verdict: Verdict, as_fitted: Projection) -> tuple[NoiseViolation, ...]:
    """Return how the noise departs from its model where no candidate explains that; outliers are told by themselves."""
    if verdict not in ("adequate", "noise_model") or found.adopted:
        return ()
    told = ("heavy_tails",) if found.outlier_sd.any() else ()
    return tuple(each for each in judged_noise_in(as_fitted).violations if each.kind not in told)


def _asked(effect: str, found: SearchResult, result: str) -> Diagnosis:
    """Return the answer for one effect: found, absent down to a size, or undetectable."""
    lines = tuple(line for line in _ranking(found) if line.effect == effect)
    known = next((each for each in _detectabilities(found) if each.effect == effect), None)
    best = min((line.p_global for line in lines), default=1.0)
    undetectable: tuple[UndetectableEffect, ...] = ()
    if best < thresholds.FALSE_ALARM:
        verdict: Verdict = "missing_effect"
    elif known is not None and not known.undetectable:
        verdict = "adequate"
    else:
        verdict = "undetectable"
        needs = found.responses.unobservable.get(effect, ())
        undetectable = (_hidden(known) if known is not None else _not_supplied(effect, needs),)
    smallest = finite(known.smallest_detectable) if known is not None else None
    return Diagnosis(
        verdict=verdict,
        result=result,
        p_global=best,
        ranking=lines,
        undetectable=undetectable,
        asked=AskedEffect(effect=effect, smallest_detectable=smallest, unit=known.unit if known is not None else ""),
    )


def _best(found: SearchResult) -> float:
    best = min((candidate.p for candidate in found.first.candidates), default=1.0)
    return found.against_budget(found.look_elsewhere(best))


def _ranking(found: SearchResult) -> tuple[RankedEffect, ...]:
    """Return every candidate by its p-value, those beyond doubt by their likelihood ratio."""
    return tuple(
        RankedEffect(
            effect=candidate.effect,
            channels=candidate.owners,
            delta_chi2=candidate.delta_chi2,
            evidence=2 * candidate.score.log_likelihood_gain,
            dof=candidate.dof,
            p=candidate.p,
            p_global=found.against_budget(found.look_elsewhere(candidate.p)),
            within_runs=candidate.score.within_runs,
            shape=dict(candidate.scan.shape),
            coefficients=_coefficients(candidate),
        )
        for candidate in sorted(found.first.candidates, key=lambda each: (max(each.p, _BEYOND_DOUBT), each.log_p))
    )


def _coefficients(candidate: Candidate) -> tuple[CoefficientEstimate, ...]:
    return tuple(
        CoefficientEstimate(
            name=coefficient.parameter.name,
            value=finite(value),
            sd=finite(sd),
            unit=coefficient.parameter.shown_unit,
        )
        for coefficient, value, sd in zip(candidate.coefficients, candidate.value, candidate.sd, strict=True)
    )


def _evidence(found: SearchResult, group: EquivalenceGroup) -> ResidualEvidence:
    projection, leader = found.first.projection, group.leader
    response = next(each for each in found.first.prepared if each.response.scan == leader.scan)
    names = [channel.name for channel in projection.fitted.model.campaign.channels]
    channel = dominant_channel(projection, names, leader.score)
    covariate = following_covariate(projection, found.first.structures, leader, channel, goes_with(found, leader))
    return residual_evidence(projection, found.responses, response, leader, channel, covariate, found.covariates)


def _group(
    fit: Fit,
    found: SearchResult,
    group: EquivalenceGroup,
    evidence: ResidualEvidence,
    unlisted: Causes,
    stage: FoundStage | None,
) -> EffectGroup:
    leader = group.leader
    drop, residual = _at_known_noise(fit, found, leader, evidence.channel)
    return EffectGroup(
        effects=group.effects,
        channels=leader.owners,
        delta_chi2=leader.delta_chi2,
        delta_chi2_known=drop,
        dof=leader.dof,
        p_global=found.against_budget(group.p),
        candidates=tuple(
            GroupMember(
                effect=member.effect,
                channels=member.owners,
                delta_chi2=member.delta_chi2,
                shape=dict(member.scan.shape),
                coefficients=_coefficients(member),
                unexplained=unexplained,
            )
            for member, unexplained in zip(group.members, group.unexplained, strict=True)
        ),
        residual=residual,
        within=evidence.within,
        covariate=covariate_label(evidence.covariate) if evidence.covariate is not None else None,
        discriminating_run=discriminating_run(fit, group),
        unlisted=tuple(tuple(map(covariate_label, each)) for each in unlisted),
        stage=_chain_stage(fit, leader, stage) if stage is not None else None,
        beyond_typical=_beyond_typical(leader),
    )


def _at_known_noise(fit: Fit, found: SearchResult, leader: Candidate, channel: str) -> tuple[float, RmsChange]:
    """Return the Δχ² of a candidate at the noise known beforehand, and what it does to the residual of a channel."""
    about = Linearised(jnp.asarray(fit.z), jnp.asarray(found.responses.misfit), jnp.asarray(found.responses.jacobian))
    before = known_noise_point(fit.model, about, known_scales(fit))
    after = before.with_columns(columns_of(found.first.prepared, leader))
    then, now = before.record(), after.record()
    one, other = (next(each for each in both.channels if each.channel == channel) for both in (then, now))
    factor, unit = {"deg/s": (3600.0, "deg/h"), "deg": (3600.0, "arcsec")}.get(one.unit, (1e6, "ug"))
    change = RmsChange(channel=channel, before=factor * one.rms, after=factor * other.rms, unit=unit)
    return then.chi2 - now.chi2, change


def _beyond_typical(leader: Candidate) -> tuple[UntypicalSize, ...]:
    """Return the coefficients that are certainly larger than those met in practice."""
    sizes = zip(leader.coefficients, leader.value.tolist(), leader.sd.tolist(), strict=True)
    return tuple(
        UntypicalSize(
            name=coefficient.parameter.name, value=value, largest=coefficient.typical[1],
            unit=coefficient.parameter.shown_unit,
        )
        for coefficient, value, sd in sizes
        if abs(value) - thresholds.PRIOR_CONFLICT_SD * sd > coefficient.typical[1]
    )  # fmt: skip


def _chain_stage(fit: Fit, leader: Candidate, stage: FoundStage) -> ChainStage:
    sensor: Kind = next(channel.kind for channel in fit.model.campaign.channels if channel.name in leader.owners)
    named = "sensor" if stage.stage == Stage.SENSOR else "converter"
    return ChainStage(named=named, sensor=sensor, determined=stage.determined)


def _nearest(found: SearchResult) -> tuple[NearestEffect, ...]:
    return tuple(
        NearestEffect(effects=group.effects, channels=group.leader.owners, delta_chi2=group.leader.delta_chi2)
        for group in found.groups
    )


def _noise(found: SearchResult) -> tuple[NoiseFinding, ...]:
    adopted = {(noise.effect, noise.channels) for noise in found.adopted}
    return tuple(
        NoiseFinding(
            effect=noise.effect,
            channels=noise.channels,
            value=noise.value,
            p=noise.p,
            delta_chi2=noise.drop,
            adopted=(noise.effect, noise.channels) in adopted,
        )
        for noise in found.noise
    )


def _detectabilities(found: SearchResult) -> list[Detectability]:
    """Return how well each effect can be detected, by its best coefficient and shape."""
    best: dict[str, Detectability] = {}
    for response in found.first.prepared:
        seen = detectability(
            found.first.projection, response, thresholds.FALSE_ALARM_EFFECT, found.look_elsewhere.looks
        )
        known = best.get(seen.effect)
        if known is None or seen.smallest_detectable / seen.typical[1] < known.smallest_detectable / known.typical[1]:
            best[seen.effect] = seen
    return list(best.values())


def _undetectable(found: SearchResult) -> tuple[UndetectableEffect, ...]:
    hidden = [_hidden(each) for each in _detectabilities(found) if each.undetectable]
    return (*hidden, *(_not_supplied(name, needs) for name, needs in found.responses.unobservable.items()))


def _hidden(seen: Detectability) -> UndetectableEffect:
    return UndetectableEffect(
        effect=seen.effect,
        absorbed_by=seen.absorbed_by,
        reason="absorbed" if seen.retained < 0.5 else "noise",
        retained=seen.retained,
        smallest_detectable=finite(seen.smallest_detectable),
        typical=seen.typical,
        unit=seen.unit,
        bias=seen.bias,
    )


def _not_supplied(effect: str, needs: tuple[str, ...]) -> UndetectableEffect:
    return UndetectableEffect(effect=effect, reason="not_supplied", needs=needs)


def _rivals(found: SearchResult) -> tuple[RivalExplanation, ...]:
    return tuple(
        RivalExplanation(
            effects=tuple(EffectChoice(effect=member.effect, channels=member.owners) for member in each.members),
            log_odds=each.log_odds,
        )
        for each in found.rivals
    )

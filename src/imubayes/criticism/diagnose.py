"""From a fit to its diagnosis: how probable each explanation is, what supports the most probable, and any wrong run.

Everything rests on one posterior over explanations (`imubayes.criticism.evidence`): the verdict is the most probable
kind, groups are its effects, and the next command adds them.  Wrong inputs of the leading explanation are given in the
units of the record: what would make the runs agree.
"""

import time
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from imubayes.adequacy.adequacy_record import Disagreement
from imubayes.adequacy.known_noise import compare_with_known, known_scales
from imubayes.adequacy.known_noise_fit import KnownNoisePoint, known_noise_point
from imubayes.adequacy.projection import project
from imubayes.adequacy.weighed_records import wrong_record
from imubayes.criticism import diagnosis_record as record
from imubayes.criticism import explanation_records as explanations
from imubayes.criticism.detectability import AbsorbedResponses, Detectability, discriminating_run
from imubayes.criticism.evidence.effect_variants import SHOWN
from imubayes.criticism.evidence.hypothesis_evidence import Evaluated, EvidenceOf, Hypothesis
from imubayes.criticism.evidence.model_search import ModelSearch, beyond_prior
from imubayes.criticism.evidence.noise_structures import Family, RunNoise
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior, MissingEffect, SlotMember
from imubayes.criticism.evidence.relinearised_search import explain
from imubayes.criticism.evidence.row_evidence import RowEvidence
from imubayes.criticism.explanation_records import ResidualFormula
from imubayes.criticism.formula_search import find_formula
from imubayes.criticism.residual_evidence import ResidualEvidence, outliers, residual_evidence
from imubayes.effects.base import Effect
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.covariates import COVARIATES
from imubayes.foundations.errors import input_error
from imubayes.foundations.progress import Tell, silent
from imubayes.foundations.records import finite
from imubayes.foundations.units import to_si
from imubayes.foundations.wrong_records import WrongRecord
from imubayes.inference.fitted_model import Fit
from imubayes.inference.parameter_fit import Linearised
from imubayes.responses.candidate_effects import Responses, candidate_responses
from imubayes.responses.residual_covariates import ResidualCovariate, covariates
from imubayes.responses.wrong_inputs import NO_RUN, WrongInput


def disagreements(posterior: ExplanationPosterior, fitted: Fit) -> tuple[Disagreement, ...]:
    """Return the run, row or prior, as recorded, that is wrong in the leading explanation; else none."""
    campaign = fitted.model.campaign
    if posterior.leading == "noise":
        return _counts(posterior, fitted)
    if posterior.leading != "input":
        return ()
    near = [(share, each, _wrong(each)) for share, each in posterior.wrong_inputs]
    _, best, first = near[0]
    same = [(share, each) for share, each, wrong in near if (wrong.run, wrong.row) == (first.run, first.row)]
    causes = {(cause.form, cause.quantity): cause for share, each in reversed(same)
              for cause in (_cause(posterior.of, fitted, each, share),)}  # fmt: skip
    others = dict.fromkeys(
        _place(campaign, wrong) for _, _, wrong in near if (wrong.run, wrong.row) != (first.run, first.row)
    )
    without = max(each.log_posterior for each in posterior.distinct if each.hypothesis.form is None)
    return (
        Disagreement(
            run=_run_name(campaign, first),
            row=None if first.row is None else first.row + 1,
            log_odds=float(best.log_posterior - without),
            causes=tuple(sorted(causes.values(), key=lambda each: -each.probability)),
            instead=tuple(others),
        ),
    )


def _counts(posterior: ExplanationPosterior, fitted: Fit) -> tuple[Disagreement, ...]:
    """Return the run whose stated counts of samples the leading explanation contradicts."""
    noise = [each.rows for each in posterior.top.hypothesis.noise if isinstance(each.rows, RunNoise)]
    if not noise:
        return ()
    run, rows = noise[0].run, posterior.of.problem.of_channels
    count = sum(length for each in rows for k, (_, length) in zip(each.runs, each.series, strict=True) if k == run)
    ratio = np.array([noise[0].ratio ** -2])
    cause = wrong_record(fitted, WrongInput(run, "samples"), ratio, ratio * np.sqrt(3 / count), 1.0)
    stated = max(each.log_posterior for each in posterior.distinct if not _of_counts(each))
    odds = float(posterior.top.log_posterior - stated)
    return (Disagreement(run=cause.run, row=None, log_odds=odds, causes=(cause,)),)


def _of_counts(found: Evaluated) -> bool:
    return any(isinstance(each.rows, RunNoise) for each in found.hypothesis.noise)


def _wrong(found: Evaluated) -> WrongInput:
    form = found.hypothesis.form
    assert form is not None
    assert form.form.wrong is not None
    return form.form.wrong


def _run_name(campaign: Campaign, wrong: WrongInput) -> str:
    return "" if wrong.run == NO_RUN else campaign.runs[wrong.run].name


def _place(campaign: Campaign, wrong: WrongInput) -> str:
    name = _run_name(campaign, wrong)
    if not name:
        return "a prior"
    return name if wrong.row is None else f"row {wrong.row + 1} of run {name}"


def _cause(of: EvidenceOf, fitted: Fit, found: Evaluated, share: float) -> WrongRecord:
    """Return a wrong input in the unit of the record."""
    form = found.hypothesis.form
    assert form is not None
    own = len(found.columns)
    size, sd = (form.form.unit * each[own:] for each in (found.mean, np.sqrt(np.diag(of.solved(found).covariance))))
    return wrong_record(fitted, _wrong(found), size, sd, share)


def _known(name: str, value: float, sd: float | None, unit: str) -> explanations.CoefficientEstimate:
    return explanations.CoefficientEstimate(name=name, value=finite(value), sd=sd, unit=unit)


_SET_AT = ("time", "temperature", "converter_temperature")


def with_step(posterior: ExplanationPosterior, campaign: Campaign) -> explanations.Evidence:
    """Return the evidence, a step of the outputs in it with its size and place."""
    evidence, best = posterior.evidence, posterior.with_form
    chosen = best.hypothesis.form if best is not None else None
    if best is None or chosen is None or evidence.form is None or not chosen.form.of_outputs:
        return evidence
    problem, own = posterior.of.problem, len(best.columns)
    sd = np.sqrt(np.diag(posterior.of.solved(best).covariance))
    sizes = []
    for k in chosen.channels:
        place, noise = own + chosen.span(k).start, float(np.median(1 / problem.root[problem.rows[k].entry]))
        channel = campaign.channels[k]
        sizes.append(
            _known(channel.name, noise * float(best.mean[place]), noise * float(sd[place]), channel.output_unit)
        )
    assert chosen.form.run is not None
    run = campaign.runs[chosen.form.run]
    settings = []
    for name in _SET_AT:
        if name in run.covariates:
            known, read = COVARIATES[name], campaign.as_read(run, name)
            value = float(read[chosen.form.row or 0]) / known.factor(campaign.site.gravity)
            settings.append(_known(known.phrase, value, None, known.unit))
    step = explanations.FoundStep(sizes=tuple(sizes), settings=tuple(settings))
    return evidence.model_copy(update={"form": evidence.form.model_copy(update={"step": step})})


_MISSING_NOISE: dict[Family, str] = {
    "tails": "outliers", "runs": "run_scatter", "correlated": "correlated_noise", "wander": "random_walk_noise",
    "rate": "rate_proportional_noise",
}  # fmt: skip
_VERDICTS: dict[explanations.Explanation, explanations.Verdict] = {
    "nothing": "adequate", "noise": "noise_model", "effects": "missing_effect", "input": "run_disagrees",
    "outside": "unexplained_structure",
}  # fmt: skip


def judge(fit: Fit, result: str = "RESULT", effect: str = "", progress: Tell = silent) -> record.Diagnosis:
    """Return the diagnosis of a fit.

    Parameters
    ----------
    fit : explained about its mode, whether or not the sampling about it converged; a fit that did not converge, about
        where it stopped.
    result : its result folder, for the next command.
    effect : ask about one effect only: whether it is there, absent or undetectable.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        if the effect that is asked about does not exist, is noise, or is in the model already.
    """
    if effect:
        _refuse_unknown(effect, fit)
    judged = explained_fit(fit, result, progress)
    if judged is None:
        message = fit.message or "The fit did not converge."
        return record.Diagnosis(verdict="not_converged", message=message, result=result)
    return judged.answer_about(effect) if effect else judged.diagnosis()


Heard = Callable[[explanations.WeighedSoFar], None]
"""Called with what a search at work has weighed so far."""
_HEARD_EVERY = 0.5
"""Seconds between two reports of a search at work: each sums over all hypotheses."""


def explained_fit(
    fit: Fit, result: str = "RESULT", progress: Tell = silent, heard: Heard | None = None
) -> "ExplainedFit | None":
    """Return a fit with the posterior over explanations, for questions about it; None of a fit that stands nowhere.

    `heard` is called with what has been weighed so far while the search is at work; without it nothing is summed up.
    """
    progress("predicting with every effect of the catalogue")
    responses = candidate_responses(fit) if np.isfinite(fit.z).all() else None
    if responses is None or not np.isfinite(responses.misfit).all():
        return None
    progress("weighing the explanations")
    known = covariates(fit)
    posterior = explain(fit, responses, known, _listener(fit, progress, heard))
    progress("interpreting the result")
    return ExplainedFit(fit, responses, known, posterior, result)


def _listener(fit: Fit, progress: Tell, heard: Heard | None) -> Callable[[ModelSearch], None]:
    """Return what counts the hypotheses of a search aloud, and reports what they say from time to time.

    A search about another linearisation begins anew, and the count goes on.
    """
    last, before, here = time.monotonic(), 0, 0

    def listen(search: ModelSearch) -> None:
        nonlocal last, before, here
        before, here = before + here * (len(search.of.known) < here), len(search.of.known)
        progress(f"weighing the explanations, {before + here} so far")
        if heard is not None and time.monotonic() - last > _HEARD_EVERY:
            found = ExplanationPosterior(search, fit).inclusion
            if found:
                heard(explanations.WeighedSoFar(hypotheses=before + here, inclusion=found))
            last = time.monotonic()

    return listen


def _refuse_unknown(effect: str, fit: Fit) -> None:
    where = f"effect '{effect}'"
    member = fit.model.registry.find(effect, where)
    if not issubclass(member, Effect):
        raise input_error(
            f"'{effect}' is noise, not an effect", where, "an effect", "leave it out: every diagnosis judges the noise"
        )
    if any(spec.name == effect and spec.channels is None for spec in fit.model.spec.effects):
        raise input_error(
            f"'{effect}' is in the model already",
            fit.model.spec.where,
            "an effect that the model lacks",
            "see its estimate in the summary of the fit",
        )


class ExplainedFit:
    """A fit with the posterior over explanations of what it leaves.

    Attributes
    ----------
    fit, responses, known : the fit, its linear model with all candidates, and the covariates of its entries.
    posterior, of : over explanations, and the evidence of each.
    at_known_noise : the linear model fitted at the noise known beforehand.
    result : folder of the result, for the next command.
    """

    def __init__(
        self,
        fit: Fit,
        responses: Responses,
        known: Sequence[ResidualCovariate],
        posterior: ExplanationPosterior,
        result: str,
    ):
        self.fit, self.responses, self.known, self.result = fit, responses, known, result
        self.posterior, self.of = posterior, posterior.of
        self.absorbed = AbsorbedResponses(posterior.of, fit)
        about = Linearised(np.asarray(fit.z), responses.misfit, responses.jacobian)
        self.at_known_noise = known_noise_point(fit.model, about, known_scales(fit))

    @cached_property
    def rows(self) -> RowEvidence:
        """What explains rows that are chosen."""
        return RowEvidence(self.posterior)

    def diagnosis(self) -> record.Diagnosis:
        """Return what is missing."""
        fit, posterior = self.fit, self.posterior
        # Beside a prior that is too narrow effects take what it leaves: they are reported once it is wide enough.
        slots = () if beyond_prior(posterior.top) else posterior.slots
        shown = [
            residual_evidence(posterior, self.absorbed, self.responses, slot.members[0], self.known) for slot in slots
        ]
        noise = compare_with_known(project(fit, self.responses.misfit, self.responses.jacobian))
        simple, every = self._suggestions()
        diagnosis = record.Diagnosis(
            verdict=self._verdict(),
            message=fit.message if not (fit.optimised and fit.sampled) else "",
            result=self.result,
            explanations=with_step(posterior, fit.model.campaign),
            groups=tuple(map(self._group, slots, shown)),
            delta_chi2=self._delta_chi2(slots),
            ranking=record.ranking(posterior),
            formulas=tuple(self._formulas()),
            disagreeing=disagreements(posterior, fit),
            undetectable=self._undetectable(),
            outliers=outliers(posterior),
            suggested=simple,
            all_that_fit=every,
            recorded_noise=noise.of_rows,
            contradicted=noise.contradicted,
            neglected=self.absorbed.neglected,
        )
        return diagnosis.with_evidence(shown[0] if shown else None, noise)

    def answer_about(self, effect: str) -> record.Diagnosis:
        """Return the answer for one effect: found, absent down to a size, or undetectable."""
        lines = tuple(line for line in record.ranking(self.posterior) if line.effect == effect)
        seen = next((each for each in self.absorbed.of_effects if each.effect == effect), None)
        undetectable: tuple[record.UndetectableEffect, ...] = ()
        if not self.fit.optimised:
            verdict: explanations.Verdict = "not_converged"
        elif self.posterior.including([effect]) >= 0.5:
            verdict = "missing_effect"
        elif seen is not None and not seen.undetectable:
            verdict = "adequate"
        else:
            verdict = "undetectable"
            needs = self.responses.unobservable.get(effect, ())
            undetectable = (_hidden(seen) if seen is not None else _not_supplied(effect, needs),)
        asked = record.AskedEffect(
            effect=effect,
            smallest_detectable=finite(seen.smallest_detectable) if seen is not None else None,
            unit=seen.unit if seen is not None else "",
        )
        return record.Diagnosis(
            verdict=verdict, message="" if self.fit.optimised else self.fit.message, result=self.result,
            explanations=self.posterior.evidence, ranking=lines, undetectable=undetectable, asked=asked,
        )  # fmt: skip

    def _verdict(self) -> explanations.Verdict:
        if not self.fit.optimised:
            return "not_converged"
        found = "run_disagrees" if _of_counts(self.posterior.top) else _VERDICTS[self.posterior.leading]
        certain = self.posterior.evidence.of("effects").probability >= explanations.NAMED
        single = all(len(slot.members) == 1 and slot.probability >= explanations.NAMED for slot in self.posterior.slots)
        return "equivalent_effects" if found == "missing_effect" and not (certain and single) else found

    @cached_property
    def _doubtful(self) -> MissingEffect | None:
        """The strongest of the slots whose effects the runs do not distinguish."""
        return next((slot for slot in self.posterior.slots if len(slot.members) > 1), None)

    def _group(self, slot: MissingEffect, shown: ResidualEvidence) -> record.EffectGroup:
        leader = slot.members[0]
        members, about = tuple(map(self._screened, slot.members)), shown.covariate
        return record.EffectGroup(
            channels=members[0].channels,
            probability=slot.probability,
            log_odds=slot.gain,
            delta_chi2=members[0].delta_chi2,
            candidates=members,
            residual=self._rms(leader, shown.channel),
            within=shown.within,
            covariate=record.CovariateLabel.model_validate(about, from_attributes=True) if about is not None else None,
            discriminating_run=discriminating_run(self.fit, self.posterior, slot) if slot is self._doubtful else None,
            beyond_typical=self._beyond_typical(leader, members[0].coefficients),
        )

    def _screened(self, member: SlotMember) -> record.ScreenedEffect:
        variant = self.of.variants[member.variant]
        return record.ScreenedEffect(
            effect=member.effect,
            channels=variant.owners,
            probability=member.share,
            delta_chi2=self.at_known_noise.record().chi2 - self._with(member).record().chi2,
            shape=dict(self.of.problem.candidates[variant.response].scan.shape),
            coefficients=self.posterior.coefficients(member.variant, member.found),
        )

    def _with(self, *members: SlotMember) -> KnownNoisePoint:
        return self.at_known_noise.with_columns(
            np.concatenate([self.posterior.response_to(each, self.responses)[0] for each in members], axis=1)
        )

    def _delta_chi2(self, slots: Sequence[MissingEffect]) -> float | None:
        """Return the drop of χ² by the leaders of all slots together, at the noise known beforehand."""
        if not slots:
            return None
        return self.at_known_noise.record().chi2 - self._with(*(each.members[0] for each in slots)).record().chi2

    def _rms(self, member: SlotMember, channel: str) -> explanations.RmsChange:
        """Return what an effect does to the residual of a channel, or of turns, at the noise known beforehand."""
        points = self.at_known_noise, self._with(member)
        rows = next(each for each in self.of.problem.rows if each.name == channel)
        if rows.kind == "closure":
            rms = [float(np.sqrt(np.mean(each.misfit[rows.entry] ** 2))) for each in points]
            factor, unit = 1 / to_si("arcsec"), "arcsec"
        else:
            records = [next(k for k in each.record().channels if k.channel == channel) for each in points]
            rms = [each.rms for each in records]
            factor, unit = {"deg/s": (3600.0, "deg/h"), "deg": (3600.0, "arcsec")}.get(records[0].unit, (1e6, "ug"))
        return explanations.RmsChange(channel=channel, before=factor * rms[0], after=factor * rms[1], unit=unit)

    def _beyond_typical(
        self, member: SlotMember, estimates: Sequence[explanations.CoefficientEstimate]
    ) -> tuple[record.UntypicalSize, ...]:
        """Return the coefficients that are certainly larger than those met in practice."""
        places = self.of.variants[member.variant].places
        largest = [self.of.problem.coefficients[k].typical[1] for k in places]
        return tuple(
            record.UntypicalSize(name=each.name, value=each.value, largest=most, unit=each.unit)
            for each, most in zip(estimates, largest, strict=True)
            if each.value is not None and abs(each.value) - SHOWN * (each.sd or 0.0) > most
        )

    def _suggestions(self) -> tuple[explanations.Suggestion | None, explanations.Suggestion | None]:
        """Return the simplest explanation, and with all that fits as well if that is more."""
        if self.posterior.leading == "noise":
            return self._missing_noise(), None
        told = [slot for slot in self.posterior.slots if slot.probability >= 0.5]
        if self.posterior.leading != "effects" or not told:
            return None, None
        simple = self._suggestion([slot.members[0] for slot in told])
        every = self._suggestion([member for slot in told for member in slot.members])
        return simple, every if every.effects != simple.effects else None

    def _missing_noise(self) -> explanations.Suggestion | None:
        there = {effect.name for effect in self.fit.model.assembly.effects}
        told = self.posterior.evidence.noise
        found = [(_MISSING_NOISE[each.family], each.channels) for each in told if each.family in _MISSING_NOISE]
        name = next((missing for missing, _ in found if missing not in there), None)
        if name is None:
            return None
        here = {channel for missing, channels in found if missing == name for channel in channels}
        every = [channel.name for channel in self.fit.model.campaign.channels]
        on = tuple(channel for channel in every if channel in here)
        return explanations.Suggestion(effects=(name,), channels=None if len(on) in (0, len(every)) else on)

    def _suggestion(self, members: Sequence[SlotMember]) -> explanations.Suggestion:
        """Return effects to add, their channels named if they are not all on which these were screened."""
        names = [channel.name for channel in self.fit.model.campaign.channels]
        effects = tuple(dict.fromkeys(member.effect for member in members))
        here = {owner for member in members for owner in self.of.variants[member.variant].owners}
        screened = {
            coefficient.owner
            for response in self.responses.candidates
            if response.scan.effect in effects
            for coefficient in response.coefficients
        }
        on = tuple(name for name in names if name in here)
        return explanations.Suggestion(effects=effects, channels=None if here == screened or not on else on)

    def _formulas(self) -> list[ResidualFormula]:
        """Return the formula of each channel of a form that leads; what happens in one run alone has none."""
        top = self.posterior.top
        chosen = top.hypothesis.form
        if self.posterior.leading != "outside" or chosen is None or chosen.form.run is not None:
            return []
        beside = self.of.evaluate(Hypothesis(top.hypothesis.variants, top.hypothesis.noise), top)
        found = [
            find_formula(self.of, beside, top.scale, self.posterior.fitted, self.known, k) for k in chosen.channels
        ]
        return [each for each in found if each is not None]

    def _undetectable(self) -> tuple[record.UndetectableEffect, ...]:
        hidden = [_hidden(each) for each in self.absorbed.of_effects if each.undetectable]
        absent = self.responses.unobservable.items()
        return (*hidden, *(_not_supplied(name, needs) for name, needs in absent))


def _hidden(seen: Detectability) -> record.UndetectableEffect:
    return record.UndetectableEffect(
        effect=seen.effect,
        absorbed_by=seen.absorbed_by,
        reason="absorbed" if seen.retained < 0.5 else "noise",
        retained=seen.retained,
        smallest_detectable=finite(seen.smallest_detectable),
        typical=seen.typical,
        unit=seen.unit,
        bias=seen.bias,
    )


def _not_supplied(effect: str, needs: tuple[str, ...]) -> record.UndetectableEffect:
    return record.UndetectableEffect(effect=effect, reason="not_supplied", needs=needs)

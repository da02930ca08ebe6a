"""The diagnosis of a fit as a typed record: probable explanations, ranked effects, disagreeing runs, formulas.

It holds facts only: how probable each explanation is, and what follows from that.  Sentences and the next command are
made where a diagnosis is displayed.  Every effect that the runs can show is ranked by how probable it is that it is
missing.  A run that does not agree with the others is recorded with what would make it agree.
"""

from typing import Literal

import numpy as np
from pydantic import PrivateAttr

from imubayes.adequacy.adequacy_record import Disagreement, NoiseComparison
from imubayes.adequacy.known_noise import KnownNoise
from imubayes.criticism.detectability import NEGLECTED_SHIFT
from imubayes.criticism.evidence.hypothesis_evidence import Evaluated, inverse
from imubayes.criticism.evidence.model_search import states_noise
from imubayes.criticism.evidence.posterior_summary import ExplanationPosterior, estimates
from imubayes.criticism.evidence.proposals import Conditional, Screen, conditional
from imubayes.criticism.explanation_records import (
    Absorber,
    CoefficientEstimate,
    Evidence,
    NeglectedUncertainty,
    ParameterBias,
    ResidualFormula,
    RmsChange,
    Suggestion,
    Verdict,
)
from imubayes.criticism.residual_evidence import Outlier, ResidualEvidence
from imubayes.foundations.records import Presented, Record
from imubayes.inference.candidate_runs import RunDesign


class ScreenedEffect(Record):
    """Result of the search for one effect.

    Attributes
    ----------
    channels : channels, mountings or tables of its coefficients.
    probability : share in its group, or, in the ranking, probability that it is missing.
    delta_chi2 : predicted drop of χ² if the effect were added, at the noise known beforehand.
    shape : scanned parameters, such as a time constant, at their most probable value.
    coefficients : with their posterior standard deviations.
    """

    effect: str
    channels: tuple[str, ...]
    probability: float
    delta_chi2: float
    shape: dict[str, float]
    coefficients: tuple[CoefficientEstimate, ...]


class RankedEffect(ScreenedEffect):
    """A line of the ranking; `log_odds`: natural logarithm of the odds for this effect alone against nothing missing.

    The noise is that of the model without the effect.
    """

    log_odds: float


class CovariateLabel(Record):
    """A covariate: name, unit, and its words for a sentence."""

    name: str
    unit: str
    phrase: str


class UntypicalSize(Record):
    """A coefficient beyond what is met in practice; `largest` is the largest typical size, in the same unit."""

    name: str
    value: float
    largest: float
    unit: str


class EffectGroup(Record):
    """A missing effect, and those that these runs cannot distinguish from it, the most probable first.

    Attributes
    ----------
    channels, delta_chi2 : of the first.
    probability : that one of them is missing.
    log_odds : natural logarithm of the odds for it, given the other groups.
    candidates : one per effect.
    residual : rms of the channel that shows it best, before and after adding the first, at the noise known beforehand.
    within : whether pictures show that residual about the mean of each run.
    covariate : covariate on which that residual depends; None if no single covariate explains it.
    discriminating_run : the feasible run that distinguishes them best; None if there is none.
    beyond_typical : the coefficients of the first that are larger than those met in practice.
    """

    channels: tuple[str, ...]
    probability: float
    log_odds: float
    delta_chi2: float
    candidates: tuple[ScreenedEffect, ...]
    residual: RmsChange
    within: bool = False
    covariate: CovariateLabel | None
    discriminating_run: RunDesign | None = None
    beyond_typical: tuple[UntypicalSize, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """The names of the candidates."""
        return tuple(each.effect for each in self.candidates)


class UndetectableEffect(Record):
    """An effect that these runs cannot show.

    Attributes
    ----------
    absorbed_by : parameters that absorb its response, largest share first.
    reason : ``absorbed`` by the model, hidden in the ``noise``, or ``not_supplied``: no run responds to it.
    needs : covariates or stimulus that would bring it out and no run has; empty if unknown.
    retained : share of the response that the model does not absorb.
    smallest_detectable, typical, unit : size that would be named with a probability of 80 %, and the range met in
        practice.
    bias : of the parameter it biases most while undetected.
    """

    effect: str
    absorbed_by: tuple[Absorber, ...] = ()
    reason: Literal["absorbed", "noise", "not_supplied"]
    needs: tuple[str, ...] = ()
    retained: float | None = None
    smallest_detectable: float | None = None
    typical: tuple[float, float] | None = None
    unit: str = ""
    bias: ParameterBias | None = None


class AskedEffect(Record):
    """The requested effect, with the size detected with 80 % power; None if no size would be detected."""

    effect: str
    smallest_detectable: float | None
    unit: str


class Diagnosis(Presented, Record):
    """Missing effects of a model, found without a refit.

    Attributes
    ----------
    verdict : the most probable kind of explanation; if one effect was requested, the answer about it.
    message : why the fit, or the sampling about its mode, did not converge.
    result : folder of the result that was diagnosed.
    explanations : probability of each explanation; None for a fit without a mode.
    groups : the effects of the most probable explanation, each with the effects that the runs cannot distinguish from
        it; the strongest first.
    delta_chi2 : predicted drop of χ² by the first of every group together, at the noise known beforehand.
    ranking : every effect that the runs can show, the most probable first.
    formulas : of the residual, if a cause outside the catalogue is the most probable explanation.
    disagreeing : the run or row whose record is wrong in the most probable explanation.
    undetectable : effects that the runs cannot show.
    outliers : rows far from the most probable explanation.
    suggested : the simplest explanation: effects, or noise, to add next.
    all_that_fit : the same with everything that the runs cannot distinguish from it; None if that is the same.
    recorded_noise : white noise of each channel, as fitted and as known beforehand.
    contradicted : noise scales of the fit that contradict the noise known beforehand, the least probable first.
    neglected : stated uncertainties of the equipment that no interval of the fit includes, those that matter.
    asked : the requested effect, if there was one.

    Examples
    --------
    >>> import imubayes
    >>> found = imubayes.diagnose("results/accel-channel")
    >>> found.verdict, found.suggested
    ('adequate', None)
    """

    __repr__, __str__ = Presented.__repr__, Presented.__str__

    format: Literal[2] = 2
    verdict: Verdict
    message: str = ""
    result: str = "RESULT"
    explanations: Evidence | None = None
    groups: tuple[EffectGroup, ...] = ()
    delta_chi2: float | None = None
    ranking: tuple[RankedEffect, ...] = ()
    formulas: tuple[ResidualFormula, ...] = ()
    disagreeing: tuple[Disagreement, ...] = ()
    undetectable: tuple[UndetectableEffect, ...] = ()
    outliers: tuple[Outlier, ...] = ()
    suggested: Suggestion | None = None
    all_that_fit: Suggestion | None = None
    recorded_noise: tuple[NoiseComparison, ...] = ()
    contradicted: tuple[NoiseComparison, ...] = ()
    neglected: tuple[NeglectedUncertainty, ...] = ()
    asked: AskedEffect | None = None
    _evidence: ResidualEvidence | None = PrivateAttr(None)
    _scatter: KnownNoise | None = PrivateAttr(None)

    @property
    def evidence(self) -> ResidualEvidence | None:
        """The residual that shows the first group best, for pictures; None without one, and of a stored diagnosis."""
        return self._evidence

    @property
    def scatter(self) -> KnownNoise | None:
        """The rows against the recorded noise, for pictures; None of a stored diagnosis."""
        return self._scatter

    @property
    def disagreeing_noise(self) -> tuple[NoiseComparison, ...]:
        """The channels whose fitted and recorded noise do not agree, the largest ratio first."""
        apart = [each for each in self.recorded_noise if not each.agrees]
        return tuple(sorted(apart, key=lambda each: -each.ratio))

    @property
    def explains_by_noise(self) -> bool:
        """Whether the leading explanation, nothing missing or other noise, leaves the scatter of the data to noise."""
        return self.explanations is not None and self.explanations.leading.kind in ("nothing", "noise")

    @property
    def most_biasing(self) -> ParameterBias | None:
        """The worst bias by an effect that the runs cannot show; None if none would matter beside a posterior."""
        known = [each.bias for each in self.undetectable if each.bias is not None]
        worst = max(known, key=lambda bias: abs(bias.in_sd), default=None)
        return worst if worst is not None and abs(worst.in_sd) >= NEGLECTED_SHIFT else None

    @property
    def proposed(self) -> Suggestion | None:
        """Effects or noise to add next: the suggestion or, if nothing is missing, neglected stated uncertainties."""
        if self.suggested is not None or self.verdict != "adequate" or self.asked is not None or not self.neglected:
            return self.suggested
        return Suggestion(effects=tuple(each.effect for each in self.neglected), channels=None)

    def with_evidence(self, evidence: ResidualEvidence | None, scatter: KnownNoise | None = None) -> "Diagnosis":
        """Return the same diagnosis with the residual that shows its first group, and with the rows' scatter."""
        copy = self.model_copy()
        copy._evidence, copy._scatter = evidence, scatter
        return copy

    def probability(self, effect: str) -> float:
        """Return the probability that an effect is missing."""
        found = self.explanations.inclusion if self.explanations is not None else ()
        return max((each.probability for each in found if each.effect == effect), default=0.0)

    def channels_for(self, effect: str) -> tuple[str, ...] | None:
        """Return the channels on which an effect was found; None for all on which it was screened, and if not found."""
        for choice in (self.suggested, self.all_that_fit):
            if choice is not None and choice.effects == (effect,):
                return choice.channels
        members = [member for group in self.groups for member in group.candidates if member.effect == effect]
        return members[0].channels if members else None

    def estimate(self, effect: str) -> ScreenedEffect | None:
        """Return the estimate of an effect as a member of a group or of the ranking; None if it is in neither."""
        members = [member for group in self.groups for member in group.candidates]
        return next((line for line in (*members, *self.ranking) if line.effect == effect), None)


def ranking(posterior: ExplanationPosterior) -> tuple[RankedEffect, ...]:
    """Return one line per effect, by its inclusion probability, then by its log odds alone."""
    of = posterior.of
    nothing = posterior.search.best(states_noise)
    alone = conditional(of, of.solved(nothing))
    as_known = conditional(of, of.solved(nothing, np.ones(len(nothing.scale))))
    best: dict[str, RankedEffect] = {}
    for gain, n in Screen(of).singles(alone):
        if of.variants[n].effect not in best:
            best[of.variants[n].effect] = _line(posterior, nothing, alone, as_known, n, gain)
    return tuple(sorted(best.values(), key=lambda each: (-each.probability, -each.log_odds)))


def _line(
    posterior: ExplanationPosterior, nothing: Evaluated, alone: Conditional, as_known: Conditional, n: int, gain: float
) -> RankedEffect:
    of, variant = posterior.of, posterior.of.variants[n]
    places = np.array(variant.places)
    covariance = inverse(_positive(alone.own[np.ix_(places, places)]) + np.eye(len(places)) / max(variant.widths) ** 2)
    mean = covariance @ alone.right[places]
    own, right = as_known.own[np.ix_(places, places)], as_known.right[places]
    return RankedEffect(
        effect=variant.effect,
        channels=variant.owners,
        probability=posterior.including([variant.effect]),
        delta_chi2=float(right @ np.linalg.lstsq(own, right, rcond=1e-9)[0]),
        shape=dict(of.problem.candidates[variant.response].scan.shape),
        coefficients=estimates(of.problem, variant.places, mean, np.diag(covariance)),
        log_odds=gain,
    )


def _positive(own: np.ndarray) -> np.ndarray:
    """Return a symmetric matrix without the negative eigenvalues that rounding gives it."""
    squares, axes = np.linalg.eigh(0.5 * (own + own.T))
    return (axes * np.maximum(squares, 0.0)) @ axes.T

"""The diagnosis of a fit as a typed record: verdict, groups of missing effects, ranking, noise, structure, outliers.

It holds facts only; sentences and the next command are made where a diagnosis is displayed.
"""

from typing import Literal

from pydantic import PrivateAttr

from imubayes.campaign_data import Kind
from imubayes.criticism import thresholds
from imubayes.criticism.detectability import Absorber, ParameterBias
from imubayes.criticism.disagreement_record import Disagreement
from imubayes.criticism.evidence.evidence_record import Evidence
from imubayes.criticism.formula_search import FormulaTerm
from imubayes.criticism.known_noise import KnownNoise
from imubayes.criticism.localised_structure import Step
from imubayes.criticism.noise_violation import NoiseComparison, NoiseViolation
from imubayes.criticism.residual_evidence import ResidualEvidence
from imubayes.criticism.slow_noise_records import WanderingNoise
from imubayes.criticism.verdict import EffectChoice, RmsChange, Suggestion, Verdict
from imubayes.inference.candidate_runs import RunDesign
from imubayes.json_record import Record
from imubayes.representation import Presented


class CoefficientEstimate(Record):
    """A coefficient with its standard uncertainty, in its unit; None where it is not determined."""

    name: str
    value: float | None
    sd: float | None
    unit: str


class ScreenedEffect(Record):
    """What the score test says of one effect.

    Attributes
    ----------
    channels : channels, mountings or tables of its coefficients.
    delta_chi2 : drop of χ² if the effect were added, noise scales estimated anew.
    shape : scanned parameters, such as a time constant, at their best value.
    coefficients : one-step estimates.
    """

    effect: str
    channels: tuple[str, ...]
    delta_chi2: float
    shape: dict[str, float]
    coefficients: tuple[CoefficientEstimate, ...]


class RankedEffect(ScreenedEffect):
    """A line of the ranking.

    Attributes
    ----------
    evidence : twice the log-likelihood ratio: a drop of χ² against a noise scale of few degrees of freedom counts less.
    dof : directions that could be resolved.
    p, p_global : p-value of this candidate alone, and corrected for the number of looks and families of tests.
    within_runs : drop of χ² from the variation within runs alone.
    """

    evidence: float = 0.0
    dof: int
    p: float
    p_global: float
    within_runs: float


class GroupMember(ScreenedEffect):
    """A member of an equivalence group; `unexplained`: χ² left by a refit with it instead of the leader."""

    unexplained: float


class CovariateLabel(Record):
    """A covariate: name, unit, and its words for a sentence."""

    name: str
    unit: str
    phrase: str


class ChainStage(Record):
    """Where in the signal chain of a channel an effect acts: in the sensor, or in its converter.

    Attributes
    ----------
    named : the stage of the effect.
    sensor : kind of sensor.
    determined : whether these runs would show the same effect at the other stage as another one, which need not be in
        the catalogue.  Runs that drive the converter alone do so.
    """

    named: Literal["sensor", "converter"]
    sensor: Kind
    determined: bool


class UntypicalSize(Record):
    """A coefficient beyond what is met in practice; `largest` is the largest typical size, in the same unit."""

    name: str
    value: float
    largest: float
    unit: str


class EffectGroup(Record):
    """Effects that these runs cannot distinguish, the best first.

    Attributes
    ----------
    channels, delta_chi2, dof : of the first.
    delta_chi2_known : Δχ² of the first at the noise known beforehand; None of diagnoses of earlier versions.
    p_global : p-value of the first, corrected for the number of looks and families of tests.
    candidates : one per effect.
    residual : rms of the channel that shows it best, before and after adding the first, at the noise known beforehand.
    within : whether pictures show that residual about the mean of each run.
    covariate : what that residual depends on; None where no single covariate explains it.
    discriminating_run : the feasible run that distinguishes them best; None where there is none.
    unlisted : covariates, one to three, of each plain function that fits as well and is none of the effects: it may be
        of a cause that the catalogue lacks.
    stage : where in the signal chain the first acts, and whether that is determined; None of an effect outside of it.
    beyond_typical : the coefficients of the first that are larger than those met in practice; several effects at once
        may imitate one of such a size.
    """

    effects: tuple[str, ...]
    channels: tuple[str, ...]
    delta_chi2: float
    delta_chi2_known: float | None = None
    dof: int
    p_global: float
    candidates: tuple[GroupMember, ...]
    residual: RmsChange
    within: bool = False
    covariate: CovariateLabel | None
    discriminating_run: RunDesign | None = None
    unlisted: tuple[tuple[CovariateLabel, ...], ...] = ()
    stage: ChainStage | None = None
    beyond_typical: tuple[UntypicalSize, ...] = ()


class RivalExplanation(Record):
    """Other effects that explain the same together.

    Attributes
    ----------
    effects : with their channels, mountings or tables.
    log_odds : logarithm of their odds against what was found; sizes beyond the typical range and every further effect
        count against either.
    """

    effects: tuple[EffectChoice, ...]
    log_odds: float


class NeglectedUncertainty(Record):
    """A standard uncertainty that the campaign states of its equipment and the model takes as exact.

    Attributes
    ----------
    effect, parameter : what describes it, and its parameter as it would be named in the model.
    value, unit : as stated.
    shifts, in_sd : the parameter of the model that it would shift most, by so many of its standard deviations.
    """

    effect: str
    parameter: str
    value: float
    unit: str
    shifts: str
    in_sd: float


class NearestEffect(Record):
    """Effects that explain a part of structure which the catalogue does not explain in full."""

    effects: tuple[str, ...]
    channels: tuple[str, ...]
    delta_chi2: float


class NoiseFinding(Record):
    """A kind of noise that the model may lack.

    Attributes
    ----------
    value : estimate: correlation from row to row, relative variance of run offsets, …
    p : under white noise.
    delta_chi2 : square of the statistic in standard deviations.
    adopted : whether it remains significant once effects and structure are taken out.
    """

    effect: str
    channels: tuple[str, ...]
    value: float
    p: float
    delta_chi2: float
    adopted: bool


class UndetectableEffect(Record):
    """An effect that these runs cannot show.

    Attributes
    ----------
    absorbed_by : parameters that absorb its response, largest share first.
    reason : ``absorbed`` by the model, hidden in the ``noise``, or ``not_supplied``: no run responds to it.
    needs : covariates or stimulus that would bring it out and no run has; empty where unknown.
    retained : share of the response that the model does not absorb.
    smallest_detectable, typical, unit : size detected with 80 % power, and the range met in practice.
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


class Amplitude(Record):
    """A coefficient of a formula, or the height of a step, at the input."""

    value: float
    sd: float | None
    unit: str


class ResidualStructure(Record):
    """Dependence of a channel's residual on a covariate, or on a product of two.

    Attributes
    ----------
    covariate : name, of two joined by " × ".
    test : the form that was fitted.
    p : corrected for the number of looks.
    step : where it is a step in one run.
    shape : formula in symbols; empty where none was sought.
    coefficient : of the first term, or the height of the step.
    terms, inclusion, near : of the formula: its terms, how often the first comes first when runs are resampled, and
        terms that fit almost as well.
    kind : kind of the channel of the formula.
    """

    channel: str
    covariate: str
    test: str
    p: float
    step: Step | None = None
    shape: str = ""
    coefficient: Amplitude | None
    terms: tuple[FormulaTerm, ...] = ()
    inclusion: float | None = None
    near: tuple[str, ...] = ()
    kind: str = ""


class StrongestStructure(Record):
    """The structure that stands out most: its channel, and covariates, or the step that it mostly is."""

    channel: str
    covariates: tuple[CovariateLabel, ...]
    step: Step | None = None


class Outlier(Record):
    """An outlying sample.

    Attributes
    ----------
    row : counts from 1; of a raw log, the rows are its means.
    distance : deletion residual in standard deviations.
    time_s, table_angle_deg : of the row, as recorded; None where it has none.
    """

    run: str
    channel: str
    row: int
    distance: float
    time_s: float | None = None
    table_angle_deg: float | None = None


class AskedEffect(Record):
    """The effect that was asked about, with the size detected with 80 % power; None where none would be."""

    effect: str
    smallest_detectable: float | None
    unit: str


class Diagnosis(Presented, Record):
    """What is missing in a model, found without a refit.

    Attributes
    ----------
    verdict : the outcome.
    message : why the fit, or the sampling about its mode, did not converge.
    result : folder of the result that was diagnosed.
    p_global : p-value of the best candidate, corrected for the number of looks and families of tests.
    threshold : probability of a false alarm that the search allows; a corrected p-value below it is a finding.
    groups : in order of evidence; empty unless the verdict names effects.
    ranking : every candidate, the most significant first.
    nearest : effects that explain a part of unexplained structure.
    looks : effective number of independent candidates.
    suggested : the effects, or noise, to add next; all that the runs do not distinguish.
    paired : whether the first two groups were found together: neither explains without the other what both do.
    unfinished : whether more effects are missing than one search selects: the groups are the first of several.
    rivals : other sets of effects that the data do not exclude in place of those found, the likeliest first; of a pair,
        what was found before it leads; of wandering noise, the effect that would do in its place.
    strongest : the structure that no effect explains.
    more_remains : whether structure or further effects remain beside the first group, small against what it explains:
        add it and diagnose again.
    scatter_remains : whether rows still scatter more than recorded beside the first group, so that it may only resemble
        the cause.
    recorded_noise : white noise of each channel, as fitted and as known beforehand, after the groups.
    contradicted : noise scales of the fit that contradict what is known of them, the least probable first.
    disagreeing : runs and rows that do not agree with the others at the noise known before the fit.
    explanations : how probable each explanation is; None of models with slow noise or heavy tails, and
        of earlier versions.
    neglected : stated uncertainties of the equipment that no interval of the fit includes, those that matter.
    violations : how the noise departs from its model where nothing in the catalogue explains that.
    wandering : whether noise that wanders otherwise than the model's explains what is found as well, or instead of it.
    asked : the effect that was asked about, where one was.
    """

    __repr__, __str__ = Presented.__repr__, Presented.__str__

    format: Literal[1] = 1
    verdict: Verdict
    message: str = ""
    result: str = "RESULT"
    p_global: float = 1.0
    threshold: float = thresholds.FALSE_ALARM
    groups: tuple[EffectGroup, ...] = ()
    ranking: tuple[RankedEffect, ...] = ()
    noise: tuple[NoiseFinding, ...] = ()
    undetectable: tuple[UndetectableEffect, ...] = ()
    nearest: tuple[NearestEffect, ...] = ()
    structure: tuple[ResidualStructure, ...] = ()
    looks: float = 0.0
    outliers: tuple[Outlier, ...] = ()
    suggested: Suggestion | None = None
    paired: bool = False
    unfinished: bool = False
    rivals: tuple[RivalExplanation, ...] = ()
    strongest: StrongestStructure | None = None
    more_remains: bool = False
    scatter_remains: bool = False
    recorded_noise: tuple[NoiseComparison, ...] = ()
    contradicted: tuple[NoiseComparison, ...] = ()
    disagreeing: tuple[Disagreement, ...] = ()
    explanations: Evidence | None = None
    neglected: tuple[NeglectedUncertainty, ...] = ()
    violations: tuple[NoiseViolation, ...] = ()
    wandering: WanderingNoise = ""
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
    def most_biasing(self) -> ParameterBias | None:
        """The worst bias by an effect that the runs cannot show; None where none would matter beside a posterior."""
        known = [each.bias for each in self.undetectable if each.bias is not None]
        worst = max(known, key=lambda bias: abs(bias.in_sd), default=None)
        return worst if worst is not None and abs(worst.in_sd) >= thresholds.NEGLECTED_SHIFT else None

    @property
    def proposed(self) -> Suggestion | None:
        """What to add next: what is suggested or, where nothing is missing, stated uncertainties that are neglected."""
        if self.suggested is not None or self.verdict != "adequate" or self.asked is not None or not self.neglected:
            return self.suggested
        return Suggestion(effects=tuple(each.effect for each in self.neglected), channels=None)

    @property
    def noise_outweighs(self) -> bool:
        """Whether noise that the model lacks has stronger evidence than the effect or structure of the verdict."""
        adopted = [noise for noise in self.noise if noise.adopted]
        others = [group.p_global for group in self.groups] or [each.p for each in self.structure]
        if not adopted or not others or self.verdict in ("noise_model", "run_disagrees"):
            return False
        return min(noise.p for noise in adopted) < min(others)

    def with_evidence(self, evidence: ResidualEvidence | None, scatter: KnownNoise | None = None) -> "Diagnosis":
        """Return the same diagnosis with the residual that shows its first group, and with the rows' scatter."""
        copy = self.model_copy()
        copy._evidence, copy._scatter = evidence, scatter
        return copy

    def channels_for(self, effect: str) -> tuple[str, ...] | None:
        """Return the channels on which an effect was found; None for all on which it was screened, and if not found."""
        if self.suggested is not None and self.suggested.effects == (effect,):
            return self.suggested.channels
        members = [member for group in self.groups for member in group.candidates if member.effect == effect]
        everywhere = {name for line in self.ranking if line.effect == effect for name in line.channels}
        return members[0].channels if members and set(members[0].channels) != everywhere else None

    def estimate(self, effect: str) -> "ScreenedEffect | NoiseFinding | None":
        """Return what the screening says of an effect or noise: as a member of a group, or its best line, or None."""
        members = [member for group in self.groups for member in group.candidates]
        return next((line for line in (*members, *self.ranking, *self.noise) if line.effect == effect), None)

"""Records of a verdict: probabilities of the explanations, effects with channels, suggestions, residual rms.

They state what a diagnosis decides and what an addition changes, and what a search found: how probable each explanation
is, and what stands in the place of each effect; formulas of what no effect explains; and what hides an effect, with the
bias that it causes meanwhile.
"""

import math
from dataclasses import dataclass
from typing import Literal

from imubayes.foundations.records import Record

Verdict = Literal[
    "adequate",
    "missing_effect",
    "equivalent_effects",
    "unexplained_structure",
    "noise_model",
    "run_disagrees",
    "undetectable",
    "not_converged",
]
"""The verdict of a diagnosis: that of its most probable explanation, or why there is none."""


class CoefficientEstimate(Record):
    """A coefficient with its standard uncertainty, in its unit; None if it is not determined."""

    name: str
    value: float | None
    sd: float | None
    unit: str


class EffectChoice(Record):
    """An effect with the channels it acts on; None for all that it can act on."""

    effect: str
    channels: tuple[str, ...] | None


class Suggestion(Record):
    """Effects, or noise, to add next, and the channels that they have in common; None for all channels.

    The effects `left_out` explain the same, but the refit with them does not converge.
    """

    effects: tuple[str, ...]
    channels: tuple[str, ...] | None
    left_out: tuple[str, ...] = ()


class RmsChange(Record):
    """Residual rms of one channel before and after an addition, in `unit`."""

    channel: str
    before: float
    after: float
    unit: str


EXPECTED = 1.0
"""Expected number of missing effects before the data, in equal shares of the catalogue."""
NAMED = 0.9
"""Probability at which an explanation is a finding.  Measured on effects, nulls and noise: 62 of 62 right."""
NAMED_ODDS = math.log(NAMED / (1 - NAMED))
NEAR = 3.0
"""Nats within which hypotheses are reported together: the others have less than e⁻³ = 0.05 of the odds."""
Explanation = Literal["nothing", "noise", "effects", "input", "outside"]
"""Nothing is missing; the noise is not as stated; effects of the catalogue; a wrong input; a form outside of it."""


class ProbableExplanation(Record):
    """A kind of explanation: its probability, and the log odds of its most probable form against the best of all.

    `log_odds` is a natural logarithm; None if no explanation of the kind was evaluated.
    """

    kind: Explanation
    probability: float
    log_odds: float | None


class ProbableEffect(Record):
    """An effect with its inclusion probability: that of all explanations that contain it."""

    effect: str
    channels: tuple[str, ...]
    probability: float


class WeighedSoFar(Record):
    """What a search at work has weighed: how many hypotheses, and the effects of those with their probabilities."""

    hypotheses: int
    inclusion: tuple[ProbableEffect, ...]


class EffectSlot(Record):
    """A missing effect of the leading explanation, with its alternatives if the other effects are kept.

    Attributes
    ----------
    candidates : effects with their shares, the most probable first, until 95 % are listed.
    gain : natural logarithm of the evidence for it.
    probability : that one of them is missing.
    """

    candidates: tuple[ProbableEffect, ...]
    gain: float
    probability: float

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels, mountings or tables of the most probable one."""
        return self.candidates[0].channels


class FoundStep(Record):
    """A step: its size, and the recorded covariates of the row at which it is.

    Attributes
    ----------
    sizes : one of each channel, by its name, in output units.
    settings : time and temperatures of the row, those that the run has, as recorded and without an uncertainty.
    """

    sizes: tuple[CoefficientEstimate, ...]
    settings: tuple[CoefficientEstimate, ...]


class FoundForm(Record):
    """The form outside the catalogue, or the wrong record, of the most probable explanation that has one.

    Attributes
    ----------
    name : what it is.
    channels : on which.
    covariates : columns of the covariates that it depends on.
    run, row : of a step or a wrong record; the row counts from 1.
    log_odds : against the most probable explanation without one.
    wrong : whether it is a wrong record.
    step : of a step of the outputs: how large, and where.
    """

    name: str
    channels: tuple[str, ...]
    covariates: tuple[str, ...] = ()
    run: str = ""
    row: int | None = None
    log_odds: float
    wrong: bool = False
    step: FoundStep | None = None


class FoundNoise(Record):
    """Noise other than stated in the most probable explanation.

    Attributes
    ----------
    family : what it is; ``scale``: white noise of another size.
    scale : ratio of the noise of a row to that known beforehand.
    """

    channels: tuple[str, ...]
    family: str
    scale: float


class Evidence(Record):
    """Probabilities of the explanations of a residual.

    Attributes
    ----------
    explanations : every kind of explanation.
    slots : effects of the leading explanation, the strongest first.
    inclusion : effects by their inclusion probability.
    form : the most probable form or wrong record; None if none is near.
    noise : noise other than stated, in the leading explanation.
    noise_known : standard deviation of the logarithm of the worst known noise scale.
    hypotheses : number of hypotheses evaluated.
    """

    explanations: tuple[ProbableExplanation, ...]
    slots: tuple[EffectSlot, ...]
    inclusion: tuple[ProbableEffect, ...]
    form: FoundForm | None
    noise: tuple[FoundNoise, ...]
    noise_known: float
    hypotheses: int

    @property
    def leading(self) -> ProbableExplanation:
        """The most probable kind of explanation."""
        return max(self.explanations, key=lambda each: each.probability)

    def of(self, kind: Explanation) -> ProbableExplanation:
        """Return one kind of explanation."""
        return next(each for each in self.explanations if each.kind == kind)


class FormulaTerm(Record):
    """One term of a formula, with its coefficient at the input.

    Attributes
    ----------
    shape : the term in symbols.
    expression : the term in Python, in SI, for an effect's `sample`.
    needs : covariates that a run has to supply.
    value, sd, unit : coefficient.
    delta_chi2 : drop of χ² when the term was selected.
    log_odds : natural logarithm of the odds for it, all terms of the library counted.
    """

    shape: str
    expression: str
    needs: tuple[str, ...]
    value: float
    sd: float | None
    unit: str
    delta_chi2: float
    log_odds: float


class ResidualFormula(Record):
    """The simplest formula for what no effect of the catalogue explains on a channel.

    Attributes
    ----------
    kind : kind of the channel.
    shape : the formula in symbols: the sum of the terms.
    terms : with their coefficients at the input, in the order of selection.
    inclusion : how often the first term comes first when runs are resampled.
    near : terms that fit almost as well as the first, in symbols.
    """

    channel: str
    kind: str
    shape: str
    terms: tuple[FormulaTerm, ...]
    inclusion: float
    near: tuple[str, ...]


@dataclass(frozen=True)
class Absorber:
    """What hides an effect: parameter family (`effect.parameter`, or `RUN_OFFSETS`) and its share of the response."""

    parameter: str
    share: float


@dataclass(frozen=True)
class ParameterBias:
    """The parameter that an effect of the largest typical size biases most while undetected.

    None of that size is assumed if the campaign states the uncertainty of the equipment.

    Attributes
    ----------
    parameter, unit : name and unit.
    value, in_sd : the bias, in that unit and in posterior standard deviations.
    coefficient, size, size_unit : of the coefficients of the effect the one that biases most, with its largest typical
        size.
    """

    parameter: str
    unit: str
    value: float
    in_sd: float
    coefficient: str = ""
    size: float = 0.0
    size_unit: str = ""


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

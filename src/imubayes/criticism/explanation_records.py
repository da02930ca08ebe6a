"""Records of a verdict: probabilities of the explanations, effects with channels, suggestions, residual rms.

They state what a diagnosis decides and what an addition changes, and what a search found: how probable each explanation
is, and what stands in the place of each effect.
"""

import math
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
    """Effects, or noise, to add next, on the channels that those which act on channels share; None for all.

    Those `left_out` explain the same, but the refit with them does not converge.
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


NAMED = 0.9
"""Probability at which an explanation is told as a finding.  Measured on effects, nulls and noise: 62 of 62 right."""
NAMED_ODDS = math.log(NAMED / (1 - NAMED))
NEAR = 3.0
"""Nats within which hypotheses are told beside each other: of the others all have less than e⁻³ = 0.05 of the odds."""
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
    """An effect with its inclusion probability: of all explanations that contain it."""

    effect: str
    channels: tuple[str, ...]
    probability: float


class WeighedSoFar(Record):
    """What a search at work has weighed: how many hypotheses, and the effects of those with their probabilities."""

    hypotheses: int
    inclusion: tuple[ProbableEffect, ...]


class EffectSlot(Record):
    """One missing effect of the leading explanation, and what may stand in its place, the rest held.

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
    """A form outside the catalogue, or a wrong input, of the most probable explanation that has one.

    Attributes
    ----------
    name : what it is.
    channels : on which.
    covariates : columns of the covariates that it depends on.
    run, row : of a step or a wrong input; the row counts from 1.
    log_odds : against the most probable explanation without one.
    wrong : whether it is a wrong input.
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
    scale : noise of a row over that known beforehand.
    """

    channels: tuple[str, ...]
    family: str
    scale: float


class Evidence(Record):
    """How probable each explanation of what a model leaves is.

    Attributes
    ----------
    explanations : every kind of explanation.
    slots : effects of the leading explanation, the strongest first.
    inclusion : effects by their inclusion probability.
    form : the most probable form or wrong record; None if none is near.
    noise : noise other than stated, in the leading explanation.
    noise_known : standard deviation of the logarithm of the worst known noise scale.
    hypotheses : how many were evaluated.
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

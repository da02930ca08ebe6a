"""What a diagnosis decides, and what an addition changes: verdicts, effects with their channels, residual rms."""

from typing import Literal

from imubayes.json_record import Record

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


MISSING: tuple[Verdict, ...] = ("missing_effect", "equivalent_effects")
"""Verdicts that name effects."""


class CoefficientEstimate(Record):
    """A coefficient with its standard uncertainty, in its unit; None where it is not determined."""

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

"""Estimates that no working unit can have, and outputs that a fit leaves unexplained, as records."""

from typing import Literal

from imubayes.json_record import Record


class ImplausibleEstimate(Record):
    """An estimate that a working unit on the stated equipment cannot have.

    Attributes
    ----------
    reason : outside the domain of the parameter, or far from its prior.
    name, unit, value : of the parameter, the value being that of the posterior mode.
    lowest, highest : ends of the domain in the unit; None where the reason is another.
    prior_mean, prior_sd : median and standard deviation of the prior, in the unit; None where it has none.
    distance : of the estimate from the middle of the prior, in its standard deviations.
    """

    reason: Literal["outside_domain", "far_from_prior"]
    name: str
    unit: str
    value: float
    lowest: float | None = None
    highest: float | None = None
    prior_mean: float | None
    prior_sd: float | None
    distance: float


class UnexplainedOutput(Record):
    """A channel whose outputs the model does not describe.

    Attributes
    ----------
    channel, unit : name, and unit of the input.
    residual, within_runs : rms of the residual, in all and about its mean in each run, in the unit.
    output : rms of the outputs, in the unit.
    noise : recorded standard deviation of the rows' means, in the unit.
    """

    channel: str
    unit: str
    residual: float
    within_runs: float
    output: float
    noise: float

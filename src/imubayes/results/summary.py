"""The summary of a fit: the typed record behind `summary.json`.

Numbers are in datasheet units.  A number that a fit without convergence, or without sampling, does not have is None.
"""

import math
from typing import Literal

from pydantic import BaseModel, ConfigDict


def finite(value: float) -> float | None:
    """Return a number for JSON; None for a non-finite value."""
    return float(value) if math.isfinite(value) else None


class Record(BaseModel):
    """Base of everything that the result folder keeps as JSON."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Quantity(Record):
    """An estimate with its uncertainty.

    Attributes
    ----------
    name, unit : as in the summary, ``scale_factor[gx]`` in ``pulse/s per deg/s``.
    mean, sd : posterior mean and standard deviation.
    q025, q975 : ends of the 95 % equal-tailed credible interval.
    prior_sd : prior standard deviation, None where it is infinite.
    from_data : 1 − (posterior sd / prior sd)², the share of the information contributed by the data.
    """

    name: str
    unit: str
    mean: float | None
    sd: float | None
    q025: float | None
    q975: float | None
    prior_sd: float | None
    from_data: float | None


class ParameterSummary(Quantity):
    """A parameter: `map` is the posterior mode, the others are sampling diagnostics (None without sampling)."""

    nuisance: bool
    map: float | None
    r_hat: float | None
    ess_bulk: float | None
    ess_tail: float | None


class Conformance(Record):
    """Posterior probability that a quantity does not exceed a threshold, in the unit of the quantity."""

    threshold: float
    unit: str
    probability: float | None


class DerivedSummary(Quantity):
    """A derived quantity; `within` is given for Δk, whose threshold decides whether the 1 g line stands for all."""

    within: Conformance | None = None


class RunSummary(Record):
    """Goodness of fit of one channel in one run; `rms` of the residual in input units, deg/s or g."""

    name: str
    channel: str
    n: int
    chi2: float | None
    rms: float | None
    unit: str


class WeakDirection(Record):
    """A combination of parameters or derived quantities that the data did not determine.

    Attributes
    ----------
    combination : for display.
    quantities : names of the members.
    kind : ``confusion`` for two derived quantities of which the data determine a combination only.
    from_data : share of the information along the combination that came from the data.
    """

    combination: str
    quantities: tuple[str, ...] = ()
    kind: Literal["confusion", "combination"] = "combination"
    from_data: float


class NextRun(Record):
    """A run that would narrow a quantity: expected standard deviation before and after it."""

    run: str
    quantity: str
    sd_before: float
    sd_after: float
    unit: str


class ProcedureShare(Record):
    """Standard deviation of a quantity from the runs of one procedure alone, and without them."""

    procedure: str
    alone: float
    without: float


class Contribution(Record):
    """Standard deviation of a quantity at the mode, by test procedure."""

    quantity: str
    unit: str
    sd: float
    by: tuple[ProcedureShare, ...]


class Seconds(Record):
    """Time spent, s."""

    load: float = 0.0
    fit: float = 0.0
    sample: float = 0.0


class Summary(Record):
    """Everything `summary.json` says of a fit (format 1)."""

    format: Literal[1] = 1
    campaign: str
    model: str
    converged: bool
    message: str
    sampled: bool
    interval: str
    uncertainty: str
    acceptance: float | None
    parameters: tuple[ParameterSummary, ...]
    derived: tuple[DerivedSummary, ...]
    runs: tuple[RunSummary, ...]
    chi2: float | None
    dof: float
    log_evidence: float | None
    weak_directions: tuple[WeakDirection, ...]
    next_runs: tuple[NextRun, ...]
    contributions: tuple[Contribution, ...]
    notes: tuple[str, ...]
    seconds: Seconds

"""The summary of a fit: the typed record behind `summary.json`.

Numbers are in datasheet units.  A number that a fit without convergence, or without sampling, does not have is None.
An estimate from posterior draws is mean, standard deviation and the 95 % equal-tailed interval.  Quantities in output
units are shown in the unit of their channel.  The record also holds what the fit comes from.
"""

from typing import Literal

import numpy as np

from imubayes.adequacy.adequacy_record import DoubtedRun, KnownNoiseFit, NoiseComparison, NoiseViolation
from imubayes.campaign.equipment import ANGLE, ANGLE_UNIT
from imubayes.foundations.campaign_data import SetAside, channel_of_component
from imubayes.foundations.quantity_names import SCALE_FACTOR, QuantityName, family_of
from imubayes.foundations.records import Record
from imubayes.foundations.units import with_output_unit
from imubayes.inference.candidate_runs import NextRun
from imubayes.inference.identifiability import (
    Contribution,
    ImplausibleEstimate,
    PriorConflict,
    UnexplainedOutput,
    WeakDirection,
)
from imubayes.model.model_file import SingleRunEffect, UncertainEquipment

_INTERVAL = (2.5, 97.5)
# A quantity that varies by less than this share of itself varies by rounding.
_ROUNDING = 1e-12


class Estimated(Record):
    """Posterior mean, standard deviation, and the ends of the 95 % equal-tailed credible interval."""

    mean: float
    sd: float
    q025: float
    q975: float


def estimated(draws: np.ndarray) -> Estimated:
    """Return the estimate from draws of a quantity, (S,); one that only rounding changes is exact."""
    if is_constant(draws):
        value = float(draws[0])
        return Estimated(mean=value, sd=0.0, q025=value, q975=value)
    low, high = np.percentile(draws, _INTERVAL)
    return Estimated(mean=float(draws.mean()), sd=float(draws.std()), q025=float(low), q975=float(high))


def is_constant(draws: np.ndarray) -> bool:
    """Return whether draws, (S,), differ by rounding at most."""
    return float(np.ptp(draws)) <= _ROUNDING * float(np.max(np.abs(draws)))


class SoftwareVersion(Record):
    """A package and its version."""

    package: str
    version: str


class FitProvenance(Record):
    """Provenance of a fit.

    Attributes
    ----------
    serial : serial number of the unit; empty if the campaign states none.
    first_run, last_run : earliest and latest start of a run, ISO 8601 as in the campaign; None if no run states one.
    fitted : time of the fit, ISO 8601 in UTC.
    data_sha256, model_sha256 : identify the data and the model, as in `fit.json`.
    seed : of the sampler.
    software : versions that made the fit.
    priors_from : source of the priors, in words; empty for priors of the user.
    """

    serial: str
    first_run: str | None
    last_run: str | None
    fitted: str
    data_sha256: str
    model_sha256: str
    seed: int
    software: tuple[SoftwareVersion, ...]
    priors_from: str = ""


class Quantity(Record):
    """An estimate with its uncertainty.

    Attributes
    ----------
    name, unit : as in the summary, ``scale_factor[gx]`` in ``pulse/s per deg/s``.
    mean, sd : posterior mean and standard deviation.
    q025, q975 : ends of the 95 % equal-tailed credible interval.
    prior_sd : prior standard deviation, None if it is infinite.
    from_data : 1 − (posterior sd / prior sd)², the share of the information contributed by the data.
    """

    name: str
    unit: str
    mean: float | None = None
    sd: float | None = None
    q025: float | None = None
    q975: float | None = None
    prior_sd: float | None = None
    from_data: float | None = None

    @property
    def repeats_misalignments(self) -> bool:
        """Whether it is a component of an input axis, which shows nothing beyond the misalignments."""
        return channel_of_component(self.name) is not None


class ParameterSummary(Quantity):
    """A parameter: `map` is the posterior mode, the others are sampling diagnostics (None without sampling)."""

    nuisance: bool = False
    map: float | None = None
    r_hat: float | None = None
    ess_bulk: float | None = None
    ess_tail: float | None = None


class Conformance(Record):
    """Posterior probability that a quantity does not exceed a threshold, in the unit of the quantity."""

    threshold: float
    unit: str
    probability: float | None


class DerivedSummary(Quantity):
    """A derived quantity; `within` is given for Δk, whose threshold decides if the 1 g line applies to all inputs."""

    within: Conformance | None = None


class CombinedQuantities(Record):
    """What is combined.

    Attributes
    ----------
    name : the standard symbol, ``D_F+D_II[g]``, or the sum as it is written.
    standard : whether a procedure of the campaign declares it, with its symbol.
    quantities, weights : the members, and their weights in `unit` over the unit of each.  The weights are None for
        k′ = k cos θ, whose members are the scale factor k and the mounting angle θ.
    constant : added to the sum, in `unit`.
    middle_of : run in the middle of whose record it holds, if it changes with time; else empty.
    """

    name: str
    standard: bool
    quantities: tuple[str, ...]
    weights: tuple[float, ...] | None
    constant: float = 0.0
    middle_of: str = ""


class CombinationSummary(CombinedQuantities, Quantity):
    """A combination that the data determine much better than its leading member."""


class RunSummary(Record):
    """Goodness of fit of one channel in one run.

    Attributes
    ----------
    rms : of the residual in input units, deg/s or g.
    within : rms about its mean in the run, in the same unit; None in results of earlier versions, as `noise`.
    noise : its standard deviation according to the model, run offset included.
    """

    name: str
    channel: str
    n: int
    chi2: float | None
    rms: float | None
    within: float | None = None
    noise: float | None = None
    unit: str


class PriorScatter(Record):
    """A noise scale that the data hardly determine, and the parameters that depend on its prior.

    Attributes
    ----------
    scale : name of the scale, ``run_scatter.tau[ax]``.
    from_data : share of the information on it contributed by the data.
    parameters : those whose posterior standard deviation follows the scale, the strongest first.
    factor : of the first of them, its standard deviation at the highest fifth of the scale over that at the lowest.
    """

    scale: str
    from_data: float
    parameters: tuple[str, ...]
    factor: float


class Seconds(Record):
    """Time spent, s."""

    load: float = 0.0
    fit: float = 0.0
    sample: float = 0.0


class Summary(Record):
    """The contents of `summary.json` (format 1).

    Attributes
    ----------
    provenance : unit, dates, hashes, seed and software; None in results of earlier versions.
    implausible, unexplained : reasons why a fit that reached a mode failed; empty otherwise.
    intervals_valid : whether the fit converged, and its noise agrees with the model and with the knowledge of it.
    noise_violations : differences of the noise from the model, the clearest first.
    noise_suspected : differences of the noise from the model that may be chance; intervals count as valid.
    noise_contradicted : noise scales that contradict the noise known beforehand, the clearest first.
    known_noise : goodness of fit at the noise known beforehand, including the part that the noise of the fit absorbed;
        None if
        the fit has no mode, and in results of earlier versions.
    prior_scatter : noise scales known from their priors alone, on which intervals depend.
    doubted_runs : runs that the others do not predict at the noise known before the fit.
    left_out : effects between runs that one run of a channel cannot determine: not in the model, nor in the intervals.
    exact : stated uncertainties of site and equipment that the model takes as exact; no interval includes them.
    set_aside : readings that the model leaves out.
    combinations : determined combinations of the members of weak directions.
    pareto_k : tail index of the importance weights of the sampler's proposal; None without sampling.
    """

    format: Literal[1] = 1
    campaign: str
    model: str
    provenance: FitProvenance | None = None
    converged: bool
    message: str
    implausible: tuple[ImplausibleEstimate, ...] = ()
    unexplained: tuple[UnexplainedOutput, ...] = ()
    sampled: bool
    interval: str
    uncertainty: str
    acceptance: float | None
    pareto_k: float | None = None
    intervals_valid: bool = True
    noise_violations: tuple[NoiseViolation, ...] = ()
    noise_suspected: tuple[NoiseViolation, ...] = ()
    noise_contradicted: tuple[NoiseComparison, ...] = ()
    known_noise: KnownNoiseFit | None = None
    prior_scatter: tuple[PriorScatter, ...] = ()
    doubted_runs: tuple[DoubtedRun, ...] = ()
    left_out: tuple[SingleRunEffect, ...] = ()
    exact: tuple[UncertainEquipment, ...] = ()
    set_aside: tuple[SetAside, ...] = ()
    parameters: tuple[ParameterSummary, ...]
    derived: tuple[DerivedSummary, ...]
    runs: tuple[RunSummary, ...]
    chi2: float | None
    dof: float
    log_evidence: float | None
    weak_directions: tuple[WeakDirection, ...]
    combinations: tuple[CombinationSummary, ...] = ()
    prior_conflicts: tuple[PriorConflict, ...] = ()
    next_runs: tuple[NextRun, ...]
    contributions: tuple[Contribution, ...]
    notes: tuple[str, ...]
    seconds: Seconds

    @property
    def delta_k_threshold(self) -> float | None:
        """The threshold of Δk in percent; None if the fit has no Δk."""
        return next((each.within.threshold for each in self.derived if each.within is not None), None)


def channel_units(summary: Summary) -> dict[str, tuple[str, str]]:
    """Return the units of output and input of each channel, which its scale factor has."""
    scales = [entry for entry in summary.derived if family_of(entry.name) == SCALE_FACTOR]
    parts = [(entry.name[len("scale_factor[") : -1], entry.unit.rpartition(" per ")) for entry in scales]
    return {channel: (output, per) for channel, (output, _, per) in parts}


def in_output_units(summary: Summary) -> Summary:
    """Return a summary whose parameters have the output units of their channels in place of `output`.

    A quantity of channels of different output units keeps it.
    """
    units = {channel: output for channel, (output, _) in channel_units(summary).items()}
    common = next(iter(units.values())) if len(set(units.values())) == 1 else ""

    units[ANGLE] = ANGLE_UNIT

    def shown[Line: Quantity](line: Line, name: str) -> Line:
        label = QuantityName.of(name).labels
        output = next((units[part] for part in label if part in units), common)
        return line.model_copy(update={"unit": with_output_unit(line.unit, output)})

    combinations = tuple(shown(line, line.quantities[0]) for line in summary.combinations)
    own = {line.name: line.unit for line in combinations}
    return summary.model_copy(
        update={
            "parameters": tuple(shown(line, line.name) for line in summary.parameters),
            "combinations": combinations,
            "contributions": tuple(
                each.model_copy(update={"unit": own.get(each.quantity, each.unit)}) for each in summary.contributions
            ),
        }
    )

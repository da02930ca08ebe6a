"""The uncertainty report of a unit as a typed record: everything that the document says, as numbers and identifiers.

The document is made from this record alone, so that each of its numbers is in the JSON file.  Numbers are in `unit`;
`d_si` gives the same unit in the D-SI format.  A number that is withheld, or that a fit without convergence lacks, is
None.
"""

import math
from typing import Literal

from imubayes.adequacy.adequacy_record import ChannelRms
from imubayes.criticism.explanation_records import Evidence, ParameterBias, Verdict
from imubayes.foundations.campaign_data import SetAside
from imubayes.foundations.errors import closest_first
from imubayes.foundations.records import Record
from imubayes.inference.identifiability import PriorConflict, ProcedureShare, WeakDirection
from imubayes.results.summary import CombinedQuantities, NoiseViolation, RunSummary
from imubayes_qualification.budgets.budget_parts import UncertaintyBudgets
from imubayes_qualification.budgets.measurement_equation import MeasurementModel
from imubayes_qualification.budgets.standard_quantities import DigitalUnit, Standard
from imubayes_qualification.budgets.taken_as_exact import TakenAsExact
from imubayes_qualification.certificate.certificate import CapabilityFloor, Certificate, Missing
from imubayes_qualification.certificate.conformity import Obstacle
from imubayes_qualification.certificate.report_pictures import PictureData
from imubayes_qualification.certificate.report_subject import Provenance, Subject
from imubayes_qualification.evaluation.coverage import IntervalShape
from imubayes_qualification.evaluation.decision_rules import NoDecision, Outcome, RuleName, Withheld
from imubayes_qualification.evaluation.stated_digits import Statistic

IntervalKind = Literal["95 % coverage interval, of the kind stated with each"]
NumberWithheld = Literal["not_converged", "no_draws", "monte_carlo_error"]
"""Why a number is not stated: there is no posterior; it has no draws; or these leave no digit of its uncertainty."""


class MonteCarloError(Record):
    """Monte Carlo standard errors of estimate, standard uncertainty, and both ends of the coverage interval.

    Attributes
    ----------
    effective : number of independent draws that carry as much information.
    digits : significant digits in which the uncertainties are stated; 0 if these errors leave none (JCGM 101, 7.9),
        so that the number is withheld.
    tolerance : numerical tolerance δ of the digits that JCGM 101 grants; of one digit if the number is withheld.
    worst : quantity with the largest error.
    draws_needed : how many times the draws would leave one digit, about.
    """

    estimate: float
    standard_uncertainty: float
    low: float
    high: float
    effective: float
    digits: Literal[0, 1, 2]
    tolerance: float
    worst: Statistic
    draws_needed: float


class ReportedEstimate(Record):
    """A quantity with its uncertainty.

    Attributes
    ----------
    name : of the parameter or derived quantity, or key and label of a quantity of the standards.
    estimate, standard_uncertainty : posterior mean and standard deviation.
    low, high, prior_sd : ends of the coverage interval, prior standard deviation, None if infinite or unknown.
    from_data : 1 − posterior variance / prior variance; None if it is unknown.
    interval : kind of the coverage interval: y ± U, of equal tails, or the shortest.
    coverage_factor, expanded_uncertainty : k and U = k u, half the length of the interval.
    exact : whether nothing in the model changes it.
    measured : whether the data determine it: at least half of the information is theirs, and it is not exact.  What is
        not measured is not zero, whatever its estimate, and has no place among results.
    withheld : why the number is not stated; None if it is.
    """

    name: str
    unit: str
    d_si: DigitalUnit | None
    estimate: float | None = None
    standard_uncertainty: float | None = None
    low: float | None = None
    high: float | None = None
    interval: IntervalShape | None = None
    coverage_factor: float | None = None
    expanded_uncertainty: float | None = None
    monte_carlo: MonteCarloError | None = None
    prior_sd: float | None = None
    from_data: float | None = None
    exact: bool = False
    measured: bool = True
    withheld: NumberWithheld | None = None


class ResultLine(ReportedEstimate):
    """A line of the result table; prior mean of a normal prior, R̂ and effective sizes of a sampled parameter."""

    kind: Literal["parameter", "derived"]
    prior_mean: float | None = None
    r_hat: float | None = None
    ess_bulk: float | None = None
    ess_tail: float | None = None


class NamedByStandard(Record):
    """How a standard calls a quantity."""

    key: str
    symbol: str
    quantity: str
    standard: Standard


class StandardEstimate(NamedByStandard, ReportedEstimate):
    """A quantity under the name and symbol of a standard.

    Attributes
    ----------
    key, symbol, quantity, standard, term : as in the table of the standards.
    label : the channel, or pair of channels.
    members : the parameters or derived quantities that it was computed from.
    vector : whether it is the length of the vector of these: its estimate is then that of the mean vector.
    """

    term: str
    label: str
    members: tuple[str, ...]
    vector: bool = False


class ScreenedCoefficient(Record):
    """Estimate of a coefficient that the model lacks, from the linearised fit of the diagnosis."""

    name: str
    value: float
    standard_uncertainty: float
    unit: str


class NotEstimated(NamedByStandard):
    """A quantity of the standards that the result does not measure.

    Attributes
    ----------
    effects : that the model would need.
    labels : channels that lack it; all of its kind if empty.
    reason : the model lacks the effects; the runs cannot show them; the runs lack what the definition needs; or the
        data do not determine it, so that only its prior is known.
    needs : covariates or conditions that the runs do not all supply.
    from_data : share of the information that came from the data; None if there is none.
    screened : estimates of these effects by the diagnosis, without adding them; the most significant first.
    """

    effects: tuple[str, ...]
    labels: tuple[str, ...] = ()
    reason: Literal["not_in_model", "undetectable", "not_defined", "not_measured"]
    needs: tuple[str, ...] = ()
    from_data: float | None = None
    screened: tuple[ScreenedCoefficient, ...] = ()


class MountingAngle(ReportedEstimate):
    """The true angle between a sensitive axis and the rotation axis.

    Attributes
    ----------
    channel, mounting : which angle.
    nominal, deviation : nominal angle and estimate less nominal, deg.
    evidence : by procedure; empty if the angle is too close to 0 to be linear in the parameters.
    runs : in this mounting.
    """

    channel: str
    mounting: str
    nominal: float
    deviation: float | None
    evidence: tuple[ProcedureShare, ...]
    runs: tuple[str, ...]


class ReportedCombination(CombinedQuantities, ReportedEstimate):
    """A combination of quantities that the data determine much better than its leading member.

    Attributes
    ----------
    evidence : by procedure; empty if the campaign has one procedure, or if the combination is not linear.
    procedures : of the campaign.
    """

    evidence: tuple[ProcedureShare, ...]
    procedures: tuple[str, ...]


class Probability(Record):
    """A probability by two methods.

    Attributes
    ----------
    value : from draws; None if it is withheld.
    monte_carlo_error : standard error of `from_draws`.
    allowed : largest difference between the two methods.
    """

    value: float | None
    from_draws: float
    from_quadrature: float
    monte_carlo_error: float
    allowed: float
    withheld: Withheld | None


class ThermalLinearity(ReportedEstimate):
    """Δk of one converter input against the 1 g input, and P(Δk ≤ threshold)."""

    channel: str
    run: str
    threshold: float
    within: Probability | None


class LimitOutcome(Record):
    """One limit of the specification and the decision by the rule; numbers in `unit`, None for no limit.

    Attributes
    ----------
    estimate, standard_uncertainty, expanded_uncertainty, low, high, interval : at the worst temperature of the range; U
        is half the length of the 95 % coverage interval.
    temperature_range, temperature : of the limit, and where it is worst, °C.
    symbol, label : of the standards if they have one, else the name of the quantity; and the channel.
    rule, guard_factor, guard_width, rule_probability : as applied.
    guard_band : width w; None for rules on probabilities.
    consumer_risk, producer_risk : specific risks; global ones if the production is known.
    withheld : why there is no decision; None if there is one.
    monte_carlo : errors of the estimate; None if it is exact.
    omitted_ratio : factor by which the omitted contributions would multiply U.
    """

    name: str
    unit: str
    d_si: DigitalUnit | None
    lower: float | None
    upper: float | None
    nominal: float | None
    temperature_range: tuple[float, float] | None
    temperature: float | None
    estimate: float
    standard_uncertainty: float
    expanded_uncertainty: float
    conformance: Probability
    rule: RuleName
    guard_factor: float | None
    guard_width: float | None
    rule_probability: float | None
    guard_band: float | None
    outcome: Outcome
    withheld: NoDecision | None = None
    monte_carlo: MonteCarloError | None = None
    low: float | None = None
    high: float | None = None
    interval: IntervalShape = "symmetric"
    coverage_factor: float | None = None
    symbol: str = ""
    label: str = ""
    omitted_ratio: float = 1
    consumer_risk: float | None
    producer_risk: float | None
    global_consumer_risk: Probability | None
    global_producer_risk: Probability | None

    @property
    def accepts_nothing(self) -> bool:
        """Whether the guard band leaves no acceptance zone: between the limits, or above zero of a length."""
        lowest = 0.0 if self.interval == "shortest" else -math.inf
        if self.guard_band is None or self.upper is None:
            return False
        return (lowest if self.lower is None else self.lower + self.guard_band) > self.upper - self.guard_band


class Conformity(Record):
    """The unit against its specification.

    Attributes
    ----------
    sha256 : of the specification file.
    outcome : the worst of all limits, and no better than withheld if there is an obstacle.
    obstacles : why the unit cannot pass, whatever the limits say.
    """

    specification: str
    sha256: str
    outcome: Outcome
    obstacles: tuple[Obstacle, ...]
    limits: tuple[LimitOutcome, ...]


class ModelTried(Record):
    """One model of the history: the effects added, the improvement, and whether it was taken and is selected."""

    id: str
    title: str
    verdict: Verdict | None
    chi2: float | None
    dof: float | None
    rms: tuple[ChannelRms, ...]
    depth: int
    taken: bool
    selected: bool
    reported: bool


class Adequacy(Record):
    """Whether the model describes the data.

    Attributes
    ----------
    verdict : of the diagnosis; None if the result was never diagnosed.
    explanations : how probable each explanation of the data is; None if the result was never diagnosed.
    candidates : effects that were weighed.
    missing : effects that the diagnosis names.
    undetectable : effects that these runs cannot show.
    most_biasing : largest bias of an estimate by one of them; None if that would not matter.
    noise_violations : how the noise departs from its model.
    noise_suspected : how it may depart, although it may be chance.
    diagnoses : how often it was looked: diagnoses in the history of models, the last one included.
    history : models tried.
    runs : goodness of fit by run and channel.
    prior_conflicts : parameters whose prior disagrees with the data.
    set_aside : readings that the model leaves out, each with its reason.
    """

    verdict: Verdict | None
    explanations: Evidence | None
    candidates: int
    missing: tuple[str, ...]
    undetectable: tuple[str, ...]
    intervals_valid: bool
    noise_violations: tuple[NoiseViolation, ...]
    noise_suspected: tuple[NoiseViolation, ...] = ()
    most_biasing: ParameterBias | None = None
    chi2: float | None
    dof: float
    diagnoses: int
    history: tuple[ModelTried, ...]
    runs: tuple[RunSummary, ...]
    prior_conflicts: tuple[PriorConflict, ...]
    set_aside: tuple[SetAside, ...] = ()


class ReportedConvergence(Record):
    """Whether fit and sampling converged; numbers of the sampling are None if there was none.

    Attributes
    ----------
    worst_r_hat, least_bulk, least_tail : over all parameters, each with the parameter that has it.
    pareto_k : tail index of the importance weights of the proposal.
    draws : number of posterior draws.
    """

    converged: bool
    message: str
    sampled: bool
    draws: int | None
    acceptance: float | None
    pareto_k: float | None
    worst_r_hat: float | None
    worst_r_hat_of: str
    least_bulk: float | None
    least_bulk_of: str
    least_tail: float | None
    least_tail_of: str


class OmittedChannel(Record):
    """Values of a channel that a run recorded but that are missing or were excluded."""

    run: str
    channel: str
    values: int


class Omissions(Record):
    """What was left out: missing values, notes of the reduction, outliers, and parameters that are not reported."""

    channels: tuple[OmittedChannel, ...]
    notes: tuple[str, ...]
    outliers: int
    nuisance_parameters: int


class CoveredRange(Record):
    """Range of a covariate over all runs."""

    name: str
    phrase: str
    unit: str
    lowest: float
    highest: float


class StatisticalScope(Record):
    """The basis of the statistics, and the questions that they do not cover.

    Attributes
    ----------
    ranges : of the covariates; nothing is said beyond them.
    first_start, last_start : of the runs.
    not_supplied : effect and the inputs that no run supplied for it.
    weak_directions : combinations of parameters that the data did not determine.
    from_priors : quantities of the result table for which less than a tenth of the information came from the data.
    """

    ranges: tuple[CoveredRange, ...]
    first_start: str | None
    last_start: str | None
    not_supplied: tuple[tuple[str, str], ...]
    weak_directions: tuple[WeakDirection, ...]
    from_priors: tuple[str, ...]


class ReportSection(Record):
    """A section that the author of a report adds: text, and a table if it has rows.

    Attributes
    ----------
    head, rows : of the table; its first column names the row.

    Examples
    --------
    >>> import imubayes
    >>> def traceability(report):
    ...     return imubayes.ReportSection(title="Traceability", head=("table", "certificate"), rows=(("rate", "K-17"),))
    >>> imubayes.report("results/accel-channel", sections=[traceability]).supplied[0].title
    'Traceability'
    """

    title: str
    paragraphs: tuple[str, ...] = ()
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()


class QualificationReport(Record):
    """The uncertainty report of one unit (format 1).

    Attributes
    ----------
    interval : coverage of all intervals; each states its kind: symmetric, equal-tailed or shortest.
    conformity : None if no specification was given.
    exact : errors of site and equipment that the model takes as exact; those marked as included are in every U.
    budgets : None if the fit did not converge.
    measurement : the equations of the model.
    pictures : the numbers that the pictures show.
    certificate : statements of the laboratory; None if it states nothing.
    missing : requirements of ISO/IEC 17025 that are not met, and statements that contradict the campaign.
    floors, unused_capabilities : quantities whose U is the capability of the laboratory; those that the result lacks.
    supplied : sections that the author of the report added; the package computed none of them.
    """

    format: Literal[1] = 1
    interval: IntervalKind = "95 % coverage interval, of the kind stated with each"
    subject: Subject
    provenance: Provenance
    convergence: ReportedConvergence
    adequacy: Adequacy
    conformity: Conformity | None
    results: tuple[ResultLine, ...]
    mounting_angles: tuple[MountingAngle, ...]
    combinations: tuple[ReportedCombination, ...] = ()
    standards: tuple[StandardEstimate, ...]
    not_estimated: tuple[NotEstimated, ...]
    thermal_linearity: tuple[ThermalLinearity, ...]
    exact: TakenAsExact = TakenAsExact()
    budgets: UncertaintyBudgets | None = None
    left_out: Omissions
    scope: StatisticalScope
    measurement: MeasurementModel = MeasurementModel()
    pictures: PictureData
    certificate: Certificate | None = None
    missing: tuple[Missing, ...] = ()
    floors: tuple[CapabilityFloor, ...] = ()
    unused_capabilities: tuple[str, ...] = ()
    supplied: tuple[ReportSection, ...] = ()

    @property
    def estimates(self) -> tuple[ReportedEstimate, ...]:
        """Everything that the tables state."""
        return *self.results, *self.mounting_angles, *self.standards, *self.combinations, *self.thermal_linearity

    def __getitem__(self, name: str) -> ReportedEstimate:
        """Return the statement of a quantity by its name; raises `KeyError` if the report does not have it."""
        known = {each.name: each for each in self.estimates}
        if name not in known:
            raise KeyError(f"the report has no quantity '{name}': {closest_first(name, known, most=5)}")
        return known[name]

    @property
    def accepted(self) -> bool:
        """Whether the unit passed, or was not held against a specification; never if the fit did not converge."""
        passed = "pass", "conditional_pass"
        return self.conformity.outcome in passed if self.conformity is not None else self.convergence.converged

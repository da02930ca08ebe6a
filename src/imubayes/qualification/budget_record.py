"""The uncertainty budgets of a report as records: contributions in the form of the GUM, and what would narrow them."""

from typing import Literal

from imubayes.inference.candidate_runs import RunDesign
from imubayes.json_record import Record

InputKind = Literal["run", "prior", "priors", "noise_scales", "second_order", "small"]
Source = Literal["fixture", "table", "site", "reference", "unit"]


class BudgetLine(Record):
    """One contribution to the posterior variance of a quantity.

    Attributes
    ----------
    kind : the noise of a run; a prior; priors of one effect taken together; the noise scales, which are not known
        exactly; the second-order part; all contributions too small for a line of their own.
    input : run, parameter or effect; empty where `kind` says all.
    type : A from the data, B from a prior; None for the second-order part and for small contributions of both types.
    source : what a prior is about.
    group : procedure of a run.
    inputs : number of inputs in the line.
    distribution : of the input.
    unit, input_uncertainty : unit of the input and its standard uncertainty; None for a run, whose contribution is
        evaluated from all its rows, and for several inputs.
    sensitivity : ∂quantity/∂input, in the unit of the quantity over that of the input.
    contribution : standard uncertainty that the input contributes, in the unit of the quantity.
    share : of the posterior variance.
    degrees_of_freedom : None where they are infinite.
    """

    kind: InputKind
    input: str
    type: Literal["A", "B"] | None
    source: Source | None = None
    group: str | None = None
    inputs: int = 1
    distribution: str | None = None
    unit: str | None = None
    input_uncertainty: float | None = None
    sensitivity: float | None = None
    contribution: float
    share: float
    degrees_of_freedom: float | None = None


class HalvedInput(Record):
    """Standard uncertainty of a quantity if one contribution were halved: noise of a run, or width of priors."""

    kind: Literal["run", "prior", "priors"]
    input: str
    source: Source | None
    standard_uncertainty: float


class NarrowingRun(Record):
    """A further run, and the standard uncertainty that it would leave by linear prediction at the mode.

    Attributes
    ----------
    run : as designed; None where it repeats a run of the campaign.
    repeats : that run.
    """

    run: RunDesign | None = None
    repeats: str | None = None
    standard_uncertainty: float


class QuantityBudget(Record):
    """Uncertainty budget of a quantity.

    Attributes
    ----------
    standard_uncertainty, monte_carlo_error : root of the posterior variance, and its Monte Carlo standard error.
    lines : contributions, the largest first.
    contributed : root of the sum of all contributions.
    scaled : factor on the contributions of the linear approximation where draws are wider or narrower than it; else 1.
    remainder : share of the posterior variance beyond them: higher orders and Monte Carlo error.
    components : whether inputs contribute through the components of a vector, as to an angle near zero.
    degrees_of_freedom : effective, by Welch–Satterthwaite; None where they are infinite.
    coverage_factor, expanded_uncertainty : U, half the length of the 95 % coverage interval, and k = U/u.
    halved : what u would be if one contribution were halved, the most useful first.
    next_run : the run that would narrow the quantity most; None where none narrows it by a hundredth.
    """

    name: str
    unit: str
    standard_uncertainty: float
    monte_carlo_error: float
    lines: tuple[BudgetLine, ...]
    contributed: float
    scaled: float
    remainder: float
    components: bool
    degrees_of_freedom: float | None
    coverage_factor: float
    expanded_uncertainty: float
    halved: tuple[HalvedInput, ...]
    next_run: NarrowingRun | None


class CorrelationMatrix(Record):
    """Correlations of posterior draws: row i holds those of quantity i with quantities 0 … i."""

    names: tuple[str, ...]
    rows: tuple[tuple[float, ...], ...]


class UncertaintyBudgets(Record):
    """Budgets of all quantities, and their correlations."""

    quantities: tuple[QuantityBudget, ...]
    correlation: CorrelationMatrix

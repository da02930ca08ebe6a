"""The parts of an uncertainty budget: records, linear algebra of contributions, and posterior variances.

Budgets are records with contributions in the form of the GUM, and what would narrow them.

At the mode the estimate of θ is linear in its inputs: the whitened data, each of unit variance, and the prior means,
each with its prior variance s².  With W the whitened Jacobian, C = (WᵀW + diag s⁻²)⁻¹ and g the gradient of a quantity
q, its estimate has the sensitivities

    ∂q/∂datum = W C g,    ∂q/∂(prior mean) = s⁻² ∘ C g,

so its variance is Σ (W C g)² + Σ (C g)²/s² = gᵀ C (WᵀW + diag s⁻²) C g = gᵀ C g: contributions of type A and type B add
up to the posterior variance exactly.  A prior that becomes exact, or noise that is halved, changes the weights of all
other inputs too; what is then left follows from updates of C.

The posterior variance itself is found by control variates (`imubayes.results.posterior_variance`).
The slope of q on u, 1 if q is linear, holds what odd orders add to the linear part (statistical linearisation).
The remainder is regressed on the second-order part likewise: that of a function of quantities is taken from its
members, and the length of a vector, say, bends otherwise than they do.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imubayes.foundations.numerics import inverse_of_precision
from imubayes.foundations.records import Record
from imubayes.inference.candidate_runs import RunDesign
from imubayes.results.linear_part import LinearPart
from imubayes.results.posterior_variance import KnownVariance, variance_of
from imubayes_qualification.budgets.better_priors import QuantityDerivatives, second_order
from imubayes_qualification.evaluation.coverage import IntervalShape


@dataclass(frozen=True)
class LinearContributions:
    """Variance contributions to Q quantities.

    Attributes
    ----------
    type_a : shape (Q, G), of the data, by group.
    type_b : shape (Q, P), of each prior.
    sensitivity : shape (Q, P), ∂q/∂(prior mean).
    """

    type_a: np.ndarray
    type_b: np.ndarray
    sensitivity: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """Sum of all contributions, shape (Q,)."""
        return self.type_a.sum(axis=1) + self.type_b.sum(axis=1)


def posterior_covariance(whitened: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Return C, shape (P, P), from the whitened Jacobian (E, P) and the prior standard deviations (P,)."""
    return inverse_of_precision(whitened.T @ whitened + np.diag(widths**-2.0))


def linear_contributions(
    along: np.ndarray, whitened: np.ndarray, member: np.ndarray, widths: np.ndarray
) -> LinearContributions:
    """Return the contributions of data and priors.

    Parameters
    ----------
    along : shape (Q, P), gradients of the quantities times C.
    whitened : shape (E, P), Jacobian of the whitened data; 0 for data that are left out.
    member : shape (G, E), bool, whether a datum is of a group.
    widths : shape (P,), prior standard deviations.
    """
    return LinearContributions(type_a_contributions(along, whitened, member), (along / widths) ** 2, along / widths**2)


def type_a_contributions(along: np.ndarray, whitened: np.ndarray, member: np.ndarray) -> np.ndarray:
    """Return the contributions of the data, (Q, G); parameters as of `linear_contributions`."""
    return (member.astype(float) @ (whitened @ along.T) ** 2).T


def deviation_with_halved_groups(
    gradients: np.ndarray, whitened: np.ndarray, widths: np.ndarray, groups: Sequence[np.ndarray]
) -> np.ndarray:
    """Return the standard deviation of each quantity if the priors of one group, (P,) bool, were halved; (Q, N)."""
    precision = whitened.T @ whitened + np.diag(widths**-2.0)
    found = np.zeros((len(gradients), len(groups)))
    for place, chosen in enumerate(groups):
        covariance = inverse_of_precision(precision + np.diag(np.where(chosen, 3 / widths**2, 0.0)))
        found[:, place] = np.sqrt(np.sum((gradients @ covariance) * gradients, axis=1))
    return found


def deviation_with_more_of_a_run(
    gradients: np.ndarray, whitened: np.ndarray, member: np.ndarray, widths: np.ndarray, times: float
) -> np.ndarray:
    """Return the standard deviation of each quantity if the data of one group counted so many times more, (Q, G).

    Once more is the run repeated, three times more is its noise halved.
    """
    precision = whitened.T @ whitened + np.diag(widths**-2.0)
    found = np.zeros((len(gradients), len(member)))
    for place, chosen in enumerate(member):
        covariance = inverse_of_precision(precision + times * whitened[chosen].T @ whitened[chosen])
        found[:, place] = np.sqrt(np.sum((gradients @ covariance) * gradients, axis=1))
    return found


def degrees_of_freedom(variances: np.ndarray) -> np.ndarray:
    """Return the degrees of freedom of variances from posterior draws of them, (H, …) → (…,); infinite if known.

    With ν degrees of freedom the posterior of 1/u² is proportional to χ²(ν), so that ν = 2 E[1/u²]²/Var[1/u²], which is
    GUM E.4.3 for the estimate of a variance.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        precision = 1 / variances
        spread = precision.var(axis=0)
        return np.where(np.isfinite(spread) & (spread > 0), 2 * precision.mean(axis=0) ** 2 / spread, np.inf)


InputKind = Literal["run", "prior", "priors", "exact", "noise_scales", "second_order", "small", "cmc"]
Source = Literal["fixture", "table", "site", "reference", "unit"]


class BudgetLine(Record):
    """One contribution to the posterior variance of a quantity.

    Attributes
    ----------
    kind : the noise of a run; a prior; priors of one effect taken together; a parameter that the model takes as
        ``exact`` and the report does not; the noise scales, which are not known exactly; the second-order part; all
        contributions too small for a line of their own; what the capability of the laboratory (CMC) is larger by.
    input : run, parameter or effect; empty if `kind` says all.
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
    relative_uncertainty : relative standard uncertainty of a contribution of type A, as the scatter of its runs is
        known from few rows (GUM E.4.3: 1/√(2ν)); None for what is known exactly.  u of the quantity contains it.
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
    relative_uncertainty: float | None = None


class HalvedInput(Record):
    """Standard uncertainty of a quantity if one contribution were halved: noise of a run, or width of priors."""

    kind: Literal["run", "prior", "priors", "exact"]
    input: str
    source: Source | None
    standard_uncertainty: float


class NarrowingRun(Record):
    """A further run, and the standard uncertainty that it would leave by linear prediction at the mode.

    Attributes
    ----------
    run : as designed; None if it repeats a run of the campaign.
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
    scaled : factor on the contributions of the linear approximation if draws are wider or narrower than it; else 1.
    remainder : share of the posterior variance beyond them: higher orders and Monte Carlo error.
    components : whether inputs contribute through the components of a vector, as to an angle near zero.
    interval : kind of the 95 % coverage interval.
    coverage_factor, expanded_uncertainty : U, half the length of that interval, and k = U/u.
    halved : u if one contribution were halved, the most useful first.
    next_run : the run that would narrow the quantity most; None if none narrows it by a hundredth.
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
    interval: IntervalShape
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


@dataclass(frozen=True)
class PosteriorDraws:
    """Posterior draws.

    Attributes
    ----------
    z, h : shapes (S, P) and (S, H), parameters and noise scales, in z.
    values : quantity → shape (S,), in its unit; NaN where it was not computed.
    effective : quantity → effective number of its draws.
    """

    z: np.ndarray
    h: np.ndarray
    values: Mapping[str, np.ndarray]
    effective: Mapping[str, float]


@dataclass(frozen=True)
class PosteriorVariances:
    """Variances of Q quantities.

    Attributes
    ----------
    posterior, error : shapes (Q,), posterior variance, and its Monte Carlo standard error.
    slope : shape (Q,), of the quantity on its linear part.
    widened : shape (Q,), standard deviation of the sampled linear part over that of the approximation if the two
        contradict each other but are alike; else 1.
    second_order : shape (Q,), variance of what the second-order part explains of the rest.
    """

    posterior: np.ndarray
    error: np.ndarray
    slope: np.ndarray
    widened: np.ndarray
    second_order: np.ndarray

    @property
    def scale(self) -> np.ndarray:
        """Factors (Q,) on the variances of the linear part of the approximation."""
        return (self.slope * self.widened) ** 2


def posterior_variances(
    part: LinearPart,
    derivatives: QuantityDerivatives,
    known: np.ndarray,
    known_error: np.ndarray,
    draws: PosteriorDraws,
) -> PosteriorVariances:
    """Return the posterior variances of the quantities of `draws`, in their order.

    Parameters
    ----------
    part : of the posterior of θ.
    derivatives : of the quantities.
    known, known_error : shapes (Q,), variance of the linear part, and its error.
    draws : of the posterior.
    """
    delta, w = part.unbent(draws.z)
    linear = delta @ derivatives.gradient.T
    found = []
    for place, (name, values) in enumerate(draws.values.items()):
        of_linear = KnownVariance(float(known[place]), float(known_error[place]))
        made = variance_of(values, linear[:, place], of_linear, draws.effective[name])
        bend = 0.0
        if made.follows:
            rest = values - made.slope * linear[:, place]
            bend = _explained(rest, second_order(part, derivatives, place, w))
        found.append((made.value, made.error, made.slope, made.widened, bend))
    return PosteriorVariances(*np.array(found).reshape(-1, 5).T)


def _explained(rest: np.ndarray, part: np.ndarray) -> float:
    """Return the variance of draws (S,) that their regression on a part of them, (S,), explains."""
    finite = np.isfinite(rest)
    about, along = (each[finite] - each[finite].mean() for each in (rest, part))
    square = float(along @ along)
    return float(about @ along) ** 2 / square / max(len(along), 1) if square > 0 else 0.0

"""Linear algebra of an uncertainty budget from a joint posterior.

At the mode the estimate of θ is linear in its inputs: the whitened data, each of unit variance, and the prior means,
each with its prior variance s².  With W the whitened Jacobian, C = (WᵀW + diag s⁻²)⁻¹ and g the gradient of a quantity
q, its estimate has the sensitivities

    ∂q/∂datum = W C g,    ∂q/∂(prior mean) = s⁻² ∘ C g,

so its variance is Σ (W C g)² + Σ (C g)²/s² = gᵀ C (WᵀW + diag s⁻²) C g = gᵀ C g: contributions of type A and type B add
up to the posterior variance exactly.  A prior that becomes exact, or noise that is halved, changes the weights of all
other inputs too; what is then left follows from updates of C.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.inference.posterior_precision import inverse_of_precision


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
    """Return the degrees of freedom of variances from posterior draws of them, (H, …) → (…,); infinite where known.

    With ν degrees of freedom the posterior of 1/u² is proportional to χ²(ν), so that ν = 2 E[1/u²]²/Var[1/u²], which is
    GUM E.4.3 for the estimate of a variance.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        precision = 1 / variances
        spread = precision.var(axis=0)
        return np.where(np.isfinite(spread) & (spread > 0), 2 * precision.mean(axis=0) ** 2 / spread, np.inf)


def effective_degrees(contributions: np.ndarray, degrees: np.ndarray) -> float:
    """Return ν of a sum of variances by Welch–Satterthwaite (GUM G.4.1); infinite where all are."""
    sum_of_squares = float(np.sum(contributions**2 / degrees))
    return float(np.sum(contributions) ** 2 / sum_of_squares) if sum_of_squares > 0 else float("inf")

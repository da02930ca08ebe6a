"""Variance that better priors would leave, and the second-order part of a quantity.

The linear part of a quantity is that of `imubayes.results.linear_part`, whose symbols are used here.  The
second-order part is ½ wᵀBw, B from the bend and from the curvature of the quantity itself.

A better prior shows what would be left of a variance, noise scales unknown.  It is one more reading x of its parameter
θ_j, of variance r: r = 0 makes the prior exact, r = s²/3 halves its width s.  Given h everything is normal, and with C
= Cov(θ|h), c = Cov(q, θ_j|h), m = E[θ|h]

    Var(q|h, x) = Var(q|h) − c²/(C_jj + r),    E[q|h, x] = E[q|h] + c (x − m_j)/(C_jj + r).

The reading bears on the noise scales, too: p(h|x) ∝ p(h) N(x; m_j, C_jj + r).  It bounds a scatter between few runs,
which is known from its prior more than from them, and that can matter more than what it says of θ_j.  If x falls is
not known beforehand; it is taken at the mode.  The variance is the mean of the conditional variance plus the variance
of the conditional mean, both over p(h|x), by importance weights on draws of h.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from imubayes import Fit
from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float
from imubayes.foundations.numerics import inverse_of_precision
from imubayes.model.derived_quantities import derived_jacobian, evaluate_derived
from imubayes.model.problem import Problem
from imubayes.results.linear_part import LinearMoments, LinearPart


@dataclass(frozen=True)
class LinearGivenScales:
    """Q linear quantities and P parameters at given noise scales; means are from the mode.

    Attributes
    ----------
    along : shape (Q, P), covariance of quantities and parameters.
    variance, mean : shape (Q,), of the quantities.
    own, shift : shape (P,), variance and mean of the parameters.
    """

    along: np.ndarray
    variance: np.ndarray
    mean: np.ndarray
    own: np.ndarray
    shift: np.ndarray


class BetterPriors:
    """Sums over draws of the noise scales, for Q quantities and P priors: shape (Q, P)."""

    def __init__(self, shape: tuple[int, int]):
        self._weight, self._scale = np.zeros(shape[1]), None
        self._variance, self._mean, self._square = np.zeros((3, *shape))

    def add(self, at: LinearGivenScales, reading: np.ndarray) -> None:
        """Add a draw; `reading` is r, (P,)."""
        total = at.own + reading
        if self._scale is None:
            self._scale = total
        weight = np.sqrt(self._scale / total) * np.exp(-0.5 * at.shift**2 / total)
        gain = at.along / total
        mean = at.mean[:, None] - gain * at.shift
        self._weight += weight
        self._variance += weight * (at.variance[:, None] - gain * at.along)
        self._mean += weight * mean
        self._square += weight * mean**2

    @property
    def variance(self) -> np.ndarray:
        """Variance of each quantity with each prior better, (Q, P)."""
        mean = self._mean / self._weight
        return np.maximum(self._variance / self._weight + self._square / self._weight - mean**2, 0.0)


@dataclass(frozen=True)
class QuantityDerivatives:
    """Derivatives of Q quantities at the mode, in their units, by the parameters in z.

    Attributes
    ----------
    gradient : shape (Q, P).
    curvature : shape (Q, K, K), second derivatives along the weak directions.
    """

    gradient: np.ndarray
    curvature: np.ndarray


@dataclass(frozen=True)
class ConditionalMoments(LinearMoments):
    """Moments of Q linear quantities given each of n draws of the noise scales, with what priors contribute.

    Attributes
    ----------
    type_b : shape (Q, P), contribution of each prior, averaged over the draws.
    sensitivity : shape (Q, P), ∂q/∂(prior mean), averaged likewise.
    exact_prior, halved_prior : shape (Q, P), variance with one prior exact, or half as wide.
    """

    type_b: np.ndarray
    sensitivity: np.ndarray
    exact_prior: np.ndarray
    halved_prior: np.ndarray


def conditional_moments(part: LinearPart, problem: Problem, gradients: np.ndarray, h: np.ndarray) -> ConditionalMoments:
    """Return the moments of linear quantities with gradients (Q, P) given noise scales h, (n, H)."""
    variances, means, sums = [], [], np.zeros((2, *gradients.shape))
    exact, halved = BetterPriors(gradients.shape), BetterPriors(gradients.shape)
    for given in part.in_blocks(problem, h):
        for precision, slope, widths in zip(given.precision, given.slope, given.widths, strict=True):
            covariance = inverse_of_precision(precision)
            along, shift = gradients @ covariance, covariance @ slope
            variance, mean = np.sum(along * gradients, axis=1), gradients @ shift
            scaled, at = along / widths, LinearGivenScales(along, variance, mean, np.diagonal(covariance), shift)
            sums[0] += scaled**2
            sums[1] += scaled / widths
            exact.add(at, np.zeros_like(widths))
            halved.add(at, widths**2 / 3)
            variances.append(variance)
            means.append(mean)
    type_b, sensitivity = sums / len(h)
    return ConditionalMoments(
        np.array(variances), np.array(means), type_b, sensitivity, exact.variance, halved.variance
    )


def second_order(part: LinearPart, derivatives: QuantityDerivatives, place: int, w: np.ndarray) -> np.ndarray:
    """Return the second-order part ½ wᵀBw of one of the quantities at weak coordinates w, (S, K); shape (S,)."""
    total = part.bend @ derivatives.gradient[place] + derivatives.curvature[place]
    return 0.5 * np.einsum("si,ij,sj->s", w, total, w, optimize=True)


def derivatives_of(fit: Fit, part: LinearPart, names: Sequence[str]) -> QuantityDerivatives:
    """Return the derivatives of parameters and derived quantities of a fit by name."""
    layout, problem = fit.model.layout, fit.model.problem
    weak = part.weak
    slopes, bends = (np.asarray(each) / layout.factors() for each in _prior_derivatives(problem, np.asarray(fit.z)))
    known = {name: (np.eye(len(layout))[place] * slopes[place]) for place, name in enumerate(layout.names)}
    own = {name: bends[place] * np.outer(weak[place], weak[place]) for place, name in enumerate(layout.names)}
    wanted = [quantity.name for quantity in fit.derived.names if quantity.name in names]
    if wanted:
        gradient = derived_jacobian(fit.derived.derivation, problem, fit.z)
        covariance = weak.T @ part.conditional_covariance(problem, fit.h) @ weak
        curvature = _derived_curvature(fit, weak, np.sqrt(np.diagonal(covariance)))
        for place, quantity in enumerate(fit.derived.names):
            known[quantity.name], own[quantity.name] = gradient[place], curvature[place]
    shape = (0, len(layout)), (0, weak.shape[1], weak.shape[1])
    if not names:
        return QuantityDerivatives(np.zeros(shape[0]), np.zeros(shape[1]))
    return QuantityDerivatives(np.stack([known[name] for name in names]), np.stack([own[name] for name in names]))


@kept
def _prior_derivatives(problem: Problem, z: Float[Array, " P"]):
    """Return first and second derivative of every parameter, in SI, by its own z."""
    return jax.jvp(problem.priors.slopes, (z,), (jnp.ones_like(z),))


def _derived_curvature(fit: Fit, weak: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return second derivatives of the derived quantities along pairs of weak directions, (D, K, K).

    By central differences over one posterior standard deviation of each direction, `reach` (K,).
    """
    count = weak.shape[1]
    rows, columns = np.triu_indices(count)
    steps = weak.T * reach[:, None]
    pairs = steps[rows] + steps[columns]
    points = np.concatenate([fit.z + pairs, fit.z - pairs, fit.z[None]])
    values = evaluate_derived(fit.derived.derivation, fit.model.problem, points)
    whole = values[: len(pairs)] + values[len(pairs) : -1] - 2 * values[-1]
    own = whole[rows == columns] / 4
    mixed = 0.5 * (whole - own[rows] - own[columns]) / (reach[rows] * reach[columns])[:, None]
    found = np.zeros((values.shape[1], count, count))
    found[:, rows, columns] = found[:, columns, rows] = mixed.T
    return found

"""The linear part of a posterior, whose variance has no Monte Carlo error.

The nested Laplace approximation (`imubayes.inference.nested_laplace`) writes θ = θ̂ + δ + ½ Σ_ij w_i w_j A_ij.  Given
the noise scales h, δ is normal but for the marginals that are tabulated, and the bend follows from its weak coordinates
w.  The bend does not change w, so every posterior draw gives back its δ by subtraction.  A quantity q has the linear
part u = gᵀδ with the variance E_h[gᵀC(h)g] + Var_h[gᵀm(h)], if g is stretched along tabulated directions to their
widths, C(h) is the covariance and m(h) the mean of θ given h.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imubayes.foundations.arrays import cholesky, inverse_lower, on_host
from imubayes.foundations.numerics import inverse_of_precision
from imubayes.inference.conditional_precision import Conditional, conditional, conditional_precision
from imubayes.inference.fitted_model import Fit
from imubayes.inference.nested_laplace import weak_directions
from imubayes.inference.parameter_fit import Linearised
from imubayes.inference.posterior_mode import Mode
from imubayes.inference.scale_density import Curvature
from imubayes.inference.tabulated_directions import TabulatedDirections
from imubayes.model.problem import Problem, prior_widths

# Draws of the noise scales whose precisions are taken at once, and draws bent back at once.
_AT_ONCE, _BENT_AT_ONCE = 40, 500
CONDITIONING_WORK = 2e9
"""Multiplications spent on averaging variances over draws of the noise scales.

Origin: a quarter of a second on one core.  Variances scatter over draws by 30 % if a scale is known, which the 600
draws of a large model average to 1.2 %, 0.6 % of the standard uncertainty; if a scatter between runs is known from
its prior alone they scatter by several times themselves, so a small model takes all draws.
"""
_LEAST_DRAWS = 40


@dataclass(frozen=True)
class Conditionals:
    """The distribution of θ given each of n draws of the noise scales, linear about the mode.

    Attributes
    ----------
    precision : shape (n, P, P).
    slope : shape (n, P), gradient of the log density at the mode.
    widths : shape (n, P), of the priors.
    """

    precision: np.ndarray
    slope: np.ndarray
    widths: np.ndarray


@dataclass(frozen=True)
class LinearPart:
    """What bends and spreads θ about its mode.

    Attributes
    ----------
    z : shape (P,), the mode.
    weak : shape (P, K), orthonormal weak directions.
    bend : shape (K, K, P), acceleration along pairs of them.
    blocks : precision of θ given the noise scales.
    shape : marginals of weak directions that are not normal; None if all are.
    """

    z: np.ndarray
    weak: np.ndarray
    bend: np.ndarray
    blocks: Conditional
    shape: TabulatedDirections | None

    def conditionals(self, problem: Problem, h: np.ndarray) -> Conditionals:
        """Return the distributions of θ given noise scales h, (n, H)."""
        return Conditionals(*conditional(self.blocks, problem, h), prior_widths(problem, h))

    def in_blocks(self, problem: Problem, h: np.ndarray) -> Iterator[Conditionals]:
        """Yield the distributions of θ given noise scales h, (n, H), some at once."""
        for start in range(0, len(h), _AT_ONCE):
            yield self.conditionals(problem, h[start : start + _AT_ONCE])

    def conditional_covariance(self, problem: Problem, h: np.ndarray) -> np.ndarray:
        """Return the covariance of θ given noise scales h, (H,); shape (P, P)."""
        return inverse_of_precision(self.conditionals(problem, h[None]).precision[0])

    def stretched(self, problem: Problem, h: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Return gradients (Q, P) by normal steps about the mode, from those by δ: as δ has the widths of its tables.

        The map is that at the noise scales of the mode, h (H,): it hardly depends on them.
        """
        if self.shape is None:
            return gradients
        precision = self.conditionals(problem, h[None]).precision[0]
        return gradients @ self.shape.stretch(np.linalg.cholesky(precision))

    def unbent(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return δ, (S, P), and its weak coordinates w, (S, K), of points z, (S, P)."""
        bent = z - self.z
        w = bent @ self.weak
        flat = self.bend.reshape(-1, self.bend.shape[-1])
        parts = []
        for start in range(0, len(z), _BENT_AT_ONCE):
            chosen = w[start : start + _BENT_AT_ONCE]
            products = (chosen[:, :, None] * chosen[:, None, :]).reshape(len(chosen), len(flat))
            parts.append(bent[start : start + _BENT_AT_ONCE] - 0.5 * products @ flat)
        return np.concatenate(parts), w


def linear_part(fit: Fit, about: Linearised) -> LinearPart:
    """Return the linear part of the posterior of a fit, linearised about its mode.

    That of its approximation if the fit was made in this process; of a fit read from a result folder it is made
    again, which costs two predictions for each pair of weak directions.
    """
    if fit.posterior is not None:
        known = fit.posterior.approximation
        weak, bend = np.asarray(known.weak), np.asarray(known.bend)
        return LinearPart(np.asarray(known.z), weak, bend, known.blocks, known.shape)
    problem, size = fit.model.problem, len(fit.h)
    unasked = Curvature(0.0, np.zeros(size), np.eye(size))
    mode = Mode(np.asarray(about.z), np.asarray(fit.h), 0.0, on_host(about), unasked, 0, True, True)
    weak, bend, shape = weak_directions(problem, mode)
    return LinearPart(
        np.asarray(fit.z), np.asarray(weak), np.asarray(bend), conditional_precision(problem, mode), shape
    )


def thinned_scales(h: np.ndarray, parameters: int) -> np.ndarray:
    """Return the draws of the noise scales, out of h (S, H), over which variances of quantities are averaged.

    A budget averages over the same ones, so that its contributions and the uncertainty have no difference by chance.
    Which they are does not depend on the order of the draws, which is another one in a result folder.  They are evenly
    spaced in the order of their first scale.
    """
    per_draw = 3.5 * parameters**3  # a model has about 1.6 quantities for each parameter
    if h.shape[1]:
        h = h[np.argsort(h[:, 0], kind="stable")]
    return evenly(h, max(_LEAST_DRAWS, int(CONDITIONING_WORK / max(per_draw, 1.0))))


def evenly(draws: np.ndarray, most: int) -> np.ndarray:
    """Return at most so many draws, evenly spaced; a single one of what has no columns."""
    count = min(most, len(draws)) if draws.shape[1] else 1
    return draws[np.linspace(0, len(draws) - 1, count).astype(int)]


@dataclass(frozen=True)
class LinearMoments:
    """Moments of Q linear quantities given each of n draws of the noise scales.

    Attributes
    ----------
    variance, mean : shape (n, Q); the mean from the mode.
    """

    variance: np.ndarray
    mean: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """Variance over all noise scales, shape (Q,): of the mean, and the mean of the variance."""
        return self.variance.mean(axis=0) + self.mean.var(axis=0)

    @property
    def spread(self) -> np.ndarray:
        """Standard error of the average of the variances over the draws, shape (Q,)."""
        return self.variance.std(axis=0) / np.sqrt(len(self.variance))


def linear_moments(part: LinearPart, problem: Problem, gradients: np.ndarray, h: np.ndarray) -> LinearMoments:
    """Return the moments of linear quantities with gradients (Q, P), stretched, given noise scales h, (n, H)."""
    variances, means = [], []
    for given in part.in_blocks(problem, h):
        # An inverse and a product of matrices take half the time of solving for each quantity.
        half = inverse_lower(cholesky(given.precision))
        of_quantities = half @ gradients.T
        of_mean = half @ given.slope[..., None]
        variances.append(np.einsum("npq,npq->nq", of_quantities, of_quantities))
        means.append(np.einsum("npo,npq->nq", of_mean, of_quantities))
    return LinearMoments(np.concatenate(variances), np.concatenate(means))

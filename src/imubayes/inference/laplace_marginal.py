"""The Laplace marginal of the noise scales h, with θ integrated out of the linearised model, and its maximum.

About a point the model is linear, y − f ≈ e − J δ, and the data speak of θ through precision, gradient and quadratic
form, each a function of the hyperparameters.  With Σ(h) = D + Σ_g T_g 1 1ᵀ every product with Σ⁻¹ is a weighted sum
less one rank-one term per run and channel, so the precision JᵀΣ⁻¹J costs one matrix product at any h.  If rows are
correlated J and e pass the filter of their series first.

The linearisation is a compiled program.  All that follows is NumPy: the marginal and its gradient come from statistics
of the linearisation (`imubayes.inference.scale_statistics`).  Only if rows are correlated or have heavy tails is the
gradient taken automatically, by a compiled program.

The mode of h is found by quasi-Newton steps: the Hessian is computed once, by differences of the gradient, then updated
from the steps.  When the steps have become short it is computed anew, and convergence is judged by that Hessian alone.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import numpy as np

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float, Scalar, cho_solve, cholesky, namespace, on_host
from imubayes.foundations.numerics import inverse_of_precision
from imubayes.inference.parameter_fit import Linearised
from imubayes.inference.scale_density import Curvature
from imubayes.inference.scale_statistics import ScaleStatistics, row_classes, scale_statistics
from imubayes.model.likelihood import has_heavy_tails, log_normaliser, pseudo_values, whitened
from imubayes.model.noise_covariance import group_sum, whitener
from imubayes.model.problem import Problem, masked, prior_widths


class Knowledge(eqx.Module):
    """Data part of the log density about z at given h: precision (P, P), gradient (P,), quadratic form eᵀΣ⁻¹e."""

    precision: Float[Array, "P P"]
    gradient: Float[Array, " P"]
    square: Scalar


def knowledge(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Knowledge:
    """Return what the data say about θ at hyperparameters h."""
    by, pseudo, observations = whitener(problem, h), pseudo_values(problem, h, about.misfit), problem.observations
    # (I − κ û ûᵀ)² = I − (2κ − κ²|u|²/|u|²…) û ûᵀ; with shrink = κ/|u|² the rank-one weight is 2·shrink − shrink²·|u|².
    along_rows = by.direction
    weight = along_rows**2
    direction = group_sum(weight, observations)
    rank_one = 2 * by.shrink - by.shrink**2 * direction
    if by.series is not None:
        jacobian, misfit = by.scale(about.jacobian), by.scale(pseudo)
        along = group_sum(along_rows[:, None] * jacobian, observations)
        misfit_along = group_sum(along_rows * misfit, observations)
        precision = jacobian.T @ jacobian - along.T @ (rank_one[:, None] * along)
        gradient = jacobian.T @ misfit - along.T @ (rank_one * misfit_along)
        return Knowledge(precision, gradient, (misfit**2).sum() - (rank_one * misfit_along**2).sum())
    weighted = weight[:, None] * about.jacobian
    along, misfit_along = group_sum(weighted, observations), group_sum(weight * pseudo, observations)
    precision = about.jacobian.T @ weighted - along.T @ (rank_one[:, None] * along)
    gradient = weighted.T @ pseudo - along.T @ (rank_one * misfit_along)
    if has_heavy_tails(problem):
        return Knowledge(precision, gradient, (whitened(problem, h, about.misfit) ** 2).sum())
    square = (weight * pseudo**2).sum() - (rank_one * misfit_along**2).sum()
    return Knowledge(precision, gradient, square)


def precision_of(
    problem: Problem, about: Linearised, h: Float[Array, " H"], chosen: np.ndarray | None = None
) -> np.ndarray:
    """Return what chosen entries, (E,) bool, or all say of θ in z, without the prior; shape (P, P)."""
    some = problem if chosen is None else masked(problem, ~chosen)
    return knowledge(some, on_host(about), np.asarray(h)).precision


def deviations(gradients: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Return the standard deviations, (n,), of quantities with gradients (n, P) under a precision (P, P)."""
    return np.sqrt(np.sum(gradients * np.linalg.solve(precision, gradients.T).T, axis=1))


def log_marginal(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Scalar:
    """Return log p(y, h) with θ integrated out of the linearised model (the Laplace marginal of h)."""
    known, xp = knowledge(problem, about, h), namespace(h, about.misfit, problem.observations.weight)
    prior_precision = prior_widths(problem, h) ** -2
    total = known.precision + xp.diag(prior_precision)
    gradient = known.gradient - prior_precision * about.z
    factor = cholesky(total)
    log_determinant = 2 * xp.log(factor.diagonal()).sum()
    fit = (
        -0.5 * known.square - 0.5 * (prior_precision * about.z**2).sum() + 0.5 * gradient @ cho_solve(factor, gradient)
    )
    size = about.z.shape[0]
    return fit - 0.5 * log_determinant + 0.5 * size * np.log(2 * np.pi) + log_normaliser(problem, h)


def inverse_within(precision: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Return the inverse of a precision (P, P) restricted to the span of an orthonormal basis (P, S); shape (P, P).

    Its small variances are not those of the eigenvalues of the whole covariance, which have the rounding of the largest
    variance: next to directions that the data leave to the prior, 1e-16 of the latter is 1e-2 of a variance of 1e-14.
    """
    return basis @ inverse_of_precision(basis.T @ precision @ basis) @ basis.T


_MOST_STEPS = 60
# A step is short if no component of h changes by this much, in prior standard deviations.
_SHORT = 1e-3
# The same if the Hessian is only learnt: a step that it makes too short is still short of _SHORT.
_SHORT_LEARNT = 1e-5
# Half the distance of the central differences of the gradient: six digits of the curvature.
_APART = 1e-3
# A decrease below this is rounding; shortest fraction of a step that is tried.
_ROUNDING, _SHORTEST = 1e-9, 1e-3
# The rank-one update is skipped if step and secant error are this close to orthogonal: its denominator vanishes.
_TELLING = 1e-8
# Far from the mode a density may overflow; what is not finite is never taken.
_SILENT = np.errstate(all="ignore")


@dataclass(frozen=True)
class MarginalSlope:
    """The Laplace marginal of h at a point: log p(y, h) and its gradient (H,)."""

    value: float
    gradient: np.ndarray


@kept
def _traced_slope(problem: Problem, about: Linearised, h: Float[Array, " H"]):
    """Return the Laplace marginal and its gradient at one h: one program, whatever the number of points."""
    return jax.value_and_grad(log_marginal, argnums=2)(problem, about, h)


class ScaleMarginal:
    """The Laplace marginal of h about a linearisation: from its statistics, or differentiated automatically.

    Attributes
    ----------
    statistics : None if rows are correlated or have heavy tails.
    """

    def __init__(self, problem: Problem, about: Linearised):
        self.problem, self.about = problem, on_host(about)
        at = self.about
        self.statistics: ScaleStatistics | None = scale_statistics(
            problem, row_classes(problem), at.z, at.misfit, at.jacobian
        )

    @_SILENT
    def values(self, points: np.ndarray) -> np.ndarray:
        """Return log p(y, h) at several h, (n, H); shape (n,)."""
        if self.statistics is not None:
            return self.statistics.log_marginals(points)
        if self.problem.timeline is not None:
            # By the program of the gradient, which is at hand: a recursion over rows takes NumPy ten times as long.
            return self.slopes(points)[0]
        return np.array([float(log_marginal(self.problem, self.about, point)) for point in points])

    @_SILENT
    def slopes(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return log p(y, h), (n,), and its gradient, (n, H), at several h, (n, H)."""
        if self.statistics is not None:
            return self.statistics.slopes(points)
        found = [_traced_slope(self.problem, self.about, point) for point in points]
        return np.array([float(value) for value, _ in found]), np.stack([np.asarray(slope) for _, slope in found])

    def slope(self, h: np.ndarray) -> MarginalSlope:
        """Return value and gradient at one h, (H,)."""
        value, gradient = self.slopes(h[None])
        return MarginalSlope(float(value[0]), gradient[0])

    def curvature(self, h: Float[Array, " H"]) -> Curvature:
        """Return value, gradient and negative Hessian, the latter by central differences of the gradient."""
        here, count = self.slope(h), len(h)
        if not count:
            return Curvature(here.value, here.gradient, np.zeros((0, 0)))
        apart = _APART * np.eye(count)
        gradients = self.slopes(h + np.concatenate([apart, -apart]))[1]
        information = (gradients[count:] - gradients[:count]) / (2 * _APART)
        return Curvature(here.value, here.gradient, 0.5 * (information + information.T))


def curvature(problem: Problem, about: Linearised, h: np.ndarray) -> Curvature:
    """Return value, gradient and negative Hessian of the Laplace marginal of h."""
    return ScaleMarginal(problem, about).curvature(np.asarray(h))


def climb(
    problem: Problem,
    about: Linearised,
    h: Float[Array, " H"],
    information: np.ndarray | None = None,
    *,
    judged: bool = True,
) -> tuple[np.ndarray, Curvature]:
    """Return the mode of the Laplace marginal of h, and value, gradient and negative Hessian there.

    Parameters
    ----------
    problem, about : the model, and its linearisation about θ.
    h : shape (H,), the start.
    information : shape (H, H), negative Hessian at the start, or at a point nearby; computed if None.
    judged : whether the end is judged by the Hessian there.  If not, the Hessian is the one learnt from the steps,
        and costs nothing: enough for a value of the marginal, which is flat at its mode, but not for a width.
    """
    return climbed(ScaleMarginal(problem, about), np.asarray(h), information, judged=judged)


def climbed(
    marginal: ScaleMarginal, h: np.ndarray, information: np.ndarray | None = None, *, judged: bool = True
) -> tuple[np.ndarray, Curvature]:
    """Return the mode of a marginal as `climb` does."""
    measured, short = information is None, _SHORT if judged else _SHORT_LEARNT
    at = marginal.curvature(h) if information is None else _with(marginal.slope(h), information)
    for _ in range(_MOST_STEPS):
        step = _newton_step(at)
        ahead, length = None, 1.0
        if not _is_short(step, short):
            ahead, length = _ahead(marginal, h, at, step)
        if ahead is None:
            if measured or (not judged and _is_short(step, short)):
                break
            at, measured = marginal.curvature(h), True
            continue
        taken = length * step
        h, at, measured = h + taken, _with(ahead, _learnt(at, taken, ahead.gradient)), False
    return h, at if measured or not judged else marginal.curvature(h)


def _is_short(step: np.ndarray, short: float) -> bool:
    """Return whether a step is short; one that is not a number counts as short."""
    return not (step.size and float(np.max(np.abs(step))) >= short)


def _with(here: MarginalSlope, information: np.ndarray) -> Curvature:
    return Curvature(here.value, here.gradient, information)


def _newton_step(at: Curvature) -> np.ndarray:
    """Return the ascent step: Newton's, with absolute eigenvalues, at most 1 along each eigenvector."""
    information, gradient = np.asarray(at.information), np.asarray(at.gradient)
    if not (np.all(np.isfinite(information)) and np.all(np.isfinite(gradient))):
        return np.full(len(gradient), np.nan)
    eigenvalues, axes = np.linalg.eigh(information)
    # Far from the mode the marginal may be flat or convex; the prior has curvature 1, which sets the scale.
    step = axes.T @ gradient / np.maximum(np.abs(eigenvalues), 0.1)
    return axes @ np.clip(step, -1.0, 1.0)


def _ahead(
    marginal: ScaleMarginal, h: np.ndarray, at: Curvature, step: np.ndarray
) -> tuple[MarginalSlope | None, float]:
    """Return the marginal after a step, shortened until it does not descend, and its length; None if all do."""
    length = 1.0
    while length > _SHORTEST:
        ahead = marginal.slope(h + length * step)
        if ahead.value >= float(at.value) - _ROUNDING:
            return ahead, length
        length *= 0.3
    return None, length


def _learnt(at: Curvature, taken: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Return the negative Hessian after a step, by the symmetric rank-one update (Conn, Gould & Toint 1991).

    Unlike that of BFGS it may be indefinite, as is the Hessian of the marginal far from its mode.
    """
    lacking = np.asarray(at.gradient) - gradient - np.asarray(at.information) @ taken
    along = float(lacking @ taken)
    if not abs(along) > _TELLING * float(np.linalg.norm(lacking) * np.linalg.norm(taken)):
        return np.asarray(at.information)
    return np.asarray(at.information) + np.outer(lacking, lacking) / along

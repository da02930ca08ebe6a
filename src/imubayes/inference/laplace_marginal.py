"""The Laplace marginal of the noise scales h, with θ integrated out of the linearised model, and its maximum.

About a point the model is linear, y − f ≈ e − J δ, and the data speak of θ through precision, gradient and quadratic
form, each a function of the hyperparameters.  With Σ(h) = D + Σ_g T_g 1 1ᵀ every product with Σ⁻¹ is a weighted sum
less one rank-one term per run and channel, so the precision JᵀΣ⁻¹J costs one matrix product at any h.  Where rows are
correlated J and e pass the filter of their series first.

The mode of h is found by quasi-Newton steps: the Hessian is computed once, by differences of the gradient, then updated
from the steps.  When the steps have become short it is computed anew, and convergence is judged by that Hessian alone.
Automatic second derivatives of the marginal would take longer to compile than all these gradients take to evaluate.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_factor, cho_solve

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float, Scalar
from imubayes.model.likelihood import has_heavy_tails, log_normaliser, pseudo_values, whitened
from imubayes.model.noise_covariance import group_sum, whiten, whitener
from imubayes.model.problem import Problem, predict_with_jacobian, prior_widths


class Linearised(eqx.Module):
    """The model about z: misfit e = y − f(z), shape (E,), and Jacobian ∂f/∂z, shape (E, P)."""

    z: Float[Array, " P"]
    misfit: Float[Array, " E"]
    jacobian: Float[Array, "E P"]


class Knowledge(eqx.Module):
    """Data part of the log density about z at given h: precision (P, P), gradient (P,), quadratic form eᵀΣ⁻¹e."""

    precision: Float[Array, "P P"]
    gradient: Float[Array, " P"]
    square: Scalar


# Compiled once for all who ask; what calls it from a compiled function takes it in.
@kept
def linearise(problem: Problem, z: Float[Array, " P"]) -> Linearised:
    """Return the model linearised about z."""
    predicted, jacobian = predict_with_jacobian(problem, z)
    return Linearised(z, problem.observations.value - predicted, jacobian)


def knowledge(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Knowledge:
    """Return what the data say about θ at hyperparameters h."""
    by, pseudo, observations = whitener(problem, h), pseudo_values(problem, h, about.misfit), problem.observations
    # (I − κ û ûᵀ)² = I − (2κ − κ²|u|²/|u|²…) û ûᵀ; with shrink = κ/|u|² the rank-one weight is 2·shrink − shrink²·|u|².
    weight = by.direction**2
    direction = group_sum(weight, observations)
    rank_one = 2 * by.shrink - by.shrink**2 * direction
    if by.series is not None:
        jacobian, misfit = by.scale(about.jacobian), by.scale(pseudo)
        along = group_sum(by.direction[:, None] * jacobian, observations)
        misfit_along = group_sum(by.direction * misfit, observations)
        precision = jacobian.T @ jacobian - along.T @ (rank_one[:, None] * along)
        gradient = jacobian.T @ misfit - along.T @ (rank_one * misfit_along)
        return Knowledge(precision, gradient, jnp.sum(misfit**2) - jnp.sum(rank_one * misfit_along**2))
    weighted = weight[:, None] * about.jacobian
    along, misfit_along = group_sum(weighted, observations), group_sum(weight * pseudo, observations)
    precision = about.jacobian.T @ weighted - along.T @ (rank_one[:, None] * along)
    gradient = weighted.T @ pseudo - along.T @ (rank_one * misfit_along)
    if has_heavy_tails(problem):
        return Knowledge(precision, gradient, jnp.sum(whitened(problem, h, about.misfit) ** 2))
    square = jnp.sum(weight * pseudo**2) - jnp.sum(rank_one * misfit_along**2)
    return Knowledge(precision, gradient, square)


@kept
def _precision(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Float[Array, "P P"]:
    return knowledge(problem, about, h).precision


def precision_of(
    problem: Problem, about: Linearised, h: Float[Array, " H"], chosen: np.ndarray | None = None
) -> np.ndarray:
    """Return what chosen entries, (E,) bool, or all say of θ in z, without the prior; shape (P, P)."""
    weight = problem.observations.weight * (1.0 if chosen is None else jnp.asarray(chosen.astype(float)))
    return np.asarray(_precision(eqx.tree_at(lambda p: p.observations.weight, problem, weight), about, h))


@kept
def whitened_jacobian(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Float[Array, "E P"]:
    """Return Σ(h)^(−½) J: the products of its columns are the precision of θ in z, without the prior."""
    return whiten(problem, whitener(problem, h), about.jacobian)


def whitened_columns(problem: Problem, h: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return columns (E, …), in output units, whitened by the noise at scales h."""
    return np.asarray(_whitened_columns(problem, jnp.asarray(h), jnp.asarray(columns)))


@kept
def _whitened_columns(problem: Problem, h, columns):
    return whiten(problem, whitener(problem, h), columns)


def whitened_about(problem: Problem, about: Linearised, h: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return whitened residual (E,), whitened Jacobian (E, P) and prior widths (P,) at noise scales h."""
    residual, jacobian, widths = map(np.asarray, _whitened_about(problem, about, jnp.asarray(h)))
    return residual, jacobian, widths


@kept
def _whitened_about(problem: Problem, about: Linearised, h):
    by = whitener(problem, h)
    residual = whiten(problem, by, pseudo_values(problem, h, about.misfit))
    return residual, whiten(problem, by, about.jacobian), prior_widths(problem, h)


def deviations(gradients: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Return the standard deviations, (n,), of quantities with gradients (n, P) under a precision (P, P)."""
    return np.sqrt(np.sum(gradients * np.linalg.solve(precision, gradients.T).T, axis=1))


def log_marginal(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Scalar:
    """Return log p(y, h) with θ integrated out of the linearised model (the Laplace marginal of h)."""
    known = knowledge(problem, about, h)
    prior_precision = prior_widths(problem, h) ** -2
    total = known.precision + jnp.diag(prior_precision)
    gradient = known.gradient - prior_precision * about.z
    factor = cho_factor(total, lower=True)
    step = cho_solve(factor, gradient)
    log_determinant = 2 * jnp.sum(jnp.log(jnp.diagonal(factor[0])))
    fit = -0.5 * known.square - 0.5 * jnp.sum(prior_precision * about.z**2) + 0.5 * gradient @ step
    size = about.z.shape[0]
    return fit - 0.5 * log_determinant + 0.5 * size * jnp.log(2 * jnp.pi) + log_normaliser(problem, h)


def inverse_of_precision(precision: np.ndarray) -> np.ndarray:
    """Return the inverse of a positive definite matrix, (P, P).

    Some parameters of a servo table are determined to 1e-8 of their prior, and the eigenvalues of their precision
    differ by more than the rounding of the largest.  Cholesky's factor does not depend on the scale of the parameters,
    and weak directions are those of the largest variance, which rounding does not touch.
    """
    scale = np.sqrt(np.diag(precision))
    correlated = precision / np.outer(scale, scale)
    try:
        lower = np.linalg.cholesky(correlated)
    except np.linalg.LinAlgError:
        lower = np.linalg.cholesky(correlated + len(scale) * np.finfo(float).eps * np.eye(len(scale)))
    half = np.linalg.solve(lower, np.diag(1 / scale))
    return half.T @ half


def inverse_within(precision: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Return the inverse of a precision (P, P) restricted to the span of an orthonormal basis (P, S); shape (P, P).

    Its small variances are not those of the eigenvalues of the whole covariance, which have the rounding of the largest
    variance: next to directions that the data leave to the prior, 1e-16 of the latter is 1e-2 of a variance of 1e-14.
    """
    return basis @ inverse_of_precision(basis.T @ precision @ basis) @ basis.T


_MOST_STEPS = 60
# A step is short where no component of h changes by this much, in prior standard deviations.
_SHORT = 1e-3
# The same where the Hessian is only learnt: a step that it makes too short is still short of _SHORT.
_SHORT_LEARNT = 1e-5
# Half the distance of the central differences of the gradient: six digits of the curvature.
_APART = 1e-3
# A decrease below this is rounding; shortest fraction of a step that is tried.
_ROUNDING, _SHORTEST = 1e-9, 1e-3
# The rank-one update is skipped where step and secant error are this close to orthogonal: its denominator vanishes.
_TELLING = 1e-8


class Slope(eqx.Module):
    """The Laplace marginal of h at a point: log p(y, h) and its gradient (H,)."""

    value: Scalar
    gradient: Float[Array, " H"]


class Curvature(eqx.Module):
    """The Laplace marginal of h at a point: log p(y, h), its gradient (H,) and its negative Hessian (H, H)."""

    value: Scalar
    gradient: Float[Array, " H"]
    information: Float[Array, "H H"]


@kept
def slope(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Slope:
    """Return value and gradient of the Laplace marginal of h."""
    return Slope(*jax.value_and_grad(log_marginal, argnums=2)(problem, about, h))


def curvature(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Curvature:
    """Return value, gradient and negative Hessian of the Laplace marginal of h, the latter by central differences."""
    here, count = slope(problem, about, h), len(h)
    if not count:
        return Curvature(here.value, here.gradient, jnp.zeros((0, 0)))
    apart = _APART * np.eye(count)
    gradients = np.asarray(_gradients(problem, about, jnp.asarray(np.asarray(h) + np.concatenate([apart, -apart]))))
    information = (gradients[count:] - gradients[:count]) / (2 * _APART)
    return Curvature(here.value, here.gradient, jnp.asarray(0.5 * (information + information.T)))


@kept
def _gradients(problem: Problem, about: Linearised, points: Float[Array, "N H"]) -> Float[Array, "N H"]:
    """Return the gradient of the Laplace marginal at several h, one after another in one call of compiled code."""
    return jax.lax.map(lambda h: jax.grad(log_marginal, argnums=2)(problem, about, h), points)


def climb(
    problem: Problem,
    about: Linearised,
    h: Float[Array, " H"],
    information: Float[Array, "H H"] | None = None,
    *,
    judged: bool = True,
) -> tuple[Float[Array, " H"], Curvature]:
    """Return the mode of the Laplace marginal of h, and value, gradient and negative Hessian there.

    Parameters
    ----------
    problem, about : the model, and its linearisation about θ.
    h : shape (H,), the start.
    information : shape (H, H), negative Hessian at the start, or at a point nearby; computed where None.
    judged : whether the end is judged by the Hessian there.  Where not, the Hessian is the one learnt from the steps,
        and costs nothing: enough for a value of the marginal, which is flat at its mode, but not for a width.
    """
    measured, short = information is None, _SHORT if judged else _SHORT_LEARNT
    at = curvature(problem, about, h) if information is None else _with(slope(problem, about, h), information)
    for _ in range(_MOST_STEPS):
        step = _newton_step(at)
        ahead, length = None, 1.0
        if not _is_short(step, short):
            ahead, length = _ahead(problem, about, h, at, step)
        if ahead is None:
            if measured or (not judged and _is_short(step, short)):
                break
            at, measured = curvature(problem, about, h), True
            continue
        taken = length * step
        h, at, measured = h + taken, _with(ahead, _learnt(at, taken, ahead.gradient)), False
    return h, at if measured or not judged else curvature(problem, about, h)


def _is_short(step: np.ndarray, short: float) -> bool:
    """Tell whether a step is short; one that is not a number counts as short."""
    return not (step.size and float(np.max(np.abs(step))) >= short)


def _with(here: Slope, information: Float[Array, "H H"]) -> Curvature:
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
    problem: Problem, about: Linearised, h: Float[Array, " H"], at: Curvature, step: np.ndarray
) -> tuple[Slope | None, float]:
    """Return the marginal after a step, shortened until it does not descend, and its length; None where all do."""
    length = 1.0
    while length > _SHORTEST:
        ahead = slope(problem, about, h + length * step)
        if float(ahead.value) >= float(at.value) - _ROUNDING:
            return ahead, length
        length *= 0.3
    return None, length


def _learnt(at: Curvature, taken: np.ndarray, gradient: Float[Array, " H"]) -> Float[Array, "H H"]:
    """Return the negative Hessian after a step, by the symmetric rank-one update (Conn, Gould & Toint 1991).

    Unlike that of BFGS it may be indefinite, as is the Hessian of the marginal far from its mode.
    """
    lacking = np.asarray(at.gradient) - np.asarray(gradient) - np.asarray(at.information) @ taken
    along = float(lacking @ taken)
    if not abs(along) > _TELLING * float(np.linalg.norm(lacking) * np.linalg.norm(taken)):
        return at.information
    return at.information + jnp.asarray(np.outer(lacking, lacking) / along)

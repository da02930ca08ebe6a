"""The mode of the noise scales: their Laplace marginal, with θ integrated out of the linearised model, is maximised.

Quasi-Newton steps: the Hessian is computed once, by differences of the gradient, then updated from the steps.  When the
steps have become short it is computed anew, and convergence is judged by that Hessian alone.  Automatic second
derivatives of the marginal would take longer to compile than all these gradients take to evaluate.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Float, Scalar
from imubayes.inference.posterior_precision import Linearised, log_marginal
from imubayes.kept_programs import kept
from imubayes.model.problem import Problem

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

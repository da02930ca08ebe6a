"""The parameters θ at given noise scales, and the model linearised about them.

The linearisation is the one compiled program of a model that differentiates it.  Levenberg–Marquardt is NumPy around
it: compiled with the model, a program would be twice as large, and its steps no faster.
"""

from dataclasses import dataclass

import equinox as eqx
import numpy as np

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float, cho_solve, cholesky, on_host
from imubayes.model.likelihood import least_squares_form
from imubayes.model.noise_covariance import whiten
from imubayes.model.problem import Problem, is_small, predict_with_jacobian, prior_widths

_STEPS = 30
# Steps end where one changes each parameter, and the cost, by no more than this share and this much.
_TOLERANCE = 1e-3
# The prior damps already: the first step is Gauss–Newton's.  A step that fails raises the damping.
_FIRST_DAMPING = 1e-6
_COST_UNIT = 1e6
# The damping falls after a step that achieves nearly what was predicted, and rises where it achieves nearly nothing.
_GOOD, _BAD, _FALL, _RISE = 0.99, 0.01, 1 / 3.5, 4.0
# Relative change of the cost that is rounding: residuals are small differences of large observations.
_ROUNDING = 1e-11


class Linearised(eqx.Module):
    """The model about z: misfit e = y − f(z), shape (E,), and Jacobian ∂f/∂z, shape (E, P)."""

    z: Float[Array, " P"]
    misfit: Float[Array, " E"]
    jacobian: Float[Array, "E P"]


def linearised(problem: Problem, z: Float[Array, " P"]) -> Linearised:
    """Return the model linearised about z, as a part of a compiled function."""
    predicted, jacobian = predict_with_jacobian(problem, z)
    return Linearised(z, problem.observations.value - predicted, jacobian)


_linearised = kept(linearised, briefly=is_small)


def linearise(problem: Problem, z: Float[Array, " P"]) -> Linearised:
    """Return the model linearised about z, as arrays of NumPy."""
    return on_host(_linearised(problem, np.asarray(z)))


@dataclass(frozen=True)
class FittedParameters:
    """Outcome of a fit of θ at given noise scales.

    Attributes
    ----------
    about : the model linearised about the end point.
    steps : number of steps.
    successful : whether the end point is a minimum.
    """

    about: Linearised
    steps: int
    successful: bool


@np.errstate(all="ignore")
def fitted_parameters(
    problem: Problem, start: Linearised, h: Float[Array, " H"], tolerance: float = _TOLERANCE
) -> FittedParameters:
    """Return θ at given h by Levenberg–Marquardt (Marquardt 1963) from a start.

    Convergence is tested after accepted steps only, so a step that changes the cost by rounding alone is accepted: at
    the minimum steps would be rejected for that, and the search would go on with ever shorter ones.
    """
    at, damping = _LeastSquares(problem, start, np.asarray(h)), _FIRST_DAMPING
    for step in range(1, _STEPS + 1):
        delta = at.step(damping)
        trial = _LeastSquares(problem, linearise(problem, at.about.z + delta), at.h)
        change, predicted = trial.cost - at.cost, at.predicted(delta)
        accepted = change <= _BAD * predicted
        damping *= _FALL if change <= _GOOD * predicted else 1.0 if accepted else _RISE
        if accepted or abs(change) <= _ROUNDING * at.cost:
            settled = abs(change) < tolerance * (1 / _COST_UNIT + at.cost)
            at = trial
            if settled and np.all(np.abs(delta) < tolerance * (1 + np.abs(at.about.z))):
                return FittedParameters(at.about, step, True)
    return FittedParameters(at.about, _STEPS, False)


def fit_at(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> np.ndarray:
    """Return θ at given h, (P,), started from z."""
    return np.asarray(fitted_parameters(problem, linearise(problem, z), h).about.z)


class _LeastSquares:
    """Half the squared residual, whitened, with that of the prior, and its quadratic model about a point."""

    def __init__(self, problem: Problem, about: Linearised, h: np.ndarray):
        self.about, self.h = about, h
        by, straight = least_squares_form(problem, h, about.misfit)
        residual, slope = whiten(problem, by, straight), whiten(problem, by, about.jacobian)
        precision = prior_widths(problem, h) ** -2
        self.cost = 0.5 * float(residual @ residual + precision @ about.z**2)
        self._hessian = slope.T @ slope + np.diag(precision)
        self._descent = slope.T @ residual - precision * about.z

    def step(self, damping: float) -> np.ndarray:
        """Return the damped step, (P,); its columns are scaled to unit length, which keeps the digits."""
        damped = self._hessian + damping * np.eye(len(self._descent))
        unit = 1 / np.sqrt(np.diag(damped))
        return unit * cho_solve(cholesky(unit[:, None] * damped * unit), unit * self._descent)

    def predicted(self, step: np.ndarray) -> float:
        """Return the change of the cost by the quadratic model."""
        return float(0.5 * step @ self._hessian @ step - step @ self._descent)

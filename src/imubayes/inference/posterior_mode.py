"""The joint fit: θ by Levenberg–Marquardt at given noise scales, the noise scales by their Laplace marginal.

The joint mode of θ and σ is biased low by about p/2n; the mode of the marginal, with θ integrated out, is not.  The two
are found in turns, a few rounds of each, because θ hardly depends on the noise scales.  The outcome is a value: a fit
that did not converge says so in a sentence.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import numpy as np

from imubayes.foundations.arrays import Array, Float, cho_solve, cholesky, on_host
from imubayes.inference.laplace_marginal import climb, knowledge
from imubayes.inference.parameter_fit import Linearised, fit_at, fitted_parameters, linearise
from imubayes.inference.scale_density import Curvature
from imubayes.model.likelihood import has_heavy_tails, log_normaliser, whitened, with_normal_noise
from imubayes.model.noise_covariance import whiten, whitener
from imubayes.model.problem import Problem, predict_many, prior_widths

# A Newton decrement of 0.01 moves no estimate by more than a hundredth of its standard deviation.
_DECREMENT = 1e-2
# Rounds of θ and h in turns; the change of h per round, in units of its prior, that ends them.
_ROUNDS, _SETTLED = 8, 1e-2
_POLISH_STEPS = 20


class Mode(eqx.Module):
    """Where the joint fit ended.

    Attributes
    ----------
    z, h : shapes (P,) and (H,).
    decrement : √(gᵀH⁻¹g), the size of the step still to go, in posterior standard deviations.
    about : the model linearised about z.
    marginal : the Laplace marginal of h at ĥ, with its curvature.
    steps : Levenberg–Marquardt steps in all.
    settled : whether h no longer changed.
    converged : whether all of it converged.
    """

    z: Float[Array, " P"]
    h: Float[Array, " H"]
    decrement: float
    about: Linearised
    marginal: Curvature
    steps: int
    settled: bool
    converged: bool


@dataclass(frozen=True)
class Newton:
    """The Gauss–Newton step, (P,), at given h, and its size √(gᵀH⁻¹g), in posterior standard deviations."""

    step: np.ndarray
    decrement: float


# If a weak direction is curved, Gauss–Newton creeps along it with steps that shrink by a constant factor.
_LENGTHS = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0])


@np.errstate(all="ignore")
def gauss_newton(problem: Problem, about: Linearised, h: Float[Array, " H"]) -> Newton:
    """Return the step to the mode of the linearised model, and the decrement."""
    known, prior_precision = knowledge(problem, about, h), prior_widths(problem, h) ** -2
    gradient = known.gradient - prior_precision * about.z
    step = cho_solve(cholesky(known.precision + np.diag(prior_precision)), gradient)
    # NaN, and not 0, of a step that is none.
    return Newton(step, float(np.sqrt(np.maximum(gradient @ step, 0.0))))


@np.errstate(all="ignore")
def heights(problem: Problem, z: Sequence[np.ndarray] | np.ndarray, h: Float[Array, " H"]) -> np.ndarray:
    """Return the log density at several θ (n of shape P) and one h, −∞ where it is not finite; shape (n,)."""
    points, h = np.stack([np.asarray(point) for point in z]), np.asarray(h)
    misfits, known = problem.observations.value - predict_many(problem, points), log_normaliser(problem, h)
    widths = prior_widths(problem, h)
    if has_heavy_tails(problem):
        data = np.array([np.sum(whitened(problem, h, misfit) ** 2) for misfit in misfits])
    else:
        data = np.sum(whiten(problem, whitener(problem, h), misfits.T) ** 2, axis=0)
    found = -0.5 * (data + np.sum((points / widths) ** 2, axis=1)) + known
    return np.where(np.isfinite(found), found, -np.inf)


def find_mode(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> Mode:
    """Return the joint fit, started from z (P,) and h (H,)."""
    steps, settled, about, at, h = 0, False, None, None, np.asarray(h)
    if has_heavy_tails(problem):
        # Far from the fit every sample would pass for an outlier and have no influence.
        z = fit_at(with_normal_noise(problem), z, h)
    for _ in range(_ROUNDS):
        fitted = fitted_parameters(problem, z, h)
        steps += int(fitted.steps)
        z, about = fitted.value, fitted.aux
        before = h
        h, at = climb(problem, about, h, at.information if at is not None else None)
        settled = h.size == 0 or float(np.max(np.abs(h - before))) < _SETTLED
        if settled or not np.all(np.isfinite(h)):
            break
    assert about is not None
    assert at is not None
    about, decrement, more = _polished(problem, about, h)
    return _mode(about, h, at, decrement, steps + more, settled)


def mode_near(
    problem: Problem, about: Linearised, h: Float[Array, " H"], information: np.ndarray | None = None
) -> Mode:
    """Return the joint fit from a place close to it: h in the linearised model and Gauss–Newton steps in turns.

    For a fit of nearly the same data, whose linearisation `about` is at hand: a step or two lead there, if
    Levenberg–Marquardt would take several for each of its rounds.

    Parameters
    ----------
    problem : to be fitted.
    about, h : where to start: the linearised model, and the noise scales, shape (H,).
    information : shape (H, H), negative Hessian of the marginal of h at a fit of nearly the same data.  If it is
        given, that of the mode is learnt from the steps alone: the mode is as good, widths of h are not.
    """
    steps, settled, at, decrement, h = 0, False, None, np.inf, np.asarray(h)
    judged = information is None
    for _ in range(_ROUNDS):
        before = h
        h, at = climb(problem, about, h, at.information if at is not None else information, judged=judged)
        settled = h.size == 0 or float(np.max(np.abs(h - before))) < _SETTLED
        about, decrement, more = _polished(problem, about, h)
        steps += more
        if (settled and not more) or not np.all(np.isfinite(h)):
            break
    assert at is not None
    return _mode(about, h, at, decrement, steps, settled)


def _polished(problem: Problem, about: Linearised, h: np.ndarray) -> tuple[Linearised, float, int]:
    """Return the model about the end of Gauss–Newton steps at given h, the decrement there, and how many they were."""
    decrement, steps, about = np.inf, 0, on_host(about)
    for _ in range(_POLISH_STEPS):
        newton = gauss_newton(problem, about, h)
        decrement = newton.decrement
        if not decrement >= _DECREMENT / 10:
            break
        ends = about.z + _LENGTHS[:, None] * newton.step
        best = int(np.argmax(heights(problem, ends, h)))
        if _LENGTHS[best] == 0:
            break
        steps += 1
        about = linearise(problem, ends[best])
    return about, decrement, steps


def _mode(about: Linearised, h: np.ndarray, at: Curvature, decrement: float, steps: int, settled: bool) -> Mode:
    parts = (decrement, h, at.value, at.gradient, at.information)
    finite = all(bool(np.all(np.isfinite(part))) for part in parts)
    return Mode(about.z, h, decrement, about, at, steps, settled, finite and settled and decrement < _DECREMENT)


def log_evidence(mode: Mode) -> float:
    """Return the Laplace estimate of log p(y), h integrated out as well."""
    _, log_determinant = np.linalg.slogdet(np.asarray(mode.marginal.information))
    return float(mode.marginal.value + 0.5 * len(mode.h) * np.log(2 * np.pi) - 0.5 * log_determinant)


def message(mode: Mode) -> str:
    """Return the sentence that says how the fit ended; empty when it converged."""
    if mode.converged:
        return ""
    if not np.isfinite(mode.decrement):
        return "The fit did not converge: the model gave a value that is not finite."
    if not mode.settled:
        return f"The fit did not converge: the noise scales still changed after {_ROUNDS} rounds."
    return (
        f"The fit did not converge: the last step was {mode.decrement:.2g} posterior standard deviations, "
        f"more than {_DECREMENT:g}."
    )

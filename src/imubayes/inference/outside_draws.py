"""Fits whose mode and draws were found elsewhere, as a batch finds those of many units at a time."""

from dataclasses import replace

import equinox as eqx
import numpy as np

from imubayes.foundations.arrays import Array, Float, on_host
from imubayes.inference.conditional_precision import conditional_precision
from imubayes.inference.fitted_model import Fit
from imubayes.inference.nested_laplace import NestedLaplace, curved_directions
from imubayes.inference.noise_scale_modes import resampled
from imubayes.inference.parameter_fit import linearise
from imubayes.inference.posterior_mode import Mode
from imubayes.inference.run_fit import judged_fit, posterior_of_draws
from imubayes.inference.scale_density import Curvature, ScaleDensity
from imubayes.model.bind import Model


class UnbentDraws(eqx.Module):
    """Draws of a nested Laplace approximation before they are bent, M for each of S noise scales.

    Attributes
    ----------
    delta : shape (S, M, P), steps of θ from the mode.
    h : shape (S, H), noise scales.
    log_weight : shape (S,), up to a constant, the Laplace marginal of the scales over the density they were drawn from.
    """

    delta: Float[Array, "*S M P"]
    h: Float[Array, "*S H"]
    log_weight: Float[Array, "*S"]


def fit_of_draws(
    model: Model, z: np.ndarray, decrement: float, marginal: Curvature, density: ScaleDensity, drawn: UnbentDraws
) -> Fit:
    """Return the fit at a mode found elsewhere, with draws made there of its nested Laplace approximation.

    It has no posterior if its estimates cannot be those of a working unit.

    Parameters
    ----------
    z, decrement : shape (P,), θ at the mode, and the size of the step still to go, in posterior standard deviations.
    marginal : that of the noise scales at the mode.
    density : that the noise scales were drawn from, without a ridge.
    """
    mode = Mode(z, density.h, decrement, linearise(model.problem, z), on_host(marginal), 0, True, True)
    fit = judged_fit(model, mode)
    if not fit.converged:
        return fit
    problem, size = model.problem, len(fit.z)
    weak, _, bend = curved_directions(problem, mode)
    given = conditional_precision(problem, mode)
    approximation = NestedLaplace(fit.z, density, given, weak, bend)
    delta = np.asarray(drawn.delta)
    each, delta = delta.shape[-2], delta.reshape(-1, size)
    bent = delta + _bent(delta, np.asarray(weak), np.asarray(bend))
    points = np.concatenate([fit.z + bent, np.repeat(np.asarray(drawn.h), each, axis=0)], axis=1)
    points = resampled(points, np.repeat(np.asarray(drawn.log_weight), each))
    return replace(fit, posterior=posterior_of_draws(fit, points, approximation, None))


def _bent(delta: np.ndarray, weak: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """Return the bend of steps (S, P)."""
    along = delta @ weak
    pairs = (along[:, :, None] * along[:, None, :]).reshape(len(delta), -1)
    return 0.5 * pairs @ bend.reshape(-1, delta.shape[1])

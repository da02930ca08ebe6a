"""Coordinates in which correlated noise has no ridge: the scale of its innovations in place of its own.

Of AR(1) noise r_k = φ r_(k−1) + √(1 − φ²) ε_k a series tells the standard deviation of the innovations, σ √(1 − φ²), at
once, and σ and φ only after many correlation times: as φ nears 1 both grow together, along a curve (Box and Jenkins).
In the logarithm of σ √(1 − φ²) the curve is straight.  The shear that leads there does not change φ, so its determinant
is 1.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Float
from imubayes.kept_programs import kept
from imubayes.model.noise_covariance import group_sum, noise_distribution, row_correlations, rows_correlate
from imubayes.model.problem import Problem

# Least singular value, relative to the largest, that counts for how scales move the variance of a run.
_LEAST = 1e-6


class InnovationScale(eqx.Module):
    """The shear h = u + S (λ(u) − λ(ĥ)) with λ = ½ log(1 − φ²) of each run and channel.

    Attributes
    ----------
    slope : S, shape (H, G); its rows are 0 for the correlations themselves.
    at_mode : λ(ĥ), shape (G,).
    """

    slope: Float[Array, "H G"]
    at_mode: Float[Array, " G"]

    def straightened(self, problem: Problem, h: Float[Array, " H"]) -> Float[Array, " H"]:
        """Return u of noise scales h."""
        return h - self._along_ridge(problem, h)

    def scales(self, problem: Problem, straight: Float[Array, " H"]) -> Float[Array, " H"]:
        """Return the noise scales h of u."""
        return straight + self._along_ridge(problem, straight)

    def straightened_information(
        self, problem: Problem, h: Float[Array, " H"], information: Float[Array, "H H"]
    ) -> Float[Array, "H H"]:
        """Return the negative Hessian in u of a density of h at its mode, from that in h."""
        slope = jax.jacfwd(lambda straight: self.scales(problem, straight))(h)
        return slope.T @ information @ slope

    def _along_ridge(self, problem: Problem, h: Float[Array, " H"]) -> Float[Array, " H"]:
        return self.slope @ (_log_innovation(problem, h) - self.at_mode)


def innovation_scale(problem: Problem, h: Float[Array, " H"]) -> InnovationScale | None:
    """Return the shear about the mode h; None where no rows are correlated."""
    if problem.timeline is not None or not rows_correlate(problem):
        return None
    sensitivity, at_mode = _at(problem, h)
    return InnovationScale(-jnp.asarray(np.linalg.pinv(np.asarray(sensitivity), rcond=_LEAST)), at_mode)


@kept
def _at(problem: Problem, h: Float[Array, " H"]) -> tuple[Float[Array, "G H"], Float[Array, " G"]]:
    """Return how scales move the mean logarithm of the noise of each run and channel, and λ there."""

    def mean_log(h: Float[Array, " H"]) -> Float[Array, " G"]:
        own, observations = noise_distribution(problem, h).squared_scale, problem.observations
        there = jnp.where(observations.weight > 0, 1.0, 0.0)
        logarithm = jnp.where(there > 0, jnp.log(jnp.where(there > 0, own, 1.0)), 0.0)
        return 0.5 * group_sum(logarithm, observations) / jnp.maximum(group_sum(there, observations), 1.0)

    return jax.jacfwd(mean_log)(h), _log_innovation(problem, h)


def _log_innovation(problem: Problem, h: Float[Array, " H"]) -> Float[Array, " G"]:
    return 0.5 * jnp.log1p(-(row_correlations(problem, problem.hyper_priors.values(h)) ** 2))

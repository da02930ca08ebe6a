"""The mode of a log density that JAX can differentiate, and the normal distribution about it.

Strongly correlated parameters make a ridge; starts of the right standard deviations without the correlations lie far
off it, and walkers that begin there may never arrive.  A JAX function has a gradient, so the mode is found by
Newton steps and the correlations come with it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from imubayes.inference.gradient_moves import Single
from imubayes.inference.laplace_proposal import BatchedDensity

# Newton steps at most, and the decrement g·H⁻¹g below which a mode is found: a thousandth of a standard deviation.
_NEWTON_STEPS, _DECREMENT = 100, 1e-6
# Gradients are differenced over this share of the conditional standard deviation.
_DIFFERENCE = 1e-3
# Curvatures below this share of the largest are taken for this share: flat directions are not followed for ever.
_FLAT = 1e-14


@dataclass(frozen=True)
class NormalProposal:
    """A normal distribution as a proposal: point = centre + axes · standard normal.

    Attributes
    ----------
    centre : shape (D,).
    axes : shape (D, D), invertible.
    """

    centre: np.ndarray
    axes: np.ndarray

    @property
    def dimensions(self) -> int:
        """Number D of parameters."""
        return len(self.centre)

    def to_point(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the points of standard normal vectors, (n, D), and the log density of the proposal, (n,)."""
        return self.centre + normal @ self.axes.T, self._density(normal)

    def to_normal(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the standard normal vectors of points, (n, D), and the log density of the proposal, (n,)."""
        normal = np.linalg.solve(self.axes, (points - self.centre).T).T
        return normal, self._density(normal)

    def _density(self, normal: np.ndarray) -> np.ndarray:
        constant = 0.5 * self.dimensions * np.log(2 * np.pi) + np.linalg.slogdet(self.axes)[1]
        return -0.5 * np.sum(normal**2, axis=1) - constant


def _uncounted(evaluations: int) -> None:
    """Count nothing."""


def normal_about_mode(
    scaled: Single, start: np.ndarray, scale: np.ndarray, spend: Callable[[int], None] = _uncounted
) -> NormalProposal | None:
    """Return the Laplace approximation of a log density, from Newton steps with the absolute values of its curvatures.

    None if no mode is found.

    Parameters
    ----------
    scaled : log density at (x − start)/scale.
    start, scale : shape (D,), where the search begins, and rough standard deviations.
    spend : called with the number of evaluations that are made.
    """
    whole = jax.jit(jax.vmap(jax.value_and_grad(scaled)))

    def gradients(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        spend(len(at))
        value, slope = whole(jnp.asarray(at))
        return np.asarray(value), np.asarray(slope)

    size = len(start)
    at, apart = np.zeros(size), np.full(size, _DIFFERENCE)
    for _ in range(_NEWTON_STEPS):
        offsets = np.concatenate([np.zeros((1, size)), np.diag(apart), -np.diag(apart)])
        value, slope = gradients(at + offsets)
        if not (np.isfinite(value[0]) and np.all(np.isfinite(slope))):
            return None
        curvature = -(slope[1 : size + 1] - slope[size + 1 :]) / (2 * apart[:, None])
        found, axes = np.linalg.eigh((curvature + curvature.T) / 2)
        strength = np.maximum(np.abs(found), _FLAT * np.abs(found).max() or 1.0)
        step = axes @ (axes.T @ slope[0] / strength)
        if slope[0] @ step < _DECREMENT:
            flat = found.min() <= _FLAT * found.max()
            return None if flat else NormalProposal(start + scale * at, scale[:, None] * axes / np.sqrt(found))
        shorter = at + 0.5 ** np.arange(2 * size + 1)[:, None] * step
        heights = gradients(shorter)[0]
        best = int(np.nanargmax(np.where(np.isfinite(heights), heights, -np.inf)))
        if not heights[best] > value[0]:
            return None
        at = shorter[best]
        apart = _DIFFERENCE / np.sqrt(np.maximum(np.abs(np.diag(curvature)), strength.max() * _FLAT))
    return None


def differentiable(log_density: BatchedDensity, start: np.ndarray, scale: np.ndarray) -> Single | None:
    """Return the log density of one point (x − start)/scale, (D,); None if JAX cannot differentiate it.

    None as well in single precision, where differences of gradients give no curvature.
    """

    def single(scaled: jax.Array) -> jax.Array:
        return jnp.asarray(log_density(jnp.asarray(start + scale * scaled)[None]))[0]  # pyright: ignore

    if not jax.config.jax_enable_x64:
        return None
    try:
        jax.make_jaxpr(jax.value_and_grad(single))(jnp.zeros(len(start)))
    # Whatever the function does not take: it is of NumPy, it branches on values, it calls other programs.
    except Exception:
        return None
    return single

"""The density of noise scales h about the mode of their marginal: where that is evaluated, and how h is drawn from it.

The marginal of a noise scale is skewed; that of a scatter between few runs is as wide as its prior and may have a
second mode: it is evaluated along each of its axes and drawn from as tabulated (Rue, Martino & Chopin 2009, § 3.1).
Whoever has the marginal evaluates it: `imubayes.inference.nested_laplace` for one model, a batch for many at a time.
"""

from dataclasses import dataclass

import equinox as eqx
import numpy as np

from imubayes.foundations.arrays import Array, Float
from imubayes.inference.tabulated_density import TabulatedDensity, from_normal, log_density, tabulate, to_normal

# Where the marginal of h is evaluated along each axis, in units of its width at the mode,
_PROBES = np.array([-8.0, -6.0, -4.5, -3.5, -2.7, -2.0, -1.3, -0.6, 0.0, 0.6, 1.3, 2.0, 2.7, 3.5, 4.5, 6.0, 8.0, 11.0])
# and, for other maxima, over the whole prior, in z: a scatter at the lower end is zero for all that data can determine.
_SURVEY = np.linspace(-3.5, 3.5, 15)
# Another maximum counts if it is less than this below the highest, and this above what lies between.
_HOPELESS, _APART = 15.0, 0.1
# Log density, relative to the mode, if the marginal is not finite.
_NOWHERE = -200.0


class Curvature(eqx.Module):
    """The Laplace marginal of h at a point: log p(y, h), its gradient (H,) and its negative Hessian (H, H)."""

    value: Float[Array, ""] | float
    gradient: Float[Array, " H"]
    information: Float[Array, "H H"]


class ScaleDensity(eqx.Module):
    """A density of noise scales h about their mode: independent tabulated variables along axes.

    Attributes
    ----------
    h : shape (H,), the mode.
    axes : shape (H, H), columns are the axes: unit lower triangular, the identity if the scales are independent.
    along : the marginal along each axis, from the mode.
    """

    h: Float[Array, " H"]
    axes: Float[Array, "H H"]
    along: TabulatedDensity

    def steps(self, normal: Float[Array, "*batch H"]) -> Float[Array, "*batch H"]:
        """Return the steps along the axes that standard normal vectors stand for."""
        return from_normal(self.along, normal)

    def normals(self, steps: Float[Array, "*batch H"]) -> Float[Array, "*batch H"]:
        """Return the standard normal vectors that steps along the axes stand for."""
        return to_normal(self.along, steps)

    def scales(self, steps: Float[Array, "*batch H"]) -> Float[Array, "*batch H"]:
        """Return h after steps along the axes."""
        return self.h + steps @ self.axes.T

    def log_density(self, steps: Float[Array, "*batch H"]) -> Float[Array, "*batch"]:
        """Return the log density after steps along the axes."""
        return log_density(self.along, steps).sum(axis=-1)


@dataclass(frozen=True)
class ScaleProbes:
    """Where the marginal of h is evaluated.

    Attributes
    ----------
    h, axes : shapes (H,) and (H, H), of its mode, and as of `ScaleDensity`.
    deviation : shape (H,), width of the marginal along each axis.
    knots : shape (H, n), along each axis, increasing.
    near : shape (H, n), which of them the table is made of; the others reach over the prior.
    points : shape (H n, H).
    """

    h: np.ndarray
    axes: np.ndarray
    deviation: np.ndarray
    knots: np.ndarray
    near: np.ndarray
    points: np.ndarray

    def tabulated(self, log_density: np.ndarray) -> "ScaleDensity":
        """Return the marginal along each axis, from its logarithm at the points (H n,) relative to that at the mode."""
        knots, values = (each[self.near].reshape(-1, len(_PROBES)) for each in (self.knots, self._heights(log_density)))
        return ScaleDensity(self.h, self.axes, tabulate(knots, values, self.deviation))

    def other_maxima(self, log_density: np.ndarray) -> list[int]:
        """Return the places among the points of maxima beside the mode, apart from it and not hopelessly below it."""
        found = []
        for axis, (knots, height) in enumerate(zip(self.knots, self._heights(log_density), strict=True)):
            mode = int(np.argmin(np.abs(knots)))
            for place in np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:])) + 1:
                between = height[min(place, mode) : max(place, mode) + 1].min()
                if place != mode and height[place] > max(height.max() - _HOPELESS, between + _APART):
                    found.append(axis * len(knots) + int(place))
        return found

    def _heights(self, log_density: np.ndarray) -> np.ndarray:
        values = np.nan_to_num(log_density, nan=_NOWHERE, neginf=_NOWHERE, posinf=_NOWHERE)
        return np.maximum(values, _NOWHERE).reshape(self.knots.shape)


def scale_probes(h: np.ndarray, information: np.ndarray) -> ScaleProbes:
    """Return where to evaluate the marginal of h, from its mode (H,) and its negative Hessian (H, H) there."""
    eigenvalues, vectors = np.linalg.eigh(information)
    # If the marginal is flatter than the prior, the Laplace width is unbounded; the prior has width 1.
    factor = np.linalg.cholesky((vectors / np.maximum(eigenvalues, 1.0)) @ vectors.T)
    deviation = np.diagonal(factor)
    axes = factor / deviation
    knots = np.concatenate([deviation[:, None] * _PROBES, _SURVEY - h[:, None]], axis=1)
    order = np.argsort(knots, axis=1)
    knots = np.take_along_axis(knots, order, axis=1)
    points = h + knots[..., None] * axes.T[:, None, :]
    return ScaleProbes(h, axes, deviation, knots, order < len(_PROBES), points.reshape(-1, len(axes)))

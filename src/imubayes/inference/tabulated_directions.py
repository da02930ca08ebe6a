"""Weak directions of θ whose marginal is not normal: they are drawn from tabulated densities.

A direction that the data determine poorly reaches far: the heading of a tumble whose gyros hardly resolve the Earth
rate turns by tens of degrees, and its posterior is wider and flatter than the curvature at the mode says.  A normal
proposal is then too narrow, and walkers stay for a hundred steps in the tails.  The marginal along such a direction is
evaluated on a grid, each time at the highest point of the posterior across it and with the width there (the Laplace
approximation of a marginal, Tierney & Kadane 1986), and takes the place of the normal one.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
import scipy.special

from imubayes.foundations.arrays import Array, Float, cho_solve, cholesky, solve_lower
from imubayes.inference.laplace_marginal import knowledge
from imubayes.inference.parameter_fit import Linearised, linearise
from imubayes.inference.posterior_mode import Mode, heights
from imubayes.inference.tabulated_density import TabulatedDensity, from_normal, log_density, tabulate, to_normal
from imubayes.model.problem import Problem, prior_widths

# Where the marginal is evaluated, in standard deviations of the normal approximation, outwards from the mode.
_OUTWARDS = (0.6, 1.3, 2.0, 2.7, 3.5, 4.5, 6.0, 8.0)
# A direction is normal if the log density at this distance is within the second number of that of a normal
# distribution.
_SCREEN, _ALIKE = 2.5, 0.3
# Directions that are tabulated at most, the farthest from normal first.
_MOST = 4
# Gauss–Newton steps to the highest point across a direction, from that of the last grid point.
_STEPS = 2
# Quantiles by which a width is integrated, tails included.
_NORMAL_QUANTILES = scipy.special.ndtri((np.arange(4000) + 0.5) / 4000)
# Log density, relative to the mode, if it is not finite.
_NOWHERE = -200.0


class TabulatedDirections(eqx.Module):
    """Directions with the marginal along each.

    Attributes
    ----------
    directions : shape (P, M), orthonormal, independent of each other at the mode.
    along : the marginal along each, in standard deviations of the normal approximation.
    """

    directions: Float[Array, "P M"]
    along: TabulatedDensity

    def shaped(
        self, factor: Sequence[np.ndarray] | np.ndarray, normal: Float[Array, "n P"]
    ) -> tuple[Float[Array, "n P"], Float[Array, " n"]]:
        """Return whitened steps with these marginals, and their log density less that of standard normal vectors.

        Parameters
        ----------
        factor : n lower Cholesky factors L, (P, P), of the precision of θ; the step is L⁻ᵀ times the whitened one.
        normal : standard normal vectors.
        """
        axes = self._axes(factor)
        before = np.einsum("npm,np->nm", axes, normal)
        after = from_normal(self.along, before)
        return normal + np.einsum("npm,nm->np", axes, after - before), self._excess(after)

    def normalised(
        self, factor: Float[Array, "n P P"], whitened: Float[Array, "n P"]
    ) -> tuple[Float[Array, "n P"], Float[Array, " n"]]:
        """Return the standard normal vectors of whitened steps, and the log density as `shaped` does."""
        axes = self._axes(factor)
        after = np.einsum("npm,np->nm", axes, whitened)
        return whitened + np.einsum("npm,nm->np", axes, to_normal(self.along, after) - after), self._excess(after)

    def stretch(self, factor: Float[Array, "P P"]) -> np.ndarray:
        """Return the linear map (P, P) of steps of the normal approximation that gives them the widths of the tables.

        Parameters
        ----------
        factor : lower Cholesky factor of the precision of θ.
        """
        whitening, axes = factor.T, self._axes(factor[None])[0]
        back = np.linalg.solve(whitening, axes)
        widths = from_normal(self.along, np.tile(_NORMAL_QUANTILES[:, None], axes.shape[1])).std(axis=0)
        return np.eye(len(whitening)) + (back * (widths - 1)) @ (axes.T @ whitening)

    def _axes(self, factor: Sequence[np.ndarray] | np.ndarray) -> Float[Array, "n P M"]:
        """Return the directions among whitened steps, orthonormal: vᵀδ = (L⁻¹v)ᵀ (Lᵀδ)."""
        axes, triangle = np.linalg.qr(np.stack([solve_lower(each, self.directions) for each in factor]))
        return axes * np.sign(np.diagonal(triangle, axis1=-2, axis2=-1))[..., None, :]

    def _excess(self, after: Float[Array, "n M"]) -> Float[Array, " n"]:
        return np.sum(log_density(self.along, after) + 0.5 * after**2 + 0.5 * np.log(2 * np.pi), axis=-1)


def tabulated_directions(
    problem: Problem, mode: Mode, weak: Float[Array, "P K"], reach: np.ndarray, bend: Float[Array, "K K P"]
) -> TabulatedDirections | None:
    """Return the weak directions whose marginal is not normal; None if all are.

    Parameters
    ----------
    weak : shape (P, K), orthonormal weak directions, eigenvectors of the precision at the mode.
    reach : shape (K,), standard deviation along each of the normal approximation.
    bend : shape (K, K, P), acceleration along pairs of them.
    """
    chosen = _not_normal(problem, mode, weak, reach, bend)
    if not chosen.size:
        return None
    tables = [_marginal(problem, mode, weak[:, place], float(reach[place])) for place in chosen]
    at = np.array([-distance for distance in reversed(_OUTWARDS)] + [0.0, *_OUTWARDS])
    knots = np.tile(at, (len(chosen), 1))
    return TabulatedDirections(weak[:, chosen], tabulate(knots, np.stack(tables), np.ones(len(chosen))))


def _not_normal(problem: Problem, mode: Mode, weak: np.ndarray, reach: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """Return the places of directions along which the log density falls otherwise than a normal one."""
    count = weak.shape[1]
    if not count:
        return np.zeros(0, int)
    steps = _SCREEN * reach[:, None] * weak.T
    curve = 0.5 * (_SCREEN * reach[:, None]) ** 2 * bend[np.arange(count), np.arange(count)]
    here = mode.z
    found = heights(problem, np.concatenate([[here], here + curve + steps, here + curve - steps]), mode.h)
    fall = np.nan_to_num(found[1:] - found[0], neginf=_NOWHERE).reshape(2, count)
    excess = np.abs(fall + 0.5 * _SCREEN**2).max(axis=0)
    order = np.argsort(-excess)[:_MOST]
    return order[excess[order] > _ALIKE]


def _marginal(problem: Problem, mode: Mode, direction: np.ndarray, reach: float) -> np.ndarray:
    """Return the log marginal along a direction at the grid, relative to the mode."""
    middle = _across(problem, mode.about, mode.h, direction)[1]
    height = heights(problem, [mode.z], mode.h)[0]
    sides = []
    for sign in (-1.0, 1.0):
        z, before, side = mode.z, 0.0, []
        for distance in _OUTWARDS:
            z = z + sign * reach * (distance - before) * direction
            before, width = distance, middle
            for _ in range(_STEPS):
                step, width = _across(problem, linearise(problem, z), mode.h, direction)
                z = z + step
            found = heights(problem, [z], mode.h)[0] - height - 0.5 * (width - middle)
            side.append(max(float(found), _NOWHERE) if np.isfinite(found) else _NOWHERE)
        sides.append(side)
    return np.array([*reversed(sides[0]), 0.0, *sides[1]])


@np.errstate(all="ignore")
def _across(problem: Problem, about: Linearised, h: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the Gauss–Newton step across a direction, and log det of the precision across it."""
    known, prior_precision = knowledge(problem, about, h), prior_widths(problem, h) ** -2
    factor = cholesky(known.precision + np.diag(prior_precision))
    step = cho_solve(factor, known.gradient - prior_precision * about.z)
    along = cho_solve(factor, direction)
    variance = direction @ along
    width = 2 * np.sum(np.log(np.diagonal(factor))) + np.log(variance)
    return step - direction @ step / variance * along, float(width)

"""A fit judged at the noise that was known before it: what the runs say of one another, in closed form.

A fit adapts its noise scales to whatever the model lacks: a run whose recorded input is wrong becomes scatter between
runs, and no residual is left that would tell.  Here white noise is that of the raw samples within rows, and a scatter
between runs is no larger than its prior says.  About a point the model is linear, y = f + J t + e, and what a run adds
to the χ² of all others is the difference of two least squares with the priors as further rows (Cook and Weisberg,
Residuals and Influence in Regression, 1982).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from imubayes.gather import in_batches
from imubayes.inference.posterior_precision import linearise
from imubayes.kept_programs import kept
from imubayes.model.bind import Model
from imubayes.model.noise_covariance import inverse_covariance, whitener
from imubayes.model.problem import Problem, prior_widths

_AT_ONCE = 16
"""Columns that are divided by the covariance at once, so that one compiled program serves all."""
_LEAST_FREEDOM = 5.0
"""Degrees of freedom of a channel below which it does not tell its noise."""


@dataclass(frozen=True)
class EntryPlaces:
    """Run, row and channel of each entry, (E,)."""

    run: np.ndarray
    row: np.ndarray
    channel: np.ndarray


@dataclass(frozen=True)
class LinearFit:
    """The model linearised, at given noise.

    Attributes
    ----------
    jacobian, misfit : shapes (E, P) and (E,).
    weighted, pulled : Σ⁻¹J and Σ⁻¹ misfit; entries of different runs or channels are independent.
    precision, centre : of the priors, (P,), the centre less the point of linearisation.
    at : run, row and channel of each entry.
    weight : shape (E,), factor on Σ⁻¹, the same in all rows of a run and channel; 0 leaves out.
    """

    jacobian: np.ndarray
    misfit: np.ndarray
    weighted: np.ndarray
    pulled: np.ndarray
    precision: np.ndarray
    centre: np.ndarray
    at: EntryPlaces
    weight: np.ndarray

    @cached_property
    def lower(self) -> np.ndarray:
        """Cholesky factor of the precision of all parameters, (P, P)."""
        found = self.jacobian.T @ (self.weight[:, None] * self.weighted)
        return np.linalg.cholesky(0.5 * (found + found.T) + np.diag(self.precision))

    @cached_property
    def shift(self) -> np.ndarray:
        """The parameters of least χ² less the point of linearisation, (P,)."""
        pull = self.weighted.T @ (self.weight * self.misfit) + self.precision * self.centre
        return scipy.linalg.cho_solve((self.lower, True), pull)

    @cached_property
    def influence(self) -> np.ndarray:
        """Return v = M(y − f), (E,), as if every entry counted."""
        return self.pulled - self.weighted @ self.shift

    @cached_property
    def chi2_of_entries(self) -> np.ndarray:
        """What each entry adds to χ², (E,); the sums over a run and channel alone have a meaning."""
        return self.weight * (self.misfit - self.jacobian @ self.shift) * self.influence

    @cached_property
    def chi2(self) -> float:
        """The least χ², priors included."""
        priors = self.precision @ (self.shift - self.centre) ** 2
        return float(self.chi2_of_entries.sum() + priors)

    @cached_property
    def _half(self) -> np.ndarray:
        """Σ⁻¹J L⁻ᵀ with L Lᵀ the precision, (E, P)."""
        return scipy.linalg.solve_triangular(self.lower, self.weighted.T, lower=True).T

    def noise_ratios(self, kept: np.ndarray) -> np.ndarray:
        """Return χ² over degrees of freedom of each channel among entries kept, (E,) bool, at least 1; at entries."""
        used, ratios = kept & (self.weight > 0), np.ones(len(kept))
        plain = np.where(used, self.chi2_of_entries / np.where(self.weight > 0, self.weight, 1.0), 0.0)
        freedom = self.freedom(used)
        whole = plain.sum() / max(freedom.sum(), _LEAST_FREEDOM)
        for channel in np.unique(self.at.channel):
            own = self.at.channel == channel
            few = freedom[own].sum() < _LEAST_FREEDOM
            ratios[own] = max(1.0, whole if few else plain[own].sum() / freedom[own].sum())
        return ratios

    def freedom(self, used: np.ndarray) -> np.ndarray:
        """Return the degrees of freedom left of each entry, (E,), by the parameters; 0 where not used, (E,) bool."""
        leverage = np.sum(scipy.linalg.solve_triangular(self.lower, self.jacobian.T, lower=True).T * self._half, axis=1)
        return np.where(used, 1 - self.weight * leverage, 0.0)

    def weighted_by(self, weight: np.ndarray) -> "LinearFit":
        """Return the fit with other factors on Σ⁻¹."""
        return replace(self, weight=weight)

    def without_run(self, run: int) -> "LinearFit":
        """Return the fit to all other runs, each channel at the noise that they show if that is larger."""
        others = self.weighted_by((self.at.run != run).astype(float))
        return others.weighted_by(others.weight / others.noise_ratios(others.weight > 0))


def linear_fit(model: Model, problem: Problem, z: np.ndarray, h: np.ndarray) -> LinearFit:
    """Return a problem of a model linearised about parameters z at noise scales h."""
    about = linearise(problem, jnp.asarray(z))
    jacobian, misfit = np.asarray(about.jacobian), np.asarray(about.misfit)
    divided = divide(problem, h, np.column_stack([misfit, jacobian]))
    entries = model.entries
    return LinearFit(
        jacobian=jacobian, misfit=misfit, weighted=divided[:, 1:], pulled=divided[:, 0],
        precision=np.asarray(prior_widths(problem, jnp.asarray(h))) ** -2.0, centre=-np.asarray(z),
        at=EntryPlaces(entries.run, np.where(entries.closing, -1, entries.row), entries.channel),
        weight=np.asarray(problem.observations.weight),
    )  # fmt: skip


def divide(problem: Problem, h: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return Σ(h)⁻¹ times columns (E, C)."""
    at = jnp.asarray(h)
    return in_batches(lambda some: _inverse(problem, at, some)[0], columns.T, _AT_ONCE).T


@kept
def _inverse(problem: Problem, h, columns):
    by = whitener(problem, h)
    return jax.vmap(lambda column: inverse_covariance(problem, by, column))(columns)

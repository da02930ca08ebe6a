"""What the posterior of each unit says of a parameter once the prior of its model is divided out.

A population must not be inferred from posteriors as they are: each of them contains the prior of the model, n units
would count it n times, and badly measured units would pull the spread towards the prior's.  With a normal posterior
N(m, s²) under a normal prior N(μ₀, σ₀²) the quotient is the integrated likelihood of the unit, normal as well:

    1/v = 1/s² − 1/σ₀²,    y = v (m/s² − μ₀/σ₀²).

All other parameters of the unit are integrated over with the priors that the model gives them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

LEAST_FROM_DATA = 0.05
"""Share of the information on a parameter that must come from a unit's data for the unit to count (convention).

Below it the quotient of posterior and prior is mostly the error of the normal approximation.  Units are left out by
their uncertainty alone, never by their value, so that the selection does not bias the population.
"""


@dataclass(frozen=True)
class UnitPosteriors:
    """The posterior of one parameter in n units, on a scale on which the prior is normal.

    Attributes
    ----------
    mean, sd : shape (n,), posterior mean and standard deviation.
    prior_mean, prior_sd : shape (n,), of the prior; an infinite standard deviation is a flat prior.
    draws : shape (n,), effective number of draws that mean and sd were estimated from; infinite where they are exact.
    """

    mean: np.ndarray
    sd: np.ndarray
    prior_mean: np.ndarray
    prior_sd: np.ndarray
    draws: np.ndarray

    @cached_property
    def from_data(self) -> np.ndarray:
        """1 − posterior variance / prior variance, shape (n,)."""
        return 1 - (self.sd / self.prior_sd) ** 2

    @cached_property
    def informative(self) -> np.ndarray:
        """Whether a unit carries information on the parameter, shape (n,) bool.

        The posterior must be narrower than the prior by more than `LEAST_FROM_DATA`, and by more than the standard
        error of a variance estimated from so many draws.
        """
        least = np.maximum(LEAST_FROM_DATA, np.sqrt(2 / self.draws))
        usable = np.isfinite(self.mean) & np.isfinite(self.sd) & (self.sd > 0)
        return usable & (self.from_data > least)

    @cached_property
    def likelihood(self) -> tuple[np.ndarray, np.ndarray]:
        """Estimate and variance of each unit with the prior divided out, (n,) each; 0 and ∞ without information."""
        precision = np.where(self.informative, 1 / self.sd**2 - 1 / self.prior_sd**2, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            variance = 1 / precision
            estimate = variance * (self.mean / self.sd**2 - self.prior_mean / self.prior_sd**2)
        return np.where(self.informative, estimate, 0.0), np.where(self.informative, variance, np.inf)

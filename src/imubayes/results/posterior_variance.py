"""Posterior variances of quantities, with their linear parts as control variates.

The variance of some thousand draws is known to two per cent, and a standard uncertainty with two digits has to be known
better.  The linear part u of q has a variance V that is known (`imubayes.results.linear_part`).  So
V + (s²(q) − s²(u)), both sample variances of the same draws, has the Monte Carlo error of the difference alone: that of
the nonlinear part.  V is the variance of u under the nested Laplace approximation.  Two findings end that:

- The sampled u hold what is not q.  A sum that is known a thousand times better than its members has a u with what is
  left of their bend beyond the second order.  The regression of u on q then has the slope 1, and that of q on u less;
  if it is q that bends, it is the other way round.  If the draws of q have the variance V, as they do if q is linear
  in what the data determine, V stands, with the Monte Carlo error of the draws that confirm it.
- The sampled u contradict V by more than their Monte Carlo error allows.  Then the posterior is not that of the
  approximation and the sample variance itself is taken: the curvature that Gauss–Newton neglects, for one, changes
  widths by some per cent.
"""

from dataclasses import dataclass

import numpy as np

CONTRADICTION_ERRORS = 4.0
"""Monte Carlo errors by which the sampled variance of a linear part may differ from the one that is known.

Origin: 4 standard deviations, exceeded by chance once in 16 000 quantities.  A smaller value gives up the sharper
estimate for the sampled one more often; a larger one overlooks a posterior that is not its approximation.
"""

MOST_WIDENED = 1.25
"""Factor by which a sampled standard deviation may contradict the approximation and its contributions be scaled.

Origin: Gauss–Newton neglects the curvature of the model, which changed one width of full-qualification by 3.5 %; shares
of contributions still hold then.  Beyond it the approximation is another distribution, and the difference stays in the
remainder, where the report names it.
"""

# Share of a sampled linear part that is not the quantity's, from which on it matters: half of what a budget may miss.
_LEFT = 0.01
# Relative spread below which a quantity does not vary.
_ROUNDING = 1e-13


@dataclass(frozen=True)
class KnownVariance:
    """The variance of a linear part, and its error: it is an average over draws of the noise scales."""

    value: float
    error: float


@dataclass(frozen=True)
class PosteriorVariance:
    """Variance of a quantity, its Monte Carlo error, its slope on the sampled linear part, and the widening of that.

    `follows` is whether that linear part is the quantity's own; if not, nothing is regressed on it.
    """

    value: float
    error: float
    slope: float = 1.0
    widened: float = 1.0
    follows: bool = True


def variance_of(values: np.ndarray, linear: np.ndarray, known: KnownVariance, effective: float) -> PosteriorVariance:
    """Return the variance of draws (S,); their linear part, (S,), serves as control variate if it has that known."""
    finite = np.isfinite(values)
    if not values[finite].std() > _ROUNDING * np.max(np.abs(values[finite])):
        return PosteriorVariance(0.0, 0.0)
    about, along = (each[finite] - each[finite].mean() for each in (values, linear))
    q, u = about**2, along**2
    effective = min(effective, float(len(q)))
    errors = {"plain": q.std(), "linear": u.std(), "difference": (q - u).std()}
    plain, of_linear, of_difference = (float(error) / np.sqrt(effective) for error in errors.values())
    # Slopes of the quantity on its linear part, and the other way round.
    product = float(np.mean(about * along))
    slope, back = (product / max(float(square.mean()), np.finfo(float).tiny) for square in (u, q))
    confirmed = float(np.hypot(plain, known.error))
    confirms = abs(float(q.mean()) - known.value) <= CONTRADICTION_ERRORS * confirmed
    if confirms and 1 - slope > max(_LEFT, abs(back - 1)):
        return PosteriorVariance(known.value, confirmed, follows=False)
    agrees = abs(float(u.mean()) - known.value) <= CONTRADICTION_ERRORS * np.hypot(of_linear, known.error)
    if agrees and of_difference < plain:
        value = known.value + float((q - u).mean())
        return PosteriorVariance(value, float(np.hypot(of_difference, known.error)), slope)
    widened = float(np.sqrt(u.mean() / known.value)) if not agrees and known.value > 0 else 1.0
    if max(widened, 1 / max(widened, _ROUNDING)) > MOST_WIDENED:
        widened = 1.0
    return PosteriorVariance(float(q.mean()), plain, slope if widened != 1.0 else 1.0, widened)

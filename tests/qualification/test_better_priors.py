"""The uncertainty that a better prior leaves, against fits with that prior: the scatter between runs is unknown."""

import numpy as np
import pytest

from imubayes_qualification.budgets.better_priors import BetterPriors, LinearGivenScales

# Four run means about bias + slope · input, with a scatter between runs: its prior is log-normal.
INPUTS = np.array([-1.0, -0.3, 0.4, 1.0])
DESIGN = np.stack([np.ones(4), INPUTS], axis=1)
MEANS = DESIGN @ np.array([0.4, -0.7]) + np.array([0.25, -0.2, 0.1, -0.15])
WITHIN, WIDTHS = 0.05, np.array([2.0, 2.0])
GRID = np.linspace(-6, 5, 1201)
QUANTITIES = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 2.0]])


def conditional(log_scatter: float, widths: np.ndarray, about: np.ndarray):
    """Covariance and mean of bias and slope, and the log density of the data, at one scatter, priors about a point."""
    noise = (WITHIN**2 + np.exp(2 * log_scatter)) * np.eye(4)
    covariance = np.linalg.inv(DESIGN.T @ np.linalg.solve(noise, DESIGN) + np.diag(widths**-2.0))
    mean = about + covariance @ DESIGN.T @ np.linalg.solve(noise, MEANS - DESIGN @ about)
    whole = noise + DESIGN @ np.diag(widths**2) @ DESIGN.T
    rest = MEANS - DESIGN @ about
    return covariance, mean, -0.5 * (np.linalg.slogdet(whole)[1] + rest @ np.linalg.solve(whole, rest))


def fitted(widths: np.ndarray, about: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Posterior variances of the quantities by integration over the scatter, and its posterior on the grid."""
    found = [conditional(value, widths, about) for value in GRID]
    density = np.array([log for *_, log in found]) - 0.5 * (GRID - np.log(0.1)) ** 2
    weight = np.exp(density - density.max())
    weight /= weight.sum()
    means = np.stack([QUANTITIES @ mean for _, mean, _ in found])
    variances = np.stack([np.sum(QUANTITIES @ covariance * QUANTITIES, axis=1) for covariance, *_ in found])
    return weight @ variances + weight @ (means - weight @ means) ** 2, weight


@pytest.mark.parametrize("factor", [1e-6, 0.5])
def test_a_better_prior_leaves_what_a_fit_with_it_leaves(factor):
    nothing = np.zeros(2)
    _, weight = fitted(WIDTHS, nothing)
    mode = conditional(GRID[weight.argmax()], WIDTHS, nothing)[1]
    scatter = GRID[np.searchsorted(np.cumsum(weight), (np.arange(4000) + 0.5) / 4000)]
    better = BetterPriors((3, 2))
    # What is left if the scatter is believed to be known as well as before.
    unmoved = np.zeros((3, 2))
    for value in scatter:
        covariance, mean, _ = conditional(value, WIDTHS, nothing)
        along, shift = QUANTITIES @ covariance, mean - mode
        variance, own = np.sum(along * QUANTITIES, axis=1), np.diagonal(covariance)
        reading = WIDTHS**2 * factor**2 / (1 - factor**2)
        better.add(LinearGivenScales(along, variance, QUANTITIES @ shift, own, shift), reading)
        unmoved += (variance[:, None] - along**2 / (own + reading)) / len(scatter)
    for prior in range(2):
        # The prior is narrowed by a reading at the mode: its mean moves with its width.
        widths = np.where(np.arange(2) == prior, factor * WIDTHS, WIDTHS)
        about = np.where(np.arange(2) == prior, (1 - factor**2) * mode, 0.0)
        expected, _ = fitted(widths, about)
        np.testing.assert_allclose(better.variance[:, prior], expected, rtol=0.02, atol=1e-9)
    if factor < 0.1:
        expected, _ = fitted(np.array([factor, 1.0]) * WIDTHS, np.array([mode[0], 0.0]))
        assert abs(unmoved[1, 0] / expected[1] - 1) > 0.1, "the scatter learns nothing from a prior"

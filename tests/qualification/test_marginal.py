"""The smooth marginal fitted to draws."""

import numpy as np
import pytest

from imubayes.qualification.marginal import FittedMarginal


def test_slopes_of_the_log_density_are_its_derivatives():
    y, at, step = np.linspace(-3.0, 3.0, 7), np.array([0.3, 0.2, -0.4, 0.1]), 1e-6

    def density(parameters: np.ndarray) -> FittedMarginal:
        location, log_scale, skewness, log_tail = parameters
        return FittedMarginal(location, np.exp(log_scale), skewness, np.exp(log_tail))

    steps = step * np.eye(4)
    numeric = [(density(at + s).log_density(y) - density(at - s).log_density(y)) / (2 * step) for s in steps]
    assert density(at).slopes(y) == pytest.approx(np.array(numeric), abs=1e-7)

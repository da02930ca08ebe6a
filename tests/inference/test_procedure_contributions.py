"""What each procedure tells agrees with the posterior: quantities without a gradient are left out."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from imubayes.inference.procedure_contributions import _gradients


def posterior(generator, quantity) -> Any:
    points = generator.normal(size=(4000, 3))
    rows = np.arange(len(points))
    return SimpleNamespace(points=points, derived_rows=rows, derived=quantity(points))


def test_a_linear_quantity_has_its_gradient_and_an_angle_near_zero_has_none():
    """An angle of two tilts about zero is their length: no linear function explains it."""
    generator = np.random.default_rng(0)
    made = posterior(
        generator, lambda z: np.stack([2 * z[:, 0] - z[:, 2], np.hypot(z[:, 0], z[:, 1]), 5 + 0 * z[:, 0]], axis=1)
    )
    gradients, linear = _gradients(made, 3, [0, 1, 2])
    np.testing.assert_allclose(gradients[0], [2, 0, -1], atol=1e-9)
    assert linear.tolist()[:2] == [True, False]

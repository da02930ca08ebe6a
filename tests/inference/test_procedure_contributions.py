"""What each procedure determines agrees with the posterior: quantities without a gradient are left out."""

import numpy as np

from imubayes.inference.procedure_contributions import _gradients_of_draws


def test_a_linear_quantity_has_its_gradient_and_an_angle_near_zero_has_none():
    """An angle of two tilts about zero is their length: no linear function explains it."""
    z = np.random.default_rng(0).normal(size=(4000, 3))
    values = np.stack([2 * z[:, 0] - z[:, 2], np.hypot(z[:, 0], z[:, 1]), np.full(len(z), 5.0)], axis=1)
    gradients, linear = _gradients_of_draws(z, values)
    np.testing.assert_allclose(gradients[0], [2, 0, -1], atol=1e-9)
    assert linear.tolist()[:2] == [True, False]

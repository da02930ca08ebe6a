"""Products of rotations along stretches of steps, by blocks."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imubayes.foundations.numerics import running_products


@pytest.mark.parametrize("steps", [1, 2, 7, 16, 23])
def test_every_product_is_that_of_the_steps_before_it(steps: int) -> None:
    matrices = Rotation.random(2 * steps, random_state=steps).as_matrix().reshape(2, steps, 3, 3)
    found = running_products(matrices)
    assert found.shape == (2, steps + 1, 3, 3)
    for stretch, own in zip(found, matrices, strict=True):
        expected = np.eye(3)
        np.testing.assert_array_equal(stretch[0], expected)
        for step, matrix in enumerate(own, 1):
            expected = expected @ matrix
            np.testing.assert_allclose(stretch[step], expected, atol=1e-14)

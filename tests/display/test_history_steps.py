"""Labels of a picture of steps stand apart, in order, and beside what they name."""

import numpy as np
import pytest

from imubayes.display.figures.history_steps import spread_apart


@pytest.mark.parametrize(
    ("values", "wanted"),
    [
        ([], []),
        ([3.0, 1.0], [3.0, 1.0]),
        ([2.80, 2.81], [2.305, 3.305]),
        ([2.81, 2.80], [3.305, 2.305]),
        ([0.0, 0.1, 5.0], [0.5, 1.5, 5.0]),
        ([4.0, 4.0, 4.0], [3.0, 4.0, 5.0]),
    ],
)
def test_labels_stand_apart(values, wanted):
    assert spread_apart(values, 1.0) == pytest.approx(wanted)


def test_of_many_none_is_closer_than_asked_for():
    values = np.random.default_rng(1).uniform(0, 3, 8)
    heights = np.array(spread_apart(values.tolist(), 0.7))
    assert np.diff(np.sort(heights)).min() > 0.7 - 1e-9
    assert list(np.argsort(heights)) == list(np.argsort(values))

"""Levels of a covariate: set points that scatter are levels, a continuum has none."""

import numpy as np
import pytest

from imubayes.criticism.formula_search import levels, library
from imubayes.responses.residual_covariates import ResidualCovariate


@pytest.mark.parametrize("count", [20, 51, 80, 1000])
def test_an_even_continuum_has_as_many_levels_as_values(count: int) -> None:
    values = np.random.default_rng(1).permutation(np.linspace(-40.0, 60.0, count))
    assert len(np.unique(levels(values))) == count


def test_set_points_that_scatter_are_levels() -> None:
    generator = np.random.default_rng(2)
    points = generator.permutation(np.repeat([-40.0, 0.0, 25.0, 60.0], 30))
    found = levels(points + generator.uniform(-0.5, 0.5, len(points)))
    assert [len(np.unique(found[points == point])) for point in (-40.0, 0.0, 25.0, 60.0)] == [1, 1, 1, 1]
    assert found.max() == 3


def test_a_constant_is_one_level() -> None:
    assert not levels(np.full(9, 3.5)).any()


def test_one_speed_in_both_directions_has_no_bump():
    speed = np.repeat([50.0, -50.0], 20)
    terms = library([ResidualCovariate("rate_i", "deg/s", speed, "rate along the input axis")], np.arange(40), 9.8)
    assert "power" in {term.sort for term in terms}
    assert "bump" not in {term.sort for term in terms}
    assert all(np.isfinite(term.values).all() for term in terms)

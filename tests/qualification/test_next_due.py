"""When the next calibration is due, by the drift between two and stated limits."""

import math

import numpy as np
import pytest

from imubayes.results.repeatability import ComparedQuantity
from imubayes_qualification.certificate.next_calibration import next_due


def due(first, first_sd, second, second_sd, apart, days=100.0, lower=-math.inf, upper=math.inf):
    compared = ComparedQuantity(
        name="gyro_bias.bias[gx]", unit="deg/h", first=first, first_sd=first_sd, second=second, second_sd=second_sd,
        difference=second - first, difference_sd=apart, common=0.0, e_n=0.0, p=1.0, moved=False,
    )  # fmt: skip
    return next_due(compared, days, lower, upper)


def test_an_exact_drift_reaches_the_limit_when_the_line_does():
    found = due(1.0, 1e-9, 2.0, 1e-9, 1e-9, upper=5.0)
    assert found.days == pytest.approx(300.0, rel=1e-2)
    assert found.rate == pytest.approx(365.25 / 100)
    assert due(1.0, 1e-9, 2.0, 1e-9, 1e-9, lower=-5.0).days is None
    assert due(2.0, 1e-9, 1.0, 1e-9, 1e-9, lower=-1.0).days == pytest.approx(200.0, rel=1e-2)


@pytest.mark.parametrize("common", [0.0, 0.09])
def test_the_uncertainty_is_that_of_a_line_through_both(common):
    """At the stated time the limit is k = 2 of the scatter of extrapolated draws away, common errors included."""
    first_sd, second_sd = 0.4, 0.5
    apart = math.sqrt(first_sd**2 + second_sd**2 - 2 * common)
    found = due(1.0, first_sd, 2.0, second_sd, apart, upper=12.0)
    assert found.days is not None
    covariance = [[first_sd**2, common], [common, second_sd**2]]
    first, second = np.random.default_rng(1).multivariate_normal([1.0, 2.0], covariance, 200_000).T
    later = second + (second - first) * found.days / 100.0
    assert later.mean() + 2 * later.std() == pytest.approx(12.0, rel=5e-3)


def test_what_is_not_within_its_limits_is_due_now():
    assert due(1.0, 0.1, 2.0, 0.1, 0.14, upper=2.1).days == 0.0
    # No drift: the uncertainty of the drift alone brings it to the limit in time.
    assert due(1.0, 0.1, 1.0, 0.1, 0.14, upper=2.0).days == pytest.approx(300.0, rel=0.2)

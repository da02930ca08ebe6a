"""The smooth marginal fitted to draws."""

import numpy as np
import pytest

from imubayes.results.marginal import Marginal
from imubayes_qualification.evaluation.fitted_marginal import FittedMarginal, _likeliest, fitted_to


def test_slopes_of_the_log_density_are_its_derivatives():
    y, at, step = np.linspace(-3.0, 3.0, 7), np.array([0.3, 0.2, -0.4, 0.1]), 1e-6

    def density(parameters: np.ndarray) -> FittedMarginal:
        location, log_scale, skewness, log_tail = parameters
        return FittedMarginal(location, np.exp(log_scale), skewness, np.exp(log_tail))

    steps = step * np.eye(4)
    numeric = [(density(at + s).log_density(y) - density(at - s).log_density(y)) / (2 * step) for s in steps]
    assert density(at).slopes(y) == pytest.approx(np.array(numeric), abs=1e-7)


@pytest.mark.parametrize("name", ["standard_t", "gamma"])
def test_condensed_draws_have_the_marginal_of_all(name):
    random = np.random.default_rng(3)
    draws = random.standard_t(4, 12_000) if name == "standard_t" else random.gamma(1.2, 1, 12_000)
    fitted = fitted_to(np.sort(draws))
    values = np.log(draws) if fitted.sign else draws
    whole, _ = _likeliest(values, np.full(len(values), 1 / len(values)), fitted.sign)
    for end in np.quantile(draws, [0.001, 0.025, 0.5, 0.975, 0.999]):
        assert fitted.probability(-np.inf, end) == pytest.approx(whole.probability(-np.inf, end), abs=1e-5)


def test_interval_and_errors_are_those_of_quantiles():
    draws = np.random.default_rng(4).gamma(2, 1, 999)
    found = Marginal(draws, 400.0)
    assert found.interval == pytest.approx(np.quantile(draws, [0.025, 0.975]), rel=1e-12)
    # Quantiles of bootstrap samples scatter as the error says.
    ends = np.random.default_rng(5).choice(draws, (2000, 400))
    assert found.errors.high == pytest.approx(np.quantile(ends, 0.975, axis=1).std(), rel=0.15)

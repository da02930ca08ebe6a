"""Sampling goes on until the digits asked for are deserved."""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from imubayes.api import fit
from imubayes.inference.run_fit import LAPLACE_DRAWS
from imubayes.results.marginal import Marginal, numerical_tolerance
from imubayes.results.posterior_quantities import draws_lacking, posterior_quantities
from imubayes.results.result import Result
from imubayes.results.summary import is_constant
from imubayes_qualification.evaluation.stated_digits import digits_deserved

ROOT = Path(__file__).parents[2]
CAMPAIGN, MODEL = ROOT / "data" / "accel-channel", ROOT / "models" / "accel-channel.toml"


def digits_of(marginal: Marginal) -> int:
    return digits_deserved(marginal.errors, marginal.sd).digits


def fewest_digits(result: Result) -> int:
    known = posterior_quantities(result)
    return min(digits_of(known.marginal(name)) for name in known.draws if not is_constant(known.draws[name]))


def test_the_draws_of_a_normal_posterior_leave_a_digit_whatever_it_is():
    """Twice the error of the 2.5 % quantile, √(p(1 − p)/n)/φ(z), against half a unit of the first digit of u."""
    u = np.linspace(0.95, 9.49, 500)
    error = u * np.sqrt(0.025 * 0.975) / stats.norm.pdf(stats.norm.ppf(0.025))
    allowed = np.array([numerical_tolerance(each, 1) for each in u])
    # The error itself is known to a sixth.
    assert (2 * error / np.sqrt(LAPLACE_DRAWS) <= allowed / (7 / 6)).all()
    # Fault planted: 4000 draws withhold nearly half of them.
    assert np.mean(2 * error / np.sqrt(4000) > allowed) > 0.3
    draws = 5.5 * np.random.default_rng(9).normal(size=LAPLACE_DRAWS)
    assert digits_of(Marginal(draws, float(LAPLACE_DRAWS))) == 1


@pytest.mark.slow
def test_draws_are_made_until_every_quantity_deserves_a_digit(monkeypatch):
    monkeypatch.setattr("imubayes.results.posterior_quantities.LAPLACE_DRAWS", 1000)
    result = fit(CAMPAIGN, MODEL, sample=False, until_digits=1)
    assert result.fit.posterior is not None
    # So few draws withhold some numbers.
    assert len(result.fit.posterior.points) > 1000
    assert fewest_digits(result) == 1
    lacking, name = draws_lacking(result.fit, 2)
    assert lacking > 1
    assert digits_of(posterior_quantities(result).marginal(name)) == 1


@pytest.mark.slow
def test_chains_are_continued_until_every_quantity_deserves_a_digit(tmp_path):
    result = fit(CAMPAIGN, MODEL, tmp_path / "result", until_digits=1)
    assert result.converged
    assert fewest_digits(result) == 1

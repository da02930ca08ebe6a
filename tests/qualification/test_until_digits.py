"""Sampling goes on until the digits asked for are deserved."""

from pathlib import Path

import pytest

from imubayes.api import fit
from imubayes.inference.run_fit import LAPLACE_DRAWS
from imubayes.qualification.digits import digits_deserved
from imubayes.qualification.posterior_quantities import posterior_quantities
from imubayes.qualification.until_digits import draws_lacking
from imubayes.results.estimates import is_constant
from imubayes.results.result import Result

ROOT = Path(__file__).parents[2]
CAMPAIGN, MODEL = ROOT / "data" / "accel-channel", ROOT / "models" / "accel-channel.toml"


def fewest_digits(result: Result) -> int:
    known = posterior_quantities(result)
    return min(
        digits_deserved(known.marginal(name)).digits for name in known.draws if not is_constant(known.draws[name])
    )


def test_draws_are_made_until_every_quantity_deserves_a_digit():
    result = fit(CAMPAIGN, MODEL, sample=False, until_digits=1)
    assert result.fit.posterior is not None
    # 4000 draws withhold some numbers.
    assert len(result.fit.posterior.points) > LAPLACE_DRAWS
    assert fewest_digits(result) == 1
    lacking, name = draws_lacking(result.fit, 2)
    assert lacking > 1
    assert digits_deserved(posterior_quantities(result).marginal(name)).digits == 1


@pytest.mark.slow
def test_chains_are_continued_until_every_quantity_deserves_a_digit(tmp_path):
    result = fit(CAMPAIGN, MODEL, tmp_path / "result", until_digits=1)
    assert result.converged
    assert fewest_digits(result) == 1

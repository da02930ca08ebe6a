"""Sampling goes on until the digits asked for are deserved."""

from pathlib import Path

import numpy as np
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
    before, after = (fit(CAMPAIGN, MODEL, sample=False, until_digits=digits) for digits in (None, 1))
    assert before.fit.posterior is not None
    assert after.fit.posterior is not None
    assert len(before.fit.posterior.points) == LAPLACE_DRAWS
    # 4000 draws withhold some numbers; what is lacking says how many more there have to be.
    lacking, name = draws_lacking(before.fit, 1)
    assert (fewest_digits(before), fewest_digits(after)) == (0, 1)
    assert digits_deserved(posterior_quantities(before).marginal(name)).digits == 0
    assert lacking > 1
    assert len(after.fit.posterior.points) > lacking * LAPLACE_DRAWS
    # The first draws are the same: the mode and what was asked for change nothing else.
    np.testing.assert_array_equal(after.fit.z, before.fit.z)


@pytest.mark.slow
def test_chains_are_continued_until_every_quantity_deserves_a_digit(tmp_path):
    result = fit(CAMPAIGN, MODEL, tmp_path / "result", until_digits=1)
    assert result.converged
    assert fewest_digits(result) == 1

"""What each procedure determines agrees with the posterior, on every shipped campaign with several procedures."""

import numpy as np
import pytest
from combination_scores import ROOT, fitted

CAMPAIGNS = [
    "accel-channel",
    pytest.param("trihedral-imu", marks=pytest.mark.slow),
    pytest.param("full-qualification", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_contributions_agree_with_the_posterior(name):
    summary = fitted(ROOT / "data" / name, name).summary
    derived = {each.name: each for each in (*summary.derived, *summary.combinations)}
    assert summary.contributions
    for each in summary.contributions:
        quantity = derived[each.quantity]
        assert each.sd == quantity.sd
        for share in each.by:
            # A part of the data determines no more than all of them, and no less than the prior; both are from draws.
            assert each.sd <= min(share.alone, share.without)
            assert max(share.alone, share.without) <= quantity.prior_sd
        # If one procedure determines nearly all, it alone is about as good as all together.  Of a sum of parameters
        # another one may determine a member, and of the sum nothing.
        best = min(each.by, key=lambda share: share.alone)
        single = quantity in summary.derived
        if single and all(share.alone > 0.9 * quantity.prior_sd for share in each.by if share is not best):
            assert best.alone < 1.25 * each.sd, each


@pytest.mark.parametrize("name", ["polar-tumble"])
def test_a_nominal_scale_factor_is_exact(name):
    """The torquer's scale factor is no parameter of this model: its draws differ by rounding alone."""
    (scale,) = [each for each in fitted(ROOT / "data" / name, name).summary.derived if each.name == "scale_factor[g]"]
    assert (scale.mean, scale.sd, scale.q025, scale.q975) == (scale.mean, 0.0, scale.mean, scale.mean)
    assert np.isclose(scale.mean, 0.01, rtol=1e-15)
    assert scale.prior_sd == 0.0
    assert scale.from_data is None

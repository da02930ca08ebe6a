"""Conformity of 2000 simulated units, each fitted by the product."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from conforming_units import MODEL, UNITS, Shares, fitted_units, marginals_of, study, unit_of

from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes_archive.unit_fits.fit_unit import joint_normal_vectors


@pytest.fixture(scope="module")
def found() -> tuple[Shares, Shares]:
    honest, faulty, _ = study(UNITS)
    return honest, faulty


@pytest.mark.slow
def test_of_units_with_p_c_of_90_percent_90_percent_are_inside(found):
    share, count = found[0].at_90
    assert count >= 400
    assert share == pytest.approx(0.90, abs=0.03)


@pytest.mark.slow
def test_guard_band_accepts_at_the_stated_risk(found):
    honest = found[0]
    share, count = honest.at_guard
    assert count >= 400
    assert share == pytest.approx(0.05, abs=0.015)
    assert honest.accepted_wrongly == pytest.approx(honest.stated, rel=0.25)
    assert honest.withheld < 0.01


@pytest.mark.slow
def test_an_understated_uncertainty_goes_red(found):
    """The planted fault, u understated 1.5 times."""
    faulty = found[1]
    assert faulty.at_90[0] < 0.87
    assert faulty.at_guard[0] > 0.065
    assert faulty.accepted_wrongly > 1.25 * faulty.stated


@pytest.mark.slow
def test_units_side_by_side_have_the_posterior_of_imubayes_fit():
    for seed, (_, side_by_side) in enumerate(fitted_units(range(4))):
        model = bind(MODEL, unit_of(seed)[1])
        # The same normal vectors: what differs is not Monte Carlo error.
        alone = marginals_of(joint_fit(model, None, laplace_draws=joint_normal_vectors(*model.problem.size)))
        for name, marginal in side_by_side.items():
            assert marginal.mean == pytest.approx(alone[name].mean, abs=0.02 * alone[name].sd)
            assert marginal.sd == pytest.approx(alone[name].sd, rel=0.05)
            assert np.isfinite(marginal.draws).all()

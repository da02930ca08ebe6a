"""A quantity that the data do not determine is not zero: record and page list it as not measured."""

from dataclasses import replace

import numpy as np
import pytest

from imubayes.criticism.diagnosis_record import Diagnosis, RankedEffect
from imubayes.criticism.explanation_records import CoefficientEstimate
from imubayes.results.posterior_quantities import PosteriorQuantities
from imubayes.results.summary import Quantity
from imubayes.results.temperature_range import ThermalModel
from imubayes_qualification.budgets.standard_quantities import STANDARD_QUANTITIES
from imubayes_qualification.budgets.unit_under_test import TestedUnit, with_standards
from imubayes_qualification.certificate.report_estimates import _not_measured, _screened, standard_estimates
from small_campaign import channels

SIZE = 4000
QUANTITIES = {
    # name: unit, mean, sd, share of the information from the data
    "scale_factor[gx]": ("pulse/s per deg/s", 1000.0, 0.0, None),
    "gyro_bias.bias[gx]": ("deg/h", 5.0, 0.1, 0.99),
    "gyro_g2_sensitivity.d_io[gx]": ("deg/h/g^2", 0.0, 0.1, 0.02),
    "gyro_g_sensitivity.d_i[gx]": ("deg/h/g", 0.3, 0.1, 0.49),
    "gyro_g_sensitivity.d_o[gx]": ("deg/h/g", 0.3, 0.1, 0.51),
    "gyro_misalignment.toward_o[gx]": ("arcsec", 10.0, 1.0, 0.9),
    "gyro_misalignment.toward_s[gx]": ("arcsec", 10.0, 9.0, 0.1),
}


def unit() -> TestedUnit:
    random = np.random.default_rng(8)
    entries = {
        name: Quantity(name=name, unit=given, mean=mean, sd=sd, from_data=share)
        for name, (given, mean, sd, share) in QUANTITIES.items()
    }
    draws = {name: mean + sd * random.standard_normal(SIZE) for name, (_, mean, sd, _) in QUANTITIES.items()}
    known = PosteriorQuantities(entries, draws, dict.fromkeys(entries, float(SIZE)))
    made = TestedUnit(known, channels()[:1], {}, 9.8, None, ThermalModel({}, {}, 25.0))
    quantities, lengths = with_standards(made)
    return replace(made, quantities=quantities, lengths=lengths)


def test_priors_and_nominal_values_are_not_measured():
    lines = {each.symbol: each for each in standard_estimates(unit())}
    measured = {symbol for symbol, each in lines.items() if each.measured}
    assert measured == {"D_F", "D_O", "Θ_O"}
    # A length is measured if both of its components are.
    assert not lines["Θ"].measured
    listed = {each.symbol: each for each in _not_measured(list(lines.values()))}
    assert set(listed) == {"S", "D_IO", "D_I", "Θ_S", "Θ"}
    assert all(each.reason == "not_measured" and each.labels == ("gx",) for each in listed.values())
    assert listed["S"].from_data is None
    assert listed["D_IO"].from_data == pytest.approx(0.02)


def test_a_quantity_has_the_one_step_estimate_of_its_own_coefficient_alone():
    """D_IO is not d_ss of the same effect, and f(I) is no coefficient."""
    of = {each.key: each for each in STANDARD_QUANTITIES}
    known = ("gyro_g2_sensitivity.d_ss", "gyro_g2_sensitivity.d_io", "gyro_scale_cubic.cubic")
    lines = [
        RankedEffect(
            effect=name.partition(".")[0], channels=("gx",), probability=0.1, delta_chi2=1.0, shape={}, log_odds=0.0,
            coefficients=(CoefficientEstimate(name=f"{name}[gx]", value=1.0, sd=0.1, unit="x"),),
        )
        for name in known
    ]  # fmt: skip
    found = Diagnosis(verdict="adequate", result="", ranking=tuple(lines))
    assert [each.name for each in _screened(of["gyro_g2_sensitivity_io"], found)] == ["gyro_g2_sensitivity.d_io[gx]"]
    assert _screened(of["gyro_g2_sensitivity_oo"], found) == ()
    assert _screened(of["nonlinearity"], found) == ()

"""Numbers as in GUM 7.2.6, against cases worked by hand."""

import math

import pytest

from imubayes.display.loop.history import elpd_text
from imubayes.display.numbers_and_labels import concise, percent, ratio_text, significant, value_and_sd, with_minus
from imubayes.loop.model_history import CrossValidation
from imubayes.results.marginal import numerical_tolerance
from imubayes_qualification.display.report.words import risk_text


@pytest.mark.parametrize(
    ("value", "sd", "expected"),
    [
        (12.3456, 0.0213, ("12.346", "0.021")),
        (100.02147, 0.00035, ("100.02147", "0.00035")),  # the mass standard of GUM 7.2.2
        (1.0, 0.0996, ("1.00", "0.10")),  # rounding carries into a new digit
        (-0.004, 0.21, ("0.00", "0.21")),  # no negative zero
        (1234.5, 168.1, ("1230", "170")),
        (1000.1796, 0.00502, ("1000.1796", "0.0050")),
        (5, 1, ("5.0", "1.0")),
        (3.2e-7, 1.4e-8, ("3.20e-07", "0.14e-07")),
        (0.0, 0.5, ("0.00", "0.50")),
        (2.34567891, 0.0, ("2.34568", "0")),  # no uncertainty: six digits
        (None, None, ("–", "–")),
        (math.nan, 1.0, ("–", "1.0")),
    ],
)
def test_value_is_rounded_by_its_uncertainty(value, sd, expected):
    assert value_and_sd(value, sd) == expected


@pytest.mark.parametrize(
    ("value", "sd", "expected"),
    [
        (54.735612, 0.000361, "54.73561(36)"),
        (12.3456, 2.13, "12.3(2.1)"),
        (1000.18, 0.0996, "1000.18(10)"),
        (7.0, 0.0, "7.00000"),
        (-0.00013, 0.00023, "-0.00013(23)"),
        (0.0, 0.5, "0.00(50)"),
        (3.1, 12.5, "3(12)"),
        (3.0e-9, 2.0e-10, "3.00e-09 ± 0.20e-09"),
    ],
)
def test_concise_notation(value, sd, expected):
    assert concise(value, sd) == expected


@pytest.mark.parametrize(
    ("share", "expected"),
    [
        (0.0, "0 %"), (-0.02, "0 %"), (0.099, "10 %"), (0.123, "12 %"), (0.949, "95 %"), (0.973, "97.3 %"),
        (0.9989, "99.8 %"), (0.99967, "99.96 %"), (0.9999, "99.99 %"), (0.999999, "> 99.99 %"), (1.0, "> 99.99 %"),
        (None, "–"),
    ],
)  # fmt: skip
def test_share_is_never_rounded_to_certainty(share, expected):
    assert percent(share) == expected


@pytest.mark.parametrize(
    ("value", "digits", "expected"),
    [(381.2, 2, "380"), (0.012345, 3, "0.0123"), (2251.3, 4, "2251"), (0, 3, "0"), (1.2e-9, 3, "1.20e-09")],
)
def test_significant_digits(value, digits, expected):
    assert significant(value, digits) == expected


@pytest.mark.parametrize(
    ("value", "expected"), [(0.4101, "0.41"), (9.998, "10.00"), (12.34, "12.3"), (123456.0, "1.2e+05"), (None, "–")]
)
def test_ratio(value, expected):
    assert ratio_text(value) == expected


def test_a_number_that_nothing_changes_has_no_digits_of_rounding():
    """A nominal scale factor over thousands of equal draws: 0.0100000000000000054 ± 3.5e-18 says nothing."""
    assert value_and_sd(0.0100000000000000054, 3.5e-18) == ("0.0100000", "0")
    assert value_and_sd(0.0, 0.0)[1] == "0"
    assert value_and_sd(1.0, 1e-9) != ("1.0000", "0")


@pytest.mark.parametrize(
    ("value", "printed"),
    [(0.0325, "0.032"), (0.0375, "0.038"), (0.0345, "0.034"), (0.995, "1.0"), (0.0995, "0.10"), (9.95, "10"),
     (99.5, "100"), (0.0315, "0.032"), (12.5, "12")],
)  # fmt: skip
def test_one_number_has_one_rounding(value, printed):
    """Half to even of the number as it is written (ISO 80000-1, B.3), wherever it is printed, and two digits of it."""
    alone, beside = significant(value, 2), value_and_sd(10 * value, value)[1]
    assert (alone, beside) == (printed, printed)
    assert risk_text(value / 100) == f"{printed} %"
    assert float(printed) == pytest.approx(value, abs=numerical_tolerance(value, 2) * (1 + 1e-9))


@pytest.mark.parametrize(
    ("text", "printed"), [("-1.5e-11", "−1.5e-11"), ("1.8e-06", "1.8e-06"), ("-22.4 ± 1.8", "−22.4 ± 1.8")]
)
def test_a_negative_number_has_a_minus_sign_and_its_exponent_a_hyphen(text, printed):
    assert with_minus(text) == printed


@pytest.mark.parametrize(
    ("delta", "se", "printed"), [(303.14, 88.2, "+303 ± 88"), (-54.2, 11.3, "−54 ± 11"), (0.031, 0.24, "+0.03 ± 0.24")]
)
def test_the_gain_of_cross_validation_has_the_digits_of_its_error(delta, se, printed):
    assert elpd_text(CrossValidation(by="run", delta=delta, se=se, helped=1, of=2, verdict="helps")) == printed

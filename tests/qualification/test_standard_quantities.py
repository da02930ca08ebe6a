"""Quantities of the standards from known parameters, and the inputs that they are defined at."""

import numpy as np
import polars as pl
import pytest

from imubayes.results.posterior_quantities import PosteriorQuantities
from imubayes.results.summary import Quantity
from imubayes_qualification.budgets.standard_quantities import STANDARD_QUANTITIES, UnitUnderTest, draws_of_standard
from imubayes_qualification.budgets.unit_under_test import inputs_over_range
from small_campaign import channels

RATES = np.array([-300.0, -150, -60, -20, -10, 0, 10, 20, 60, 150, 300])
ASYMMETRY, QUADRATIC, CUBIC = 12.38, 0.02, 1e-4  # ppm, ppm per deg/s, ppm per (deg/s)²


def unit(inputs: np.ndarray) -> UnitUnderTest:
    values = {
        "gyro_scale_asymmetry.asymmetry[gx]": ("ppm", ASYMMETRY),
        "gyro_scale_quadratic.quadratic[gx]": ("ppm/(deg/s)", QUADRATIC),
        "gyro_scale_cubic.cubic[gx]": ("ppm/(deg/s)^2", CUBIC),
    }
    entries = {name: Quantity(name=name, unit=given) for name, (given, _) in values.items()}
    draws = {name: np.full(5, value) for name, (_, value) in values.items()}
    known = PosteriorQuantities(entries, draws, dict.fromkeys(values, 5.0))
    return UnitUnderTest(known, channels()[:1], {"gx": inputs}, 9.8)


def of(key: str, inputs: np.ndarray) -> float:
    quantity = next(each for each in STANDARD_QUANTITIES if each.key == key)
    (found,) = draws_of_standard(quantity, unit(inputs))
    return float(found.draws[0])


@pytest.mark.parametrize("rates", [RATES, RATES[3:], np.sort([*RATES, 0]), np.array([-100.0, -50, 50, 100])])
def test_nonlinearity_and_asymmetry_are_at_the_rates_that_were_run(rates):
    def error(rate: np.ndarray) -> np.ndarray:
        return ASYMMETRY * np.abs(rate) + QUADRATIC * rate**2 + CUBIC * rate**3

    apart = error(rates) - np.polyval(np.polyfit(rates, error(rates), 1), rates)
    assert of("nonlinearity", rates) == pytest.approx(np.abs(apart).max() / np.abs(rates).max(), rel=1e-6)
    above, below = (np.polyfit(side, error(side), 1)[0] for side in (rates[rates >= 0], rates[rates <= 0]))
    assert of("asymmetry", rates) == pytest.approx(above - below, rel=1e-6)


def rows(run: str, procedure: str, kind: str, channel: str, inputs: np.ndarray) -> pl.DataFrame:
    return pl.DataFrame({"input_observed": inputs}).with_columns(
        run=pl.lit(run), procedure=pl.lit(procedure), kind=pl.lit(kind), channel=pl.lit(channel)
    )


def test_inputs_are_those_of_the_runs_over_the_range():
    """An inclined axis, another axis's run and an injected current are no test of linearity."""
    noise = 0.02 * np.random.default_rng(3).normal(size=(3, len(RATES)))
    table = pl.concat([
        rows("x-up", "rate_table", "gyro", "gx", RATES + noise[0]),
        rows("y-up", "rate_table", "gyro", "gx", noise[1]),
        rows("pyramid", "rate_table", "gyro", "gx", RATES * 0.577 + noise[2]),
        rows("head", "dividing_head", "accelerometer", "ax", np.cos(np.arange(8) * np.pi / 4)),
        rows("inject", "current_injection", "accelerometer", "ax", np.array([12.0, 12.0])),
    ])  # fmt: skip
    found = inputs_over_range(table)
    np.testing.assert_allclose(found["gx"], RATES, atol=0.1)
    np.testing.assert_allclose(found["ax"], np.sort(np.cos(np.arange(8) * np.pi / 4)), atol=1e-9)

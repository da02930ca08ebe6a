"""From the table of a batch to populations: the latest campaign of a unit counts, on the scale of its prior."""

import datetime

import numpy as np
import polars as pl
import pytest

from imubayes_archive.population.parameter_population import populations
from imubayes_archive.unit_fits.posterior_table import (
    Outcome,
    Quantities,
    UnitIdentity,
    UnitPosterior,
    parameter_table,
    unit_table,
)

UNITS = 60


def tables(outlier: float = 0.0) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Return a batch of 60 units: a bias N(5, 2²) under N(0, 10²) and a positive scale of median 3, spread 0.4."""
    random, found = np.random.default_rng(3), []
    for place in range(UNITS):
        bias = random.normal(5, 2) + (outlier if place == 7 else 0.0)
        scale = np.log(3.0) + random.normal(0, 0.4)
        for year in (2023, 2024):
            # Only the first calibration is wrong: the population must not see it.
            wrong = 100.0 if year == 2023 else 0.0
            found.append(_unit(f"U{place:02d}", year, random.normal(bias + wrong, 1.0), random.normal(scale, 0.1)))
    found.append(UnitPosterior(UnitIdentity("X", "c", "x", "x.parquet"), Outcome("failed", "damaged")))
    return parameter_table("m", found), unit_table("m", "code", found)


def _unit(name: str, year: int, bias: float, log_scale: float) -> UnitPosterior:
    sd = (1 + 1 / 100) ** -0.5
    share = 1 - 0.1**2 / 0.8**2
    median, square = np.log(2.0), 0.8**2
    prior_mean = np.exp(median + square / 2)
    z = np.array([-1.96, -0.674, 0.0, 0.674, 1.96])
    middle = log_scale + (median - log_scale) * (1 - share)
    width = 0.1 * np.sqrt(share)
    parts = (
        Quantities("parameter", ("bias[ax]",), ("ug",), np.array([bias * sd**2]), np.array([sd]),
                   (bias * sd**2 + sd * z)[:, None], np.array([0.0]), np.array([10.0]), np.array([1 - sd**2 / 100])),
        Quantities("noise", ("noise[ax]",), ("ug",), np.array([np.exp(middle)]), np.array([np.exp(middle) * width]),
                   np.exp(middle + width * z)[:, None], np.array([prior_mean]),
                   np.array([prior_mean * np.sqrt(np.expm1(square))]), np.array([share])),
    )  # fmt: skip
    identity = UnitIdentity(name, str(year), f"{name}-{year}", "f", datetime.date(year, 5, 6))
    return UnitPosterior(identity, Outcome("fitted"), parts, np.eye(2))


def test_each_parameter_has_its_population_on_the_scale_of_its_prior():
    found, units = populations(*tables())
    bias, noise = found.parameters
    assert (found.units, found.campaigns, found.left_out) == (UNITS + 1, 2 * UNITS + 1, 1)
    assert (bias.scale, noise.scale) == ("linear", "log")
    assert bias.mean == pytest.approx(5.0, abs=2 * bias.mean_sd)
    assert bias.spread == pytest.approx(2.0, abs=2 * bias.spread_sd)
    assert noise.mean == pytest.approx(np.log(3.0), abs=2 * noise.mean_sd)
    assert noise.spread == pytest.approx(0.4, abs=2 * noise.spread_sd)
    assert units.height == 2 * UNITS
    assert units["digest"].str.ends_with("2024").all()
    assert bias.outlying == ()


def test_an_outlying_unit_is_named():
    found, units = populations(*tables(outlier=15.0))
    bias = found.parameters[0]
    assert [each.unit for each in bias.outlying] == ["U07"]
    assert abs(bias.outlying[0].distance) > 4
    assert units.filter(pl.col("outlying"))["unit"].to_list() == ["U07"]
    table = found.to_polars()
    assert table["outlying"].to_list() == [["U07"], []]
    assert table["mean"].to_list() == [each.mean for each in found.parameters]

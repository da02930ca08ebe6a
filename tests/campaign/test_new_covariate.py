"""Adding a covariate is adding one entry to the registry: every part of the program then knows it."""

import numpy as np
import polars as pl
import pytest

from imubayes.campaign import load_campaign
from imubayes.criticism.formula_search import library
from imubayes.display.figures.panels import abscissa
from imubayes.display.residual_columns import covariates_of, numbers
from imubayes.foundations.covariates import COVARIATES, Covariate
from imubayes.foundations.signal_path_state import Ambient
from imubayes.foundations.units import same_dimension
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import bind
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.procedures import PROCEDURES
from imubayes.responses.residual_covariates import covariates
from imubayes.results.result import Predicted, residual_table

HUMIDITY = Covariate("humidity", "humidity_pct", "%", "1", "relative humidity", symbol="H")


@pytest.fixture
def moist(small, monkeypatch):
    """The small campaign with a column that a toy entry of the registry explains."""
    monkeypatch.setitem(COVARIATES, HUMIDITY.name, HUMIDITY)
    file = small / "runs" / "positions.csv"
    table = pl.read_csv(file)
    percent = pl.Series("humidity_pct", np.linspace(30.0, 60.0, table.height))
    table.with_columns(percent).write_csv(file)
    return load_campaign(small)


def test_a_new_covariate_is_read_shown_and_regressed_on(moist):
    run = next(run for run in moist.runs if run.name == "positions")
    np.testing.assert_allclose(run.covariates["humidity"], np.linspace(0.3, 0.6, run.rows))
    assert "humidity" in PROCEDURES[run.procedure].stimulus(run, moist).supplies

    spec = ModelSpec("small", tuple(EffectSpec(name) for name in ("gyro_bias", "accel_bias", "white_noise")))
    # What is reported of the readings needs no fit: a prediction of one pulse/s, at the middle of the priors.
    model = bind(spec, moist)
    fit = Fit(model, *map(np.zeros, model.problem.size), True)
    np.testing.assert_array_equal(np.unique(np.asarray(fit.model.problem.nodes.ambient.humidity))[[0, -1]], [0, 0.6])
    table = residual_table(model, Predicted(*np.ones((4, len(model.entries))))).table
    assert np.nanmax(numbers(table, "humidity_pct")) == pytest.approx(60.0)
    assert HUMIDITY in covariates_of(table)
    assert abscissa(numbers(table, "humidity_pct"), HUMIDITY)[1] == "relative humidity / %"

    found = covariates(fit)
    regressor = next(each for each in found if each.name == "humidity_pct")
    assert np.nanmax(regressor.values) == pytest.approx(60.0)
    terms = library([regressor], np.isfinite(regressor.values), moist.site.gravity)
    assert terms[0].expression == "sample.ambient.humidity ** 1"
    assert terms[0].needs == ("humidity",)


def test_an_unknown_covariate_names_the_known_ones():
    with pytest.raises(AttributeError, match=r"no covariate 'humidity'.*temperature"):
        _ = Ambient().humidity


@pytest.mark.parametrize("covariate", COVARIATES.values(), ids=lambda covariate: covariate.name)
def test_units_of_an_entry_agree(covariate):
    assert same_dimension(covariate.unit, covariate.si)
    assert covariate.factor() > 0


def test_columns_and_symbols_are_distinct():
    columns = [covariate.column for covariate in COVARIATES.values()]
    symbols = [covariate.symbol for covariate in COVARIATES.values() if covariate.symbol]
    assert len(set(columns)) == len(columns)
    assert len(set(symbols)) == len(symbols)

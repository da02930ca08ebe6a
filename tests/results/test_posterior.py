"""The posterior as an ArviZ tree: real dimensions, the same draws in memory and on disk, and ArviZ draws it."""

from pathlib import Path

import arviz_plots
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray

from imubayes.api import Result, fit
from imubayes.results.posterior_draws import draws_of
from imubayes.results.result import read_result

ROOT = Path(__file__).parents[2]
SCALE = "gyro_scale_factor.scale"


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Result:
    folder = tmp_path_factory.mktemp("posterior") / "result"
    return fit(ROOT / "data" / "trihedral-imu", ROOT / "models" / "trihedral-imu.toml", folder, sample=False)


@pytest.fixture(scope="module")
def tree(result) -> xarray.DataTree:
    return result.posterior


def test_labels_are_dimensions(result, tree):
    posterior = tree.posterior
    assert posterior[SCALE].dims == ("chain", "draw", "channel")
    assert posterior["mounting_angle"].dims == ("chain", "draw", "channel", "mounting")
    estimates = {line.name: line for line in (*result.summary.parameters, *result.summary.derived)}
    scale = posterior[SCALE].sel(channel="gx")
    assert float(scale.mean()) == pytest.approx(estimates[f"{SCALE}[gx]"].mean)
    angle = posterior["mounting_angle"].sel(channel="ax", mounting="pyramid")
    assert float(angle.std(skipna=True)) == pytest.approx(estimates["mounting_angle[ax,pyramid]"].sd)
    assert bool(np.isnan(posterior[SCALE].sel(channel="ax")).all()), "an accelerometer has no gyro scale factor"


def test_every_quantity_of_the_summary_has_draws(result, tree):
    names = [line.name for line in (*result.summary.parameters, *result.summary.derived)]
    assert list(draws_of(tree, names)) == names


def test_the_file_holds_the_same(result, tree):
    stored = read_result(result.folder)
    assert stored.summary == result.summary
    assert stored.residuals.table.equals(result.residuals.table)
    for group in ("posterior", "prior", "log_likelihood"):
        xarray.testing.assert_equal(stored.posterior[group].to_dataset(), tree[group].to_dataset())


def test_summary_and_residuals_as_data_frames(result):
    frame = result.to_dataframe()
    assert frame.height == len(result.summary.parameters) + len(result.summary.derived)
    scale = frame.filter(frame["name"] == "scale_factor[gx]").row(0, named=True)
    line = next(quantity for quantity in result.summary.derived if quantity.name == "scale_factor[gx]")
    assert (scale["kind"], scale["mean"], scale["sd"]) == ("derived", line.mean, line.sd)
    residuals = result.residuals.to_dataframe()
    assert {"run", "channel", "residual", "whitened"} <= set(residuals.columns)


@pytest.mark.filterwarnings("ignore:Your data appears to have a single value or no finite values")
@pytest.mark.parametrize(
    "plot", ["plot_dist", "plot_trace_dist", "plot_forest", "plot_ess", "plot_rank", "plot_autocorr", "plot_ridge"]
)
def test_arviz_plots_the_posterior(tree, plot):
    getattr(arviz_plots, plot)(tree, var_names=["gyro_bias.bias", "scale_factor"])
    plt.close("all")


@pytest.mark.filterwarnings("ignore:Your data appears to have a single value or no finite values")
def test_arviz_plots_prior_and_posterior(tree):
    arviz_plots.plot_prior_posterior(tree, var_names=["gyro_bias.bias", "scale_factor"])
    plt.close("all")

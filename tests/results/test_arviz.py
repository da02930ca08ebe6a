"""ArviZ on a sampled result: its functions run without options, and its diagnostics mean what they say."""

import subprocess
import sys
from pathlib import Path

import arviz_plots
import arviz_stats
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray

from imubayes.api import fit
from imubayes.inference.chains import Chains, Settings
from imubayes.inference.convergence import Convergence
from imubayes.results.posterior_groups import by_ensemble
from imubayes.results.result import read_result

ROOT = Path(__file__).parents[2]
STATS = (
    "summary",
    "ess",
    "rhat",
    "mcse",
    "diagnose",
    "eti",
    "hdi",
    "mean",
    "median",
    "mode",
    "std",
    "mad",
    "kde",
    "loo",
)
PLOTS = (
    "plot_dist", "plot_forest", "plot_ridge", "plot_trace", "plot_trace_dist", "plot_rank", "plot_ess", "plot_mcse",
    "plot_autocorr", "plot_ess_evolution", "plot_convergence_dist", "plot_parallel", "plot_prior_posterior",
    "plot_ppc_dist", "plot_ppc_pit", "plot_ppc_tstat", "plot_ppc_interval", "plot_loo_pit",
)  # fmt: skip


# Of every kind at every run of the tests.
AT_ONCE = ("plot_dist", "plot_trace", "plot_rank", "plot_ess", "plot_prior_posterior", "plot_ppc_dist", "plot_loo_pit")


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> xarray.DataTree:
    """The file of a sampled fit, read again."""
    folder = tmp_path_factory.mktemp("sampled") / "result"
    campaign, model = ROOT / "data" / "accel-channel", ROOT / "models" / "accel-channel.toml"
    fit(campaign, model, folder, settings=Settings(most_steps=10))
    return read_result(folder).posterior


def test_a_chain_is_an_ensemble(tree):
    assert tree.posterior.sizes["chain"] == 4
    assert tree.posterior.sizes["draw"] > 400
    assert tree.sample_stats["lp"].shape == (4, tree.posterior.sizes["draw"])


@pytest.mark.slow
def test_arviz_is_imported_after_a_fit_as_well_as_before():
    """ArviZ looks at all modules when it is imported; a lazily loaded part of it would be imported half-made."""
    code = "import imubayes; imubayes.fit; import imubayes.inference.convergence; import arviz_plots"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_file_is_what_xarray_would_write(tmp_path):
    """Names, labels, units, attributes and values, for groups with and without chains."""
    campaign, model = ROOT / "data" / "accel-channel", ROOT / "models" / "accel-channel.toml"
    result = fit(campaign, model, tmp_path / "result", sample=False)
    result.posterior.to_netcdf(str(tmp_path / "xarray.nc"), engine="h5netcdf")
    with (
        xarray.open_datatree(tmp_path / "result" / "posterior.nc", engine="h5netcdf") as written,
        xarray.open_datatree(tmp_path / "xarray.nc", engine="h5netcdf") as expected,
    ):
        assert written.attrs == expected.attrs
        xarray.testing.assert_identical(written, expected)
        assert set(written["log_likelihood"].coords) == {"chain", "draw", "entry", "run", "channel", "row"}


def test_the_summary_of_arviz_has_a_number_everywhere(tree):
    summary = arviz_stats.summary(tree, round_to="none")
    assert np.isfinite(summary.to_numpy(dtype=float)).all()
    assert summary["r_hat"].max() < 1.02


# The shortened chains leave one or two entries with uncertain importance weights, of which ArviZ warns.
@pytest.mark.filterwarnings("ignore:Estimated shape parameter of Pareto distribution")
@pytest.mark.parametrize("name", STATS)
def test_statistics_run_without_options(tree, name):
    assert getattr(arviz_stats, name)(tree) is not None or name == "diagnose"


@pytest.mark.filterwarnings("ignore:Estimated shape parameter of Pareto distribution")
@pytest.mark.parametrize(
    "name", [name if name in AT_ONCE else pytest.param(name, marks=pytest.mark.slow) for name in PLOTS]
)
def test_plots_run_without_options(tree, name):
    getattr(arviz_plots, name)(tree)
    plt.close("all")


def test_effective_size_is_that_of_correlated_walkers():
    """Walkers with autocorrelation ρ per step: n (1 − ρ)/(1 + ρ) effective draws, and not n."""
    ensembles, steps, walkers, rho = 4, 100, 40, 0.8
    random = np.random.default_rng(3)
    points = np.empty((ensembles, steps, walkers, 1))
    points[:, 0] = random.normal(size=(ensembles, walkers, 1))
    for step in range(1, steps):
        points[:, step] = rho * points[:, step - 1] + np.sqrt(1 - rho**2) * random.normal(size=(ensembles, walkers, 1))
    none = Convergence(np.ones(1), np.ones(1), np.ones(1), converged=True, message="")
    chains = Chains(points, points[..., 0], 1.0, none)
    draws = by_ensemble(points.reshape(-1, 1), chains)[..., 0]
    total = ensembles * steps * walkers
    found = float(arviz_stats.ess(draws, chain_axis=0, draw_axis=1))
    assert found == pytest.approx(total * (1 - rho) / (1 + rho), rel=0.25)
    step_by_step = points.reshape(ensembles, -1)
    assert float(arviz_stats.ess(step_by_step, chain_axis=0, draw_axis=1)) > 0.8 * total, "the order that is wrong"

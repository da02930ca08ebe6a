"""The posterior as an ArviZ tree: labelled dimensions without gaps, the same draws in memory and on disk."""

from pathlib import Path

import numpy as np
import pytest
import xarray

from imubayes.api import Result
from imubayes.results.posterior_groups import (
    SAMPLE,
    Group,
    Groups,
    Labelled,
    _without_noise,
    in_units,
    rounded,
)
from imubayes.results.result import read_result
from imubayes.results.result_folder import write_posterior
from imubayes.results.stored_tables import draws_of

ROOT = Path(__file__).parents[2]
SCALE = "gyro_scale_factor.scale"


@pytest.fixture(scope="module")
def result(hidden_gyro) -> Result:
    return hidden_gyro


@pytest.fixture(scope="module")
def tree(result) -> xarray.DataTree:
    return result.posterior


def test_labels_are_dimensions(result, tree):
    posterior = tree.posterior
    assert posterior[SCALE].dims == ("chain", "draw", "gyro_channel")
    assert posterior["scale_factor"].dims == ("chain", "draw", "channel")
    assert posterior["mounting_angle"].dims == ("chain", "draw", "channel", "mounting")
    estimates = {line.name: line for line in (*result.summary.parameters, *result.summary.derived)}
    scale = posterior[SCALE].sel(gyro_channel="gx")
    assert float(scale.mean()) == pytest.approx(estimates[f"{SCALE}[gx]"].mean)
    angle = posterior["mounting_angle"].sel(channel="ax", mounting="pyramid")
    assert float(angle.std()) == pytest.approx(estimates["mounting_angle[ax,pyramid]"].sd, rel=0.05)
    axis = posterior["input_axis"].sel(channel="gz")
    assert posterior["input_axis"].dims == ("chain", "draw", "channel", "component")
    assert axis.component.values.tolist() == ["x", "y", "z"]
    np.testing.assert_allclose((axis**2).sum("component"), 1.0, rtol=1e-9)
    assert float(axis.sel(component="x").std()) == pytest.approx(estimates["input_axis[gz,x]"].sd, rel=0.05)
    assert list(posterior["axis_angle"].axis_pair.values[:2]) == ["ax,ay", "ax,az"]


def test_no_group_has_a_gap(tree):
    for group in tree.children.values():
        for name, variable in group.data_vars.items():
            assert variable.dtype.kind != "f" or bool(np.isfinite(variable).all()), name


def test_every_variable_has_its_unit(tree):
    posterior = tree.posterior
    assert all(posterior[name].attrs["units"] for name in posterior.data_vars)
    assert posterior[SCALE].attrs["units"] == "ppm"
    assert posterior["white_noise.sigma"].attrs["units"] == "pulse/s"
    assert "pulse/s per g (ax, ay, az)" in posterior["scale_factor"].attrs["units"]


def test_every_entry_has_run_channel_and_row(result, tree):
    assert list(tree.log_likelihood.data_vars) == ["output"]
    for group in ("observed_data", "posterior_predictive", "prior_predictive", "log_likelihood"):
        assert {"run", "channel", "row"} <= set(tree[group].coords)
    observed = tree.observed_data["output"]
    table = result.residuals.table
    assert observed.channel.values.tolist() == table["channel"].to_list()
    np.testing.assert_allclose(observed, table["observed"])
    assert tree.constant_data["unit"].values.tolist() == table["output_unit"].to_list()


def test_every_quantity_of_the_summary_has_draws(result, tree):
    names = [line.name for line in (*result.summary.parameters, *result.summary.derived)]
    assert list(draws_of(tree, names)) == names


def test_the_file_holds_the_same(result, tree):
    stored = read_result(result.folder)
    assert stored.summary == result.summary
    assert stored.residuals.table.equals(result.residuals.table)
    for group in ("posterior", "prior", "log_likelihood"):
        xarray.testing.assert_equal(stored.posterior[group].to_dataset(), tree[group].to_dataset())


def test_draws_of_the_prior_are_those_of_its_group(result, tree):
    """From the file as from the tree, and far wider than those of the posterior."""
    name = "mounting_angle[gz,pyramid]"
    before, after = (draws_of(result.posterior_file, [name], group)[name] for group in ("prior", "posterior"))
    np.testing.assert_allclose(before, draws_of(tree, [name], "prior")[name], rtol=1e-6)
    assert before.std() > 10 * after.std()


def test_summary_and_residuals_as_data_frames(result):
    frame = result.to_dataframe()
    assert frame.height == len(result.summary.parameters) + len(result.summary.derived)
    scale = frame.filter(frame["name"] == "scale_factor[gx]").row(0, named=True)
    line = next(quantity for quantity in result.summary.derived if quantity.name == "scale_factor[gx]")
    assert (scale["kind"], scale["mean"], scale["sd"]) == ("derived", line.mean, line.sd)
    residuals = result.residuals.to_dataframe()
    assert {"run", "channel", "residual", "whitened"} <= set(residuals.columns)


def test_what_has_a_bound_is_stored_as_it_was_drawn(result, tree):
    """Rounded to zero, a scale between runs would be infinitely far from the bulk of its prior."""
    model = result.fit.model
    drawn = in_units(model, result.fit.posterior.points)
    names = [each.name for each in (*model.layout.parameters, *model.hyper_layout.parameters)]
    place = next(place for place, name in enumerate(names) if name.startswith("run_scatter.tau"))
    stored = read_result(result.folder).draws[names[place]]
    np.testing.assert_array_equal(stored.reshape(-1), drawn[:, place])


def test_draws_are_rounded_where_it_matters_to_nothing():
    values = np.random.default_rng(0).normal(size=(500, 3)) * [1.0, 1e-9, 0.0] + [1e6, -3.0, 7.0]
    step = 2.0**-12 * values.std(axis=0)
    found = rounded(values, step)
    assert np.all(np.abs(found - values) <= step / 2)
    assert np.abs(found - values)[:, 0].max() > 0
    np.testing.assert_array_equal(found[:, 2], 7.0)
    np.testing.assert_array_equal(rounded(values, np.array([np.nan, np.inf, 0.0])), values)


@pytest.mark.parametrize("ratio", [1e-2, 2e-4, 2e-5])
def test_rounding_changes_no_uncertainty_of_what_is_known_better_than_its_members(ratio):
    """Seat plus misalignment is known to a few thousandths of each: U of the sum from stored draws is that of it."""
    random = np.random.default_rng(5)
    common, own = 46.0 * random.standard_normal((4, 5000)), 46.0 * ratio * random.standard_normal((4, 5000))
    drawn = np.stack([300.0 + common, -120.0 - common + own], axis=-1)
    stored = _without_noise(drawn)
    exact, found = (np.quantile(each.sum(axis=-1), [0.025, 0.975]) for each in (drawn, stored))
    assert found[1] - found[0] == pytest.approx(exact[1] - exact[0], rel=1e-3)
    assert stored.sum(axis=-1).std() == pytest.approx(drawn.sum(axis=-1).std(), rel=1e-3)
    assert np.abs(stored - drawn).max() > 0, "they are rounded"


def test_the_file_of_the_draws_is_packed(tmp_path):
    """Half of what single precision would need: labels as characters, draws without the digits that are noise."""
    draws = np.random.default_rng(1).normal(size=(4, 1000, 10)) * 1e-3 + 5
    spread = draws.reshape(-1, 10).std(axis=0)
    labels = np.array([f"channel {number}" for number in range(10)])
    group = Group(
        {"scale": Labelled((*SAMPLE, "channel"), rounded(draws, 2.0**-12 * spread))},
        {"channel": Labelled(("channel",), labels)},
    )
    file = tmp_path / "posterior.nc"
    write_posterior(Groups({"posterior": group}, {}), file)
    assert file.stat().st_size < 0.4 * draws.nbytes
    with xarray.open_dataset(file, group="posterior", engine="h5netcdf") as found:
        np.testing.assert_allclose(found["scale"], draws, atol=3e-7)
        assert found["channel"].to_numpy().tolist() == labels.tolist()

"""The tables of a batch: long form, units with covariance, and what is read back."""

import datetime

import numpy as np
import polars as pl
import pytest

from imubayes.foundations.errors import InputError
from imubayes.results.folder_files import seal
from imubayes_archive.unit_fits.fit_unit import QUANTILES, quantiles_of
from imubayes_archive.unit_fits.posterior_table import (
    PARAMETERS,
    UNITS,
    Outcome,
    Quantities,
    UnitIdentity,
    UnitPosterior,
    model_folder,
    packed,
    parameter_table,
    part_folder,
    read_outcomes,
    read_parameters,
    read_units,
    unit_table,
    unpacked,
)


def fitted_unit(name: str = "A1") -> UnitPosterior:
    random = np.random.default_rng(1)
    root = random.normal(size=(3, 3))

    def quantities(kind, names):
        size = len(names)
        mean, sd, prior_mean, prior_sd, share = (random.normal(size=size) for _ in range(5))
        quantiles = random.normal(size=(5, size))
        return Quantities(kind, names, ("ppm",) * size, mean, sd, quantiles, prior_mean, prior_sd, share)

    identity = UnitIdentity(name, "autumn", f"digest-{name}", "a.parquet", datetime.date(2024, 5, 6), tables=("t",))
    parts = (quantities("parameter", ("p", "q")), quantities("noise", ("s",)), quantities("derived", ("d",)))
    return UnitPosterior(identity, Outcome("fitted", seconds=0.5), parts, root @ root.T)


FAILED = UnitPosterior(UnitIdentity("B2", "spring", "digest-B2", "b.parquet"), Outcome("refused", "no rows", "b.csv"))


def test_a_packed_covariance_comes_back():
    matrix = fitted_unit().covariance
    assert np.array_equal(unpacked(packed(matrix)), matrix)
    assert unpacked([]).shape == (0, 0)


def test_tables_have_their_schemas_and_a_failed_unit_has_one_row():
    long, units = parameter_table("m", [fitted_unit(), FAILED]), unit_table("m", "c", [fitted_unit(), FAILED])
    assert long.schema == PARAMETERS
    assert units.schema == UNITS
    assert long["parameter"].to_list() == ["p", "q", "s", "d", None]
    assert (long["reason"][-1], long["status"][-1], long["mean"][-1]) == ("no rows", "refused", None)
    assert units["names"].to_list() == [["p", "q", "s"], []]
    assert units["year"].to_list() == [2024, None]
    assert np.allclose(units["mean"][0].to_numpy(), long["mean"].to_numpy()[:3])


def test_parts_are_read_together_in_one_order(tmp_path):
    for key, name in (("2", "A1"), ("1", "C3")):
        folder = part_folder(tmp_path, "abc", key)
        folder.mkdir(parents=True)
        parameter_table("abc", [fitted_unit(name)]).write_parquet(folder / "parameters.parquet")
        unit_table("abc", "c", [fitted_unit(name)]).write_parquet(folder / "units.parquet")
        seal(folder)
    (model_folder(tmp_path, "abc") / "model.toml").write_text("")
    assert read_units(tmp_path)["unit"].to_list() == ["A1", "C3"]
    assert read_parameters(tmp_path, "ab").group_by("unit", maintain_order=True).len()["len"].to_list() == [4, 4]
    assert isinstance(read_parameters(tmp_path)["date"][0], datetime.date)
    assert read_parameters(tmp_path).filter(pl.col("kind") == "derived").height == 2


def test_a_folder_without_results_and_an_unknown_model_are_refused(tmp_path):
    with pytest.raises(InputError, match="holds no results of a batch"):
        read_units(tmp_path)
    for name in ("abc", "def"):
        model_folder(tmp_path, name).mkdir()
        (model_folder(tmp_path, name) / "model.toml").write_text("")
    with pytest.raises(InputError, match="several models"):
        read_units(tmp_path)
    with pytest.raises(InputError, match="no results of model 'x'"):
        read_units(tmp_path, "x")
    assert read_units(tmp_path, "abc").is_empty()


def test_quantiles_are_those_of_numpy():
    draws = np.random.default_rng(0).normal(size=(257, 3))
    assert np.allclose(quantiles_of(draws), np.percentile(draws, QUANTILES, axis=0), rtol=0, atol=1e-12)


def test_outcomes_are_the_units_without_their_estimates(tmp_path):
    folder = part_folder(tmp_path, "abc", "1")
    folder.mkdir(parents=True)
    (folder.parent / "model.toml").write_text("")
    unit_table("abc", "code", [fitted_unit()]).write_parquet(folder / "units.parquet")
    seal(folder)
    outcomes, units = read_outcomes(tmp_path), read_units(tmp_path)
    assert outcomes.equals(units.drop("names", "mean", "covariance"))

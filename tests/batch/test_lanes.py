"""Units fitted in lanes have the optimum and the posterior of `imubayes fit`, whatever stands beside them."""

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
from small_units import DATA, MODELS, change_readings, edit, make_units

import imubayes.batch.fit_chunk as chunks
from imubayes.batch.batch_settings import BatchSettings
from imubayes.batch.fit_chunk import fit_chunk
from imubayes.batch.fit_unit import bound_to, fit_alone, posterior_of
from imubayes.batch.lane_mode import find_modes
from imubayes.batch.lane_posterior import posteriors
from imubayes.batch.lanes import LaneStructure, structure_key
from imubayes.batch.posterior_table import UnitIdentity, UnitPosterior
from imubayes.batch.run_batch import ChunkTask
from imubayes.batch.unit_sources import sources_of
from imubayes.campaign import load_campaign
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import Model
from imubayes.model.model_file import read_model


def model_of(folder: Path, name: str = "polar-tumble") -> Model:
    return bound_to(read_model(MODELS / f"{name}.toml"), load_campaign(folder))


def marginal_sd(fit: Fit) -> np.ndarray:
    assert fit.posterior is not None
    return fit.posterior.points.std(axis=0)


def distance(model: Model) -> float:
    """Return the largest distance of the two optima, in posterior standard deviations."""
    structure = LaneStructure.of(model.problem)
    assert structure is not None
    found, fit = find_modes(structure, structure.stacked([model])), joint_fit(model, None)
    assert bool(found.converged[0])
    ours, theirs = np.concatenate([found.model.z[0], found.h[0]]), np.concatenate([fit.z, fit.h])
    return float(np.max(np.abs(ours - theirs) / marginal_sd(fit)))


@pytest.fixture(scope="module")
def units(tmp_path_factory) -> list[Path]:
    return make_units(tmp_path_factory.mktemp("units"), 6)


@pytest.mark.parametrize(
    "name",
    [
        "polar-tumble",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("trihedral-imu", "redundant-imu", "accel-channel")),
    ],
)
def test_the_optimum_is_that_of_a_single_fit(name):
    assert distance(model_of(DATA / name, name)) < 0.01


def fitted(units: list[Path], name: str = "polar-tumble") -> list[UnitPosterior]:
    sources = tuple(source for unit in units for source in sources_of(unit))
    return list(fit_chunk(ChunkTask(read_model(MODELS / f"{name}.toml"), BatchSettings(), sources)))


def test_posteriors_in_lanes_are_those_of_single_fits(units):
    (unit,) = fitted(units[:1])
    alone = fit_alone(model_of(units[0]), BatchSettings(), unit.identity)
    assert [part.names for part in alone.quantities] == [part.names for part in unit.quantities]
    for ours, theirs in zip(unit.quantities, alone.quantities, strict=True):
        varies = theirs.sd > 0
        assert np.max(np.abs(ours.mean - theirs.mean)[varies] / theirs.sd[varies]) < 0.01
        assert np.max(np.abs(np.log(ours.sd[varies] / theirs.sd[varies]))) < 0.01
        assert np.allclose(ours.prior_mean, theirs.prior_mean, equal_nan=True)


@pytest.mark.parametrize(
    "name", ["polar-tumble", *(pytest.param(n, marks=pytest.mark.slow) for n in ("trihedral-imu", "redundant-imu"))]
)
def test_rounding_changes_no_digit_that_counts(name):
    # Other processors and compilers round otherwise; parameters without data have degenerate directions.
    model, random = model_of(DATA / name, name), np.random.default_rng(1)

    def rounded(leaf):
        array = np.asarray(leaf)
        return leaf * (1 + random.normal(0, 1e-15, array.shape)) if array.dtype.kind == "f" and array.ndim else leaf

    problem = jax.tree.map(rounded, model.problem)
    problem = eqx.tree_at(lambda p: p.sparsity, problem, model.problem.sparsity)
    first, second = in_lanes([model, replace(model, problem=problem)])
    for ours, theirs in zip(first.quantities, second.quantities, strict=True):
        assert np.nanmax(np.abs(ours.mean - theirs.mean) / ours.sd) < 1e-6
        assert np.nanmax(np.abs(np.log(ours.sd / theirs.sd))) < 1e-6


def in_lanes(models: list[Model]) -> list[UnitPosterior]:
    structure = LaneStructure.of(models[0].problem)
    assert structure is not None
    varying = structure.stacked(models)
    fits = posteriors(structure, varying, find_modes(structure, varying), models)
    assert all(fit is not None for fit in fits)
    return [posterior_of(fit, BatchSettings(), UnitIdentity("", "", "", "")) for fit in fits if fit is not None]


def test_a_fault_of_the_lanes_does_not_go_unseen(monkeypatch):
    def faulty(group):
        raise TypeError("a fault")

    monkeypatch.setattr(chunks, "_in_lanes", faulty)
    with pytest.warns(UserWarning, match="lanes failed: TypeError: a fault"):
        assert chunks._in_lanes_if_possible([]) == []


def test_a_unit_is_the_same_whatever_stands_beside_it(units):
    together = fitted(units)
    for place, unit in enumerate(units):
        if place in (0, 5):
            (alone,) = fitted([unit])
            for a, b in zip(alone.quantities, together[place].quantities, strict=True):
                assert np.allclose(a.mean, b.mean, rtol=0, atol=1e-6 * np.max(b.sd))
                assert np.allclose(a.sd, b.sd, rtol=1e-6)


def test_a_missing_reading_makes_another_structure(units, tmp_path):
    (other,) = make_units(tmp_path, 1)
    file = sorted((other / "runs").glob("*.csv"))[0]
    change_readings(file, lambda values: np.where(np.arange(len(values)) == 3, np.nan, values))
    edit(file, ",nan,", ",,")  # an empty cell is a missing reading
    first, second = model_of(units[0]).problem, model_of(units[1]).problem
    assert structure_key(first) == structure_key(second)
    assert structure_key(model_of(other).problem) != structure_key(first)

"""Units fitted in lanes have the optimum and the posterior of `imubayes fit`, whatever stands beside them."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
from small_units import DATA, MODELS, change_readings, edit, make_units

import imubayes_archive.unit_fits.fit_chunk as chunks
from imubayes.campaign import load_campaign
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import Model
from imubayes.model.model_file import read_model
from imubayes_archive.unit_fits.batch_folder import BatchSettings, sources_of
from imubayes_archive.unit_fits.fit_chunk import fit_chunk, padded_count, padded_entries
from imubayes_archive.unit_fits.fit_unit import (
    bound_to,
    fit_alone,
    joint_normal_vectors,
    normal_vectors,
    posterior_of,
    posteriors,
)
from imubayes_archive.unit_fits.group_moments import grouped_model, log_marginal_of, marginal_slope
from imubayes_archive.unit_fits.lanes import LANES, LaneStructure, find_modes, structure_key
from imubayes_archive.unit_fits.posterior_table import UnitIdentity, UnitPosterior
from imubayes_archive.unit_fits.run_batch import ChunkTask


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


@pytest.mark.parametrize(("size", "hyper"), [(6, 1), (24, 3), (74, 12)])
def test_normal_vectors_of_parameters_do_not_depend_on_those_of_noise_scales(size, hyper):
    scales, parameters = normal_vectors(size, hyper)
    together = joint_normal_vectors(size, hyper)
    assert np.allclose(np.cov(together.T, bias=True), np.eye(size + hyper), atol=1e-9)
    assert np.allclose(together.mean(axis=0), 0, atol=1e-9)
    # The width of θ depends on the scales: mean squares must not; 256 independent ones correlate by up to 4/√256.
    squares = np.corrcoef(np.concatenate([scales, (parameters**2).mean(axis=1)], axis=1).T)
    assert np.abs(squares[:hyper, hyper:]).max() < 0.25


@pytest.fixture(scope="module")
def units(tmp_path_factory) -> list[Path]:
    return make_units(tmp_path_factory.mktemp("units"), 6)


@pytest.mark.parametrize("name", ["polar-tumble", "trihedral-imu", "redundant-imu", "accel-channel"])
@pytest.mark.slow
def test_the_optimum_is_that_of_a_single_fit(name):
    assert distance(model_of(DATA / name, name)) < 0.01


def fitted(units: list[Path], name: str = "polar-tumble") -> list[UnitPosterior]:
    sources = tuple(source for unit in units for source in sources_of(unit))
    return list(fit_chunk(ChunkTask(read_model(MODELS / f"{name}.toml"), BatchSettings(), sources)))


@pytest.mark.slow
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
@pytest.mark.slow
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
        # Noise scales end within 1e-4 of a prior width of their mode: the widths follow to 2e-6 in trihedral-imu.
        assert np.nanmax(np.abs(np.log(ours.sd / theirs.sd))) < 1e-5


def in_lanes(models: list[Model]) -> list[UnitPosterior]:
    structure = LaneStructure.of(models[0].problem)
    assert structure is not None
    varying = structure.stacked(models)
    fits = posteriors(structure, varying, find_modes(structure, varying), models)
    assert all(fit is not None for fit in fits)
    return [posterior_of(fit, BatchSettings(), UnitIdentity("", "", "", "")) for fit in fits if fit is not None]


@pytest.mark.slow
def test_programs_of_lanes_outlast_the_process(tmp_path, command_environment):
    script = Path(__file__).parent / "kept_lanes.py"
    environment = command_environment | {"IMUBAYES_KEEP_PROGRAMS": "1"}
    said = subprocess.run(
        [sys.executable, str(script), str(tmp_path)], env=environment, capture_output=True, text=True, check=True
    )
    first, again = said.stdout.splitlines()
    assert len(first) > 1000
    assert first == again
    assert len(list(tmp_path.iterdir())) == 2, "of the units, and of the index of their readings"


def test_the_slope_of_the_marginal_is_the_derivative_of_its_value():
    model = model_of(DATA / "polar-tumble")
    structure = LaneStructure.of(model.problem)
    assert structure is not None
    assert structure.index.proportional
    varying, size = structure.stacked([model]), structure.problem.size
    linear = structure.run(grouped_model, varying, np.zeros((LANES, size[0])))
    h = np.linspace(-0.8, 0.9, LANES * size[1]).reshape(LANES, size[1])
    value, gradient = structure.run(marginal_slope, varying, linear, h)

    def by_definition(points: np.ndarray) -> np.ndarray:
        return np.asarray(structure.run(log_marginal_of, varying, linear, points))

    assert np.allclose(value, by_definition(h), rtol=1e-12)
    for place, axis in enumerate(1e-4 * np.eye(size[1])):
        difference = (by_definition(h + axis) - by_definition(h - axis)) / 2e-4
        assert np.allclose(gradient[:, place], difference, rtol=1e-5, atol=1e-4)


@pytest.mark.slow
def test_noise_scales_that_are_given_are_kept(units):
    model = model_of(units[0])
    structure = LaneStructure.of(model.problem)
    assert structure is not None
    varying = structure.stacked([model])
    free = find_modes(structure, varying)
    kept = find_modes(structure, varying, free.h)
    assert kept.converged.all()
    assert np.array_equal(kept.h, free.h)
    assert np.allclose(kept.model.z, free.model.z, atol=1e-4)


def test_a_fault_of_the_lanes_does_not_go_unseen(monkeypatch):
    def faulty(*_):
        raise TypeError("a fault")

    monkeypatch.setattr(chunks, "_in_lanes", faulty)
    with pytest.warns(UserWarning, match="one by one, because their joint computation failed: TypeError: a fault"):
        assert chunks._in_lanes_if_possible([], True) == []


@pytest.mark.slow
def test_a_unit_is_the_same_whatever_stands_beside_it(units):
    together = fitted(units)
    for place, unit in enumerate(units):
        if place in (0, 5):
            (alone,) = fitted([unit])
            for a, b in zip(alone.quantities, together[place].quantities, strict=True):
                assert np.allclose(a.mean, b.mean, rtol=0, atol=1e-6 * np.max(b.sd))
                assert np.allclose(a.sd, b.sd, rtol=1e-6)


@pytest.fixture(scope="module")
def with_missing(tmp_path_factory) -> Path:
    (other,) = make_units(tmp_path_factory.mktemp("missing"), 1)
    file = sorted((other / "runs").glob("*.csv"))[0]
    change_readings(file, lambda values: np.where(np.arange(len(values)) == 3, np.nan, values))
    edit(file, ",nan,", ",,")  # an empty cell is a missing reading
    return other


@pytest.mark.slow
def test_a_missing_reading_makes_another_structure(units, with_missing):
    first, second = model_of(units[0]).problem, model_of(units[1]).problem
    assert structure_key(first) == structure_key(second)
    assert structure_key(model_of(with_missing).problem) != structure_key(first)


@pytest.mark.slow
def test_units_with_other_missing_readings_share_the_shapes_of_compiled_code(units, with_missing):
    def shapes(unit: Path) -> tuple:
        problem = padded_entries(model_of(unit).problem)
        structure = LaneStructure.of(problem)
        assert structure is not None
        leaves = jax.tree.leaves((problem, structure.index))
        return jax.tree.structure((problem, structure.index)), [(np.shape(x), np.asarray(x).dtype) for x in leaves]

    assert shapes(units[0]) == shapes(with_missing)
    assert [padded_count(count) for count in (1, 16, 72, 2303, 2304, 2305)] == [16, 16, 80, 2304, 2304, 2432]


@pytest.mark.slow
def test_padding_changes_no_estimate(with_missing):
    (unit,) = fitted([with_missing])
    model = model_of(with_missing)
    (plain,) = in_lanes([model])
    assert unit.outcome.readings == plain.outcome.readings == len(model.problem.observations.value)
    assert np.isclose(unit.outcome.chi2, plain.outcome.chi2)
    for ours, theirs in zip(unit.quantities, plain.quantities, strict=True):
        assert np.nanmax(np.abs(ours.mean - theirs.mean) / theirs.sd) < 1e-5
        assert np.nanmax(np.abs(np.log(ours.sd / theirs.sd))) < 1e-5

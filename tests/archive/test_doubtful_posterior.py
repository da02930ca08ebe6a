"""Units whose Laplace approximation is in doubt are sampled, the others are not."""

import numpy as np
import pytest
from scipy.stats import norm
from small_units import MODEL, make_units

import imubayes.inference.weight_shape as doubtful
import imubayes_archive.unit_fits.fit_unit as fit_unit
from imubayes.inference.laplace_proposal import pareto_k
from imubayes.inference.weight_shape import WeightShape
from imubayes.model.model_file import read_model
from imubayes_archive.unit_fits.batch_folder import BatchSettings, sources_of
from imubayes_archive.unit_fits.fit_chunk import fit_chunk
from imubayes_archive.unit_fits.run_batch import ChunkTask


def of_standard_normal_draws(mean: float, width: float, seed: int, size: int = 20) -> WeightShape:
    """Return what the weights say if the posterior is standard normal but in its first component."""
    points = np.random.default_rng(seed).normal(size=(1000, size))
    log_weight = norm.logpdf(points[:, 0], mean, width) - norm.logpdf(points[:, 0])
    weight = np.exp(log_weight)
    return doubtful.shape_of(points, weight / weight.mean(), pareto_k(log_weight))


@pytest.mark.parametrize(("mean", "width"), [(0.5, 1.0), (1.0, 1.0), (0.0, 1.3), (0.0, 2.0), (0.0, 0.7)])
def test_moments_that_are_off_are_flagged(mean, width):
    assert sum(of_standard_normal_draws(mean, width, seed).flagged for seed in range(20)) >= 19


def test_moments_that_are_right_are_not_flagged():
    assert sum(of_standard_normal_draws(0.03, 1.02, seed).flagged for seed in range(20)) <= 1


def test_a_draw_with_all_the_weight_is_flagged():
    points = np.random.default_rng(0).normal(size=(1000, 3))
    shape = doubtful.shape_of(points, 1000 * np.eye(1000)[0], 0.0)
    assert shape.skewness > 30
    assert shape.flagged
    assert WeightShape(float("nan"), 0.0, 10.0, 0.0).flagged


@pytest.mark.slow
def test_flagged_units_are_sampled_and_the_others_are_not(tmp_path, monkeypatch):
    make_units(tmp_path, 2)
    asked = []

    def sampled(model, settings):
        asked.append(model)
        return fits[len(fits) - 1]

    def seen(fit, seed):
        fits.append(fit)
        shape = plain(fit, seed)
        return shape if len(fits) == 1 else WeightShape(0.8, 9.0, 9.0, 0.1)

    fits, plain = [], fit_unit.weight_shape
    monkeypatch.setattr(fit_unit, "_sampled", sampled)
    monkeypatch.setattr(fit_unit, "weight_shape", seen)
    task = ChunkTask(read_model(MODEL), BatchSettings(sample="flagged"), tuple(sources_of(tmp_path)))
    first, second = (unit.outcome for unit in fit_chunk(task))
    assert (first.status, second.status) == ("fitted", "fitted")
    assert first.flagged is False
    assert first.pareto_k == plain(fits[0], 0).pareto_k
    assert (second.flagged, second.pareto_k, second.weight_skewness) == (True, 0.8, 9.0)
    assert asked == [fits[1].model]


@pytest.mark.slow
def test_a_flagged_unit_has_the_posterior_of_one_that_is_sampled(tmp_path, monkeypatch):
    make_units(tmp_path, 1)
    monkeypatch.setattr(doubtful, "_OFF", -1.0)  # every unit is in doubt
    spec, sources = read_model(MODEL), tuple(sources_of(tmp_path))
    ((flagged,), (sampled,)) = (
        fit_chunk(ChunkTask(spec, BatchSettings(sample=kind), sources)) for kind in ("flagged", "all")
    )
    assert flagged.outcome.method == sampled.outcome.method == "emcee"
    for ours, theirs in zip(flagged.quantities, sampled.quantities, strict=True):
        assert np.nanmax(np.abs(ours.mean - theirs.mean) / theirs.sd) < 0.1

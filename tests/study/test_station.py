"""Geographic positions on a station whose north is off by 5 arcmin: the drift terms keep their uncertainty."""

from dataclasses import replace
from pathlib import Path

import geographic_tumble
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from simulate import write_simulated

from imubayes.campaign import load_campaign
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "models" / "geographic-tumble.toml"
NORTH = 300.0  # arcsec
DRIFT = ("gyro_bias", "gyro_g_sensitivity", "gyro_g2_sensitivity")


def scores(folder: Path, seed: int, left_out: tuple[str, ...] = ()) -> np.ndarray:
    """Return (mode − truth)/sd of the drift terms, north off by 5 arcmin either way, all else drawn from the priors."""
    plan = geographic_tumble.plan(seed, model=MODEL)
    truth = plan.draw(seed) | {"station_heading.heading[all]": NORTH * (-1) ** seed}
    folder.mkdir(parents=True)
    write_simulated(folder, plan, seed, values=truth)
    spec = read_model(MODEL)
    spec = replace(spec, effects=tuple(one for one in spec.effects if one.name not in left_out))
    model = bind(spec, load_campaign(folder))
    mode = find_mode(model.problem, *(jnp.zeros(size) for size in model.problem.size))
    assert bool(mode.converged)
    covariance = np.linalg.inv(np.asarray(jax.jit(posterior_precision)(model.problem, mode)))
    return np.array(
        [
            (float(mode.z[place]) - one.z_at(truth[one.name])) / np.sqrt(covariance[place, place])
            for place, one in enumerate(model.layout.parameters)
            if one.effect in DRIFT
        ]
    )


@pytest.mark.slow
def test_drift_terms_where_north_is_off(tmp_path):
    found = np.concatenate([scores(tmp_path / str(seed), seed) for seed in range(3)])
    assert np.sqrt(np.mean(found**2)) < 1.5
    assert np.abs(found).max() < 4


@pytest.mark.slow
def test_drift_terms_where_north_is_off_over_replicates(tmp_path):
    found = np.concatenate([scores(tmp_path / str(seed), seed) for seed in range(100, 140)])
    print(f"rms z {np.sqrt(np.mean(found**2)):.3f}, largest |z| {np.abs(found).max():.2f}, {len(found)} scores")
    assert 0.85 < np.sqrt(np.mean(found**2)) < 1.15
    assert np.abs(found).max() < 4.5
    lacking = ("station_heading", "station_level", "gyro_scale_factor")
    without = np.concatenate([scores(tmp_path / f"without-{seed}", seed, lacking) for seed in range(100, 110)])
    assert np.sqrt(np.mean(without**2)) > 1.5, "a model without these effects would pass as well"

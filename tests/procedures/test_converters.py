"""One sensor behind each kind of converter: textbook and joint fit find the same drift, whatever the output is."""

from pathlib import Path

import accel_channel  # pyright: ignore[reportMissingImports]
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from imubayes.api import fit
from imubayes.campaign import load_campaign
from imubayes.model.model_file import read_model
from imubayes.parameters.priors import parse_prior
from imubayes.procedures import classical
from imubayes.procedures.textbook import Estimate
from imubayes.results.stored_tables import draws_of

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("converter", [pytest.param("V/F", marks=pytest.mark.slow), "ADC"])
def test_drift_of_gain_and_offset_is_found_behind_any_converter(converter, tmp_path):
    truth = accel_channel.generate(tmp_path, 11, converter)
    result = fit(tmp_path, ROOT / "models" / "accel-channel.toml", sample=False)
    assert result.converged
    summary = result.summary.model_dump()
    known = {one["name"]: one for one in (*summary["parameters"], *summary["derived"])}
    drift = [name for name in known if name.startswith(("converter_", "delta_k", "accel_scale"))]
    assert any(name.startswith("delta_k") for name in drift)
    for name in drift:
        one = known[name]
        assert abs(one["mean"] - truth[name]) < 4 * one["sd"], name
    # The textbook's lines stand on the same outputs: seats and source are in them, the decision is not changed.
    lines = {one.name: one for one in classical(load_campaign(tmp_path)) if isinstance(one, Estimate)}
    for name in (one for one in drift if one.startswith("delta_k")):
        assert abs(lines[name].value - truth[name]) < 4 * lines[name].sd, name


@pytest.mark.parametrize("model", ["accel-channel", "rotation-modulation"])
def test_a_standard_deviation_describes_the_tails_of_an_offset_whose_scatter_only_the_prior_tells(model):
    def beyond_six_sd(prior):
        """Share of offsets of runs more than six of their standard deviations from zero."""
        law = parse_prior(prior, "output", 9.8, "test", {"noise": 1.0, "scale": 1.0})
        z = np.linspace(-7.0, 7.0, 2001)
        tau = np.asarray(jax.vmap(law.value)(jnp.asarray(z)))
        share = stats.norm.pdf(z) / stats.norm.pdf(z).sum()
        return float(share @ (2 * stats.norm.sf(6 * np.sqrt(share @ tau**2) / tau)))

    effects = read_model(ROOT / "models" / f"{model}.toml").effects
    (prior,) = [one.prior["tau"] for one in effects if one.name == "run_scatter"]
    assert beyond_six_sd(prior) < 0.001
    assert beyond_six_sd("lognormal(0.1 noise, 1.0)") > 0.003


@pytest.mark.parametrize("seed", [5024, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (5035, 5041))])
def test_three_runs_whose_scatter_is_in_the_tail_of_its_prior_are_held_by_the_posterior(seed, tmp_path):
    """The runs do not distinguish their scatter from errors of bias, scale and source: all sizes of it have mass."""
    truth = accel_channel.generate(tmp_path, seed)
    result = fit(tmp_path, ROOT / "models" / "accel-channel.toml", sample=False)
    assert result.summary.prior_scatter
    known = {one.name: one for one in result.summary.parameters}
    gain = known["injection_error.gain[ax]"]
    assert gain.mean is not None
    assert gain.sd is not None
    missed = abs(gain.mean - truth[gain.name])
    assert missed < 4.5 * gain.sd
    # A scatter taken as small misses it.
    draws = draws_of(result.posterior, [gain.name, "run_scatter.tau[ax]"])
    small = draws["run_scatter.tau[ax]"] < np.quantile(draws["run_scatter.tau[ax]"], 0.2)
    assert missed > 6 * draws[gain.name][small].std()

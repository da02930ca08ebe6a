"""Slow noise of rows: its covariance against integrals over the rows, and a record of independent code."""

import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.foundations.campaign_data import Campaign, Run, Site
from imubayes.inference.laplace_marginal import knowledge
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import bind
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.model.nodes_and_entries import Entries, timeline
from imubayes.model.noise_covariance import slow_series
from imubayes.noise.components import FlickerNoise, GaussMarkovNoise, RandomWalkNoise, RowSpan

SHIPPED = Path(__file__).parents[2] / "data" / "static-record"
SAMPLE = 0.5  # s


def run(name: str, samples: np.ndarray, pauses: np.ndarray) -> Run:
    """Return a run of rows with pauses between them, of which the second is none."""
    start = np.cumsum(np.append(0.0, samples[:-1] * SAMPLE + pauses))
    shape = (len(samples), 1)
    time = {"time": start + samples * SAMPLE / 2}
    return Run(name, "static_record", None, None, time, np.zeros(shape), samples, np.full(shape, np.nan))


@pytest.fixture(scope="module")
def laid():
    """Three runs of one channel."""
    rng = np.random.default_rng(5)
    runs = []
    for rows in (7, 5, 3):
        pauses = rng.uniform(0, 30, rows - 1)
        pauses[1] = 0.0
        samples = rng.integers(10, 80, rows)
        samples[1:3] = 40
        runs.append(run(f"r{rows}", samples, pauses))
    index = np.repeat(np.arange(3), [7, 5, 3])
    row = np.concatenate([np.arange(each.rows) for each in runs])
    zero = np.zeros(len(row), int)
    entries = Entries(index, row, zero, zero, zero, zero - 1, zero - 1, zero > 0, zero > 0)
    return timeline(Campaign("c", Site(1.0, 0.0, 9.8), (), {}, {}, tuple(runs)), entries, index), index


def integrated(laid, autocovariance) -> np.ndarray:
    """Return the covariance of row means, by the midpoint rule."""
    timed, run_of = laid
    start, length = np.asarray(timed.row.start), np.asarray(timed.row.length)
    within = start[:, None] + length[:, None] * (np.arange(800) + 0.5) / 800
    found = np.zeros((len(start), len(start)))
    for i, j in np.argwhere(run_of[:, None] == run_of[None, :]):
        found[i, j] = np.mean(autocovariance(within[i][:, None], within[j][None, :]))
    return found


def test_rows_last_as_long_as_their_samples(laid):
    timed, _ = laid
    np.testing.assert_allclose(timed.row.length[1:3], 40 * SAMPLE)
    assert np.isinf(timed.row.gap).sum() == 3
    assert timed.row.gap[2] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("kind", ["markov", "walk", "flicker"])
def test_the_root_is_that_of_the_integrated_covariance(laid, kind):
    timed, _ = laid
    times = np.asarray(timed.row.times)
    ratio = times[1] / times[0]
    each = 0.3**2 * np.log(ratio) / np.pi
    noise, autocovariance = {
        "markov": (
            GaussMarkovNoise(jnp.asarray(0.7), jnp.asarray(40.0)),
            lambda s, t: 0.49 * np.exp(-np.abs(s - t) / 40.0),
        ),
        "walk": (RandomWalkNoise(jnp.asarray(3.0)), lambda s, t: 9.0 / 3600 * np.minimum(s, t)),
        "flicker": (
            FlickerNoise(jnp.asarray(0.3)),
            lambda s, t: each * sum(np.exp(-np.abs(s - t) / time) for time in times),
        ),
    }[kind]
    covariance = integrated(laid, autocovariance)
    if kind == "flicker":
        covariance += np.diag(2 * each * times[0] / ((ratio - 1) * np.asarray(timed.row.length)))
    rng = np.random.default_rng(2)
    root = 1 / np.sqrt(rng.uniform(0.01, 0.02, len(covariance)))
    root[4] = 0.0  # masked
    row = timed.row
    states = jax.vmap(lambda *span: noise.states(RowSpan(*span, jnp.asarray(times))))(row.start, row.length, row.gap)
    series = slow_series(timed, states, jnp.asarray(root))
    correlation = np.eye(len(root)) + root[:, None] * covariance * root
    lower = np.linalg.cholesky(correlation)
    x = rng.normal(size=(len(root), 3))
    np.testing.assert_allclose(series.forward(x), np.linalg.solve(lower, x), atol=1e-4)
    np.testing.assert_allclose(series.colour(x), lower @ x, atol=1e-4)
    np.testing.assert_allclose(series.back(x[:, 0]), np.linalg.solve(lower.T, x[:, 0]), atol=1e-4)
    np.testing.assert_allclose(series.diagonal(), np.diag(np.linalg.inv(correlation)), atol=1e-4)
    assert float(series.log_determinants().sum()) == pytest.approx(np.linalg.slogdet(correlation)[1], abs=1e-3)


def fitted(*noise: str):
    """Return names, values and logarithmic widths of the noise of the shipped record, and the sd of gx's bias."""
    effects = [EffectSpec(name) for name in ("gyro_bias", "accel_bias", *noise)]
    model = bind(ModelSpec("static", tuple(effects)), load_campaign(SHIPPED))
    problem = model.problem
    mode = find_mode(problem, jnp.zeros(problem.size[0]), jnp.zeros(problem.size[1]))
    assert bool(mode.converged)
    precision = knowledge(problem, mode.about, mode.h).precision + jnp.eye(problem.size[0])
    bias = np.sqrt(np.linalg.inv(np.asarray(precision))[0, 0])
    values = dict(zip(model.hyper_layout.names, np.asarray(problem.hyper_priors.values(mode.h)), strict=True))
    return values, float(bias)


@pytest.mark.slow
def test_a_record_of_independent_code():
    """Flicker and random walk of the generator, which shares no code, come back from block means."""
    values, bias = fitted("white_noise", "flicker_noise", "random_walk_noise")
    truth = tomllib.loads((SHIPPED / "truth.toml").read_text())["nuisance"]
    for channel, unit in {"gx": 1 / 3600, "gy": 1 / 3600, "ax": 1e-6, "ay": 1e-6, "az": 1e-6}.items():
        found = values[f"flicker_noise.b[{channel}]"]
        assert found == pytest.approx(truth[f"noise_term.flicker[{channel}]"] * unit, rel=0.35)
        walk = values[f"random_walk_noise.k[{channel}]"] / (truth[f"noise_term.random_walk[{channel}]"] * unit)
        assert 0.25 < walk < 2.5
    # Under white noise alone the bias seems known several times better than slow noise lets it be.
    assert fitted("white_noise")[1] < bias / 3

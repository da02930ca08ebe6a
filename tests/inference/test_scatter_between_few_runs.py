"""Few runs say little of the scatter between them: the fit against quadrature over the scales, in plain NumPy.

Two gyros along the axis of a rate table, in two runs of each sense: what one run has of its own, the relative error of
the table's rate explains as well, and then it is the same for both gyros.  Given the scatter all is linear and normal.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import logsumexp, ndtr, ndtri

from imubayes.api.fitting import fit
from imubayes.campaign_data import Campaign, Table
from imubayes.model.model_spec import EffectSpec, ModelSpec
from imubayes.results.result import Result
from small_campaign import ARCSEC, DEGREE, LATITUDE, _axes, _run, campaign, channels

SENSE, ROWS, SAMPLES = np.array([1, -1, 1, -1]), 12, 100
SCALE, RATE, EARTH = 1000.0, 100.0, 7.292115e-5 / DEGREE * np.sin(LATITUDE)  # pulse/s per deg/s, deg/s
NOISE, SCATTER, BIAS, ERROR = 0.5, 0.25, 10 / 3600, 5e-6  # pulse/s, pulse/s, deg/s, ratio: σ, and widths of priors
Z = np.linspace(-5, 3.5, 70)
TAU = SCATTER * ndtri((1 + ndtr(Z)) / 2)


def rows(offsets: np.ndarray) -> np.ndarray:
    """Return outputs (gyro, run, row) with given means of the runs, exactly."""
    noise = np.random.default_rng(5).normal(size=(2, len(SENSE), ROWS)) * NOISE / np.sqrt(SAMPLES)
    noise -= noise.mean(axis=2, keepdims=True)
    return SCALE * (RATE * SENSE + EARTH)[:, None] + offsets[:, :, None] + noise


# A gyro whose runs disagree beside one whose runs agree, with a third of the noise of a run mean.
OFFSETS = np.array([[0.005, -0.004, -0.003, 0.006], [0.31, -0.29, 0.28, -0.32]])


def measured(output: np.ndarray) -> Campaign:
    """Return the campaign of outputs (gyro, run, row), its runs in the order of the rows."""
    base = campaign()
    gyros = tuple(replace(channels()[2], name=name, axes=_axes(2), offset=0.0, noise=NOISE) for name in ("g1", "g2"))
    runs = []
    for place, sense in enumerate(SENSE):
        run = _run(
            f"run{place}", "rate_table", "rate", "flat", ROWS,
            table_rate=sense * RATE * DEGREE, table_angle=np.nan, table_angle_span=2 * np.pi, temperature=25.0,
        )  # fmt: skip
        blank = np.full((ROWS, 2), np.nan)
        runs.append(replace(run, observed=output[:, place].T.copy(), sample_sd=blank))
    tables = {"rate": Table("rate", 0.0, np.pi / 2, 20 * ARCSEC, ERROR, ARCSEC)}
    return replace(base, name="few-runs", channels=gyros, tables=tables, runs=tuple(runs))


def model(*scattering: str) -> ModelSpec:
    """Return the model with scatter between the runs of some gyros; the noise of rows is known."""
    return ModelSpec(
        "few-runs",
        (
            EffectSpec("gyro_bias", prior={"bias": f"normal(0, {BIAS * 3600} deg/h)"}),
            EffectSpec("table_rate_error"),
            EffectSpec("white_noise", prior={"sigma": f"lognormal({NOISE} output, 1e-4)"}),
            EffectSpec("run_scatter", channels=scattering, prior={"tau": f"halfnormal({SCATTER} output)"}),
        ),
    )


@cache
def fitted(*scattering: str) -> Result:
    return fit(measured(rows(OFFSETS)), model(*scattering), sample=False)


def marginals(taus: tuple[float, float]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return log p(y | τ), and mean and variance of both biases, deg/h, and of the error of the rate, ppm."""
    width = np.array([BIAS, BIAS, ERROR])
    design = np.array([[g == 0, g == 1, RATE * sense] for g in (0, 1) for sense in SENSE], float) * SCALE * width
    within = NOISE**2 / SAMPLES / ROWS
    own = np.repeat(within + np.square(taus), len(SENSE))
    misfit = (rows(OFFSETS).mean(axis=2) - SCALE * (RATE * SENSE + EARTH)).ravel()
    precision = np.eye(3) + design.T @ (design / own[:, None])
    mean = np.linalg.solve(precision, design.T @ (misfit / own))
    left = misfit - design @ mean
    height = -0.5 * (left @ (left / own) + mean @ mean + np.log(own).sum() + np.linalg.slogdet(precision)[1])
    unit = width * [3600, 3600, 1e6]
    return height, mean * unit, np.diag(np.linalg.inv(precision)) * unit**2


@cache
def quadrature(*scattering: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mean and sd of biases, rate error and scatters, and z (of those that scatter) at the highest density."""
    grid = [np.arange(len(Z)) if name in scattering else [None] for name in ("g1", "g2")]
    places = [(i, j) for i in grid[0] for j in grid[1]]
    taus = np.array([[0.0 if at is None else TAU[at] for at in place] for place in places])
    found = [marginals(tuple(pair)) for pair in taus]
    at = np.array([[Z[each] for each in place if each is not None] for place in places])
    density = np.array([each[0] for each in found]) - 0.5 * np.sum(at**2, axis=1)
    weight = np.exp(density - logsumexp(density))
    mean = np.concatenate([np.array([each[1] for each in found]), taus], axis=1)
    own = np.concatenate([np.array([each[2] for each in found]), np.zeros_like(taus)], axis=1)
    whole = weight @ mean
    return whole, np.sqrt(weight @ (own + (mean - whole) ** 2)), at[np.argmax(density)]


NAMES = ("gyro_bias.bias[g1]", "gyro_bias.bias[g2]", "table_rate_error.rate_error[rate]")


@pytest.mark.parametrize("scattering", [("g2",), ("g1", "g2")])
def test_the_summary_is_of_the_marginal_over_the_scales(scattering):
    mean, sd, _ = quadrature(*scattering)
    names = (*NAMES, *(f"run_scatter.tau[{name}]" for name in ("g1", "g2")))
    found = {each.name: each for each in fitted(*scattering).summary.parameters}
    for place, name in enumerate(names):
        if name in found:
            assert found[name].mean == pytest.approx(mean[place], abs=0.1 * sd[place]), name
            assert found[name].sd == pytest.approx(sd[place], rel=0.05), name


@pytest.mark.parametrize("scattering", [("g2",), ("g1", "g2")])
def test_the_mode_is_the_highest_maximum(scattering):
    result = fitted(*scattering)
    place = [result.fit.model.hyper_layout.names.index(f"run_scatter.tau[{name}]") for name in scattering]
    np.testing.assert_allclose(result.fit.h[place], quadrature(*scattering)[2], atol=Z[1] - Z[0])

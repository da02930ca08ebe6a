"""Few runs say little of the scatter between them: the fit against quadrature over the scales, in plain NumPy.

Gyros along the axis of a rate table, in two runs of each sense.  What one run has of its own, the relative error of the
table's rate explains as well, unless another gyro or other rates within the run contradict.  Given the scatter all is
linear and normal.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy.special import logsumexp, ndtr, ndtri

from imubayes.api.fitting import fit
from imubayes.foundations.campaign_data import Campaign, Table
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.results.result import Result
from small_campaign import ARCSEC, DEGREE, LATITUDE, _axes, _run, campaign, channels

# Whole fits against quadrature; at every run test_conditional_precision.py has the precision at any scatter.
pytestmark = pytest.mark.slow

GYROS, SENSE, ROWS, SAMPLES = ("g1", "g2"), np.array([1, -1, 1, -1]), 12, 100
SCALE, RATE, EARTH = 1000.0, 100.0, 7.292115e-5 / DEGREE * np.sin(LATITUDE)  # pulse/s per deg/s, deg/s
NOISE, SCATTER, BIAS, ERROR = 0.5, 0.25, 10 / 3600, 5e-6  # pulse/s, pulse/s, deg/s, ratio: σ, and widths of priors
Z = np.linspace(-5, 3.5, 70)
TAU = SCATTER * ndtri((1 + ndtr(Z)) / 2)
PPM = 1e-6


@dataclass(frozen=True)
class Data:
    """Rates (run, row), deg/s, and outputs (gyro, run, row)."""

    rate: np.ndarray
    output: np.ndarray

    @property
    def scatters(self) -> tuple[str, ...]:
        return tuple(f"run_scatter.tau[{name}]" for name in GYROS[: len(self.output)])


def noise(gyros: int) -> np.ndarray:
    """Return the noise of rows (gyro, run, row), without a mean in any run."""
    drawn = np.random.default_rng(5).normal(size=(gyros, len(SENSE), ROWS)) * NOISE / np.sqrt(SAMPLES)
    return drawn - drawn.mean(axis=2, keepdims=True)


def disagreeing() -> Data:
    """Return a gyro whose runs agree beside one whose runs do not: either may scatter, at another error of the rate."""
    rate = np.repeat(RATE * SENSE[:, None], ROWS, axis=1).astype(float)
    offsets = np.array([[0.005, -0.004, -0.003, 0.006], [0.31, -0.29, 0.28, -0.32]])
    return Data(rate, SCALE * (rate + EARTH) + offsets[:, :, None] + noise(2))


def contradicted() -> Data:
    """Return one gyro whose runs agree at an error of the rate that the rates within a run contradict.

    The density is highest where nothing scatters, and more of the mass is about the maximum where much does.
    """
    rate = SENSE[:, None] * (RATE + np.linspace(-12, 12, ROWS))
    within = rate - rate.mean(axis=1, keepdims=True)
    left = noise(1) - within * np.sum(noise(1) * within) / np.sum(within**2)
    return Data(rate, SCALE * (rate + EARTH + 3.5 * PPM * within) + left)


def measured(data: Data) -> Campaign:
    base = campaign()
    gyros = tuple(
        replace(channels()[2], name=name, axes=_axes(2), offset=0.0, noise=NOISE) for name in GYROS[: len(data.output)]
    )
    runs = []
    for place, rate in enumerate(data.rate):
        run = _run(
            f"run{place}", "rate_table", "rate", "flat", ROWS,
            table_rate=rate * DEGREE, table_angle=np.nan, table_angle_span=2 * np.pi, temperature=25.0,
        )  # fmt: skip
        output = data.output[:, place].T.copy()
        runs.append(replace(run, observed=output, sample_sd=np.full_like(output, np.nan)))
    tables = {"rate": Table("rate", 0.0, np.pi / 2, 20 * ARCSEC, ERROR, ARCSEC)}
    return replace(base, name="few-runs", channels=gyros, tables=tables, runs=tuple(runs))


MODEL = ModelSpec(
    "few-runs",
    (
        EffectSpec("gyro_bias", prior={"bias": f"normal(0, {BIAS * 3600} deg/h)"}),
        EffectSpec("table_rate_error"),
        EffectSpec("white_noise", prior={"sigma": f"lognormal({NOISE} output, 1e-4)"}),
        EffectSpec("run_scatter", prior={"tau": f"halfnormal({SCATTER} output)"}),
    ),
)


@cache
def fitted(data: Callable[[], Data]) -> Result:
    return fit(measured(data()), MODEL, sample=False)


def known_from(data: Data, gyro: int) -> list[np.ndarray]:
    """Return what a gyro determines at each τ of the biases and the error of the rate, in prior widths.

    Precision, gradient, square of the misfit and log determinant of the covariance.
    """
    own = np.zeros((*data.rate.shape, len(data.output)))
    own[..., gyro] = BIAS
    design = SCALE * np.concatenate([own, ERROR * data.rate[..., None]], axis=2).reshape(-1, own.shape[2] + 1)
    misfit = (data.output[gyro] - SCALE * (data.rate + EARTH)).ravel()
    run = np.repeat(np.arange(len(SENSE)), ROWS)
    covariance = NOISE**2 / SAMPLES * np.eye(len(run)) + TAU[:, None, None] ** 2 * (run[:, None] == run)
    inverse = np.linalg.inv(covariance)
    pulled = inverse @ misfit
    return [design.T @ inverse @ design, pulled @ design, pulled @ misfit, np.linalg.slogdet(covariance)[1]]


@cache
def quadrature(data: Callable[[], Data]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mean and sd of biases, error of the rate and scatters, and z of the scatters at the highest density."""
    recorded = data()
    count = len(recorded.output)
    places = np.array(list(product(range(len(Z)), repeat=count)))
    each = [[part[places[:, gyro]] for part in known_from(recorded, gyro)] for gyro in range(count)]
    precision, gradient, square, determinant = (np.sum(parts, axis=0) for parts in zip(*each, strict=True))
    precision = precision + np.eye(count + 1)
    mean = np.linalg.solve(precision, gradient[..., None])[..., 0]
    square = square - np.sum(gradient * mean, axis=1) + np.sum(Z[places] ** 2, axis=1)
    density = -0.5 * (square + determinant + np.linalg.slogdet(precision)[1])
    weight = np.exp(density - logsumexp(density))
    unit = np.array([BIAS * 3600] * count + [ERROR / PPM])
    mean = np.concatenate([mean * unit, TAU[places]], axis=1)
    variance = np.diagonal(np.linalg.inv(precision), axis1=1, axis2=2) * unit**2
    own = np.concatenate([variance, np.zeros(places.shape)], axis=1)
    whole = weight @ mean
    return whole, np.sqrt(weight @ (own + (mean - whole) ** 2)), Z[places[np.argmax(density)]]


@pytest.mark.parametrize("data", [contradicted, disagreeing])
def test_the_summary_is_of_the_marginal_over_the_scales(data):
    mean, sd, _ = quadrature(data)
    biases = (f"gyro_bias.bias[{name}]" for name in GYROS[: len(data().output)])
    names = (*biases, "table_rate_error.rate_error[rate]", *data().scatters)
    found = {each.name: each for each in fitted(data).summary.parameters}
    for place, name in enumerate(names):
        assert found[name].mean == pytest.approx(mean[place], abs=0.1 * sd[place]), name
        assert found[name].sd == pytest.approx(sd[place], rel=0.05), name


@pytest.mark.parametrize("data", [contradicted, disagreeing])
def test_the_mode_is_the_highest_maximum(data):
    names = fitted(data).fit.model.hyper_layout.names
    found = [fitted(data).fit.h[names.index(name)] for name in data().scatters]
    np.testing.assert_allclose(found, quadrature(data)[2], atol=Z[1] - Z[0])

"""The fit of all parameters at fixed noise scales: against SciPy over the same residual, compiled and in plain NumPy.

All begin at the middle of the prior (z = 0) and must end at the same optimum.  The times of SciPy are its best: the
faster of its two methods, each with the tolerances it comes with.
"""

import time
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from common import Report, in_words, once, seconds, trihedral
from plain_numpy import PlainModel
from scipy.optimize import least_squares

from imubayes.inference.levenberg_marquardt import GramCholesky
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.inference.parameter_fit import fit_at, fit_parameters
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import Model
from imubayes.model.likelihood import residuals
from imubayes.model.noise_covariance import whiten, whitener
from imubayes.model.problem import predict, predict_with_jacobian, prior_widths

COMPILED_BAR, PLAIN_BAR, SAME_WITHIN = 4.0, 20.0, 0.05
_METHODS = ("trf", "lm")

_fit = eqx.filter_jit(lambda problem, z, h: fit_parameters(problem, z, h))
_residuals = eqx.filter_jit(lambda problem, z, h: residuals(problem, z, h))
_predict = eqx.filter_jit(lambda problem, z: predict(problem, z))
_jacobian = eqx.filter_jit(lambda problem, z: predict_with_jacobian(problem, z)[1])


@eqx.filter_jit
def _whitened(problem, jacobian, h):
    by, widths = whitener(problem, h), prior_widths(problem, h)
    data = whiten(problem, by, jacobian)
    return jnp.concatenate([-data, jnp.diag(1 / widths)])


@eqx.filter_jit
def _normal_step(whitened, residual):
    operator = _Matrix(whitened)
    solver = GramCholesky()
    return solver.compute(solver.init(operator, {}), residual, {})[0]


class _Matrix(eqx.Module):
    """What `GramCholesky` asks of a linear operator."""

    matrix: jax.Array

    def as_matrix(self):
        return self.matrix

    def in_structure(self):
        return jax.ShapeDtypeStruct(self.matrix.shape[1:], self.matrix.dtype)


def measure(quick: bool = False) -> Report:
    report = Report("fit", "Fit at fixed noise scales: `data/trihedral-imu`, full baseline model")
    model = trihedral()
    problem = model.problem
    size, hyper_size = problem.size
    start = jnp.zeros(size)
    compile_seconds = once(lambda: fit_at(problem, start, jnp.zeros(hyper_size)))
    mode = find_mode(problem, start, jnp.zeros(hyper_size))
    h = mode.h
    report.say(f"{size} parameters at {hyper_size} fixed noise scales, {len(problem.observations.value)} readings.\n")

    outcome = _fit(problem, start, h)
    ours = seconds(lambda: fit_at(problem, start, h))
    best = np.asarray(fit_at(problem, start, h))
    deviation = np.sqrt(np.diag(np.linalg.inv(np.asarray(posterior_precision(problem, mode)))))

    def compiled(z: np.ndarray) -> np.ndarray:
        return np.asarray(_residuals(problem, z, h))

    plain = plain_model(model, np.asarray(h))
    other = np.random.default_rng(0).normal(size=size)
    agree = relative_difference(plain.residuals(other), compiled(other))
    assert agree < 1e-9, f"the plain residual differs by {agree:.1e}"
    rows = [["imubayes", "exact, sparse", in_words(ours), int(outcome.steps), "", "1", "0"]]
    fastest = {}
    for name, residual in (("compiled residual", compiled), ("plain NumPy residual", plain.residuals)):
        for method in _METHODS if not quick else _METHODS[:1]:
            taken, found, calls = timed_scipy(residual, size, method)
            off = float(np.max(np.abs(found - best) / deviation))
            same = f"{off:.1e}"
            rows.append([f"SciPy {method}, {name}", "2-point", in_words(taken), "", calls, f"{taken / ours:.1f}", same])
            if off < SAME_WITHIN:
                fastest[name] = min(fastest.get(name, np.inf), taken)
    report.table(["fit", "Jacobian", "time", "steps", "residuals", "times ours", "off by at most (posterior sd)"], rows)
    missing = {"compiled residual", "plain NumPy residual"} - fastest.keys()
    assert not missing, f"SciPy did not reach the optimum within {SAME_WITHIN} sd over the {missing}"
    report.judge("faster than SciPy over the compiled residual", fastest["compiled residual"] / ours, COMPILED_BAR)
    report.judge("faster than SciPy over the plain NumPy residual", fastest["plain NumPy residual"] / ours, PLAIN_BAR)
    report.say(f"- residuals of the two kinds agree to {agree:.1e} of the largest")
    report.say(
        f"- one residual: compiled {in_words(seconds(lambda: _residuals(problem, start, h)))}, "
        f"plain NumPy {in_words(seconds(lambda: plain.residuals(other)))}\n"
    )
    _parts(report, problem, mode, h, ours, int(outcome.steps))
    report.say(f"Compiling the fit without a cache, first call included: {compile_seconds:.1f} s.")
    return report


def _parts(report: Report, problem, mode, h, whole: float, steps: int) -> None:
    """Say where the time of the fit goes."""
    jacobian, residual = _jacobian(problem, mode.z), _residuals(problem, mode.z, h)
    whitened = _whitened(problem, jacobian, h)
    parts = {
        "residual": seconds(lambda: _residuals(problem, mode.z, h)),
        "Jacobian": seconds(lambda: _jacobian(problem, mode.z)),
        "linear algebra: whitening of the Jacobian": seconds(lambda: _whitened(problem, jacobian, h)),
        "linear algebra: normal equations, Cholesky, step": seconds(lambda: _normal_step(whitened, residual)),
    }
    report.say("Where the time goes: each part timed alone, once per step.\n")
    rows = [[name, in_words(taken), f"{100 * steps * taken / whole:.0f} %"] for name, taken in parts.items()]
    rest = whole - steps * sum(parts.values())
    rows.append(["rest (positive) or what fusing the parts saves (negative)", "", f"{100 * rest / whole:.0f} %"])
    rows.append([f"whole fit, {steps} steps", in_words(whole), "100 %"])
    report.table(["part", "time", "share of the fit"], rows)
    colours, size = problem.sparsity.seeds.shape
    report.say(f"The Jacobian takes {colours} forward derivatives for {size} parameters.\n")


def plain_model(model: Model, h: np.ndarray) -> PlainModel:
    """Return the plain NumPy model at noise scales h (in z)."""
    scales = dict(zip(model.hyper_layout.names, np.asarray(model.problem.hyper_priors.values(h)), strict=True))
    names = [channel.name for channel in model.campaign.channels]
    sigma, tau = ([scales[f"{kind}[{name}]"] for name in names] for kind in ("white_noise.sigma", "run_scatter.tau"))
    return PlainModel(model.campaign, model.layout, sigma, tau)


def timed_scipy(residual: Callable, size: int, method: str) -> tuple[float, np.ndarray, int]:
    """Return time, optimum and the number of residuals, those of the Jacobian included."""
    calls = 0

    def counted(z):
        nonlocal calls
        calls += 1
        return residual(z)

    residual(np.zeros(size))
    clock = time.perf_counter()
    found = least_squares(counted, np.zeros(size), jac="2-point", method=method)
    return time.perf_counter() - clock, found.x, calls


def relative_difference(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.max(np.abs(first - second)) / np.max(np.abs(second)))

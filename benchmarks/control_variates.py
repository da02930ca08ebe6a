"""Control variates on weighted draws of the proposal: what they would gain for means and standard deviations.

The proposal makes a point of standard normal x, whose mean and variance are known.  The influence of a draw on a mean,
w (f − μ) with w its importance weight of mean 1, and that on a variance, w ((f − μ)² − σ²), are regressed on x and
x² − 1; what is left has the Monte Carlo error of the intercept.  The gain is the ratio of the variances without and
with the regression: so many times the draws.
"""

import numpy as np
from common import ROOT, Report

from imubayes.campaign import load_campaign
from imubayes.inference.fitted_model import Fit
from imubayes.inference.laplace_proposal import LaplaceProposal, LogDensity, weigh
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.derived_quantities import evaluate_derived
from imubayes.model.model_file import read_model
from imubayes.results.marginal import Marginal, numerical_tolerance
from imubayes.results.posterior_groups import in_units
from imubayes.results.summary import is_constant

# Campaigns with their models and the number of independent sets of draws.
CAMPAIGNS = {
    "accel-channel": ("accel-channel", 24),
    "hidden-gyro": ("hidden-effects", 24),
    "multi-axis-table": ("multi-axis-table", 4),
    "trihedral-imu": ("trihedral-imu", 4),
    "desk-imu": ("desk-imu", 4),
}
DRAWS, QUICK_DRAWS = 12_000, 2000

HEAD = (
    "campaign",
    "quantities",
    "sets × draws",
    "efficiency",
    "mean: median",
    "mean: worst",
    "sd: median",
    "sd: worst",
    "scatter/stated",
    "an end decides",
    "more digits",
)
DECISION = """\
Efficiency: of the importance weights.  Scatter/stated: variance over the sets of draws over that of the residuals.  An
end decides: quantities with the largest Monte Carlo error at an end of the 95 % interval.  More digits: quantities that
would be printed with more digits if mean and standard deviation were exact.

Not adopted: the posteriors gain, what is printed does not.  Digits follow from the largest Monte Carlo error of mean,
standard deviation and both ends (JCGM 101, 7.9.4); quantiles are left as they are, and the ends decide.  The summary
would no longer have the moments of the draws that are stored, from which report, budgets and ArviZ take theirs.  Where
the proposal is worst and draws are dearest, `desk-imu`, standard deviations gain next to nothing."""


def compare(report: Report, quick: bool = False) -> None:
    """Say what the regression gains for the quantities that a summary states, campaign by campaign."""
    report.say("\n## Control variates for means and standard deviations\n")
    report.say("Weighted draws of the proposal: times the effective draws by regression on its x and x² − 1.\n")
    rows, count = [], QUICK_DRAWS if quick else DRAWS
    for campaign, (model, sets) in CAMPAIGNS.items():
        bound = bind(read_model(ROOT / f"models/{model}.toml"), load_campaign(ROOT / "data" / campaign))
        fit = joint_fit(bound, None, laplace_draws=count)
        rows.append([campaign, *_gains(fit, 2 if quick else sets, count)])
    report.table(HEAD, rows)
    report.say(DECISION)


def _gains(fit: Fit, sets: int, count: int) -> list[str]:
    """Return the cells of a campaign."""
    assert fit.posterior is not None
    problem = fit.model.problem
    proposal, density = LaplaceProposal(fit.posterior.approximation, problem), LogDensity(problem, 64)
    stated = _stated(fit, fit.posterior.points)
    varies = np.array([not is_constant(draws) for draws in stated.T])
    centre, spread = stated.mean(axis=0), stated.std(axis=0)
    ends, more = zip(*(_digits(Marginal(draws, count)) for draws in stated[:, varies].T), strict=True)
    efficiency, found = [], []
    for seed in range(sets):
        weighed = weigh(density, proposal, 1, count, seed)
        assert weighed is not None
        points, weight = weighed.points[0], weighed.weight[0]
        efficiency.append(1 / np.mean(weight**2))
        values = (_stated(fit, points) - centre)[:, varies] / spread[varies]
        normal = proposal.to_normal(points)[0]
        controls = np.concatenate([normal, normal**2 - 1], axis=1)
        found.append((*moments(values, weight, controls[:, :0]), *moments(values, weight, controls)))
    _, plain, estimates, left = (np.stack(part) for part in zip(*found, strict=True))
    gain = (plain.mean(axis=0) / left.mean(axis=0)).reshape(2, -1)
    scatter = np.mean(estimates.var(axis=0, ddof=1) / left.mean(axis=0))
    cells = [f"{cell:.3g}" for of in gain for cell in (np.median(of), of.min())]
    digits = [f"{sum(ends)}", f"{sum(more)}"]
    return [f"{gain.shape[1]}", f"{sets} × {count}", f"{np.mean(efficiency):.3f}", *cells, f"{scatter:.2f}", *digits]


def _stated(fit: Fit, points: np.ndarray) -> np.ndarray:
    """Return the quantities (n, Q) of points in z that a summary states: parameters, noise scales and derived ones."""
    shown = [not each.nuisance for each in fit.model.layout.parameters + fit.model.hyper_layout.parameters]
    derived = evaluate_derived(fit.derived.derivation, fit.model.problem, points[:, : len(fit.z)])
    return np.concatenate([in_units(fit.model, points)[:, shown], derived], axis=1)


def _digits(marginal: Marginal) -> tuple[bool, bool]:
    """Return whether an end has the largest Monte Carlo error, and whether exact mean and sd would give more digits."""
    end = max(marginal.errors.low, marginal.errors.high)
    largest, tolerances = marginal.errors.largest, [numerical_tolerance(marginal.sd, digits) for digits in (1, 2)]
    return end == largest, any(2 * end <= tolerance < 2 * largest for tolerance in tolerances)


def intercepts(values: np.ndarray, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of values (n, Q) if controls (n, C) are at their expectation 0, and its variance, (Q,) each.

    Both by least squares, the coefficients from the same draws.
    """
    regressors = np.concatenate([np.ones((len(values), 1)), controls], axis=1)
    coefficients = np.linalg.solve(regressors.T @ regressors, regressors.T @ values)
    left = np.sum((values - regressors @ coefficients) ** 2, axis=0)
    return coefficients[0], left / (len(values) - regressors.shape[1]) / len(values)


def moments(values: np.ndarray, weight: np.ndarray, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return means and standard deviations of values (n, Q) and the variances of both, (2 Q,) each.

    Parameters
    ----------
    weight : shape (n,), of mean 1.
    controls : shape (n, C).
    """
    mean = weight @ values / len(values)
    square = (values - mean) ** 2
    variance = weight @ square / len(values)
    of_mean, error = intercepts(weight[:, None] * (values - mean), controls)
    of_variance, variance_error = intercepts(weight[:, None] * (square - variance), controls)
    sd = np.sqrt(variance + of_variance)
    return np.concatenate([mean + of_mean, sd]), np.concatenate([error, variance_error / (4 * sd**2)])

"""Outliers: which samples they are, and whether they have a common cause."""

from collections.abc import Sequence

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.noise_tests import to_entries
from imubayes.criticism.projection import Projection
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.inference.posterior_mode import Mode
from imubayes.inference.posterior_precision import deviations
from imubayes.model.bind import Model
from imubayes.model.noise_covariance import noise_distribution
from imubayes.model.problem import Problem
from imubayes.tail_probabilities import binomial_survival, poisson_survival


def find_outliers(projection: Projection) -> np.ndarray:
    """Return which samples are outliers, (E,) bool: beyond the threshold in robust standard deviations."""
    size = np.abs(to_entries(projection, projection.residual[:, None])[:, 0])
    # High-leverage samples have small raw residuals; studentise (Cook & Weisberg 1982).
    leverage = np.sum(to_entries(projection, projection.basis) ** 2, axis=1)
    size /= np.sqrt(np.maximum(1 - leverage, thresholds.UNLEVERAGED_MIN))
    model, found = projection.fitted.model, np.zeros(len(size), dtype=bool)
    used = (np.asarray(model.problem.observations.weight) > 0) & ~model.entries.closing
    for place in np.unique(model.entries.channel[used]):
        own = (model.entries.channel == place) & used
        found[own] = size[own] > thresholds.OUTLIER_SD * np.median(size[own]) / thresholds.NORMAL_MAD
    return found


def deletion_residuals(problem: Problem, mode: Mode) -> tuple[np.ndarray, np.ndarray]:
    """Return how far samples lie from the prediction of the others, each (E,).

    First in standard deviations of the noise of a sample; then in those of its difference from the others of its run
    and channel, the uncertainty of the prediction included.

    Parameters
    ----------
    problem : with the outliers masked.
    mode : the fit without them.
    """
    precision, about = posterior_precision(problem, mode), mode.about
    group = np.asarray(problem.observations.group)
    used = (np.asarray(problem.observations.weight) > 0).astype(float)
    count = np.maximum(np.bincount(group, used), 1.0)

    def centred(values: np.ndarray) -> np.ndarray:
        mean = np.zeros((len(count), values.shape[1]))
        np.add.at(mean, group, used[:, None] * values)
        return values - (mean / count[:, None])[group]

    own = np.asarray(noise_distribution(problem, mode.h).squared_scale)
    jacobian = centred(np.asarray(about.jacobian))
    misfit = centred(np.asarray(about.misfit)[:, None])[:, 0]
    variance = own * (1 + 1 / count[group]) + deviations(jacobian, np.asarray(precision)) ** 2
    return misfit / np.sqrt(own), misfit / np.sqrt(variance)


def clustered(projection: Projection, outlying: np.ndarray, covariates: Sequence[ResidualCovariate]) -> bool:
    """Tell whether outliers, (E,) bool, cluster at one value of a covariate, in more than one run.

    A row counts once, however many of its channels are outliers: a disturbance acts on all of them.
    """
    model = projection.fitted.model
    entries, channels = model.entries, model.campaign.channels
    row = np.unique(np.stack([entries.run, entries.row]), axis=1, return_inverse=True)[1].reshape(-1)
    tables = [*(covariate.values for covariate in covariates), _of_table(model, "table_rate")]
    p_values: list[float] = []
    for kind in dict.fromkeys(channel.kind for channel in channels):
        of_kind = [place for place, channel in enumerate(channels) if channel.kind == kind]
        here = np.isin(entries.channel, of_kind) & ~entries.closing
        share = len(np.unique(row[here & outlying])) / max(len(np.unique(row[here])), 1)
        cells = [cell for values in tables for cell in _cells(values, here)]
        p_values += [p for cell in cells for p in _cluster_p(row, entries.run, cell, cell & outlying, share)]
    return min(p_values, default=1.0) * len(p_values) < thresholds.CLUSTER_P


def _cluster_p(row: np.ndarray, run: np.ndarray, cell: np.ndarray, hit: np.ndarray, share: float) -> list[float]:
    """Return the binomial p-value of the outliers in one cell; nothing where the cell has too few rows or runs."""

    def sufficient(chosen: np.ndarray) -> bool:
        rows, runs = len(np.unique(row[chosen])), len(np.unique(run[chosen]))
        return rows >= thresholds.CLUSTER_ROWS and runs >= thresholds.CLUSTER_RUNS

    if not sufficient(cell):
        return []
    hits, rows = len(np.unique(row[hit])), len(np.unique(row[cell]))
    return [binomial_survival(hits, rows, share) if sufficient(hit) else 1.0]


def consecutive(model: Model, sizes: np.ndarray) -> bool:
    """Tell whether outliers follow one another with the same sign: a step, or a narrow peak.

    Parameters
    ----------
    sizes : shape (E,), signed deletion residual of each outlier; 0 for other samples.

    Random outliers are seldom neighbours in time: the number of such pairs is then Poisson-distributed.
    """
    series = np.asarray(model.problem.observations.in_time)
    signs = np.concatenate([np.sign(sizes), [0.0]])
    first, second = series[:, :-1], series[:, 1:]
    neighbours = (first < len(sizes)) & (second < len(sizes))
    at = first[neighbours & (signs[first] * signs[second] > 0)]
    # A shock to the table acts on all channels, and counts once.
    pairs = len(np.unique(np.stack([model.entries.run[at], model.entries.row[at]]), axis=1).T)
    expected = neighbours.sum() * np.mean(sizes != 0) ** 2 / 2
    return pairs > 0 and poisson_survival(pairs, expected) < thresholds.CLUSTER_P


def _of_table(model: Model, name: str) -> np.ndarray:
    """Return a covariate of the table at each entry, (E,), NaN without a table: it acts on all channels alike."""
    entries, found = model.entries, np.full(len(model.entries), np.nan)
    for index, run in enumerate(model.campaign.runs):
        if run.table is not None and name in run.covariates:
            within = (entries.run == index) & ~entries.closing
            found[within] = run.covariates[name][entries.row[within]]
    return found


def _cells(values: np.ndarray, here: np.ndarray) -> list[np.ndarray]:
    """Return the entries at each value of a covariate, or in each quantile bin where values are many, (E,) bool."""
    here = here & np.isfinite(values)
    if not here.any():
        return []
    size = float(np.abs(values[here]).max())
    rounded = np.round(values / (size or 1.0), thresholds.OUTLIER_DIGITS)
    single = np.unique(rounded[here])
    if len(single) <= thresholds.OUTLIER_MAX_VALUES:
        return [here & (rounded == value) for value in single]
    edges = np.quantile(rounded[here], np.linspace(0, 1, thresholds.OUTLIER_BINS + 1)[1:-1])
    part = np.searchsorted(edges, rounded)
    return [here & (part == bin_) for bin_ in range(thresholds.OUTLIER_BINS)]

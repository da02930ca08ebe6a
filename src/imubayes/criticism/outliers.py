"""Readings that are far off: which they are, and whether they have a cause in common."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

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


def find_outliers(projection: Projection) -> np.ndarray:
    """Return which readings are so far off that a normal law does not bring them about, (E,) bool."""
    left = np.abs(to_entries(projection, projection.residual[:, None])[:, 0])
    # A reading that the model leans on hides most of what it is off by (studentised residuals, Cook & Weisberg 1982).
    leant_on = np.sum(to_entries(projection, projection.basis) ** 2, axis=1)
    left /= np.sqrt(np.maximum(1 - leant_on, thresholds.UNLEVERAGED_MIN))
    model, found = projection.fitted.model, np.zeros(len(left), dtype=bool)
    seen = (np.asarray(model.problem.observations.weight) > 0) & ~model.entries.closing
    for place in np.unique(model.entries.channel[seen]):
        own = (model.entries.channel == place) & seen
        found[own] = left[own] > thresholds.OUTLIER_SD * np.median(left[own]) / thresholds.NORMAL_MAD
    return found


def deletion_residuals(problem: Problem, mode: Mode) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much readings differ from what the rest predicts, each (E,).

    First in standard deviations of a reading, then in those of its difference from the others of its run and channel:
    what the rest predicts is uncertain, and what a run's readings have in common is none of its own.

    Parameters
    ----------
    problem : with the others masked out.
    mode : the fit to the rest.
    """
    known, about = posterior_precision(problem, mode), mode.about
    group = np.asarray(problem.observations.group)
    seen = (np.asarray(problem.observations.weight) > 0).astype(float)
    count = np.maximum(np.bincount(group, seen), 1.0)

    def apart(values: np.ndarray) -> np.ndarray:
        mean = np.zeros((len(count), values.shape[1]))
        np.add.at(mean, group, seen[:, None] * values)
        return values - (mean / count[:, None])[group]

    own, jacobian = np.asarray(noise_distribution(problem, mode.h).squared_scale), apart(np.asarray(about.jacobian))
    misfit = apart(np.asarray(about.misfit)[:, None])[:, 0]
    variance = own * (1 + 1 / count[group]) + deviations(jacobian, np.asarray(known)) ** 2
    return misfit / np.sqrt(own), misfit / np.sqrt(variance)


def clustered(projection: Projection, far: np.ndarray, known: Sequence[ResidualCovariate]) -> bool:
    """Tell whether readings that are far off, (E,) bool, gather at one value of a covariate, in more than one run.

    A row counts once, however many of its channels are far off: what happens once happens to all of them.
    """
    entries, channels = projection.fitted.model.entries, projection.fitted.model.campaign.channels
    row = np.unique(np.stack([entries.run, entries.row]), axis=1, return_inverse=True)[1].reshape(-1)
    best, looks = 1.0, 0
    for kind in dict.fromkeys(channel.kind for channel in channels):
        of_kind = [place for place, channel in enumerate(channels) if channel.kind == kind]
        here = np.isin(entries.channel, of_kind) & ~entries.closing
        share = len(np.unique(row[here & far])) / max(len(np.unique(row[here])), 1)
        for values in (*(one.values for one in known), _of_table(projection.fitted.model, "table_rate")):
            for cell in _cells(values, here):
                hit = cell & far
                rows = np.unique(row[hit])
                if (
                    len(np.unique(row[cell])) < thresholds.CLUSTER_ROWS
                    or len(np.unique(entries.run[cell])) < thresholds.CLUSTER_RUNS
                ):
                    continue
                looks += 1
                if len(rows) >= thresholds.CLUSTER_ROWS and len(np.unique(entries.run[hit])) >= thresholds.CLUSTER_RUNS:
                    best = min(best, float(stats.binom.sf(len(rows) - 1, len(np.unique(row[cell])), share)))
    return best * looks < thresholds.CLUSTER_P


def consecutive(model: Model, sizes: np.ndarray) -> bool:
    """Tell whether readings that are far off follow one another, off to the same side: a step, or a narrow peak.

    Parameters
    ----------
    sizes : shape (E,), by how much readings are off, with their sign; 0 for those that are not.

    Readings that are hit at random are seldom neighbours in time: the number of such pairs is then Poisson's.
    """
    series = np.asarray(model.problem.observations.in_time)
    signs = np.concatenate([np.sign(sizes), [0.0]])
    first, second = series[:, :-1], series[:, 1:]
    neighbours = (first < len(sizes)) & (second < len(sizes))
    alike = neighbours & (signs[first] * signs[second] > 0)
    at = first[alike]
    # A blow to the table hits all channels at once, and counts once.
    pairs = len(np.unique(np.stack([model.entries.run[at], model.entries.row[at]]), axis=1).T)
    expected = neighbours.sum() * np.mean(sizes != 0) ** 2 / 2
    return float(stats.poisson.sf(pairs - 1, expected)) < thresholds.CLUSTER_P


def _of_table(model: Model, name: str) -> np.ndarray:
    """Return what a table did at each reading, (E,), NaN where there is none: it acts on all channels alike."""
    entries, found = model.entries, np.full(len(model.entries), np.nan)
    for index, run in enumerate(model.campaign.runs):
        if run.table is not None and name in run.covariates:
            within = (entries.run == index) & ~entries.closing
            found[within] = run.covariates[name][entries.row[within]]
    return found


def _cells(values: np.ndarray, here: np.ndarray) -> list[np.ndarray]:
    """Return readings of equal values of a covariate, or of neighbouring ones where there are many, each (E,) bool."""
    here = here & np.isfinite(values)
    if not here.any():
        return []
    size = float(np.abs(values[here]).max())
    rounded = np.round(values / (size or 1.0), thresholds.OUTLIER_DIGITS)
    single = np.unique(rounded[here])
    if len(single) <= thresholds.OUTLIER_MAX_VALUES:
        return [here & (rounded == one) for one in single]
    edges = np.quantile(rounded[here], np.linspace(0, 1, thresholds.OUTLIER_BINS + 1)[1:-1])
    part = np.searchsorted(edges, rounded)
    return [here & (part == one) for one in range(thresholds.OUTLIER_BINS)]

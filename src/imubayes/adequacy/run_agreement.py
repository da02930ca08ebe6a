"""Which runs the others do not predict: what `fit` says before any diagnosis.

At the noise known before the fit every run is predicted from the others.  Only where these agree with one another is a
run told: where all runs still scatter, something is missing in the model and no run is to blame.  What in the record of
a run is wrong is weighed by `imubayes.criticism.evidence`.
"""

import math

import numpy as np

from imubayes.adequacy.adequacy_record import DoubtedRun
from imubayes.adequacy.deletion_diagnostics import LinearFit, WeightedFit, linear_fit
from imubayes.adequacy.known_noise import known_scales, largest_scatter, scales_between_runs
from imubayes.inference.fitted_model import Fit
from imubayes.tail_probabilities import f_log_survival

_TOLD_P = 0.005
"""Chance, for all runs together, below which a run is told to disagree (convention)."""


def known_before(fitted: Fit) -> np.ndarray:
    """Return the noise scales at which runs are judged, in z: as known beforehand, or as fitted where that is less.

    A scatter between runs that is less as fitted tells nothing: beside a gross error white noise takes it all.
    """
    known, between = known_scales(fitted, correlated=True), scales_between_runs(fitted.model)
    return np.where(between, known, np.minimum(known, np.asarray(fitted.h)))


def doubted_runs(fitted: Fit) -> tuple[DoubtedRun, ...]:
    """Return the runs that the others do not predict although they agree with one another, the least probable first."""
    if not fitted.optimised:
        return ()
    linear = linear_fit(fitted.model, fitted.model.problem, fitted.z, known_before(fitted))
    names, found = [run.name for run in fitted.model.campaign.runs], []
    largest = largest_scatter(fitted.model)
    for run, log_p in disagreeing_runs(linear).items():
        if log_p < math.log(_TOLD_P) and _agree(linear.fit(linear.whole - linear.of_run(run)), largest):
            found.append(DoubtedRun(run=names[run], p=math.exp(log_p)))
    return tuple(sorted(found, key=lambda each: each.p))


def disagreeing_runs(linear: LinearFit) -> dict[int, float]:
    """Return the log p-value of what each run adds to the χ² of the others, corrected for the number of runs."""
    found, runs = {}, linear.runs
    for run in runs if len(runs) > 1 else ():
        chi2, dof, freedom = _deletion(linear, run)
        f = chi2 / max(dof, 1)
        # Where the others scatter more than was known their noise is an estimate.
        log_p = float(f_log_survival(f, dof, freedom)) if freedom else 0.0
        found[run] = log_p + np.log(len(runs))
    return found


def _agree(others: WeightedFit, largest: np.ndarray) -> bool:
    """Whether no channel scatters more than what is known of its noise allows, (K,), as a factor."""
    count = min(len(largest), len(others.weight))  # closing rotations come after the channels
    seen = others.equations.count[:count] > 0
    return bool(np.all(~seen | (others.noise_ratios[:count] <= largest[:count] ** 2)))


def _deletion(linear: LinearFit, run: int) -> tuple[float, int, float]:
    """Return the χ² that a run adds to the others, its number of outputs, and degrees of freedom of the others.

    Each channel has the noise that the others show if that is larger, and one that they lack that of the median output.
    """
    others = linear.whole - linear.of_run(run)
    weight = 1 / linear.fit(others).noise_ratios
    usual = np.median(np.repeat(weight, others.count)) if others.count.any() else 1.0
    weight = np.where(others.count > 0, weight, usual)
    rest, whole = linear.fit(others, weight), linear.fit(linear.whole, weight)
    freedom = max(float(others.count.sum()) - len(rest.shift), 1.0)
    return max(whole.chi2 - rest.chi2, 0.0), len(linear.runs[run]), freedom

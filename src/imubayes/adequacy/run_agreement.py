"""Which runs the others do not predict: what `fit` says before any diagnosis.

At the noise known before the fit every run is predicted from the others.  Only where these agree with one another is a
run told: where all runs still scatter, something is missing in the model and no run is to blame.  What in the record of
a run is wrong is weighed by `imubayes.criticism.evidence`.
"""

import math

import numpy as np

from imubayes.adequacy.adequacy_record import DoubtedRun
from imubayes.adequacy.deletion_diagnostics import LinearFit, linear_fit
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
        others = linear.weighted_by(np.where(linear.at.run != run, linear.weight, 0.0))
        if _agree(others, largest) and log_p < math.log(_TOLD_P):
            found.append(DoubtedRun(run=names[run], p=math.exp(log_p)))
    return tuple(sorted(found, key=lambda each: each.p))


def disagreeing_runs(linear: LinearFit) -> dict[int, float]:
    """Return the log p-value of what each run adds to the χ² of the others, corrected for the number of runs."""
    found = {}
    runs = np.unique(linear.at.run[linear.weight > 0]).tolist()
    for run in runs if len(runs) > 1 else ():
        chi2, dof, freedom = _deletion(linear, run)
        f = chi2 / max(dof, 1)
        # Where the others scatter more than was known their noise is an estimate.
        log_p = float(f_log_survival(f, dof, freedom)) if freedom else 0.0
        found[run] = log_p + np.log(len(runs))
    return found


def _agree(linear: LinearFit, largest: np.ndarray) -> bool:
    """Whether no channel scatters more than what is known of its noise allows, (K,), as a factor."""
    ratios = linear.noise_ratios(linear.weight > 0)
    return bool(np.all(ratios <= np.where(linear.weight > 0, largest[linear.at.channel] ** 2, np.inf)))


def _deletion(linear: LinearFit, run: int) -> tuple[float, int, float]:
    """Return the χ² that a run adds to the others, its number of outputs, and degrees of freedom of the others."""
    rest = linear.without_run(run)
    own = (linear.at.run == run) & (linear.weight > 0)
    weight = rest.weight + np.where(own, _ratio_of_channels(rest, own), 0.0)
    freedom = max(float((rest.weight > 0).sum()) - len(rest.shift), 1.0)
    return max(linear.weighted_by(weight).chi2 - rest.chi2, 0.0), int(own.sum()), freedom


def _ratio_of_channels(rest: LinearFit, own: np.ndarray) -> np.ndarray:
    """Return the weight of each entry of a run, (E,): that of its channel in the other runs, or else of all."""
    used = rest.weight > 0
    found = np.full(len(own), float(np.median(rest.weight[used])) if used.any() else 1.0)
    for channel in np.unique(rest.at.channel[own]):
        same = used & (rest.at.channel == channel)
        if same.any():
            found[rest.at.channel == channel] = float(rest.weight[same][0])
    return found

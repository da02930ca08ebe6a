"""The rows of a campaign that its set-up is judged by: few of those in which the table moves.

Lags and lever arms act in rows of a changing rate, and a set-up is judged without them.  Of a run that follows the
angle of its table the judgement takes the rows at rest and at constant rate, and of the others the steadiest ones, fast
and slow.  Its time grows with the number of rows, and a mistake in a set-up shows in a few.
"""

from dataclasses import replace

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.procedures.followed_rows import followed

_MOST = 40  # rows in motion of a run, of each kind
_LATE, _CHANGE = 0.05, 0.01  # s, as `MOST_SKEW`; change of the rate in this time, of the largest, that a row may have


def steady_rows(campaign: Campaign) -> Campaign:
    """Return the campaign with the steadiest of the rows in motion."""
    return replace(campaign, runs=tuple(map(_of_run, campaign.runs)))


def without_motion(campaign: Campaign) -> Campaign:
    """Return the campaign without runs that have rows in motion: an encoder read them, sample by sample."""
    return replace(campaign, runs=tuple(run for run in campaign.runs if not followed(run).any()))


def _of_run(run: Run) -> Run:
    moves = followed(run)
    if not moves.any():
        return run
    acceleration, rate = np.abs(run.covariates["table_acceleration"]), np.abs(run.covariates["table_rate"])
    steady = moves & (acceleration * _LATE < _CHANGE * rate.max())
    fast = steady & (rate > np.median(rate[moves]))
    kept = ~moves
    for group in (fast, steady):
        places = np.flatnonzero(group)
        kept[places[np.argsort(acceleration[places], kind="stable")[:_MOST]]] = True
    return replace(
        run,
        covariates={name: values[kept] for name, values in run.covariates.items()},
        observed=run.observed[kept],
        samples=run.samples[kept],
        sample_sd=run.sample_sd[kept],
    )

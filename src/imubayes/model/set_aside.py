"""A campaign without the readings that a model sets aside: the rest is fitted as if they had not been recorded.

The files are not touched.  A run of which nothing is left is none of the runs; of others the cells are empty, as those
of missing readings are.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Run, SetAside
from imubayes.foundations.errors import InputError, Issue, closest_first, refuse


def without(campaign: Campaign, wanted: Sequence[SetAside], where: str) -> Campaign:
    """Return a campaign without some readings; the same if they have been taken out of it.

    Parameters
    ----------
    where : the model that sets them aside, for errors.

    Raises
    ------
    InputError
        for runs, channels and rows that are not there, rows of a free tumble, and if nothing is left.
    """
    if campaign.set_aside == tuple(wanted):
        return campaign
    refuse(issue for each in wanted for issue in _issues(campaign, each, where))
    runs = tuple(run for run in (_rest(campaign, run, wanted) for run in campaign.runs) if run is not None)
    if not runs:
        what = "every run of the campaign is set aside"
        raise InputError([Issue(what, where, "some of the runs", "take a run back: remove its [[set_aside]]")])
    return replace(campaign, runs=runs, set_aside=(*campaign.set_aside, *wanted))


def _issues(campaign: Campaign, wanted: SetAside, where: str) -> list[Issue]:
    """Return what of some readings is not in a campaign."""
    place, runs = f"{where}, set_aside of run '{wanted.run}'", {run.name: run for run in campaign.runs}
    if wanted.run not in runs:
        what = f"the campaign has no run '{wanted.run}'"
        return [Issue(what, place, closest_first(wanted.run, runs), "name one of the runs, or remove the entry")]
    run, channels = runs[wanted.run], [channel.name for channel in campaign.channels]
    found = [
        Issue(f"the unit has no channel '{name}'", place, closest_first(name, channels), "name one of the channels")
        for name in wanted.channels
        if name not in channels
    ]
    beyond = [row for row in wanted.rows if row > run.rows]
    if beyond:
        what = f"the run has no row {beyond[0]}"
        found.append(Issue(what, place, f"rows 1 to {run.rows}", "correct the number"))
    if run.tumble is not None and (wanted.rows or wanted.channels):
        what = "the readings of a free tumble belong together: its motion links them"
        found.append(Issue(what, place, "a whole run of free tumble", "set the run aside, without rows and channels"))
    return found


def _rest(campaign: Campaign, run: Run, wanted: Sequence[SetAside]) -> Run | None:
    """Return what is left of a run; None if nothing is."""
    own = [each for each in wanted if each.run == run.name]
    if not own:
        return run
    observed, names = run.observed.copy(), [channel.name for channel in campaign.channels]
    for each in own:
        rows = np.array(each.rows, dtype=int) - 1 if each.rows else np.arange(run.rows)
        channels = [names.index(name) for name in each.channels or names]
        observed[np.ix_(rows, channels)] = np.nan
    return replace(run, observed=observed) if np.isfinite(observed).any() else None

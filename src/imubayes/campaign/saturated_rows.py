"""Means at the limit of a channel, which are left out.

Means at the limit of their channel are left out, because they only say that the input was beyond.  A raw log shows its
limit by samples that stay there.  A table of means shows it by equal outputs at different inputs, or by a mean without
scatter that falls short of the line through the others, each at the extreme of the channel.  Means of samples near a
limit are biased as well.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imubayes.campaign.physical_checks import LEAST_SPREAD
from imubayes.campaign.run_reader import Equipment, Loaded
from imubayes.campaign.stream_checks import Finding
from imubayes.foundations.campaign_data import Channel, Run
from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import InputError
from imubayes.procedures import PROCEDURES

if TYPE_CHECKING:
    from imubayes.campaign import reduction as reduce
else:
    reduce = DeferredModule("imubayes.campaign.reduction")  # only raw logs need it

LEAST_ROWS = 5  # of a channel, to determine a limit
EQUAL_OUTPUT = 1e-9  # of the range of the outputs
OTHER_INPUT = 0.02  # of the range of the inputs
SHORT_OF_LINE = 0.01  # of the range of the outputs; a coarse output without scatter at rest lies on the line
NEAR_LIMIT_SD = 4.0  # a mean so near to the limit holds clipped samples


def without_saturated_rows(loaded: Sequence[Loaded], files: Sequence[str], equipment: Equipment) -> None:
    """Empty the cells of clipped means in every run, and note what was left out as a finding of the run.

    Parameters
    ----------
    loaded : the runs, changed in place; free tumbles and runs that could not be loaded are left as they are.
    files : the table of each.
    """
    runs = [each.run for each in loaded if each.run is not None and each.run.tumble is None]
    if not runs:
        return
    for place, channel in enumerate(equipment.channels):
        limits = tuple(_limits(runs, place, channel, equipment))
        for each, file in zip(loaded, files, strict=True):
            if limits and each.run is not None and each.run.tumble is None:
                _leave_out(each, each.run, place, channel, limits, file)


def _limits(runs: Sequence[Run], place: int, channel: Channel, equipment: Equipment) -> Iterator[float]:
    """Yield the limits that the means of a channel show."""
    observed = np.concatenate([run.observed[:, place] for run in runs])
    stimulus = np.concatenate([_stimulus(run, channel, equipment) for run in runs])
    known = np.isfinite(observed) & np.isfinite(stimulus)
    if (
        known.sum() < LEAST_ROWS
        or np.ptp(observed[known]) == 0
        or np.ptp(stimulus[known]) <= LEAST_SPREAD[channel.kind]
    ):
        return
    steady = np.concatenate([(run.sample_sd[:, place] == 0) & (run.samples > 1) for run in runs])
    steady = steady & (_scatter(runs, place) > 0)
    for extreme, inward in ((float(observed[known].min()), 1.0), (float(observed[known].max()), -1.0)):
        there = known & (np.abs(observed - extreme) <= EQUAL_OUTPUT * np.ptp(observed[known]))
        others = known & ~there
        apart = np.ptp(stimulus[there]) > OTHER_INPUT * np.ptp(stimulus[known])
        short = inward * _beyond_line(stimulus, observed, others) > SHORT_OF_LINE * np.ptp(observed[known])
        if apart or (there & steady & short).any():
            yield extreme


def _beyond_line(stimulus: np.ndarray, observed: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return by how much outputs exceed the straight line through the other rows, (R,); 0 where these give none."""
    if others.sum() < LEAST_ROWS - 1 or np.ptp(stimulus[others]) == 0:
        return np.zeros(len(observed))
    slope, intercept = np.polyfit(stimulus[others], observed[others], 1)
    return observed - (slope * stimulus + intercept)


def _stimulus(run: Run, channel: Channel, equipment: Equipment) -> np.ndarray:
    """Return the nominal input of a channel in each row, (R,); NaN where the procedure states none."""
    table, mounting = equipment.tables.get(run.table or ""), equipment.mountings.get(run.mounting or "")
    try:
        stimulus = PROCEDURES[run.procedure].nominal_input(run, channel, equipment.site, table, mounting)
    except InputError:
        stimulus = None  # what the equipment lacks is reported where the rows are judged
    return np.full(run.rows, np.nan) if stimulus is None else stimulus


def _scatter(runs: Sequence[Run], place: int) -> float:
    """Return the median standard deviation of the samples of a channel; 0 if none is recorded."""
    recorded = np.concatenate([run.sample_sd[:, place] for run in runs])
    return float(np.median(recorded[np.isfinite(recorded)])) if np.isfinite(recorded).any() else 0.0


def _leave_out(loaded: Loaded, run: Run, place: int, channel: Channel, limits: Sequence[float], file: str) -> None:
    observed = run.observed[:, place]
    margin = max(NEAR_LIMIT_SD * _scatter([run], place), EQUAL_OUTPUT * float(np.abs(limits).max()))
    clipped = np.any([np.abs(observed - limit) <= margin for limit in limits], axis=0)
    if not clipped.any():
        return
    what = reduce.clipping_note(channel.name, limits, int(clipped.sum()), run.rows, "means")
    finding = Finding(
        "saturated_channel", "warning", run.name, f"channel {what}", f"{file}, column '{channel.name}'",
        "outputs within the range of the converter", "test within the range, or leave the cells empty",
    )  # fmt: skip
    empty = clipped[:, None] & (np.arange(run.observed.shape[1]) == place)
    loaded.findings.append(finding)
    observed, sample_sd = (np.where(empty, np.nan, values) for values in (run.observed, run.sample_sd))
    loaded.run = replace(run, observed=observed, sample_sd=sample_sd)

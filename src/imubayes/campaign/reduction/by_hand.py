"""Reduction of runs in which a hand turns the unit: a raw log in rests or in motion, or a table of means."""

from collections.abc import Sequence

import numpy as np

from imubayes.campaign.file_schemas import RunEntry
from imubayes.campaign.reduction.carried_rows import reduce_motion
from imubayes.campaign.reduction.free_tumble import ReducedTumble, reduce_tumble
from imubayes.campaign.reduction.log_reduction import Limits
from imubayes.campaign.reduction.pose_table import reduce_means
from imubayes.campaign.reduction.waved_poses import reduce_waved
from imubayes.campaign.run_tables import TableSource
from imubayes.foundations.body_axes import spans_space
from imubayes.foundations.campaign_data import Channel
from imubayes.foundations.errors import input_error
from imubayes.procedures import PROCEDURES, Reduction


def reduce_by_hand(
    source: TableSource, entry: RunEntry, channels: Sequence[Channel], gravity: float, limits: Limits
) -> ReducedTumble:
    """Return the rows of a run with its rotations.

    Parameters
    ----------
    source : the table.
    entry : the run's entry in the campaign file.
    channels : all channels of the campaign.
    gravity : of the site, m/s².
    limits : of each channel, at which it clips.

    Raises
    ------
    InputError
        for a table that the procedure of the run cannot have.
    """
    where = str(source.file)
    if PROCEDURES[entry.procedure].reduction is Reduction.CARRIED:
        if source.layout.reduced:
            raise input_error(
                f"run '{entry.name}' is given as means, and a unit in motion has none",
                where, "a raw log of all channels with time_s", "give the raw log; its windows are found in it",
            )  # fmt: skip
        return _reduce_motion(entry, source.whole(), channels, gravity, where, limits)
    if source.layout.reduced:
        return reduce_means(source.whole(), channels, gravity, where)
    return reduce_tumble(source.whole(), channels, gravity, entry.initial_rest_s, where, limits)


def _reduce_motion(
    entry: RunEntry,
    numbers: dict[str, np.ndarray],
    channels: Sequence[Channel],
    gravity: float,
    where: str,
    limits: Limits,
) -> ReducedTumble:
    """Return a run in motion reduced by what carries its attitude: three gyros, or nothing."""
    if spans_space(channels, "gyro"):
        return reduce_motion(numbers, channels, gravity, where, limits)
    if not PROCEDURES[entry.procedure].without_gyros:
        raise input_error(
            f"run '{entry.name}' of {entry.procedure} needs gyros about three axes",
            f"{where}, [[channel]] of campaign.toml",
            "three gyros whose input axes are not coplanar: they carry the attitude from window to window",
            'add the gyros; accelerometers alone are calibrated by procedure = "slow_motion" or "free_tumble"',
        )
    return reduce_waved(numbers, channels, gravity, where, limits)

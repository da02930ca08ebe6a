"""The angle of a table that a gyro drives, as a reading: what a servo-table run records."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from imubayes.procedures import PROCEDURES
from imubayes.run import Channel, Run, Table
from imubayes.units import to_si

ANGLE = "table_angle"


def with_angles(
    channels: tuple[Channel, ...], runs: Sequence[Run], tables: Mapping[str, Table]
) -> tuple[tuple[Channel, ...], tuple[Run, ...]]:
    """Return channels and runs with the table's angle as one channel more, where a gyro drives a table.

    What gyros read in such a run is the error of the servo, nothing but for its noise; it is left out.
    """
    driven = [run for run in runs if PROCEDURES[run.procedure].driven]
    if not driven:
        return channels, tuple(runs)
    stated = [tables[run.table].angle_uncertainty for run in driven if run.table is not None]
    noise = max((one for one in stated if one), default=None)
    sd = None if noise is None else float(np.degrees(noise))
    angle = Channel(ANGLE, "angle", np.eye(3), "deg", 1.0, "deg", 1 / to_si("deg"), noise=sd)
    return (*channels, angle), tuple(_with_angle(run) for run in runs)


def _with_angle(run: Run) -> Run:
    reading = np.full((run.rows, 1), np.nan)
    others, notes = run.observed, run.notes
    if PROCEDURES[run.procedure].driven:
        turning = np.unwrap(run.covariates["table_angle"])
        run = replace(run, covariates={**run.covariates, "table_angle": turning})
        reading = np.degrees(turning)[:, None]
        if np.isfinite(others).any():
            notes = (*notes, "readings of the unit are left out: the gyro drives the table, and reads nothing")
        others = np.full_like(others, np.nan)
    unknown = np.full((run.rows, 1), np.nan)
    return replace(
        run,
        observed=np.concatenate([others, reading], axis=1),
        sample_sd=np.concatenate([run.sample_sd, unknown], axis=1),
        samples=np.ones(run.rows) if PROCEDURES[run.procedure].driven else run.samples,
        notes=notes,
    )

"""The table angle as an observed channel: what a servo-table run records."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from imubayes.campaign_data import Channel, Run, Table
from imubayes.procedures import PROCEDURES
from imubayes.units import to_si

ANGLE, ANGLE_UNIT = "table_angle", "deg"


def with_angles(
    channels: tuple[Channel, ...], runs: Sequence[Run], tables: Mapping[str, Table]
) -> tuple[tuple[Channel, ...], tuple[Run, ...]]:
    """Return channels and runs with the table angle as an additional channel, where a gyro drives a table.

    The gyro outputs of such a run are the servo error and are excluded.
    """
    driven = [run for run in runs if PROCEDURES[run.procedure].driven]
    if not driven:
        return channels, tuple(runs)
    stated = [tables[run.table].angle_uncertainty for run in driven if run.table is not None]
    noise = max((uncertainty for uncertainty in stated if uncertainty), default=None)
    sd = None if noise is None else float(np.degrees(noise))
    angle = Channel(ANGLE, "angle", np.eye(3), ANGLE_UNIT, 1.0, ANGLE_UNIT, 1 / to_si(ANGLE_UNIT), noise=sd)
    return (*channels, angle), tuple(_with_angle(run) for run in runs)


def _with_angle(run: Run) -> Run:
    observed = np.full((run.rows, 1), np.nan)
    others, notes = run.observed, run.notes
    if PROCEDURES[run.procedure].driven:
        turning = np.unwrap(run.covariates["table_angle"])
        run = replace(run, covariates={**run.covariates, "table_angle": turning})
        observed = np.degrees(turning)[:, None]
        if np.isfinite(others).any():
            notes = (*notes, "outputs of the unit are excluded: the servo loop nulls the gyro that drives the table")
        others = np.full_like(others, np.nan)
    unknown = np.full((run.rows, 1), np.nan)
    return replace(
        run,
        observed=np.concatenate([others, observed], axis=1),
        sample_sd=np.concatenate([run.sample_sd, unknown], axis=1),
        samples=np.ones(run.rows) if PROCEDURES[run.procedure].driven else run.samples,
        notes=notes,
    )

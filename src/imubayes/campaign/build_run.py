"""Build a `Run` in SI from columns in the units of the file."""

from collections.abc import Mapping, Sequence

import numpy as np

from imubayes.campaign.file_schemas import RunEntry
from imubayes.campaign.findings import Finding
from imubayes.campaign.named_directions import DIRECTION_COLUMNS
from imubayes.campaign.run_columns import TEXT_COLUMNS, ColumnLayout
from imubayes.campaign_data import Channel, Run, Tumble
from imubayes.covariates import recorded
from imubayes.procedures import PROCEDURES, Procedure

TURN = 2 * np.pi


def build_run(
    entry: RunEntry,
    numbers: Mapping[str, np.ndarray],
    channels: Sequence[Channel],
    gravity: float,
    notes: Sequence[str] = (),
    tumble: Tumble | None = None,
    attitude: np.ndarray | None = None,
) -> Run:
    """Return a run from its rows.

    Parameters
    ----------
    entry : the run's entry in the campaign file.
    numbers : column → shape (R,), in the units of the file; `samples` and `<channel>_sd` if available.
    channels : all channels of the campaign.
    gravity : of the site, m/s².
    notes : from the reduction.
    tumble : the rotations of a free tumble.
    attitude : shape (R, 3, 3), if the rows give directions.
    """
    rows = len(next(iter(numbers.values())))
    unknown = np.full(rows, np.nan)
    covariates, covariate_notes = _covariates(entry, numbers, rows, gravity)
    return Run(
        entry.name,
        entry.procedure,
        entry.table,
        entry.mounting,
        covariates,
        np.stack([numbers.get(channel.name, unknown) for channel in channels], axis=1),
        numbers.get("samples", np.ones(rows)),
        np.stack([numbers.get(f"{channel.name}_sd", unknown) for channel in channels], axis=1),
        None if entry.start is None else entry.start.isoformat(),
        tumble,
        attitude,
        (*notes, *covariate_notes),
        entry.temperature_uncertainty_degC,
        entry.converter_temperature_uncertainty_degC,
    )


def unused_columns(layout: ColumnLayout, procedure: Procedure, run: str, where: str) -> list[Finding]:
    """Return a warning for known columns that are not used in the rows."""
    used = {"segment", *(DIRECTION_COLUMNS if procedure.by_direction else ())}
    unused = [name for name in TEXT_COLUMNS if layout.has(name) and name not in used]
    if not unused:
        return []
    what = f"{', '.join(unused)}: read and checked, not used"
    return [
        Finding("unused_columns", "warning", run, what, f"{where}, header", "", "nothing; the other columns are used")
    ]


def unfounded_uncertainties(entry: RunEntry, run: Run, where: str) -> list[Finding]:
    """Return an error for each stated uncertainty of a temperature that the run neither states nor records."""
    stated = {
        "temperature": entry.temperature_uncertainty_degC,
        "converter_temperature": entry.converter_temperature_uncertainty_degC,
    }
    return [
        Finding(
            "unfounded_uncertainty", "error", entry.name,
            f"{name}_uncertainty_degC is stated, and there is no {name}_degC that it could be of",
            f"{where}, header", f"{name}_degC of the run, or a column of that name with values",
            f"state {name}_degC, or take {name}_uncertainty_degC out",
        )
        for name, uncertainty in stated.items()
        if uncertainty and name not in run.covariates
    ]  # fmt: skip


def _covariates(
    entry: RunEntry, numbers: Mapping[str, np.ndarray], rows: int, gravity: float
) -> tuple[dict[str, np.ndarray], list[str]]:
    covariates = {
        covariate.name: numbers[covariate.column] * covariate.factor(gravity)
        for covariate in recorded()
        if covariate.column in numbers
    }
    notes: list[str] = []
    procedure = PROCEDURES[entry.procedure]
    rate = covariates.setdefault("table_rate", np.zeros(rows))
    # With a reference gyro the table rate is not recorded, and any row may turn.
    turning = (rate != 0) | (not procedure.rate_recorded)
    angle = covariates.get("table_angle")
    if angle is None:
        if procedure.needs_table and not turning.all():
            notes.append("no angle column: table angle 0 is assumed at rest")
        angle = np.full(rows, np.nan)
    elif np.any(np.isnan(angle) & ~turning):
        notes.append(f"{np.sum(np.isnan(angle) & ~turning)} empty angles at rest are set to 0")
    covariates["table_angle"] = np.where(np.isnan(angle) & ~turning, 0.0, angle)
    span = covariates.get("table_angle_span", np.full(rows, np.nan))
    whole = np.where(np.isnan(covariates["table_angle"]), TURN, 0.0)
    covariates["table_angle_span"] = np.where(np.isnan(span), whole, span)
    stated = {"temperature": entry.temperature_degC, "converter_temperature": entry.converter_temperature_degC}
    for name, of_run in stated.items():
        _fill_temperature(name, covariates, of_run, rows, notes)
    return covariates, notes


def _fill_temperature(
    name: str, covariates: dict[str, np.ndarray], of_run: float | None, rows: int, notes: list[str]
) -> None:
    values = covariates.get(name)
    if values is not None and np.isnan(values).all():
        del covariates[name]
        values = None
    if values is None:
        if of_run is not None:
            covariates[name] = np.full(rows, of_run)
        return
    empty = np.isnan(values)
    if empty.any():
        axis = covariates.get("time", np.arange(rows, dtype=float))
        covariates[name] = np.where(empty, np.interp(axis, axis[~empty], values[~empty]), values)
        notes.append(f"{np.sum(empty)} missing values of {name} are interpolated linearly")

"""Read a plan file as the campaign that it describes, before any output is simulated."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imubayes.campaign.build_run import build_run
from imubayes.campaign.equipment import (
    build_channels,
    build_mountings,
    build_site,
    build_tables,
    check_references,
    refuse_repeats,
    refuse_reserved_names,
    require_current_scale,
)
from imubayes.campaign.file_schemas import RunEntry
from imubayes.campaign.named_directions import attitude_of
from imubayes.campaign.servo_angle import with_angles
from imubayes.campaign.toml_documents import Ledger, read_document
from imubayes.campaign_data import Campaign, Channel, Mounting, Site, Table
from imubayes.errors import InputError, closest_first
from imubayes.procedures import PROCEDURES, procedure_named
from imubayes.procedures.planned_steps import PlannedRows, columns_of
from imubayes.simulation.plan_checks import judge_steps
from imubayes.simulation.test_plan import PlanFile, PlannedRun


@dataclass(frozen=True)
class Plan:
    """A valid plan.

    Attributes
    ----------
    file : its content.
    path, model : the plan file, and the model file it names.
    campaign : the planned runs, with 0 for every output to be recorded.
    entries : the runs as entries of `campaign.toml`.
    columns : for each run the columns of its table except the outputs, in the units of the file.
    """

    file: PlanFile
    path: Path
    model: Path
    campaign: Campaign
    entries: tuple[RunEntry, ...]
    columns: tuple[dict[str, np.ndarray], ...]


def read_plan(path: str | Path) -> Plan:
    """Read a plan.

    Raises
    ------
    InputError
        with every issue of the plan.
    """
    path = Path(path)
    document = read_document(path, PlanFile)
    file, ledger = document.entry, document.ledger
    if file is None:
        raise InputError(ledger.issues)
    site = build_site(file.site)
    channels = build_channels(dict(enumerate(file.channel)), site.gravity, ledger)
    tables = build_tables(dict(enumerate(file.table)), ledger)
    mountings = build_mountings(dict(enumerate(file.mounting)), ledger)
    _check_channels(file, ledger)
    _check_runs(file, ledger)
    ledger.stop_if_any()
    entries = tuple(_entry(run, place) for place, run in enumerate(file.run))
    planned = [_rows(run) for run in file.run]
    columns = tuple(_columns(run, rows, site, tables, mountings) for run, rows in zip(file.run, planned, strict=True))
    runs = tuple(
        build_run(
            entry, numbers | rows.motion | _zero_outputs(run, numbers, channels), channels, site.gravity,
            attitude=_attitude(run, rows, channels),
        )
        for entry, numbers, run, rows in zip(entries, columns, file.run, planned, strict=True)
    )  # fmt: skip
    channels, runs = with_angles(channels, runs, tables)
    unit = file.unit
    campaign = Campaign(file.name, site, channels, tables, mountings, runs, unit.serial, grade=unit.grade)
    return Plan(file, path, path.parent / file.model, campaign, entries, columns)


def _rows(run: PlannedRun) -> PlannedRows:
    rules = PROCEDURES[run.procedure].plan
    assert rules is not None
    return rules.rows(run)


def _columns(
    run: PlannedRun, rows: PlannedRows, site: Site, tables: Mapping[str, Table], mountings: Mapping[str, Mounting]
) -> dict[str, np.ndarray]:
    rules = PROCEDURES[run.procedure].plan
    assert rules is not None
    columns = columns_of(run, rules, rows)
    if rules.nominal is None:
        return columns
    assert run.table is not None
    assert run.mounting is not None
    return columns | rules.nominal(columns, site, tables[run.table], mountings[run.mounting])


def _attitude(run: PlannedRun, rows: PlannedRows, channels: Sequence[Channel]) -> np.ndarray | None:
    if run.directions is None:
        return rows.attitude
    return np.stack([attitude_of(pair, channels) for pair in run.directions])


def recorded(run: PlannedRun, channels: tuple[Channel, ...]) -> list[str]:
    """Return the channels recorded in a run: under current injection those with a current output, none by a servo."""
    procedure = PROCEDURES[run.procedure]
    unit = [channel for channel in channels if channel.kind != "angle" and not procedure.driven]
    return [channel.name for channel in unit if channel.current_per_acceleration or not procedure.injected]


def _zero_outputs(
    run: PlannedRun, columns: dict[str, np.ndarray], channels: tuple[Channel, ...]
) -> dict[str, np.ndarray]:
    return {name: np.zeros(len(columns["time_s"])) for name in recorded(run, channels)}


def _entry(run: PlannedRun, place: int) -> RunEntry:
    plain = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in run.name)
    return RunEntry(
        name=run.name,
        procedure=run.procedure,
        # Names that differ only in characters not allowed in file names would collide without the number.
        file=f"runs/{plain}.csv" if plain == run.name else f"runs/{place:03d}-{plain}.csv",
        table=run.table,
        mounting=run.mounting,
        temperature_degC=run.temperature_degC,
        temperature_uncertainty_degC=run.temperature_uncertainty_degC,
        converter_temperature_uncertainty_degC=run.converter_temperature_uncertainty_degC,
        start=run.start,
    )


def _check_channels(file: PlanFile, ledger: Ledger) -> None:
    refuse_reserved_names(dict(enumerate(file.channel)), [channel.name for channel in file.channel], ledger)
    for place, channel in enumerate(file.channel):
        if channel.noise is None:
            ledger.add(
                f"channel '{channel.name}' has no noise",
                ("channel", place, "noise"),
                "noise = standard deviation of one raw sample, output units",
                "add 'noise': a plan has no samples to estimate it from",
            )


def _check_runs(file: PlanFile, ledger: Ledger) -> None:
    refuse_repeats({place: run.name for place, run in enumerate(file.run)}, "run", ledger)
    names = {"table": [table.name for table in file.table], "mounting": [seat.name for seat in file.mounting]}
    plannable = [procedure.name for procedure in PROCEDURES.values() if procedure.plan]
    for place, run in enumerate(file.run):
        procedure = procedure_named(run.procedure)
        if procedure.plan is None:
            ledger.add(
                f"procedure '{run.procedure}' of run '{run.name}' cannot be simulated",
                ("run", place, "procedure"),
                closest_first(run.procedure, plannable),
                "use one of the allowed procedures",
            )
        else:
            judge_steps(run, procedure.plan, place, ledger)
        check_references(run, place, names, ledger)
        if procedure.injected:
            require_current_scale(file.channel, place, ledger)

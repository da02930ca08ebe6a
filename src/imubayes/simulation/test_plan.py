"""Plan files: a campaign to be simulated, with the model that generates it; their schema, checks and reading.

A plan has the sections of `campaign.toml`; its runs give the steps of the procedure instead of a file:

    model = "../models/trihedral-imu.toml"     # relative to the plan
    seed = 1

    [truth]                                    # optional; other values are drawn from the priors
    "gyro_scale_factor.scale[gx]" = 250.0

    [[run]]
    name = "pyramid"
    procedure = "rate_table"
    table = "rate"
    mounting = "pyramid"
    temperature_degC = 25.0
    rates_deg_s = [0, 100, -100, 0]

The steps of planned runs are validated: complete, consistent and applicable to the procedure.  A plan is read as the
campaign that it describes, before any output is simulated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, Field

from imubayes.campaign import axis_directions, equipment, instruments
from imubayes.campaign import file_schemas as schemas
from imubayes.campaign.run_reader import build_run
from imubayes.campaign.toml_documents import Ledger, read_document
from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Site, Table
from imubayes.foundations.errors import InputError, closest_first
from imubayes.procedures import PROCEDURES, base, procedure_named


class PlannedRun(base.PlannedSteps):
    """One run of a plan; the steps that a procedure accepts are in its `PlanRules`."""

    name: schemas.Name
    """of the run, unique in the plan"""
    procedure: str
    """test procedure, as in campaign.toml"""
    table: str | None = None
    """name of a [[table]]"""
    mounting: str | None = None
    """name of a [[mounting]]"""
    thermometer: str | None = None
    """name of a [[thermometer]]"""
    converter_thermometer: str | None = None
    """name of a [[thermometer]]"""
    temperature_degC: base.Temperature | None = None
    """of all rows"""
    temperature_uncertainty_degC: schemas.TemperatureUncertainty | None = None
    """as in campaign.toml; the truth has an error of this size"""
    converter_temperature_uncertainty_degC: schemas.TemperatureUncertainty | None = None
    """as in campaign.toml; the truth has an error of this size"""
    start: datetime | date | None = None
    """when the run begins"""


class PlanFile(BaseModel):
    """A plan file."""

    model_config = schemas.CampaignFile.model_config

    format: Literal[1]
    """of this file"""
    name: schemas.Name
    """of the campaign"""
    notes: list[str] = []
    """remarks, copied into the campaign"""
    model: str = Field(min_length=1)
    """model file that generates the data, relative to the plan"""
    seed: int = Field(default=1, ge=0)
    """of truth and noise"""
    truth: dict[str, float] = {}
    """true values by parameter; others are drawn from the priors"""
    site: schemas.SiteEntry
    """where the runs are made"""
    unit: schemas.UnitEntry = schemas.UnitEntry()
    """what is tested"""
    channel: list[schemas.ChannelEntry] = Field(min_length=1)
    """one for each sensitive axis"""
    table: list[schemas.TableEntry] = []
    """as in campaign.toml"""
    mounting: list[schemas.MountingEntry] = []
    """as in campaign.toml"""
    thermometer: list[schemas.ThermometerEntry] = []
    """as in campaign.toml; the truth has errors of these sizes"""
    run: list[PlannedRun] = Field(min_length=1)
    """the steps of each run"""


def judge_steps(run: PlannedRun, rules: base.PlanRules, place: int, ledger: Ledger) -> None:
    """Add an issue for every step key that is missing, redundant or not applicable to the procedure."""
    one_of, further = rules.one_of, rules.further
    given = [key for key in base.STEP_KEYS if getattr(run, key) is not None]
    for key in given:
        if key not in (*one_of, *further, *base.OF_ANY_RUN):
            ledger.add(
                f"'{key}' does not apply to procedure '{run.procedure}'",
                ("run", place, key),
                ", ".join((*one_of, *further)),
                "remove the key, or correct 'procedure'",
            )
    alternatives = [key for key in one_of if key in given]
    if len(alternatives) != 1:
        ledger.add(
            f"run '{run.name}' of procedure '{run.procedure}' has "
            + (f"both {' and '.join(alternatives)}" if alternatives else f"no '{one_of[0]}'"),
            ("run", place, *alternatives[1:2]),
            ", or ".join(one_of),
            "give exactly one of these keys",
        )
    if "rate_degC_per_h" in further:
        _judge_ramp(run, place, ledger)
    elif "rows" in further and run.rows is None:
        ledger.add(
            f"the number of rows of run '{run.name}' is not given", ("run", place, "rows"), "rows = …", "add 'rows'"
        )
    _judge_directions(run, place, ledger)


def _judge_directions(run: PlannedRun, place: int, ledger: Ledger) -> None:
    for index, pair in enumerate(run.directions or ()):
        if len(pair) != 2 or not axis_directions.perpendicular(pair):
            ledger.add(
                f"'{pair}' does not name two perpendicular directions",
                ("run", place, "directions", index),
                "two of the letters E W N S U D: the input axis, then the output axis, such as 'EN'",
                "correct the letters",
            )


def _judge_ramp(run: PlannedRun, place: int, ledger: Ledger) -> None:
    ramp = run.converter_temperature_degC
    rising = ramp is not None and ramp[0] != ramp[1]
    timed = run.rate_degC_per_h is not None and run.seconds_per_row is not None
    if run.rate_degC_per_h is not None and not rising:
        ledger.add(
            f"run '{run.name}' has a temperature rate but no temperature change",
            ("run", place, "rate_degC_per_h"),
            "converter_temperature_degC = [from, to] with two different values",
            "give both ends of the ramp, or leave 'rate_degC_per_h' out",
        )
    elif timed and run.rows is not None:
        ledger.add(
            f"the duration of run '{run.name}' is overdetermined",
            ("run", place, "rows"),
            "two of rows, rate_degC_per_h and seconds_per_row",
            "remove one of the three",
        )
    elif not timed and run.rows is None:
        ledger.add(
            f"the number of rows of run '{run.name}' is not given",
            ("run", place, "rows"),
            "rows = …, or both rate_degC_per_h and seconds_per_row",
            "add 'rows'",
        )


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
    entries: tuple[schemas.RunEntry, ...]
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
    site = equipment.build_site(file.site)
    channels = equipment.build_channels(dict(enumerate(file.channel)), site.gravity, ledger)
    tables = equipment.build_tables(dict(enumerate(file.table)), ledger)
    mountings = equipment.build_mountings(dict(enumerate(file.mounting)), ledger)
    thermometers = instruments.build_thermometers(dict(enumerate(file.thermometer)), ledger)
    _check_channels(file, ledger)
    _check_runs(file, ledger)
    ledger.stop_if_any()
    entries = tuple(_entry(run, place) for place, run in enumerate(file.run))
    planned = [_rules(run).rows(run) for run in file.run]
    columns = tuple(_columns(run, rows, site, tables, mountings) for run, rows in zip(file.run, planned, strict=True))
    runs = tuple(
        build_run(
            entry, numbers | rows.motion | dict.fromkeys(recorded(run, channels), np.zeros(len(rows.duration))),
            channels, site.gravity, attitude=_attitude(run, rows, channels),
        )
        for entry, numbers, run, rows in zip(entries, columns, file.run, planned, strict=True)
    )  # fmt: skip
    channels, runs = equipment.with_angles(channels, runs, tables)
    unit = file.unit
    campaign = Campaign(file.name, site, channels, tables, mountings, runs, unit.serial, grade=unit.grade,
        thermometers=thermometers)  # fmt: skip
    return Plan(file, path, path.parent / file.model, campaign, entries, columns)


def _rules(run: PlannedRun) -> base.PlanRules:
    rules = PROCEDURES[run.procedure].plan
    assert rules is not None
    return rules


def _columns(
    run: PlannedRun, rows: base.PlannedRows, site: Site, tables: Mapping[str, Table], mountings: Mapping[str, Mounting]
) -> dict[str, np.ndarray]:
    rules = _rules(run)
    columns = base.columns_of(run, rules, rows)
    if rules.nominal is None:
        return columns
    assert run.table is not None
    assert run.mounting is not None
    return columns | rules.nominal(columns, site, tables[run.table], mountings[run.mounting])


def _attitude(run: PlannedRun, rows: base.PlannedRows, channels: Sequence[Channel]) -> np.ndarray | None:
    if run.directions is None:
        return rows.attitude
    return np.stack([axis_directions.attitude_of(pair, channels) for pair in run.directions])


def recorded(run: PlannedRun, channels: tuple[Channel, ...]) -> list[str]:
    """Return the channels recorded in a run: under current injection those with a current output, none by a servo."""
    procedure = PROCEDURES[run.procedure]
    unit = [channel for channel in channels if channel.kind != "angle" and not procedure.driven]
    return [channel.name for channel in unit if channel.current_per_acceleration or not procedure.injected]


def _entry(run: PlannedRun, place: int) -> schemas.RunEntry:
    plain = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in run.name)
    # Names that differ only in characters not allowed in file names would collide without the number.
    file = f"runs/{plain}.csv" if plain == run.name else f"runs/{place:03d}-{plain}.csv"
    # What a plan says of the converter's temperature is a ramp: it goes into the rows.
    stated = {name: getattr(run, name) for name in schemas.RunEntry.model_fields if name in PlannedRun.model_fields}
    return schemas.RunEntry.model_validate(stated | {"file": file, "converter_temperature_degC": None})


def _check_channels(file: PlanFile, ledger: Ledger) -> None:
    equipment.refuse_reserved_names(dict(enumerate(file.channel)), [channel.name for channel in file.channel], ledger)
    for place, channel in enumerate(file.channel):
        if channel.noise is None:
            ledger.add(
                f"channel '{channel.name}' has no noise",
                ("channel", place, "noise"),
                "noise = standard deviation of one raw sample, output units",
                "add 'noise': a plan has no samples to estimate it from",
            )


def _check_runs(file: PlanFile, ledger: Ledger) -> None:
    instruments.refuse_two_readings(dict(enumerate(file.run)), ledger)
    equipment.refuse_repeats({place: run.name for place, run in enumerate(file.run)}, "run", ledger)
    entries = {"table": file.table, "mounting": file.mounting, "thermometer": file.thermometer}
    names = {section: [entry.name for entry in own] for section, own in entries.items()}
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
        equipment.check_references(run, place, names, ledger)
        if procedure.injected:
            equipment.require_current_scale(file.channel, place, ledger)

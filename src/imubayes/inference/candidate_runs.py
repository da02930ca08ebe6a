"""Candidate runs: what the campaign's tables, mountings, chamber and converters allow, and the next run as a record.

The next run is one that would determine what the data did not.
"""

import math
from collections import Counter
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Literal

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Mounting, Run, Table
from imubayes.foundations.records import Record
from imubayes.procedures import PROCEDURES
from imubayes.procedures.ambient import instant

_HEAD_POSITIONS = 12
_DEFAULT_RATES = (100.0, 30.0, 10.0, -100.0, -30.0, -10.0)  # deg/s
_VERTICAL = math.radians(45.0)
_STANDARD = {
    "x-up": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "y-up": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "z-up": np.eye(3),
}
_INJECTED_G, _RAMP = 10.0, (15.0, 45.0)
_TEMPERATURES = ("temperature", "converter_temperature")
# A temperature counts as changed in a run if it moves by this much, degC.
_CHANGED = 2.0
# A cycle: up at the fastest slope seen, a hold, down at a third of it, a hold; shares of the time against the range.
_CYCLE = ((0.0, 0.15, 0.45, 0.9, 1.0), (0.0, 1.0, 1.0, 0.0, 0.0))
_CYCLE_ROWS = 60


class TemperatureProfile(Record):
    """Course of a temperature in a run between `low_degC` and `high_degC`.

    Attributes
    ----------
    covariate : name of the temperature.
    form : up once (``ramp``), or up, held, and down three times slower (``cycle``).
    hours : duration; None if it is free.
    """

    covariate: str
    form: Literal["ramp", "cycle"]
    low_degC: float
    high_degC: float
    hours: float | None = None


class RunDesign(Record):
    """Settings of a run; None for those that the procedure does not have.

    Attributes
    ----------
    procedure, table, mounting : names.
    repeated : whether the campaign has a run on this table in this mounting already.
    another_table : whether it is to be made on another table of the kind of `table`, which has errors of its own.
    max_rate_deg_s : largest magnitude of the table rate.
    positions : number of table angles, equally spaced over a turn.
    current_mA, specific_force_g : injected current, and the specific force that gives it.
    temperature : the temperature that is varied.
    """

    procedure: str
    table: str | None = None
    mounting: str | None = None
    repeated: bool = False
    another_table: bool = False
    max_rate_deg_s: float | None = None
    positions: int | None = None
    current_mA: float | None = None
    specific_force_g: float | None = None
    temperature: TemperatureProfile | None = None


@dataclass(frozen=True)
class CandidateRun:
    """A run that could be made: its design, and the run itself, without observations."""

    design: RunDesign
    run: Run


def candidate_runs(campaign: Campaign, elsewhere: bool = False) -> tuple[Campaign, list[CandidateRun]]:
    """Return the campaign with standard mountings added, and the runs that its equipment allows.

    Parameters
    ----------
    elsewhere : whether runs on another rate table, which has errors of its own, count.
    """
    mountings = _with_standard_mountings(campaign)
    others = _other_tables(campaign) if elsewhere else {}
    tables = {**campaign.tables, **{other.name: other for other in others.values()}}
    used = {(run.table, run.mounting) for run in campaign.runs}
    found = [
        _planned(campaign, table, mounting, repeated=(table.name, mounting.name) in used)
        for table in campaign.tables.values()
        if table.inner_axis is None  # runs on tables of several axes and on centrifuges are not designed
        for mounting in mountings.values()
    ]
    for original, other in others.items():
        seen = [mounting for mounting in campaign.mountings.values() if (original, mounting.name) in used]
        found.extend(_on(other, campaign.tables[original], campaign, mounting) for mounting in seen)
    found.extend(_injections(campaign))
    found.extend(_cycles(campaign))
    return replace(campaign, mountings=mountings, tables=tables), found


def _with_standard_mountings(campaign: Campaign) -> dict[str, Mounting]:
    """Return the mountings, and a standard one for each body axis that none of them has along the table axis."""
    mountings = dict(campaign.mountings)
    uncertainty = max((mounting.uncertainty for mounting in mountings.values() if mounting.uncertainty), default=None)
    for name, matrix in _STANDARD.items():
        if not any(np.allclose(known.body_to_table[2], matrix[2], atol=1e-3) for known in mountings.values()):
            mountings[name] = Mounting(name, matrix, uncertainty)
    return mountings


def _other_tables(campaign: Campaign) -> dict[str, Table]:
    """Return for each rate table another of its kind, which has errors of its own."""
    return {
        table.name: replace(table, name=f"another table than {table.name}")
        for table in campaign.tables.values()
        if table.elevation > _VERTICAL and table.inner_axis is None
    }


def _on(table: Table, original: Table, campaign: Campaign, mounting: Mounting) -> CandidateRun:
    """Return a run on another table, as it is made on the one there is."""
    planned = _planned(campaign, original, mounting)
    run = replace(planned.run, name=f"{planned.run.name} elsewhere", table=table.name)
    return CandidateRun(planned.design.model_copy(update={"another_table": True}), run)


def _cycles(campaign: Campaign) -> list[CandidateRun]:
    """Return a thermal cycle with two slopes and holds, in place of the first run of each kind of temperature."""
    found = []
    for name in _TEMPERATURES:
        runs = [run for run in campaign.runs if name in run.covariates and "time" in run.covariates]
        changed = [run for run in runs if np.ptp(run.covariates[name]) > _CHANGED and run.tumble is None]
        if changed:
            found.append(_cycle(campaign, changed[0], name))
    return found


def _cycle(campaign: Campaign, run: Run, name: str) -> CandidateRun:
    low, high = float(run.covariates[name].min()), float(run.covariates[name].max())
    duration = float(np.ptp(run.covariates["time"]))
    time = np.linspace(0.0, duration, _CYCLE_ROWS)
    covariates = {"time": time} | _still(_CYCLE_ROWS)
    for other in (*_TEMPERATURES, "current"):
        if other in run.covariates:
            covariates[other] = np.full(_CYCLE_ROWS, float(np.median(run.covariates[other])))
    if "power_on" in run.covariates:
        covariates["power_on"] = time + float(run.covariates["power_on"].min())
    covariates[name] = low + (high - low) * np.interp(time / duration, *_CYCLE)
    planned = _empty_run(campaign, f"candidate {name} cycle", run.procedure, run.table, run.mounting, covariates)
    profile = TemperatureProfile(covariate=name, form="cycle", low_degC=low, high_degC=high, hours=duration / 3600)
    design = RunDesign(procedure=run.procedure, table=run.table, mounting=run.mounting, temperature=profile)
    return CandidateRun(design, planned)


def _still(count: int) -> dict[str, np.ndarray]:
    """Return the covariates of a table at rest."""
    return {name: np.zeros(count) for name in ("table_rate", "table_angle", "table_angle_span")}


def _injections(campaign: Campaign) -> list[CandidateRun]:
    """Return a run with injected current over a converter ramp, if the sensors have a current output."""
    currents = [c.current_per_acceleration for c in campaign.channels if c.current_per_acceleration]
    if not currents or not any("converter_temperature" in run.covariates for run in campaign.runs):
        return []
    current = _INJECTED_G * campaign.site.gravity * currents[0]
    count = _HEAD_POSITIONS
    covariates = _still(count) | {
        "time": 600.0 * np.arange(count),
        "converter_temperature": np.linspace(*_RAMP, count),
        "current": np.full(count, current),
    }
    run = _empty_run(campaign, "candidate injection", "current_injection", None, None, covariates)
    low, high = _RAMP
    ramp = TemperatureProfile(covariate="converter_temperature", form="ramp", low_degC=low, high_degC=high)
    design = RunDesign(
        procedure=run.procedure, current_mA=current * 1e3, specific_force_g=_INJECTED_G, temperature=ramp
    )
    return [CandidateRun(design, run)]


def _empty_run(
    campaign: Campaign, name: str, procedure: str, table: str | None, mounting: str | None, covariates: dict
) -> Run:
    """Return a run without observations; a temperature that is not given is the usual one, the date the next day."""
    count = len(covariates["time"])
    samples = float(np.median(np.concatenate([run.samples for run in campaign.runs])))
    injected = PROCEDURES[procedure].injected
    # A current goes into channels that have one; the angle of a table is read where a gyro drives it, never here.
    known = np.array(
        [c.kind != "angle" and (not injected or bool(c.current_per_acceleration)) for c in campaign.channels]
    )
    observed = np.where(known, np.zeros((count, len(known))), np.nan)
    usual = {temperature: np.full(count, value) for temperature, value in _usual_temperatures(campaign).items()}
    return Run(
        name, procedure, table, mounting, usual | covariates, observed, np.full(count, samples),
        np.full_like(observed, np.nan), start=_next_day(campaign),
        thermometer=_usual("thermometer", campaign), converter_thermometer=_usual("converter_thermometer", campaign),
    )  # fmt: skip


def _usual(key: str, campaign: Campaign) -> str | None:
    """Return the thermometer that most runs name, under one of its keys; None if no run does."""
    named = Counter(filter(None, (getattr(run, key) for run in campaign.runs)))
    return named.most_common(1)[0][0] if named else None


def _usual_temperatures(campaign: Campaign) -> dict[str, float]:
    """Return the median of the means of the runs, degC, of each temperature that a run has."""
    means = {
        name: [run.covariates[name].mean() for run in campaign.runs if name in run.covariates] for name in _TEMPERATURES
    }
    return {name: float(np.median(values)) for name, values in means.items() if values}


def _next_day(campaign: Campaign) -> str | None:
    """Return the day after the last run; None if no run has a date."""
    dates = [instant(run.start) for run in campaign.runs if run.start]
    return (max(dates) + timedelta(days=1)).isoformat() if dates else None


def _planned(campaign: Campaign, table: Table, mounting: Mounting, repeated: bool = False) -> CandidateRun:
    """Return a run at the rates of a rate table, or in positions about an inclined axis."""
    place = {"table": table.name, "mounting": mounting.name, "repeated": repeated}
    if table.elevation > _VERTICAL:
        rates = _rates(campaign, table)
        rate = np.array([0.0, *rates, 0.0])
        angle = np.where(rate == 0, 0.0, np.nan)
        design = RunDesign(procedure="rate_table", max_rate_deg_s=max(map(abs, rates)), **place)
    else:
        rate = np.zeros(_HEAD_POSITIONS)
        angle = 2 * np.pi * np.arange(_HEAD_POSITIONS) / _HEAD_POSITIONS
        design = RunDesign(procedure="dividing_head", positions=_HEAD_POSITIONS, **place)
    rate = np.radians(rate)
    count = len(rate)
    covariates = {"time": np.arange(count, dtype=float), "table_rate": rate, "table_angle": angle}
    covariates["table_angle_span"] = np.zeros(count)
    name = f"candidate {table.name} {mounting.name}"
    return CandidateRun(design, _empty_run(campaign, name, design.procedure, table.name, mounting.name, covariates))


def _rates(campaign: Campaign, table: Table) -> list[float]:
    """Return the rates that this table has been run at, deg/s, or usual ones."""
    made = [run.covariates["table_rate"] for run in campaign.runs if run.table == table.name]
    rates = np.unique(np.degrees(np.round(np.concatenate(made), 9))) if made else np.zeros(0)
    turning = [float(rate) for rate in rates if rate != 0]
    return turning or list(_DEFAULT_RATES)


class NextRun(Record):
    """A run that would narrow a quantity: expected standard deviation before and after it."""

    run: RunDesign
    quantity: str
    sd_before: float
    sd_after: float
    unit: str

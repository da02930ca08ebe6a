"""`campaign.toml` of a recording: site, channels with their nominal scales, and one entry for each run."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.campaign.reduction.log_survey import turning_span
from imubayes.foundations.earth import normal_gravity
from imubayes.foundations.errors import InputError, input_error
from imubayes.foundations.units import to_si
from imubayes.procedures import procedure_named
from imubayes_recordings.convert.column_names import (
    ACCEL_UNITS,
    ACCELEROMETERS,
    GYRO_UNITS,
    GYROS,
    SIX,
    TABLE_ANGLE,
    TABLE_RATE,
    TEMPERATURE,
    TIME,
)
from imubayes_recordings.convert.encoder import is_followed, with_encoder_rate
from imubayes_recordings.convert.motion_kind import procedure_in_motion
from imubayes_recordings.convert.options import ConvertOptions
from imubayes_recordings.convert.raw_counts import nominal_of_counts
from imubayes_recordings.convert.recorded_runs import Columns, RecordedRun, still_seconds
from imubayes_recordings.convert.stand import LEVEL, PUT_ANYHOW, Stand, lying, on_table
from imubayes_recordings.convert.stated_turns import BODY_TO_TABLE, TURN_TABLE, StatedTurns, find_stated_turns
from imubayes_recordings.convert.unit_evidence import Units, find_units

DEFAULT_LATITUDE = 45.0
# Without a site: the rounded value assumed by bench calibration tools and their published results.
DEFAULT_GRAVITY = 9.81  # m/s²
_LEAST_PARTS = 5.0  # ppm of the scale factors that are reported
_WARMED = 10.0  # degC over which a rest is a temperature test
_STATIC, _RAMP = "static_record", "thermal_ramp"
_AT_REST = (_STATIC, _RAMP)
_ON_TABLE = "rate_table"
_BLOCKS, _SAMPLES = 3000, 10  # most blocks of a record, and fewest samples of one


@dataclass(frozen=True)
class ConvertedCampaign:
    """What is written: `campaign.toml`, its run tables, and which values were guessed and why.

    Attributes
    ----------
    tables : path of a run table within the folder → its columns.
    options : the options with which the recording was read, guesses filled in.
    guesses : option → its evidence.
    """

    document: dict[str, Any]
    tables: dict[str, Columns]
    options: ConvertOptions
    guesses: dict[str, str]


def make_campaign(runs: Sequence[RecordedRun], options: ConvertOptions, name: str, source: str) -> ConvertedCampaign:
    """Return the campaign of some runs.

    Raises
    ------
    InputError
        if a unit or the nominal scale of counts is neither stated nor determined by the numbers.
    """
    site_notes: list[str] = []
    site = _site(options, site_notes)
    gravity = site.get("gravity_m_s2") or normal_gravity(math.radians(site["latitude_deg"]), options.height_m)
    runs = _in_own_units(runs, source)
    longest = max(runs, key=_rows)
    units = find_units(longest.columns, longest.units, options, source)
    runs = [_in_rates(run, units, source) for run in runs]
    longest = max(runs, key=_rows)
    stated = replace(options, accel_unit=units.accel or "m/s^2", gyro_unit=units.gyro or "rad/s")
    notes = [f"converted from {source}", *(note for run in runs for note in run.notes)]
    channels = _channels(longest.columns, stated, gravity, notes, source)
    notes += _of_local_g(channels, gravity)
    turns = _turns(runs, channels, options, source)
    procedure, why = _procedure(longest, _rates(longest, channels), options, source)
    own = _procedures(runs, channels, procedure, options)
    labels = _labels(len(runs))
    several, why = _said_of_runs(own, labels, why)
    notes += several
    guesses = {**longest.guesses, **units.guesses, "procedure": why}
    guesses = {key: evidence for key, evidence in guesses.items() if evidence}
    stated = replace(stated, procedure=procedure, time_unit=longest.time_unit or options.time_unit)
    notes += [*(_guessed(key, evidence, stated) for key, evidence in guesses.items()), *site_notes]
    document: dict[str, Any] = {"format": 1, "name": options.name or name, "notes": notes, "site": site}
    document |= {"unit": {"serial": options.serial}, "channel": channels}
    stand = _stand(procedure, runs, channels)
    notes += stand.notes
    document |= {"table": stand.table, "mounting": stand.mounting} if stand.table else {}
    document["run"] = [
        _run(label, each, options) | seat | _motion(run, each)
        for label, (each, _), seat, run in zip(labels, own, stand.seats, runs, strict=True)
    ]
    tables = {_file(label): _table(run.columns) for label, run in zip(labels, runs, strict=True)}
    _add_turns(document, tables, list(zip(labels, turns, strict=False)), options)
    return ConvertedCampaign(document, tables, stated, guesses)


def _turns(
    runs: Sequence[RecordedRun], channels: Sequence[Mapping[str, Any]], options: ConvertOptions, source: str
) -> list[StatedTurns]:
    """Return the turns of each recording through the stated angle; nothing if none is stated."""
    if options.turn_deg is None:
        return []
    gyros, found = [each for each in channels if each["kind"] == "gyro"], []
    for run in runs:
        if run.means or TIME not in run.columns or not gyros:
            fault = "--turn-deg needs gyros, sample by sample, with their times"
            raise input_error(fault, source, "a raw log with gx, gy or gz", "leave out --turn-deg, or give the log")
        names, angle = [each["name"] for each in gyros], math.radians(options.turn_deg)
        found.append(find_stated_turns(run.columns, _rates(run, channels), names, angle, source))
    return found


def _add_turns(
    document: dict[str, Any],
    tables: dict[str, Columns],
    found: Sequence[tuple[str, StatedTurns]],
    options: ConvertOptions,
) -> None:
    """Add stated turns as runs of a table about each axis; of a recording with accelerometers the rest stays."""
    if not found:
        return
    gyros = [channel["name"] for channel in document["channel"] if channel["kind"] == "gyro"]
    kept, turned = [], dict[str, None]()
    for run, (label, turns) in zip(document["run"], found, strict=True):
        document["notes"] += turns.notes
        rest = tables.pop(_file(label))
        if any(name in rest for name in ACCELEROMETERS):
            tables[_file(label)] = {name: values[~turns.turning] for name, values in rest.items()}
            kept.append(run)
        for axis, rows in turns.rows.items():
            letter = gyros[axis][1]
            own = label.replace("recording", f"turns-{letter}")
            tables[_file(own)], turned[letter] = rows, None
            here = {"table": f"{TURN_TABLE}-{letter}", "mounting": f"about-{letter}"}
            kept.append(_run(own, _ON_TABLE, options) | here | {"turn_uncertainty_deg": options.turn_uncertainty_deg})
            count = int(np.count_nonzero(rows[TABLE_RATE]))
            angle = f"{options.turn_deg:g} deg ± {options.turn_uncertainty_deg:g} deg"
            document["notes"].append(f"{own}: {count} turns, each through a multiple of {angle}")
    # One table for each axis: the hand that laid the unit on another side turned it anyhow.
    document.setdefault("table", []).extend(
        PUT_ANYHOW | {"name": f"{TURN_TABLE}-{axis}", "axis_uncertainty_arcsec": 60 * LEVEL} for axis in turned
    )
    document.setdefault("mounting", []).extend(
        {"name": f"about-{axis}", "body_to_table": BODY_TO_TABLE["xyz".index(axis)], "uncertainty_arcmin": LEVEL}
        for axis in turned
    )
    document["run"] = kept


def _stand(procedure: str, runs: Sequence[RecordedRun], channels: Sequence[Mapping[str, Any]]) -> Stand:
    """Return table and mountings if a procedure has them, and what is assumed of them."""
    if procedure == _ON_TABLE:
        return on_table(runs, [np.degrees(_rates(run, channels)) for run in runs])
    if procedure_named(procedure).needs_table or procedure in _AT_REST:
        return lying(runs, seated=procedure not in _AT_REST)
    return Stand([], [], [{}] * len(runs), [])


def _rates(run: RecordedRun, channels: Sequence[Mapping[str, Any]]) -> np.ndarray:
    """Return what the gyros of a run measure at their nominal scale, rad/s, shape (N, G)."""
    gyros = [each for each in channels if each["kind"] == "gyro" and each["name"] in run.columns]
    rates = [(run.columns[each["name"]] - each["offset"]) / each["scale"] * to_si(each["per"]) for each in gyros]
    return np.stack(rates, axis=1) if rates else np.zeros((_rows(run), 0))


def _labels(count: int) -> list[str]:
    return ["recording"] if count == 1 else [f"recording-{place}" for place in range(1, count + 1)]


def _rows(run: RecordedRun) -> int:
    return len(next(iter(run.columns.values())))


def _guessed(key: str, evidence: str, stated: ConvertOptions) -> str:
    value = "" if key == "columns" else f" = {getattr(stated, key)}"
    return f"guessed, {key}{value}: {evidence}"


def _file(label: str) -> str:
    return f"runs/{label}.csv"


def _table(columns: Columns) -> Columns:
    return {TIME: columns[TIME], **columns} if TIME in columns else columns


def _run(label: str, procedure: str, options: ConvertOptions) -> dict[str, Any]:
    run: dict[str, Any] = {"name": label, "procedure": procedure, "file": _file(label)}
    for key in ("temperature_degC", "initial_rest_s"):
        if getattr(options, key) is not None:
            run[key] = float(getattr(options, key))
    return run


def _motion(run: RecordedRun, procedure: str) -> dict[str, Any]:
    """Return the key by which the motion of a table is used, if an encoder was read throughout."""
    return {"transitions": True} if procedure == _ON_TABLE and not run.means and is_followed(run.columns) else {}


def _procedure(run: RecordedRun, rates: np.ndarray, options: ConvertOptions, where: str) -> tuple[str, str]:
    """Return the procedure, and why it was taken if it was not stated; the rates of the gyros are in rad/s."""
    if options.procedure:
        return options.procedure, ""
    table_rate = run.columns.get(TABLE_RATE, np.zeros(1))
    if np.nanmax(table_rate) > np.nanmin(table_rate):
        return _ON_TABLE, "it has the rate of the table"
    seconds = still_seconds(run)
    if not seconds and options.turn_deg is None and not any(name in run.columns for name in ACCELEROMETERS):
        raise input_error(
            "the unit turns, and without accelerometers the angle is unknown", where,
            "turns through an angle that is known, from rest to rest: --turn-deg 360; or the rate of the table: "
            f"--column {TABLE_RATE}=NAME",
            "state the angle or the column, add the accelerometers, or give a record at rest",
        )  # fmt: skip
    if not seconds:
        return procedure_in_motion({} if run.means else run.columns, rates)
    if options.turn_deg is None and (turning := _turning(rates)):
        raise _turns_about_the_vertical(run, turning, where)
    warmth = run.columns.get(TEMPERATURE, np.zeros(1))
    warmth = warmth[np.isfinite(warmth)]
    warmed = float(np.ptp(warmth)) if len(warmth) else 0.0
    if warmed > _WARMED:
        return _RAMP, f"{seconds:.4g} s in one attitude, over {warmed:.3g} degC"
    return _STATIC, f"{seconds:.4g} s in one attitude"


def _procedures(
    runs: Sequence[RecordedRun], channels: Sequence[Mapping[str, Any]], longest: str, options: ConvertOptions
) -> list[tuple[str, str]]:
    """Return the procedure of every run and why: that of the longest, but of a unit by hand each run has its own.

    A session holds turns on a wheel and a unit that is waved; a run at rest among them has poses of a free tumble.
    """
    if options.procedure or not procedure_named(longest).reduction.by_hand:
        return [(longest, "")] * len(runs)
    found = [procedure_in_motion({} if run.means else run.columns, _rates(run, channels)) for run in runs]
    return [(each, why or "rests in several attitudes") for each, why in found]


def _said_of_runs(own: Sequence[tuple[str, str]], labels: Sequence[str], why: str) -> tuple[list[str], str]:
    """Return notes on the procedures of the runs if they differ, and otherwise the reason for the one of all."""
    if len({each for each, _ in own}) == 1:
        return [], why
    return [
        f"{label}: guessed, procedure = {each}: {seen}" for label, (each, seen) in zip(labels, own, strict=True)
    ], ""


def _turning(rates: np.ndarray) -> float:
    """Return how fast gyros turn at levels of rate, rad/s, by their rates (N, G); 0 of a unit at rest."""
    parts = np.array_split(rates, max(1, min(_BLOCKS, len(rates) // _SAMPLES)))
    means = np.array([np.nanmean(part, axis=0) for part in parts])
    return max((turning_span(rate) for rate in means.T), default=0.0)


def _turns_about_the_vertical(run: RecordedRun, turning: float, where: str) -> InputError:
    """Return the error of a unit that turns while gravity stays: a table, whose rate is not read."""
    what = f"the gyros turn by up to {math.degrees(turning):.4g} deg/s while gravity stays in one direction"
    allowed = f"the rate of the table, --column {TABLE_RATE}=NAME; or turns from rest to rest, --turn-deg 360"
    followers = run.followers()
    if not followers:
        return input_error(what, where, allowed, "state the column of the rate, or the angle of the turns")
    first = followers[0]
    by = f"{first.channel} is proportional to it by a factor of {first.slope:.4g}"
    followed = f"column '{first.column}' is not read, and {by}"
    return input_error(
        f"{what}; {followed}", where, allowed,
        f"if it is the rate in deg/s: --column {TABLE_RATE}='{first.column}'",
    )  # fmt: skip


def _of_local_g(channels: Sequence[Mapping[str, Any]], gravity: float) -> list[str]:
    """Return a note if accelerometers are in g and the gravity of the site, m/s², is not the standard one."""
    parts = 1e6 * (gravity / scipy.constants.g - 1)
    if abs(parts) < _LEAST_PARTS or all(each["kind"] == "gyro" or each["per"] != "g" for each in channels):
        return []
    return [
        f"1 g is the gravity of the site, {gravity:.6g} m/s^2; the scale factors of a device that reads in "
        f"{scipy.constants.g:g} m/s^2 are larger by {parts:.3g} ppm than in its own unit"
    ]


def _site(options: ConvertOptions, notes: list[str]) -> dict[str, float]:
    latitude, gravity = options.latitude_deg, options.gravity_m_s2
    if latitude is None:
        latitude = DEFAULT_LATITUDE
        notes.append(f"the latitude was not given: {latitude:g} deg is assumed for the Earth rate")
        if gravity is None:
            gravity = DEFAULT_GRAVITY
            notes.append(
                f"neither gravity nor latitude was given: {gravity:g} m/s² is assumed; on Earth it is 9.78 to 9.83, "
                "and the relative error carries over to the accelerometer scale factors"
            )
    site = {"latitude_deg": float(latitude), "height_m": float(options.height_m)}
    return site if gravity is None else site | {"gravity_m_s2": float(gravity)}


def _temperatures(run: RecordedRun, where: str) -> RecordedRun:
    """Return the run with temperatures in °C."""
    unit = run.units.get(TEMPERATURE, "degC")
    if TEMPERATURE not in run.columns or unit == "degC":
        return run
    values = run.columns[TEMPERATURE]
    turned = {"K": lambda v: v - 273.15, "degF": lambda v: (v - 32.0) / 1.8}.get(unit)
    if turned is None:
        allowed = "degC, K or degF"
        raise input_error(f"temperatures are in {unit}", where, allowed, "state another column of temperature_degC")
    return replace(run, columns=run.columns | {TEMPERATURE: turned(values)})


def _in_own_units(runs: Sequence[RecordedRun], where: str) -> list[RecordedRun]:
    """Return the runs with temperatures in °C, and the motion of the table in deg and s."""
    return [_of_table(_temperatures(run, where), where) for run in runs]


def _of_table(run: RecordedRun, where: str) -> RecordedRun:
    """Return the run with the rate of the table in deg/s and its angle in deg, whatever unit their names state."""
    columns = dict(run.columns)
    for name, units, own in ((TABLE_RATE, GYRO_UNITS, "deg/s"), (TABLE_ANGLE, GYRO_UNITS, "deg")):
        unit = run.units.get(name, own)
        if name not in columns or unit == own:
            continue
        known = units.get(unit)
        if known is None or unit == "count" or known.increment != units[own].increment:
            remedy = f"state another column of {name}, or convert it"
            raise input_error(f"column {name} is in {unit}", where, f"{own}, or a unit that is one in rad", remedy)
        columns[name] = np.degrees(np.asarray(columns[name]) / known.scale * to_si(known.per))
    return replace(run, columns=with_encoder_rate(columns))


def _in_rates(run: RecordedRun, units: Units, where: str) -> RecordedRun:
    """Return the run with increments over one sample turned into mean rates over it."""
    columns = dict(run.columns)
    for name in SIX:
        unit = (GYRO_UNITS if name in GYROS else ACCEL_UNITS).get(units.gyro if name in GYROS else units.accel)
        if name not in columns or unit is None or not unit.increment:
            continue
        if TIME not in columns:
            raise input_error("increments need times", where, "a time, or --sample-rate-hz", "give the sampling rate")
        step = np.diff(columns[TIME])
        columns[name] = columns[name] / np.concatenate([step[:1], step])
    return replace(run, columns=columns)


def _channels(
    columns: Columns, options: ConvertOptions, gravity: float, notes: list[str], source: str
) -> list[dict[str, Any]]:
    nominal: Mapping[str, tuple[float, float]] = {}
    if "count" in (options.accel_unit, options.gyro_unit):
        nominal = nominal_of_counts(columns, options, gravity, notes, source)
    channels = []
    for index, name in enumerate(SIX):
        if name not in columns:
            continue
        gyro = name in GYROS
        word = options.gyro_unit if gyro else options.accel_unit
        unit = (GYRO_UNITS if gyro else ACCEL_UNITS)[word]
        scale, offset = nominal.get(name, (unit.scale, 0.0))
        channels.append(
            {
                "name": name,
                "kind": "gyro" if gyro else "accelerometer",
                "input_axis": [float(index % 3 == axis) for axis in range(3)],
                "output_unit": unit.per if unit.increment else word,
                "scale": scale,
                "per": unit.per,
                "offset": offset,
            }
        )
    return channels

"""From the chosen tables to the runs of a campaign: clocks merged, parts joined, pose means distinguished from logs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from imubayes.foundations.errors import input_error
from imubayes.foundations.wording import counted
from imubayes_recordings.convert.clock import Clock, read_clock
from imubayes_recordings.convert.column_choice import ChosenTable, values_of
from imubayes_recordings.convert.column_names import (
    ACCELEROMETERS,
    CLOCK,
    COUNTER,
    DATE,
    GYROS,
    SAMPLES,
    SIX,
    TABLE_RATE,
    TIME,
)
from imubayes_recordings.convert.motion_kind import ONE_AXIS, procedure_in_motion
from imubayes_recordings.convert.options import ConvertOptions
from imubayes_recordings.convert.raw_counts import signed_counts
from imubayes_recordings.convert.recording import described, read_columns
from imubayes_recordings.convert.unnamed_rates import find_rates

Columns = dict[str, np.ndarray]
_SHOWN = 3  # first values of each column
_MOST_MEANS = 20_000  # rows of a table of pose means
_TURN = np.deg2rad(4.0)  # between the directions of most rows and the next, in a table of pose means
_STILL = 0.05  # scatter of a face relative to g
_TILTED, _DRIFTED = 0.03, 0.15  # of f across and along itself, relative to g, that is no motion yet
_LEAST_FACES = 4
_ALTERNATE = 0.1  # share of rows with forces and rates, below which they stand in rows of their own
_WARM = (-100.0, 200.0)  # degC of an inertial unit; kelvins and counts are beyond
_MOST_VOID = 0.1  # share of rows in which all six channels read the same
_LEAST_COUNTED, _COUNTED = 5, 0.9  # steps of a running number, and the share of them that are one
_PROBED, _LEAST_PROBED = 20_000, 100  # rows
_MOST_UNITS, _IDENTITIES = 6, range(2, 7)  # in one file
_ALTERNATING = 0.4  # of the change from one row to the next, over several
_FOLLOWS = 0.99  # correlation of a gyro with the rate that drives it, noise and other axes included
_MEAN_AND_SCATTER = (np.nanmean, np.nanstd)


@dataclass(frozen=True)
class RecordedRun:
    """One run as recorded.

    Attributes
    ----------
    columns : target → shape (N,), times in s from the start and everything else in recorded units.
    units : channel → unit that name or recording state.
    notes : how the recording was understood, and what was left out.
    guesses : option → why its value was taken.
    time_unit : in which times were recorded; empty if they were made from a rate or words.
    means : whether each row is the mean of a pose.
    followers : gives the columns that are not read and follow a gyro; they are read for that.
    """

    columns: Columns
    units: dict[str, str]
    notes: tuple[str, ...]
    guesses: dict[str, str]
    time_unit: str = ""
    means: bool = False
    followers: Callable[[], tuple["Follower", ...]] = tuple


@dataclass(frozen=True)
class Follower:
    """A column that is not read and follows a gyro: it may be the rate of the table.

    Attributes
    ----------
    column, channel : their names; the number of the column if it has none.
    slope : of the gyro over the column, in recorded units.
    """

    column: str
    channel: str
    slope: float


def recorded_runs(tables: Sequence[ChosenTable], options: ConvertOptions) -> tuple[RecordedRun, ...]:
    """Return the runs that the tables hold.

    Raises
    ------
    InputError
        if a raw log has no times, or two clocks do not overlap.
    """
    parts = _whole_parts(tables, options)
    if len(parts) > 1 and options.rows != "samples" and (faces := _faces(parts)) is not None:
        return (faces,)
    if len(parts) > 1 and not _of_own_axes(parts, options) and (joined := _joined(parts)) is not None:
        parts = [joined]
    return tuple(_from_zero(_told_rows(part, options, tables), options) for part in parts)


def _whole_parts(tables: Sequence[ChosenTable], options: ConvertOptions) -> list[RecordedRun]:
    """Return the run of each table; accelerometers and gyros of one file, or of the only two, are one."""
    by_file: dict[int, list[ChosenTable]] = {}
    for table in tables:
        by_file.setdefault(id(table.recording) if len(tables) > 2 else 0, []).append(table)
    parts = []
    for own in by_file.values():
        found, kinds = [_table_part(table, options) for table in own], [table.kinds for table in own]
        apart = sorted(kinds) == ["a", "g"]
        parts += [_merged(found[kinds.index("a")], found[kinds.index("g")], own)] if apart else found
    return parts


def _table_part(table: ChosenTable, options: ConvertOptions) -> RecordedRun:
    """Return the run of a table, whose forces and rates may stand in rows of their own: two clocks then."""
    values = values_of(table)
    force, rate = (
        np.any([np.isfinite(values[name]) for name in names if name in values], axis=0)
        for names in (ACCELEROMETERS, GYROS)
    )
    if table.kinds != "ag" or np.sum(force & rate) >= _ALTERNATE * min(force.sum(), rate.sum()):
        return _part(table, options, values)
    forces, rates = (
        replace(table, columns={name: own for name, own in table.columns.items() if name[:2] not in left_out})
        for left_out in (GYROS, ACCELEROMETERS)
    )
    return _merged(_part(forces, options, values), _part(rates, options, values), [table])


def _filled(values: Columns) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return which rows have a reading, and a note on those whose six channels all read the same: a sign of none."""
    channels = [values[name] for name in SIX if name in values]
    filled = np.any([np.isfinite(column) for column in channels], axis=0)
    void = np.all([column == channels[0] for column in channels], axis=0)  # a NaN is no value
    if len(channels) < len(SIX) or not 0 < void.sum() <= _MOST_VOID * filled.sum():
        return filled, ()
    word = f"{channels[0][np.flatnonzero(void)[0]]:.6g}"
    return filled & ~void, (
        f"{counted(int(void.sum()), 'row')} in which all six channels read the same ({word}) left out",
    )


def _beside(others: Columns, keep: np.ndarray, units: dict[str, str]) -> tuple[Columns, list[str]]:
    """Return the kept rows: a temperature in rows of its own is interpolated, one that is none in degC left out."""
    kept, notes = dict(others) if keep.all() else {name: column[keep] for name, column in others.items()}, []
    for name in [name for name in kept if "temperature" in name]:
        there = np.flatnonzero(np.isfinite(others[name]))
        if len(there) and np.isfinite(kept[name]).mean() < _ALTERNATE and np.sum(~keep[there]) > 0.5 * len(there):
            kept[name] = np.interp(np.flatnonzero(keep), there, others[name][there])
            notes.append(f"{name} is recorded in {len(there)} separate rows: interpolated")
        usual = float(np.median(others[name][there])) if len(there) else 0.0
        if not units.get(name) and not _WARM[0] < usual < _WARM[1]:
            del kept[name]
            notes.append(f"{name} reads {usual:.5g}, which is not in degC: not read; its header may state K or degF")
    return kept, notes


def _part(table: ChosenTable, options: ConvertOptions, values: Columns) -> RecordedRun:
    recorded = {name: values[name] for name in table.columns}
    values, signed = signed_counts(_numbered(recorded))
    mixed = _mixed_units(table, values)
    filled, void = _filled(values)
    if not filled.any():
        remedy = "state the column of each channel, such as --column ax=NAME"
        raise input_error("no row has a reading", table.topic.where, "numbers in the columns of the channels", remedy)
    clock = read_clock(table, values, filled, options)
    units = {name: column.unit for name, column in table.columns.items() if column.unit}
    note = _understood(table, recorded)
    others = {name: column for name, column in values.items() if name not in (TIME, DATE, CLOCK, COUNTER)}
    guesses = {"columns": table.evidence} if table.evidence else {}
    kept, beside = _beside(others, filled if clock is None else clock.keep, units)
    left = (*table.left, *table.recording.notes(), *signed, *mixed, *void, *beside)
    followers = partial(_followers, table, values)
    if clock is not None and table.kinds == "a":
        rates = find_rates(table, {TIME: clock.time, **kept}, clock.keep)
        kept |= rates.columns
        units |= dict.fromkeys(rates.columns, rates.unit)
        guesses |= {"columns": rates.evidence} if rates.evidence else {}
        left += rates.notes
    if clock is None:
        return RecordedRun(kept, units, (note, *left), guesses, followers=followers)
    return RecordedRun(
        {TIME: clock.time, **kept},
        units,
        (note, *left, *clock.notes),
        guesses | _time_guess(clock),
        clock.unit,
        followers=followers,
    )


def _followers(table: ChosenTable, values: Columns) -> tuple[Follower, ...]:
    """Return the columns that are not read and follow a gyro, the closest first; none if the rate is read."""
    columns, gyros = table.topic.columns, [name for name in GYROS if name in values]
    unread = [] if TABLE_RATE in table.columns else _unread(table)
    if not gyros or not unread:
        return ()
    step = max(1, len(values[gyros[0]]) // _PROBED)
    others = read_columns(table.recording, table.topic, unread)[::step]
    pairs = [
        (columns[place].name or str(place + 1), name, *_regressed(other, values[name][::step]))
        for place, other in zip(unread, others.T, strict=True)
        for name in gyros
    ]
    closest = sorted((each for each in pairs if each[2] > _FOLLOWS), key=lambda each: -each[2])
    return tuple(Follower(column, name, slope) for column, name, _, slope in closest)


def _unread(table: ChosenTable) -> list[int]:
    """Return the columns of numbers that are not read."""
    used = {place for column in table.columns.values() for place in (column.position, column.added)}
    return [place for place, own in enumerate(table.topic.columns) if place not in used and own.unit != "text"]


def _regressed(other: np.ndarray, rate: np.ndarray) -> tuple[float, float]:
    """Return the size of the correlation of two columns, (N,) each, and the slope of the second over the first."""
    both = np.isfinite(rate) & np.isfinite(other)
    if both.sum() < _LEAST_PROBED:
        return 0.0, 0.0
    first, second = other[both] - other[both].mean(), rate[both] - rate[both].mean()
    size = float(np.std(first)), float(np.std(second))
    if not min(size) > 0:
        return 0.0, 0.0
    correlation = float(np.mean((first / size[0]) * (second / size[1])))
    return abs(correlation), correlation * size[1] / size[0]


def _mixed_units(table: ChosenTable, values: Columns) -> tuple[str, ...]:
    """Return a note if the rows of several units seem to alternate.

    Raises
    ------
    InputError
        if, besides, a column that is not read may say which unit a row is of.
    """
    channels = np.stack([values[name][:_PROBED] for name in SIX if name in values], axis=1)
    channels = channels[np.isfinite(channels).all(axis=1)]
    if len(channels) < _LEAST_PROBED:
        return ()
    # Noise and motion change no less over two rows or more than over one.
    size = np.array([np.median(np.abs(channels[lag:] - channels[:-lag]), axis=0) for lag in range(1, _MOST_UNITS + 1)])
    if np.mean(size[1:].min(axis=0) < _ALTERNATING * size[0]) < 0.5:
        return ()
    what = "the readings alternate from row to row, as if one file held the rows of several units"
    if not (saying := _identities(table)):
        return (what,)
    named = " or ".join(f"{place + 1} {table.topic.columns[place].name}".strip() for place in saying)
    remedy = f"keep the rows of one unit, in a file of their own; column {named} may identify it"
    raise input_error(what, table.topic.where, "rows of one unit", remedy)


def _identities(table: ChosenTable) -> list[int]:
    """Return the columns besides channels and times that hold text, or few numbers: each row may say its unit so."""
    columns = table.topic.columns
    used = {column.position for name, column in table.columns.items() if name not in (COUNTER, SAMPLES)}
    texts = [place for place, column in enumerate(columns) if column.unit == "text" and not column.is_label]
    unread = [place for place, column in enumerate(columns) if place not in used and column.unit != "text"]
    others = read_columns(table.recording, table.topic, unread)[:_PROBED].T if unread else ()
    few = [place for place, other in zip(unread, others, strict=True) if len(np.unique(other)) in _IDENTITIES]
    return sorted({*few, *texts} - used)


def _numbered(values: Columns) -> Columns:
    """Return the columns with a number of samples that grows by one from row to row taken as a counter."""
    number = values.get(SAMPLES, np.zeros(0))
    step = np.diff(number[np.isfinite(number)])
    if len(step) < _LEAST_COUNTED or np.mean(step == 1) < _COUNTED:
        return values
    return {COUNTER if name == SAMPLES else name: column for name, column in values.items()}


def _time_guess(clock: Clock) -> dict[str, str]:
    return {"time_unit": clock.guess} if clock.guess else {}


def _understood(table: ChosenTable, values: Columns) -> str:
    """Return a note on what the columns were taken for: target ← column, with the first values."""
    topic = table.topic
    ordered = sorted(table.columns, key=lambda name: name not in (TIME, DATE, CLOCK))
    sources = [_source(table, name, values[name]) for name in ordered]
    used = {place for column in table.columns.values() for place in (column.position, column.added)}
    unread = [own.name or str(place + 1) for place, own in enumerate(topic.columns) if place not in used]
    listed = ", ".join(unread[:20]) + (", …" if len(unread) > 20 else "")
    left = f"; not read: {listed}" if unread else ""
    within = f", topic '{topic.name}'" if topic.name else ""
    how = f", {topic.note}" if topic.note else ""
    return f"{table.recording.file.name}{within}{how}: {', '.join(sources)}{left}"


def _source(table: ChosenTable, name: str, values: np.ndarray) -> str:
    """Return what a column of a run is read from, with its first values."""
    columns, own = table.topic.columns, table.columns[name]
    places = [own.position, *([] if own.added is None else [own.added])]
    named = [f"column {place + 1}" + (f" '{columns[place].name}'" if columns[place].name else "") for place in places]
    unit = f" in {own.unit}" if own.unit and own.unit not in columns[own.position].name else ""
    sign = " turned round" if own.sign < 0 else ""
    first = ", ".join(f"{value:.6g}" for value in values[:_SHOWN])
    return f"{name} ← {' + '.join(named)}{unit}{sign} ({first} …)"


def _merged(force: RecordedRun, rate: RecordedRun, tables: Sequence[ChosenTable]) -> RecordedRun:
    """Return accelerometers and gyros in one table; with two clocks the rates are interpolated to the forces' times."""
    where = " and ".join(table.topic.where for table in tables)
    forces, rates, notes = dict(force.columns), dict(rate.columns), [*force.notes, *rate.notes]
    time, clock = forces.pop(TIME, None), rates.pop(TIME, None)
    if time is None or clock is None:
        rows, others = (len(next(iter(columns.values()))) for columns in (forces, rates))
        if rows != others or time is not clock:
            what = f"accelerometers and gyros have {rows} and {others} rows, and not both have times"
            raise input_error(what, where, "times in both, or none and --sample-rate-hz", "give both with their times")
        columns = forces | rates
    else:
        if len(clock) != len(time) or np.max(np.abs(clock - time)) > 0:
            inside = _overlap(time, clock, where)
            notes.append(f"two clocks: rates are interpolated to the {int(inside.sum())} times of the accelerometers")
            rates = {name: np.interp(time[inside], clock, values) for name, values in rates.items()}
            forces = {name: values[inside] for name, values in forces.items()}
            time = time[inside]
        columns = {TIME: time} | rates | forces
    guesses = rate.guesses | force.guesses
    return RecordedRun(columns, rate.units | force.units, tuple(notes), guesses, force.time_unit or rate.time_unit)


def _overlap(time: np.ndarray, clock: np.ndarray, where: str) -> np.ndarray:
    """Return which times of the one clock lie within the other."""
    inside = (time >= clock[0]) & (time <= clock[-1])
    if inside.sum() < 2:
        spans = " and ".join(f"{each[0]:.6g} to {each[-1]:.6g} s" for each in (time, clock))
        what = f"the clocks do not overlap: {spans}"
        raise input_error(what, where, "two parts of one recording", "check the files, or --time-unit")
    return inside


def _faces(parts: Sequence[RecordedRun]) -> RecordedRun | None:
    """Return the table of pose means of several recordings that each rest on one face; None if any moves."""
    names = [name for name in SIX if all(name in part.columns for part in parts)]
    if len(parts) < _LEAST_FACES or not set(ACCELEROMETERS) <= set(names):
        return None
    means, scatter = (
        np.array([[reduced(part.columns[name]) for name in names] for part in parts]) for reduced in _MEAN_AND_SCATTER
    )
    size = float(np.median(np.linalg.norm(means[:, :3], axis=1)))
    apart = np.ptp(means[:, :3], axis=0).max() > 0.5 * size
    if not apart or np.linalg.norm(scatter[:, :3], axis=1).max() > _STILL * size:
        return None
    columns = _means_beside(parts, names)
    for place, name in enumerate(names):
        columns |= {name: means[:, place], f"{name}_sd": scatter[:, place]}
    notes = [note for part in parts for note in part.notes]
    notes.append(f"{len(parts)} files, each at rest on one face: one mean each")
    return RecordedRun(columns, parts[0].units, tuple(notes), parts[0].guesses, parts[0].time_unit, True)


def _means_beside(parts: Sequence[RecordedRun], names: Sequence[str]) -> Columns:
    """Return the number of samples of each part, and the means of what is recorded beside the channels."""
    left_out = {*names, TIME, SAMPLES, *(f"{name}_sd" for name in names)}
    shared = set.intersection(*(set(part.columns) for part in parts)) - left_out
    columns: Columns = {SAMPLES: np.array([float(np.isfinite(part.columns[names[0]]).sum()) for part in parts])}
    return columns | {name: np.array([np.nanmean(part.columns[name]) for part in parts]) for name in sorted(shared)}


def _of_own_axes(parts: Sequence[RecordedRun], options: ConvertOptions) -> bool:
    """Tell whether each part may be a rotation about an axis of its own: parts one after the other are runs then."""
    if options.procedure:
        return options.procedure == ONE_AXIS
    rates = [_stacked(part, [name for name in GYROS if name in part.columns]) for part in parts]
    return any(procedure_in_motion(part.columns, own)[0] == ONE_AXIS for part, own in zip(parts, rates, strict=True))


def _stacked(part: RecordedRun, names: Sequence[str]) -> np.ndarray:
    columns = [part.columns[name] for name in names]
    return np.stack(columns, axis=1) if columns else np.zeros((len(next(iter(part.columns.values()))), 0))


def _joined(parts: Sequence[RecordedRun]) -> RecordedRun | None:
    """Return parts that follow each other in time as one record; None if they do not."""
    ordered = sorted(parts, key=lambda part: float(part.columns[TIME][0]) if TIME in part.columns else 0.0)
    follow = all(
        TIME in first.columns and TIME in second.columns and second.columns[TIME][0] > first.columns[TIME][-1]
        for first, second in pairwise(ordered)
    )
    seated_anew = any(TABLE_RATE in part.columns for part in parts)  # perhaps
    if not follow or seated_anew or any(set(part.columns) != set(ordered[0].columns) for part in ordered):
        return None
    columns = {name: np.concatenate([part.columns[name] for part in ordered]) for name in ordered[0].columns}
    notes = [*(note for part in ordered for note in part.notes), f"{len(parts)} files, one after the other"]
    return replace(ordered[0], columns=columns, notes=tuple(notes))


def _told_rows(part: RecordedRun, options: ConvertOptions, tables: Sequence[ChosenTable]) -> RecordedRun:
    """Return the run with what its rows are: as stated, by its columns, or by the numbers."""
    counted = SAMPLES in part.columns and TIME not in part.columns
    told = not options.procedure and (counted or _pose_means(part.columns))
    if options.rows == "means" or (options.rows != "samples" and told):
        why = "its number of samples is recorded" if counted else "|f| is the same while its direction changes"
        why = "as stated" if options.rows else why
        return replace(part, means=True, notes=(*part.notes, f"each row is the mean of one pose: {why}"))
    if TIME in part.columns:
        return part
    table = tables[0]
    raise input_error(
        f"{described(table.topic)} has no time, and no sampling rate was given",
        table.topic.where,
        "--sample-rate-hz 100, a column of times (--column time_s=NAME), or --rows means if each row is one pose",
        "give the sampling rate",
    )


def _pose_means(columns: Columns) -> bool:
    """Return whether the rows are means of poses: the direction of f changes from row to row, and |f| does not."""
    if not all(name in columns for name in ACCELEROMETERS) or not 4 <= len(columns["ax"]) <= _MOST_MEANS:
        return False
    force = np.stack([columns[name] for name in ACCELEROMETERS], axis=1)
    if not np.isfinite(force).all():
        return False
    norm = np.linalg.norm(force, axis=1)
    if not norm.all() or np.quantile(np.abs(norm / np.median(norm) - 1), 0.95) > 0.15:
        return False
    cosine = np.sum(force[1:] * force[:-1], axis=1) / norm[1:] / norm[:-1]
    return bool(np.median(np.arccos(np.clip(cosine, -1, 1))) > _TURN)


def _from_zero(run: RecordedRun, options: ConvertOptions) -> RecordedRun:
    columns = dict(run.columns)
    if run.means and SAMPLES not in columns:
        columns[SAMPLES] = np.full(len(next(iter(columns.values()))), options.samples or 1.0)
        if options.samples is None and any(name.endswith("_sd") for name in columns):
            note = "the number of samples in a mean is not recorded: 1 is assumed; --samples N states it"
            run = replace(run, notes=(*run.notes, note))
    if TIME in columns:
        columns = {TIME: columns.pop(TIME) - run.columns[TIME][0], **columns}
    return replace(run, columns=columns)


def still_seconds(run: RecordedRun) -> float:
    """Return how long a run lasts that rests in one attitude all the time; 0 if it moves, or is no log."""
    names = [name for name in ACCELEROMETERS if name in run.columns] or [n for n in GYROS if n in run.columns]
    if run.means or TIME not in run.columns or not names:
        return 0.0
    values = np.stack([run.columns[name] for name in names], axis=1)
    count = min(200, len(values) // 50)
    if count < 4:
        return 0.0
    means = np.array([np.nanmean(part, axis=0) for part in np.array_split(values, count)])
    usual = np.nanmedian(means, axis=0)
    moved = means - usual
    if names[0] in ACCELEROMETERS:  # a bias that drifts with temperature may change |f| more than a turn would
        along = usual / (np.linalg.norm(usual) + 1e-300)
        across = np.linalg.norm(moved - np.outer(moved @ along, along), axis=1).max()
        still = across < _TILTED * np.linalg.norm(usual) and np.abs(moved).max() < _DRIFTED * np.linalg.norm(usual)
    else:
        still = np.abs(moved).max() < 20 * _scatter(values, count)
    return float(run.columns[TIME][-1] - run.columns[TIME][0]) if still else 0.0


def _scatter(values: np.ndarray, count: int) -> float:
    """Return the typical standard deviation of readings within one of `count` parts: motion is not noise."""
    return float(np.median([np.nanstd(part, axis=0) for part in np.array_split(values, count)]))

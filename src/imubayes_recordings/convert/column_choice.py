"""Which columns of a topic are the channels: as stated, by name, or by what unnamed numbers say."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imubayes.foundations.errors import InputError, Issue, closest_first, input_error
from imubayes_recordings.convert.column_names import (
    ACCEL_UNITS,
    ACCELEROMETERS,
    CLOCK,
    DATE,
    GYRO_UNITS,
    GYROS,
    SIX,
    TEMPERATURE,
    TIME,
    TIME_UNITS,
    UNKNOWN_AXES,
    WITHOUT_GRAVITY,
    ColumnRole,
    body_rates,
    quantity_of,
    role_of,
    separate_gravity,
    unit_in_brackets,
    without_gravity,
    words_of,
)
from imubayes_recordings.convert.options import ConvertOptions
from imubayes_recordings.convert.recording import SourceRecording, Topic, first_rows, read_columns
from imubayes_recordings.convert.unnamed_columns import (
    GuessedColumns,
    infer_layout,
    parted_seconds,
    rest_means,
    unit_of_gravity,
)

TRIPLES = {"a": ACCELEROMETERS, "g": GYROS}


@dataclass(frozen=True)
class ChosenColumn:
    """A column that is read: its position from 0, its sign, and the unit that name or recording state.

    `added` is the position of a column that is added to it, times `factor`.
    """

    position: int
    unit: str = ""
    sign: float = 1.0
    added: int | None = None
    factor: float = 1.0


@dataclass(frozen=True)
class ChosenTable:
    """A topic and the columns that are read of it.

    Attributes
    ----------
    columns : target → column; two for a date and a time of day.
    evidence : why columns without names were taken so; empty if names or options say it.
    left : columns that could have been read as well, and why they are not.
    faults : why the topic cannot serve.
    """

    recording: SourceRecording
    topic: Topic
    columns: dict[str, ChosenColumn]
    evidence: str = ""
    left: tuple[str, ...] = ()
    faults: tuple[Issue, ...] = field(default=(), repr=False)

    @property
    def usable(self) -> bool:
        """Whether it has channels, and nothing speaks against it."""
        return bool(self.kinds) and not self.faults

    @property
    def kinds(self) -> str:
        """Which kinds of channels it has: `a`, `g` or `ag`."""
        return "".join(kind for kind, names in TRIPLES.items() if any(name in self.columns for name in names))


def chosen_columns(recording: SourceRecording, topic: Topic, options: ConvertOptions, alone: bool) -> ChosenTable:
    """Return what a topic has, with what speaks against it."""
    table, faults = ChosenTable(recording, topic, {}), []
    stated: dict[str, ChosenColumn] = {}
    roles = [role_of(column.name, column.unit) for column in topic.columns]
    for target, source in options.columns.items():
        try:
            stated[target] = _stated(topic, target, source, roles)
        except InputError as error:
            faults += error.issues
    if faults and (alone or stated):
        return replace(table, columns=stated, faults=tuple(faults))
    if not topic.named:
        return _without_names(table, stated, options, alone)
    roles = [_resolved(role, topic, recording) for role in roles]
    if not any(role is not None and role.target in GYROS for role in roles):
        rates = body_rates(topic.names)
        roles = [rates.get(place, role) for place, role in enumerate(roles)]
    try:
        named, left = _by_name(table, roles, stated)
        columns = _parted_time(table, roles) | _with_gravity(topic, stated | named, options)
    except InputError as error:
        return replace(table, columns=stated, faults=error.issues)
    return _checked(replace(table, columns=columns, left=left), roles, options)


def _with_gravity(topic: Topic, columns: dict[str, ChosenColumn], options: ConvertOptions) -> dict[str, ChosenColumn]:
    """Return columns with accelerometers as sums of gravity and the rest, if there are no others."""
    if any(name in columns for name in ACCELEROMETERS):
        return columns
    sums = separate_gravity(topic.names)
    if not sums and (motion := without_gravity(topic.names)) and not any(name in options.columns for name in SIX):
        raise input_error(
            f"gravity was subtracted from {', '.join(topic.names[place] for place in motion)}, and no column has it",
            topic.where,
            "the full reading of the accelerometers, or columns of gravity and of the remaining acceleration",
            "record the accelerometers themselves; to read the gyros alone: --column gx=NAME --column gy=NAME "
            "--column gz=NAME",
        )
    return columns | {name: ChosenColumn(parts.motion, parts.unit, added=parts.gravity) for name, parts in sums.items()}


def _checked(table: ChosenTable, roles: Sequence[ColumnRole | None], options: ConvertOptions) -> ChosenTable:
    """Return a table with what stands beside its channels, and what speaks against its columns."""
    topic = table.topic
    columns, beside = _beside(topic, roles, table.columns)
    left = (*table.left, *beside)
    unknown = {target: role.unknown for target, column in columns.items() if (role := roles[column.position])}
    if unknown.get(TEMPERATURE):
        left += (f"the temperature is not read: its unit '{unknown[TEMPERATURE]}' is not known",)
        columns = {target: column for target, column in columns.items() if target != TEMPERATURE}
    text = [target for target, own in columns.items() if topic.columns[own.position].unit == "text"]
    for target in (name for name in text if name[:2] not in SIX and name not in (TIME, *options.columns)):
        left += (f"'{topic.names[columns[target].position]}' holds text: {target} is not read",)
        columns = {name: own for name, own in columns.items() if name != target}
    faults = [*_unknown_units(topic, columns, unknown, options), *_read_twice(topic, columns)]
    return replace(table, columns=columns, left=left, faults=tuple(faults))


def _unknown_units(
    topic: Topic, columns: Mapping[str, ChosenColumn], unknown: Mapping[str, str], options: ConvertOptions
) -> list[Issue]:
    """Return one issue for each kind of column whose unit is stated in a way that is not known, and by no option."""
    by_option = (
        ("accel-unit", ACCELEROMETERS, options.accel_unit, ACCEL_UNITS),
        ("gyro-unit", GYROS, options.gyro_unit, GYRO_UNITS),
        ("time-unit", (TIME,), options.time_unit or str(options.sample_rate_hz or ""), TIME_UNITS),
    )
    return [
        Issue(
            f"the unit '{unknown[found[0]]}' of {found[0]} is not known", topic.where, ", ".join(allowed),
            f"correct it in the recording, or state the unit with --{option}"
            + (", or the rate with --sample-rate-hz" if option == "time-unit" else ""),
        )
        for option, targets, stated, allowed in by_option
        if not stated and (found := [target for target in targets if target in columns and unknown.get(target)])
    ]  # fmt: skip


def _read_twice(topic: Topic, columns: Mapping[str, ChosenColumn]) -> list[Issue]:
    """Return an issue if one column would be two channels."""
    by_place: dict[int, list[str]] = {}
    for target, column in columns.items():
        by_place.setdefault(column.position, []).append(target)
    return [
        Issue(
            f"column {place + 1} '{topic.names[place]}' would be {' and '.join(targets)}", topic.where,
            "one column for each channel", f"state the column of {targets[-1]} as well: --column {targets[-1]}=NAME",
        )
        for place, targets in by_place.items()
        if len(targets) > 1
    ][:1]  # fmt: skip


def _stated(topic: Topic, target: str, source: str | int, roles: Sequence[ColumnRole | None]) -> ChosenColumn:
    word, sign = str(source), 1.0
    if word.startswith("-") and word not in topic.names:
        word, sign = word[1:], -1.0
    position = topic.position(word, target)
    role = roles[position]
    named = unit_in_brackets(topic.names[position]) if role is None or not role.unit else ""
    return ChosenColumn(position, named or (role.unit if role else ""), sign)


def _resolved(role: ColumnRole | None, topic: Topic, recording: SourceRecording) -> ColumnRole | None:
    """Return the role of an axis with the quantity that the names of topic and file say."""
    if role is None or not role.target.startswith("?"):
        return role
    kind = hinted_kind(topic, recording)
    return replace(role, target=kind + role.target[1:]) if kind else role


def hinted_kind(topic: Topic, recording: SourceRecording) -> str:
    """Return ``a`` or ``g`` if it is stated, or the name of the topic, or of the file, says what it holds."""
    if topic.kind:
        return topic.kind
    for name in (topic.name, recording.file.name.partition(".")[0]):
        if kind := quantity_of(set(words_of(name)) - {"a", "g", "f", "w"}, ""):
            return kind
    return topic.name if topic.name in TRIPLES else ""


def _without_names(
    table: ChosenTable, stated: Mapping[str, ChosenColumn], options: ConvertOptions, alone: bool
) -> ChosenTable:
    topic, recording = table.topic, table.recording
    if any(name in stated for name in SIX):
        return _by_number(table, stated, alone)
    width = len(topic.columns)
    names = topic.note if topic.misfit else f"the table has {width} columns and no names"
    state = "state the column of each channel, such as --column ax=NUMBER"
    if topic.misfit:
        return replace(table, faults=(Issue(names, topic.where, "as many names as data fields", state),))
    asked_for = alone or not topic.name or topic.name in options.topic
    if not asked_for and not hinted_kind(topic, recording):
        return table
    try:
        read = _numeric(topic, names, state)
        values, numbers = read_columns(recording, topic, read), [place + 1 for place in read]
        layout = infer_layout(values, hinted_kind(topic, recording), topic.where, names, numbers)
    except InputError as error:
        return replace(table, faults=error.issues)
    columns = _guessed_columns(layout, read) | dict(stated)
    if options.sample_rate_hz is not None and TIME not in stated:
        columns.pop(TIME, None)
    evidence = layout.evidence if not topic.kind else ""  # stated
    return replace(table, columns=columns, evidence=evidence, left=_labels(topic))


def _guessed_columns(layout: GuessedColumns, read: Sequence[int]) -> dict[str, ChosenColumn]:
    """Return the columns of a guess over some columns of a topic."""
    units = {"a": "m/s", "g": "rad"} if layout.increments else {}
    columns = {target: ChosenColumn(read[place], units.get(target[0], "")) for target, place in layout.columns.items()}
    if layout.fraction is not None:
        columns[TIME] = replace(columns[TIME], unit="s", added=read[layout.fraction])
    return columns


def _by_number(table: ChosenTable, stated: Mapping[str, ChosenColumn], alone: bool) -> ChosenTable:
    """Return a table with its stated columns.

    Of several topics each has the channels of its own kind: numbers of columns are alike in all.
    """
    kind = "" if alone else hinted_kind(table.topic, table.recording)
    own = {name: column for name, column in stated.items() if not kind or name not in SIX or name[0] == kind}
    return replace(table, columns=own, faults=tuple(_read_twice(table.topic, own)))


def _labels(topic: Topic) -> tuple[str, ...]:
    places = [str(place + 1) for place, column in enumerate(topic.columns) if column.is_label]
    return (f"column {' and '.join(places)} holds the same word in every line: a label",) if places else ()


def _numeric(topic: Topic, names: str, state: str) -> list[int]:
    """Return the columns without text, which must stand first, labels apart: they are identified by their number."""
    read = [place for place, column in enumerate(topic.columns) if column.unit != "text"]
    counted = [place for place, column in enumerate(topic.columns) if not column.is_label]
    if read != counted[: len(read)]:
        text = f"{names}, and there is text before or between its numbers"
        raise input_error(text, topic.where, "columns of numbers, text behind them", state)
    return read


def _by_name(
    table: ChosenTable, roles: Sequence[ColumnRole | None], stated: Mapping[str, ChosenColumn]
) -> tuple[dict[str, ChosenColumn], tuple[str, ...]]:
    """Return the channels that names say, and their scatter: of each kind all three axes, of one sensor; and notes."""
    chosen: dict[str, ChosenColumn] = {}
    left: list[str] = []
    issues: list[Issue] = []
    for names in TRIPLES.values():
        wanted = [name for name in names if name not in stated]
        sensors: dict[tuple[str, ...], _Sensor] = {}
        for place, role in enumerate(roles):
            if role is not None and role.target in wanted:
                sensors.setdefault(role.group, {}).setdefault(role.target, []).append(place)
        others = {group: own for group, own in sensors.items() if not set(group) & WITHOUT_GRAVITY}
        sensors = others or sensors  # accelerations that the device makes of the readings are none
        if not sensors:
            continue
        try:
            own, why = _one_sensor(table, list(sensors.values()), wanted)
        except InputError as error:
            issues += error.issues
            continue
        chosen |= {name: _column(own[name], roles) for name in wanted}
        left += [why] if why else []
    if issues:
        raise InputError(issues)
    return chosen | _scatter(roles, chosen), tuple(left)


_Sensor = dict[str, list[int]]


def _scatter(roles: Sequence[ColumnRole | None], chosen: Mapping[str, ChosenColumn]) -> dict[str, ChosenColumn]:
    """Return the columns of standard deviations that belong to chosen channels."""
    kinds = {name[0] for name in chosen}
    found = {}
    for place, role in enumerate(roles):
        if role is not None and role.target.endswith("_sd"):
            unknown = role.target.startswith("?") and len(kinds) == 1
            target = f"{next(iter(kinds))}{role.target[1:]}" if unknown else role.target
            if target[:2] in chosen:
                found[target] = _column(place, roles)
    return found


def _column(place: int, roles: Sequence[ColumnRole | None]) -> ChosenColumn:
    role = roles[place]
    return ChosenColumn(place, role.unit if role else "")


def _one_sensor(table: ChosenTable, sensors: Sequence[_Sensor], wanted: Sequence[str]) -> tuple[dict[str, int], str]:
    """Return the columns of the only sensor that has all axes, and why it was chosen of several."""
    topic, names = table.topic, table.topic.names
    whole = [own for own in sensors if len(own) == len(wanted)]
    if tuple(wanted) == ACCELEROMETERS and (heavy := _heavy(table, whole)):
        listed = ", ".join(names[place] for place in heavy.values())
        return heavy, f"{listed} read g at rest: no other columns of accelerometers do"
    candidates = [own for own in whole if any(names[places[0]] in SIX for places in own.values())] or whole
    if not candidates:
        raise _incomplete(topic, max(sensors, key=len), wanted)
    if len(candidates) > 1:
        raise _rivals(topic, candidates, wanted)
    for target, places in candidates[0].items():
        if len(places) > 1:
            raise _twice(topic, target, places)
    return {name: places[0] for name, places in candidates[0].items()}, ""


def _parted(sensor: _Sensor) -> list[dict[str, int]]:
    """Return the sensors of one group of names that has each axis several times."""
    count = min(map(len, sensor.values()))
    return [{name: places[k] for name, places in sensor.items()} for k in range(count)]


def _heavy(table: ChosenTable, sensors: Sequence[_Sensor]) -> dict[str, int]:
    """Return the only one of several sensors that reads g at rest; empty if none does, or more than one."""
    candidates = [part for own in sensors for part in _parted(own)]
    if len(candidates) < 2:
        return {}
    read = [first_rows(table.recording, table.topic, list(own.values())) for own in candidates]
    found = [own for own, rows in zip(candidates, read, strict=True) if unit_of_gravity(rows, rest_means(rows))[0]]
    return dict(found[0]) if len(found) == 1 else {}


def _incomplete(topic: Topic, found: _Sensor, wanted: Sequence[str]) -> InputError:
    named = closest_first("", [name for name in topic.names if name], most=12)
    missing = ", ".join(name for name in wanted if name not in found)
    return input_error(
        f"the columns are named {named}: there is no {missing}",
        topic.where,
        f"columns named {' '.join(SIX)} or alike, as many names as data fields",
        "state the column of each channel, such as --column ax=NAME or --column ax=NUMBER"
        f"; or the only ones of the unit: {' '.join(f'--column {n}={topic.names[found[n][0]]!r}' for n in found)}",
    )


def _rivals(topic: Topic, candidates: Sequence[_Sensor], wanted: Sequence[str]) -> InputError:
    listed = [", ".join(topic.names[places[0]] for places in own.values()) for own in candidates]
    options = " ".join(f"--column {name}={topic.names[candidates[0][name][0]]!r}" for name in wanted)
    what = f"{len(candidates)} sets of columns may be {' '.join(wanted)}"
    return input_error(what, topic.where, "; ".join(listed), f"state which, such as {options}")


def _twice(topic: Topic, target: str, places: Sequence[int]) -> InputError:
    alike = {topic.names[place] for place in places}
    what = f"are named '{alike.pop()}'" if len(alike) == 1 else f"may be {target}"
    allowed = ", ".join(f"{place + 1} '{topic.names[place]}'" for place in places)
    return input_error(f"{len(places)} columns {what}", topic.where, allowed, f"state which: --column {target}=NUMBER")


def _beside(
    topic: Topic, roles: Sequence[ColumnRole | None], columns: dict[str, ChosenColumn]
) -> tuple[dict[str, ChosenColumn], tuple[str, ...]]:
    """Return the columns with time, temperature and what else a campaign knows, and notes on rivals of these."""
    left: list[str] = []
    for target, places in _others(roles, columns).items():
        best = _best(topic, roles, target, places)
        others = ", ".join(f"'{topic.names[place]}'" for place in places if place != best[0])
        if target == TEMPERATURE and len(best) > 1:
            left.append(f"{len(best)} columns may be {target}, none is read: state one with --column {target}=NAME")
            continue
        if others and target in (TIME, TEMPERATURE):
            left.append(f"{others} may be {target} as well: '{topic.names[best[0]]}' is taken")
        columns = columns | {target: _column(best[0], roles)}
    return columns, tuple(left)


def _parted_time(table: ChosenTable, roles: Sequence[ColumnRole | None]) -> dict[str, ChosenColumn]:
    """Return a time in whole seconds with its fraction in a column beside it, as ROS writes `secs` and `nsecs`."""
    times = {place: role for place, role in enumerate(roles) if role is not None and role.target == TIME}
    for place, role in times.items():
        beside = times.get(place + 1)
        if role.unit == "s" and beside and beside.unit in ("ms", "us", "ns") and beside.group == role.group:
            factor = TIME_UNITS[beside.unit]
            if parted_seconds(first_rows(table.recording, table.topic, [place, place + 1]) * [1.0, factor]) == 0:
                return {TIME: ChosenColumn(place, "s", added=place + 1, factor=factor)}
    return {}


def _others(roles: Sequence[ColumnRole | None], columns: Mapping[str, ChosenColumn]) -> dict[str, list[int]]:
    """Return target → columns of what is no channel; a date and a time of day only if there is no other time."""
    found: dict[str, list[int]] = {}
    for place, role in enumerate(roles):
        if role is not None and role.target not in columns and role.target[:2] not in (*SIX, *UNKNOWN_AXES):
            found.setdefault(role.target, []).append(place)
    if TIME in columns or TIME in found:
        return {target: places for target, places in found.items() if target not in (DATE, CLOCK)}
    return found


def _best(topic: Topic, roles: Sequence[ColumnRole | None], target: str, places: Sequence[int]) -> Sequence[int]:
    """Return the columns of the very name; else those whose name says nothing more; else all."""
    exact = [place for place in places if topic.names[place] == target]
    plain = [place for place in places if (role := roles[place]) is not None and not role.group]
    return exact or plain or places


def values_of(table: ChosenTable) -> dict[str, np.ndarray]:
    """Return target → column of a table, in the units of the recording; shape (N,) each, kept on the disk."""
    used = (place for one in table.columns.values() for place in (one.position, one.added))
    places = list(dict.fromkeys(place for place in used if place is not None))
    read = dict(zip(places, read_columns(table.recording, table.topic, places).T, strict=True))

    def values(one: ChosenColumn) -> np.ndarray:
        plain = read[one.position] if one.added is None else read[one.position] + one.factor * read[one.added]
        return plain if one.sign > 0 else -plain

    return {name: values(one) for name, one in table.columns.items()}

"""Which topics and columns of the recordings are the channels: as stated, by name, or by what unnamed numbers say."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imubayes.campaign.convert.column_names import (
    ACCELEROMETERS,
    CLOCK,
    DATE,
    GYROS,
    SIX,
    TEMPERATURE,
    TIME,
    ColumnRole,
    quantity_of,
    role_of,
    words_of,
)
from imubayes.campaign.convert.options import ConvertOptions
from imubayes.campaign.convert.recording import Recording, Topic, described, read_columns
from imubayes.campaign.convert.unnamed_columns import infer_layout
from imubayes.foundations.errors import InputError, Issue, closest_first, input_error

TRIPLES = {"a": ACCELEROMETERS, "g": GYROS}


@dataclass(frozen=True)
class ChosenColumn:
    """A column that is read: its position from 0, its sign, and the unit that name or recording state."""

    position: int
    unit: str = ""
    sign: float = 1.0


@dataclass(frozen=True)
class ChosenTable:
    """A topic and the columns that are read of it.

    Attributes
    ----------
    columns : target → column; two for a date and a time of day.
    evidence : why columns without names were taken so; empty where names or options say it.
    left : columns that could have been read as well, and why they are not.
    faults : why the topic cannot serve.
    """

    recording: Recording
    topic: Topic
    columns: dict[str, ChosenColumn]
    evidence: str = ""
    left: tuple[str, ...] = ()
    faults: tuple[Issue, ...] = field(default=(), repr=False)

    @property
    def kinds(self) -> str:
        """Which kinds of channels it has: `a`, `g` or `ag`."""
        return "".join(kind for kind, names in TRIPLES.items() if any(name in self.columns for name in names))


def choose_tables(recordings: Sequence[Recording], options: ConvertOptions) -> tuple[ChosenTable, ...]:
    """Return the tables that hold the channels: one with all, one for accelerometers and one for gyros, or one a file.

    Raises
    ------
    InputError
        where no column is a channel, more than one choice is possible, or a stated column is missing; with what the
        recordings hold.
    """
    found = [(recording, topic) for recording in recordings for topic in recording.topics()]
    if options.topic:
        found = [(recording, topic) for recording, topic in found if topic.name in options.topic]
        lost = sorted(set(options.topic) - {topic.name for _, topic in found})
        if lost:
            names = [topic.name for recording in recordings for topic in recording.topics()]
            what = f"there is no topic '{lost[0]}'"
            raise input_error(what, "option topic", closest_first(lost[0], names), "name a topic that is there")
    alone = len(found) == 1
    tables = [_table(recording, topic, options, alone) for recording, topic in found]
    stated = [table for table in tables if _states(table, options)]
    if options.columns and not stated:
        raise InputError(tables[0].faults or _nothing(tables))
    usable = [table for table in (stated or tables) if table.kinds and not table.faults]
    if not usable:
        faults = [fault for table in tables for fault in table.faults]
        raise InputError(faults[:3] if faults and (alone or len(recordings) > 1) else _nothing(tables, faults))
    return _one_way(usable)


def _one_way(usable: Sequence[ChosenTable]) -> tuple[ChosenTable, ...]:
    """Return the tables of the only choice among those that have channels."""
    whole = [table for table in usable if table.kinds == "ag"]
    forces, rates = ([table for table in usable if table.kinds == kind] for kind in TRIPLES)
    if whole:
        candidates, several = whole, len(whole) > len({id(table.recording) for table in whole})
    else:
        several = any(len(part) > len({id(table.recording) for table in part}) for part in (forces, rates))
        several |= len(forces) > 1 and len(rates) > 1
        candidates = [*forces, *rates]
    if several:
        names = list(dict.fromkeys(table.topic.name for table in candidates))
        issue = Issue(
            f"{len(candidates)} topics hold channels",
            ", ".join(dict.fromkeys(str(table.recording.file) for table in candidates)),
            ", ".join(f"{name} ({'accelerometers' * ('a' in table.kinds)}{' and ' * (table.kinds == 'ag')}"
                      f"{'gyros' * ('g' in table.kinds)})" for name, table in zip(names, candidates, strict=False)),
            f"choose one, such as --topic {names[0]}",
        )  # fmt: skip
        raise InputError(issue)
    return tuple(candidates)


def _states(table: ChosenTable, options: ConvertOptions) -> bool:
    return any(target in table.columns for target in options.columns)


def _nothing(tables: Sequence[ChosenTable], faults: Sequence[Issue] = ()) -> Issue:
    """Return the issue that lists what the recordings hold."""
    listed = []
    for table in tables[:12]:
        names = [name or str(place) for place, name in enumerate(table.topic.names, 1)]
        listed.append(f"{described(table.topic)}: {', '.join(names[:16])}{', …' if len(names) > 16 else ''}")
    why = f"; {faults[0].what}" if faults else ""
    return Issue(
        f"no columns are named as those of accelerometers or gyros{why}",
        ", ".join(dict.fromkeys(str(table.recording.file) for table in tables)),
        "; ".join(listed),
        "state the columns: --topic TOPIC --column ax=NAME --column ay=NAME … (time_s, ax ay az, gx gy gz)",
    )


def _table(recording: Recording, topic: Topic, options: ConvertOptions, alone: bool) -> ChosenTable:
    """Return what a topic has, with what speaks against it."""
    table, faults = ChosenTable(recording, topic, {}), []
    stated: dict[str, ChosenColumn] = {}
    roles = [role_of(column.name, column.unit) for column in topic.columns]
    for target, source in options.columns.items():
        try:
            stated[target] = _stated(topic, target, source, roles)
        except InputError as error:
            faults += [issue for issue in error.issues if alone or len(options.columns) > len(stated)]
    if faults and (alone or stated):
        return replace(table, columns=stated, faults=tuple(faults))
    if faults:
        stated = {}
    if not topic.named:
        return _without_names(table, stated, options, alone)
    roles = [_resolved(role, topic, recording) for role in roles]
    try:
        columns = stated | _by_name(topic, roles, stated)
    except InputError as error:
        return replace(table, columns=stated, faults=error.issues)
    columns, left = _beside(topic, roles, columns)
    return replace(table, columns=columns, left=left)


def _stated(topic: Topic, target: str, source: str | int, roles: Sequence[ColumnRole | None]) -> ChosenColumn:
    word, sign = str(source), 1.0
    if word.startswith("-") and word not in topic.names:
        word, sign = word[1:], -1.0
    position = topic.position(word, target)
    role = roles[position]
    return ChosenColumn(position, role.unit if role else "", sign)


def _resolved(role: ColumnRole | None, topic: Topic, recording: Recording) -> ColumnRole | None:
    """Return the role of an axis with the quantity that the names of topic and file say."""
    if role is None or not role.target.startswith("?"):
        return role
    kind = hinted_kind(topic, recording)
    return replace(role, target=kind + role.target[1:]) if kind else role


def hinted_kind(topic: Topic, recording: Recording) -> str:
    """Return ``a`` or ``g`` where the name of the topic, or of the file, says what it holds."""
    for name in (topic.name, recording.file.name.partition(".")[0]):
        if kind := quantity_of(set(words_of(name)) - {"a", "g", "f", "w"}, ""):
            return kind
    return topic.name if topic.name in TRIPLES else ""


def _without_names(
    table: ChosenTable, stated: Mapping[str, ChosenColumn], options: ConvertOptions, alone: bool
) -> ChosenTable:
    topic, recording = table.topic, table.recording
    if any(name in stated for name in SIX):
        return replace(table, columns=dict(stated))
    width = len(topic.columns)
    names = topic.note if topic.misfit else f"the table has {width} columns and no names"
    state = "state the column of each channel, such as --column ax=NUMBER"
    if topic.misfit:
        return replace(table, faults=(Issue(names, topic.where, "as many names as data fields", state),))
    if not alone and topic.name and not hinted_kind(topic, recording):
        return table
    read = [place for place, column in enumerate(topic.columns) if column.unit != "text"]
    try:
        layout = infer_layout(read_columns(recording, topic, read), hinted_kind(topic, recording), topic.where, names)
    except InputError as error:
        return replace(table, faults=error.issues)
    units = {"a": "m/s", "g": "rad"} if layout.increments else {}
    columns = {
        target: ChosenColumn(read[place], units.get(target[0], "")) for target, place in layout.columns.items()
    } | dict(stated)
    if options.sample_rate_hz is not None and TIME not in stated:
        columns.pop(TIME, None)
    return replace(table, columns=columns, evidence=layout.evidence)


def _by_name(
    topic: Topic, roles: Sequence[ColumnRole | None], stated: Mapping[str, ChosenColumn]
) -> dict[str, ChosenColumn]:
    """Return the channels that names say, and their scatter: of each kind all three axes, of one sensor."""
    chosen: dict[str, ChosenColumn] = {}
    for names in TRIPLES.values():
        wanted = [name for name in names if name not in stated]
        groups: dict[tuple[str, ...], dict[str, list[int]]] = {}
        for place, role in enumerate(roles):
            if role is not None and role.target in wanted:
                groups.setdefault(role.group, {}).setdefault(role.target, []).append(place)
        if not wanted or not groups:
            continue
        own = _one_group(topic, groups, wanted, names)
        chosen |= {name: _column(own[name], roles) for name in wanted}
    scatter = {role.target: place for place, role in enumerate(roles) if role is not None and "_sd" in role.target}
    for target, place in scatter.items():
        kinds = [kind for kind in TRIPLES if f"{kind}{target[1]}" in chosen]
        name = f"{kinds[0]}{target[1:]}" if target.startswith("?") and len(kinds) == 1 else target
        if name[:2] in chosen:
            chosen[name] = _column(place, roles)
    return chosen


def _column(place: int, roles: Sequence[ColumnRole | None]) -> ChosenColumn:
    role = roles[place]
    return ChosenColumn(place, role.unit if role else "")


def _one_group(
    topic: Topic,
    groups: Mapping[tuple[str, ...], Mapping[str, Sequence[int]]],
    wanted: Sequence[str],
    names: Sequence[str],
) -> dict[str, int]:
    """Return the columns of the only sensor that has all axes."""
    whole = [own for own in groups.values() if len(own) == len(wanted)]
    exact = [own for own in whole if any(topic.columns[places[0]].name in names for places in own.values())]
    candidates = exact or whole
    if len(candidates) == 1:
        twice = [places for places in candidates[0].values() if len(places) > 1]
        if not twice:
            return {name: places[0] for name, places in candidates[0].items()}
        name = topic.columns[twice[0][0]].name
        what = (
            f"{len(twice[0])} columns are named '{name}'"
            if all(topic.columns[place].name == name for place in twice[0])
            else f"{len(twice[0])} columns may be {next(n for n, p in candidates[0].items() if p is twice[0])}"
        )
        allowed = ", ".join(f"{place + 1} '{topic.columns[place].name}'" for place in twice[0])
        remedy = f"state which: --column {wanted[0]}=NUMBER"
        raise input_error(what, topic.where, allowed, remedy)
    if candidates:
        sensors = [", ".join(topic.columns[p[0]].name for p in own.values()) for own in candidates]
        options = " ".join(f"--column {n}={topic.columns[candidates[0][n][0]].name!r}" for n in wanted)
        what = f"{len(candidates)} sets of columns may be {' '.join(wanted)}"
        raise input_error(what, topic.where, "; ".join(sensors), f"state which, such as {options}")
    found = max(groups.values(), key=len)
    missing = ", ".join(name for name in wanted if name not in found)
    raise input_error(
        f"the columns are named {closest_first('', [n for n in topic.names if n], most=12)}: there is no {missing}",
        topic.where,
        f"columns named {' '.join(SIX)} or alike, as many names as data fields",
        "state the column of each channel, such as --column ax=NAME or --column ax=NUMBER",
    )


def _beside(
    topic: Topic, roles: Sequence[ColumnRole | None], columns: dict[str, ChosenColumn]
) -> tuple[dict[str, ChosenColumn], tuple[str, ...]]:
    """Return the columns with time, temperature and what else a campaign knows, and notes on rivals of these."""
    left: list[str] = []
    by_target: dict[str, list[int]] = {}
    for place, role in enumerate(roles):
        if role is not None and role.target not in columns and role.target[:2] not in SIX and role.target[0] != "?":
            by_target.setdefault(role.target, []).append(place)
    if TIME in columns or TIME in by_target:
        by_target.pop(DATE, None)
        by_target.pop(CLOCK, None)
    for target, places in by_target.items():
        exact = [place for place in places if topic.columns[place].name == target]
        plain = [place for place in places if (role := roles[place]) is not None and not role.group]
        best = exact or plain or places
        others = [f"'{topic.columns[place].name}'" for place in places if place != best[0]]
        if target == TEMPERATURE and len(best) > 1:
            left.append(f"{len(best)} columns may be {target}, none is read: state one with --column {target}=NAME")
            continue
        if others and target in (TIME, TEMPERATURE):
            left.append(f"{', '.join(others)} may be {target} as well: '{topic.columns[best[0]].name}' is taken")
        columns = columns | {target: _column(best[0], roles)}
    return columns, tuple(left)


def values_of(table: ChosenTable) -> dict[str, np.ndarray]:
    """Return target → column of a table, in the units of the recording; shape (N,) each, kept on the disk."""
    targets = list(table.columns)
    read = read_columns(table.recording, table.topic, [table.columns[name].position for name in targets])
    signs = {name: table.columns[name].sign for name in targets}
    return {name: read[:, place] if signs[name] > 0 else -read[:, place] for place, name in enumerate(targets)}

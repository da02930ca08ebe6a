"""Which topics of the recordings hold the channels: as stated, by what they hold, or refused with a choice."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NoReturn

import numpy as np

from imubayes.foundations.errors import InputError, Issue, closest_first, input_error
from imubayes_recordings.convert.column_choice import TRIPLES, ChosenTable, chosen_columns
from imubayes_recordings.convert.column_names import quantity_of, role_of, words_of
from imubayes_recordings.convert.gravity_file import with_gravity
from imubayes_recordings.convert.options import ConvertOptions
from imubayes_recordings.convert.recording import SourceRecording, Topic, described, read_columns
from imubayes_recordings.convert.unnamed_columns import READ, rest_means, unit_of_gravity

_HOLDS = {"ag": "accelerometers and gyros", "a": "accelerometers", "g": "gyros"}


def choose_tables(recordings: Sequence[SourceRecording], options: ConvertOptions) -> tuple[ChosenTable, ...]:
    """Return the tables that hold the channels: one with all, one for accelerometers and one for gyros, or one a file.

    Raises
    ------
    InputError
        if no column is a channel, more than one choice is possible, or a stated column is missing; with what the
        recordings hold.
    """
    found = _topics(with_gravity(recordings), options)
    alone = len(found) == 1
    tables = [chosen_columns(recording, topic, options, alone) for recording, topic in found]
    stated = [table for table in tables if set(options.columns) & set(table.columns)]
    if options.columns and not stated:
        raise InputError(tables[0].faults or _nothing(tables))
    usable = [table for table in (stated or tables) if table.usable] or _refuse(tables, alone)
    chosen = _one_way(usable, len(options.topic) > 1)
    _refuse_lost_kind(tables, chosen, options)
    read = {id(table.recording) for table in chosen}
    if idle := [table for table in tables if id(table.recording) not in read]:
        _refuse(idle, alone=True)  # a file of which nothing is read was not given for nothing
    return chosen


def _refuse_lost_kind(tables: Sequence[ChosenTable], chosen: Sequence[ChosenTable], options: ConvertOptions) -> None:
    """Raise InputError if a topic names the channels that no chosen table has, and cannot serve."""
    kinds = "".join(table.kinds for table in chosen)
    for table in () if options.topic or options.columns else tables:
        roles = [role_of(column.name, column.unit) for column in table.topic.columns if column.name]
        named = {kind for kind, names in TRIPLES.items() for role in roles if role and role.target in names}
        if table.faults and named - set(kinds):
            raise InputError(table.faults)


def _topics(recordings: Sequence[SourceRecording], options: ConvertOptions) -> list[tuple[SourceRecording, Topic]]:
    """Return the topics of all recordings, or those that are stated."""
    found = [(recording, topic) for recording in recordings for topic in recording.topics()]
    if not options.topic:
        return found
    names = [topic.name for _, topic in found]
    stated = dict(_stated_topic(word, names) for word in options.topic)
    return [(recording, replace(topic, kind=stated[topic.name])) for recording, topic in found if topic.name in stated]


def _stated_topic(word: str, names: Sequence[str]) -> tuple[str, str]:
    """Return the name of a stated topic, and the kind of its channels if that is stated: `acc=1`, `gyro=4`."""
    says, equals, name = word.partition("=")
    if word in names or not equals:
        says, name = "", word
    if name not in names:
        what = f"there is no topic '{name}'"
        raise input_error(what, "option topic", closest_first(name, names), "name one of these topics")
    kind = quantity_of(set(words_of(says)), "")
    if says and not kind:
        allowed = "acc=NAME, gyro=NAME, or NAME alone"
        raise input_error(
            f"'{says}' of '{word}' is not a kind of sensor", "option topic", allowed, "state the kind in this form"
        )
    return name, kind


def _refuse(tables: Sequence[ChosenTable], alone: bool) -> NoReturn:
    faults = [fault for table in tables for fault in table.faults]
    raise InputError(faults[:3] if faults and alone else _nothing(tables, faults))


def _one_way(usable: Sequence[ChosenTable], session: bool) -> tuple[ChosenTable, ...]:
    """Return the tables of the only choice among those that have channels.

    Parameters
    ----------
    session : whether several topics are stated: those that have the same kinds each are the runs of a session.
    """
    by_kind = {kinds: [table for table in usable if table.kinds == kinds] for kinds in _HOLDS}
    whole, apart = by_kind["ag"], [by_kind["a"], by_kind["g"]]
    candidates = whole or [*apart[0], *apart[1]]
    alike = len({table.kinds for table in usable}) == 1
    if not (session and alike) and _is_open(*by_kind.values()):
        listed = {table.topic.name or table.recording.file.name: _HOLDS[table.kinds] for table in candidates}
        first, *others = listed
        several = (
            f"; runs of one unit are stated together: --topic {first} --topic {others[0]}" if alike and others else ""
        )
        issue = Issue(
            f"{len(candidates)} topics hold channels",
            ", ".join(dict.fromkeys(str(table.recording.file) for table in candidates)),
            ", ".join(f"{name} ({kinds})" for name, kinds in listed.items()),
            f"choose one, such as --topic {first}{several}",
        )
        raise InputError(issue)
    return tuple(candidates)


def _is_open(*by_kind: Sequence[ChosenTable]) -> bool:
    """Return whether tables with both kinds, with accelerometers and with gyros are more than one record each or runs.

    One topic of accelerometers and one of gyros in each of several files are the parts of a record, or its runs.
    """
    whole, *apart = [[id(table.recording) for table in part] for part in by_kind]
    if any(len(own) > len(set(own)) for own in (whole, *apart)):
        return True
    return not whole and min(map(len, apart)) > 1 and set(apart[0]) != set(apart[1])


def _nothing(tables: Sequence[ChosenTable], faults: Sequence[Issue] = ()) -> Issue:
    """Return the issue that lists what the recordings hold."""
    if numbered := [table for table in tables if table.topic.numbered]:
        return _numbered_lines(numbered)
    listed = []
    for table in tables[:12]:
        names = [name or str(place) for place, name in enumerate(table.topic.names, 1)]
        listed.append(f"{described(table.topic)}: {', '.join(names[:16])}{', …' if len(names) > 16 else ''}")
    why = f"; {faults[0].what}" if faults else ""
    unnamed = [table.topic.name for table in tables if table.topic.name and not table.topic.named]
    kinds = f"; or the kind of a topic: --topic acc={unnamed[0]} or --topic gyro={unnamed[0]}" if unnamed else ""
    return Issue(
        f"no column has the name of an accelerometer or gyro{why}",
        ", ".join(dict.fromkeys(str(table.recording.file) for table in tables)),
        f"time_s, ax, ay, az, gx, gy, gz and similar names; found in {'; '.join(listed)}",
        f"state the columns: --topic TOPIC --column ax=NAME --column ay=NAME … (time_s, ax, ay, az, gx, gy, gz){kinds}",
    )


def _numbered_lines(tables: Sequence[ChosenTable]) -> Issue:
    """Return the issue on lines that a number distinguishes, with the one that is gravity at rest for the first."""
    seen = {table.topic.name: _size_at_rest(table) for table in tables}
    listed = [f"'{name}' ({size:.4g} at rest{f': g in {unit}' if unit else ''})" for name, (unit, size) in seen.items()]
    heavy = sorted(seen, key=lambda name: not seen[name][0])  # accelerometers first
    return Issue(
        f"the lines are of several kinds, which a number distinguishes: {', '.join(listed)}",
        tables[0].topic.where,
        "a word in each line, or an option, that states which lines are of accelerometers and which of gyros",
        f"state it: --topic acc={heavy[0]} --topic gyro={heavy[-1]}",
    )


def _size_at_rest(table: ChosenTable) -> tuple[str, float]:
    """Return the unit in which the three columns behind the time read g at rest, or none, and their size."""
    places = [place for place, column in enumerate(table.topic.columns) if column.unit != "text"][1:4]
    values = np.asarray(read_columns(table.recording, table.topic, places)[:READ])
    return unit_of_gravity(values, rest_means(values))

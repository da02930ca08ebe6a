"""Gyros whose names do not say so: three columns of one sensor that follow the turns of gravity.

`x_R;y_R;z_R` beside `x_A;y_A;z_A` may be rates, a magnetometer or anything else.  The accelerometers decide: between
two rests the angle between the directions of gravity is what gyros integrate to, in rad or deg.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes_recordings.convert.column_choice import ChosenTable
from imubayes_recordings.convert.column_names import ACCELEROMETERS, GYROS, TIME, axis_and_words, role_of
from imubayes_recordings.convert.recording import read_columns
from imubayes_recordings.convert.unit_evidence import per_radian, unit_of_turns


@dataclass(frozen=True)
class FoundRates:
    """Gyros that were found by their numbers: channel → values, (N,), their unit, and notes on what may be gyros."""

    columns: Mapping[str, np.ndarray]
    unit: str
    evidence: str
    notes: tuple[str, ...]


NONE_FOUND = FoundRates({}, "", "", ())


def find_rates(table: ChosenTable, columns: Mapping[str, np.ndarray], keep: np.ndarray) -> FoundRates:
    """Return the only three columns that follow the turns of gravity; a note on others that may be gyros.

    Parameters
    ----------
    table : with accelerometers, and without gyros.
    columns : target → values of the kept rows, with `time_s` in s.
    keep : which rows are kept, (N,).
    """
    candidates = _triples(table)
    if not candidates or not all(name in columns for name in (TIME, *ACCELEROMETERS)):
        return NONE_FOUND
    names, found = table.topic.names, []
    for places in candidates:
        read = read_columns(table.recording, table.topic, places)[keep]
        rates = dict(zip(GYROS, read.T, strict=True))
        own = {name: columns[name] for name in (*ACCELEROMETERS, TIME)} | rates
        size, _ = per_radian(own, table.topic.where)
        if unit := unit_of_turns(size):
            found.append((places, rates, unit, size))
    if len(found) == 1:
        places, rates, unit, size = found[0]
        listed = ", ".join(names[place] for place in places)
        evidence = f"{listed} follow the turns of gravity: {size:.4g} {unit.split('/')[0]} per radian"
        return FoundRates(rates, unit, evidence, ())
    listed = "; ".join(", ".join(names[place] for place in places) for places in candidates)
    first = " ".join(f"--column {name}={names[place]!r}" for name, place in zip(GYROS, candidates[0], strict=True))
    return FoundRates({}, "", "", (f"{listed} may be gyros, which no turns show: not read; if they are: {first}",))


def _triples(table: ChosenTable) -> list[Sequence[int]]:
    """Return the columns x, y and z of each sensor whose names say no quantity, and that are not read."""
    used = {place for one in table.columns.values() for place in (one.position, one.added)}
    sensors: dict[tuple[str, ...], dict[str, int]] = {}
    for place, column in enumerate(table.topic.columns):
        role = role_of(column.name, column.unit) if column.name else None
        axis, words = axis_and_words(column.name)
        if axis and place not in used and column.unit != "text" and (role is None or role.target.startswith("?")):
            sensors.setdefault(words, {})[axis] = place
    return [[own[axis] for axis in "xyz"] for own in sensors.values() if set(own) == set("xyz")]

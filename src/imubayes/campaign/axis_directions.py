"""Attitudes of a unit by the directions of two axes, as geographic positions state them.

The columns `i_axis` and `o_axis` give the directions of a gyro's input and output axes, E W N S U D.
"""

from collections.abc import Sequence

import numpy as np

from imubayes.campaign.run_tables import TableSource
from imubayes.foundations.campaign_data import Channel
from imubayes.foundations.errors import Issue, refuse

DIRECTIONS = {
    "E": (1.0, 0.0, 0.0),
    "W": (-1.0, 0.0, 0.0),
    "N": (0.0, 1.0, 0.0),
    "S": (0.0, -1.0, 0.0),
    "U": (0.0, 0.0, 1.0),
    "D": (0.0, 0.0, -1.0),
}
"""Letter → unit vector in the local level (East, North, Up)."""

DIRECTION_COLUMNS = ("i_axis", "o_axis")


def attitudes(source: TableSource, rows: Sequence[int], channels: Sequence[Channel]) -> np.ndarray:
    """Return the rotation from body to local level at the given rows of a table, shape (len(rows), 3, 3).

    The axes are those of the campaign's first gyro, or of its first channel if it has none.

    Raises
    ------
    InputError
        for a letter that is not a direction, or parallel input and output axes.
    """
    letters = {name: [text for batch in source for text in batch.texts[name]] for name in DIRECTION_COLUMNS}
    found, issues = [], []
    for row in rows:
        pair = [letters[name][row] or "" for name in DIRECTION_COLUMNS]
        issues += _judge(pair, source.place(row))
        if not issues:
            found.append(attitude_of(pair, channels))
    refuse(issues)
    return np.array(found).reshape(-1, 3, 3)


def attitude_of(pair: Sequence[str], channels: Sequence[Channel]) -> np.ndarray:
    """Return the rotation from body to local level with input and output axis in two directions, shape (3, 3)."""
    reference = next((channel for channel in channels if channel.kind == "gyro"), channels[0])
    i, o = (np.array(DIRECTIONS[letter]) for letter in pair)
    return np.stack([i, o, np.cross(i, o)], axis=1) @ reference.axes


def perpendicular(pair: Sequence[str]) -> bool:
    """Return whether two letters are perpendicular directions."""
    first, second = (np.array(DIRECTIONS.get(letter, (np.nan,) * 3)) for letter in pair)
    return bool(abs(first @ second) < 0.5)


def _judge(pair: Sequence[str], where: str) -> list[Issue]:
    unknown = [
        Issue(
            f"'{letter}' is not a direction",
            f"{where}, column '{name}'",
            ", ".join(DIRECTIONS),
            "give the direction of the axis as one letter: East, West, North, South, Up or Down",
        )
        for name, letter in zip(DIRECTION_COLUMNS, pair, strict=True)
        if letter not in DIRECTIONS
    ]
    if unknown or perpendicular(pair):
        return unknown
    return [
        Issue(
            f"the output axis points {pair[1]} and the input axis {pair[0]}: they are parallel",
            f"{where}, columns 'i_axis' and 'o_axis'",
            "two perpendicular directions",
            "correct the letters of this row",
        )
    ]

"""The angle of a table by an encoder, read as often as the sensors: its rate, and whether motion is used as well."""

from collections.abc import Mapping

import numpy as np

from imubayes_recordings.convert.column_names import TABLE_ANGLE, TABLE_RATE, TIME

_SENSOR_HZ = 20.0  # least rate of readings that show how a rate changes
_MOVING, _LEAST_DEGREES = 0.2, 5.0  # share of the samples in which a table moves that is no dividing head; range
_MOVES = 1.0  # deg/s
_REPEATED = 0.2  # share of the readings in motion that may repeat the one before


def with_encoder_rate(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return columns with the rate of the table in deg/s, if its angle in deg moves and no rate is recorded.

    Parameters
    ----------
    columns : target → values, shape (N,).
    """
    found = dict(columns)
    if TABLE_RATE not in found and (rate := _encoder_rate(columns)) is not None:
        found[TABLE_RATE] = rate
    return found


def is_followed(columns: Mapping[str, np.ndarray]) -> bool:
    """Tell whether the angle is read at the rate of the sensors while the table moves."""
    return _encoder_rate(columns) is not None


def _encoder_rate(columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Return the rate by central differences of the angle, deg/s, shape (N,); None if it does not move throughout."""
    if TABLE_ANGLE not in columns or TIME not in columns or len(columns[TIME]) < 3:
        return None
    time, angle = columns[TIME], columns[TABLE_ANGLE]
    if not (np.isfinite(time).all() and np.isfinite(angle).all() and np.all(np.diff(time) > 0)):
        return None
    unwrapped = np.unwrap(angle, period=360.0)
    rate = np.gradient(unwrapped, time)
    moves = np.abs(rate) > _MOVES
    slow = np.median(np.diff(time)) > 1 / _SENSOR_HZ or moves.mean() < _MOVING or np.ptp(unwrapped) < _LEAST_DEGREES
    repeated = np.mean(np.diff(unwrapped)[moves[1:]] == 0) if moves[1:].any() else 1.0
    return None if slow or repeated > _REPEATED else rate

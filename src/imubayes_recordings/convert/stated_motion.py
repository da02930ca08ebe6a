"""Output of gyros for one radian, by a stated motion: turns through a known angle, or the rate of a table.

The rate of a table determines the nominal scale of gyros in counts as well.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from imubayes.foundations.errors import InputError
from imubayes_recordings.convert.column_names import GYROS, TABLE_RATE, TIME
from imubayes_recordings.convert.options import ConvertOptions
from imubayes_recordings.convert.stated_turns import counts_of_turns

_LEAST_RATE = 1.0  # deg/s, standard deviation of the rate of a table that turns
_AT_REST, _LEAST_ROWS = 1e-3, 50  # of the largest rate; rows at rest that give an offset


def per_radian_of_stated_motion(
    columns: Mapping[str, np.ndarray], options: ConvertOptions, where: str
) -> tuple[float, str]:
    """Return what the gyros read for one radian, and how it was found; 0 and nothing without a stated motion.

    Parameters
    ----------
    columns : target → values, shape (N,); `time_s` in s, the rate of the table in deg/s.
    where : for errors.
    """
    names = [name for name in GYROS if name in columns]
    if options.turn_deg is not None and TIME in columns:
        try:
            size = float(np.median(counts_of_turns(columns, names, math.radians(options.turn_deg), where)[0]))
        except InputError:  # which the turns themselves raise if they are read
            return 0.0, ""
        return size, f"turns of {options.turn_deg:g} deg integrate to {size:.4g} per radian"
    size = per_radian_of_table(columns, names)
    return size, f"the gyros read {size:.4g} for 1 rad/s of the table, its rate in deg/s" if size else ""


def counts_of_table(columns: Mapping[str, np.ndarray], names: Sequence[str]) -> tuple[float, np.ndarray] | None:
    """Return counts per rad/s of gyros, and counts at rest, (G,), by the rate of the table; None if it gives none.

    Parameters
    ----------
    columns : target → values, shape (N,); the rate of the table in deg/s.
    names : of the gyros.
    """
    if not (size := per_radian_of_table(columns, names)):
        return None
    table, counts = columns[TABLE_RATE], np.stack([columns[name] for name in names], axis=1)
    rest = np.abs(table) < _AT_REST * np.nanmax(np.abs(table))
    if rest.sum() >= _LEAST_ROWS:
        return size, np.nanmedian(counts[rest], axis=0)
    used = np.isfinite(table) & np.isfinite(counts).all(axis=1)
    design = np.stack([np.ones(used.sum()), table[used]], axis=1)
    return size, np.linalg.lstsq(design, counts[used], rcond=None)[0][0]


def per_radian_of_table(columns: Mapping[str, np.ndarray], names: Sequence[str]) -> float:
    """Return what the gyros read for 1 rad/s of the table: by their scatter, which no clock changes.

    Three gyros read the whole rate, and one is along the axis.  Two may lie across it and read a hundredth: no answer.
    """
    if TABLE_RATE not in columns or len(names) not in (1, 3):
        return 0.0
    values = np.stack([columns[name] for name in (TABLE_RATE, *names)], axis=1)
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < 2:
        return 0.0
    table, *gyros = np.std(values, axis=0).tolist()
    return math.hypot(*gyros) / math.radians(table) if table > _LEAST_RATE else 0.0

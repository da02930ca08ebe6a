"""Turns of a unit by hand through an angle that is known, such as 360 deg from a mark back to the mark.

Without accelerometers, or about the vertical, nothing else determines how far a unit was turned.  A turn from rest to
rest is a row of a rate table whose axis is that of the turn: its mean rate is the stated angle over its length,
whatever the rate was in between, and what the hand adds is the uncertainty of the angle.  The rests between are rows at
rest.  Which axis it is, which sense and how often the angle, the gyros themselves say at their nominal scale.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import true_stretches
from imubayes_recordings.convert.column_names import GYROS, SAMPLES, TABLE_RATE, TEMPERATURE, TIME

TURN_TABLE = "turns"
# Body axes in the frame of a table that turns about body x, y or z.
BODY_TO_TABLE = (
    [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
    [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
)
_BLOCK, _REST = 0.1, 0.5  # s: blocks that rest or move, and the shortest rest between turns
_ALLOWED = f"turns about an input axis through a multiple of --turn-deg, at rest for {_REST:g} s before and after"
_STILL = np.radians(1.0)  # rad/s about the rest
_OFF_AXIS, _OFF_ANGLE = 0.2, 0.15  # of the turn about other axes, and of the stated angle
_ROUNDS = 5
_BY_HAND = 3.0  # rad/s, roughly the fastest of a turn by hand


@dataclass(frozen=True)
class StatedTurns:
    """The turns of a recording through a stated angle.

    Attributes
    ----------
    rows : axis, 0 to 2 → column of the run table → (R,), rests and turns in order of time.
    turning : shape (N,), samples of the recording that belong to these turns.
    notes : turns that were left out, and why.
    """

    rows: dict[int, dict[str, np.ndarray]]
    turning: np.ndarray
    notes: tuple[str, ...]


def find_stated_turns(
    columns: Mapping[str, np.ndarray], rate: np.ndarray, names: Sequence[str], angle: float, where: str
) -> StatedTurns:
    """Return the turns through a multiple of an angle about one input axis, from rest to rest.

    Parameters
    ----------
    columns : target → shape (N,), with `time_s`, s, in the units of the recording.
    rate : shape (N, G), of the gyros `names` at their nominal scale, rad/s; the recording begins at rest.
    angle : rad.

    Raises
    ------
    InputError
        if no turn is one through a multiple of the angle.
    """
    time, interval = columns[TIME], float(np.median(np.diff(columns[TIME])))
    moving, rest = _moving(rate, max(1, round(_BLOCK / interval)))
    edges = true_stretches(moving)
    turns: list[tuple[int, int, int, int]] = []
    notes, seen = [], []
    for first, last in edges:
        turned = np.sum(rate[first:last] - rest, axis=0) * interval
        axis = int(np.argmax(np.abs(turned)))
        count = round(float(turned[axis]) / angle)
        seen.append(f"{np.degrees(turned[axis]):.4g} deg about {names[axis]} at {time[first]:.4g} s")
        others = np.linalg.norm(np.delete(turned, axis))
        if first == 0 or last == len(rate) or not count or abs(turned[axis] / angle - count) > _OFF_ANGLE:
            notes.append(
                f"turn left out: {seen[-1]} is not a multiple of {np.degrees(angle):.4g} deg from rest to rest"
            )
        elif others > _OFF_AXIS * abs(turned[axis]):
            notes.append(f"turn left out: {seen[-1]}, and {np.degrees(others):.3g} deg about the other axes")
        else:
            turns.append((int(first), int(last), axis, count))
    if not turns:
        raise input_error(
            f"no turn is one through {np.degrees(angle):.4g} deg: {', '.join(seen[:6]) or 'the unit never turns'}",
            where, _ALLOWED,
            "correct --turn-deg, the unit or scale of the gyros, or the sampling rate",
        )  # fmt: skip
    inside = np.zeros(len(rate), dtype=bool)
    for first, last, *_ in turns:
        inside[first:last] = True
    return StatedTurns(_rows(columns, edges, turns, angle, interval), inside, tuple(notes))


def counts_of_turns(
    columns: Mapping[str, np.ndarray], names: Sequence[str], angle: float, where: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return counts per rad/s and counts at rest of gyros, (G,) each, from turns through multiples of an angle.

    An axis without turns of its own has the scale of the others, as the axes of one sensor nearly do.

    Parameters
    ----------
    columns : target → shape (N,), with `time_s`, s, and the gyros in counts; the recording begins at rest.
    names : of the gyros.
    angle : rad.

    Raises
    ------
    InputError
        if the unit never turns about one axis alone.
    """
    counts = np.stack([columns[name] for name in names], axis=1)
    interval = float(np.median(np.diff(columns[TIME])))
    rough = float(np.quantile(np.abs(counts - np.median(counts, axis=0)), 0.999)) / _BY_HAND or 1.0
    moving, rest = _moving(counts / rough, max(1, round(_BLOCK / interval)))
    edges = true_stretches(_inside(moving))
    turned = np.array([np.sum(counts[first:last] - rest * rough, axis=0) * interval for first, last in edges])
    turned = np.abs(turned).reshape(-1, len(names))
    alone = turned[np.sum(turned > _OFF_AXIS * turned.max(axis=1, keepdims=True), axis=1) == 1]
    if not len(alone):
        raise input_error("no turn about one axis was found", where, _ALLOWED, "state --gyro-scale and --gyro-offset")
    single = _common_part(alone.max(axis=1))
    axis, multiple = alone.argmax(axis=1), alone.max(axis=1) / single
    whole = (np.abs(multiple - np.round(multiple)) < _OFF_ANGLE) & (np.round(multiple) > 0)
    per_turn = np.full(len(names), np.nan)
    for place in np.unique(axis[whole]).tolist():
        own = whole & (axis == place)
        per_turn[place] = np.median(alone[own].max(axis=1) / np.round(multiple[own]))
    return np.where(np.isnan(per_turn), np.nanmean(per_turn), per_turn) / angle, rest * rough


def _inside(moving: np.ndarray) -> np.ndarray:
    """Return which samples move, (N,), without a motion that the recording begins or ends with."""
    inside = moving.copy()
    still = np.flatnonzero(~moving)
    if len(still):
        inside[: still[0]] = inside[still[-1] :] = False
    return inside


def _common_part(sizes: np.ndarray) -> float:
    """Return the largest size of which most of some sizes, (n,), are whole multiples."""
    ratio = sizes[:, None] / sizes
    fits = np.sum((np.abs(ratio - np.round(ratio)) < _OFF_ANGLE) & (np.round(ratio) > 0), axis=0)
    return float(sizes[fits == fits.max()].max())


def _moving(rate: np.ndarray, block: int) -> tuple[np.ndarray, np.ndarray]:
    """Return which samples move, (N,), with a block of rest at both ends of each motion, and the rate at rest, (G,)."""
    count = len(rate) // block
    means = rate[: count * block].reshape(count, block, -1).mean(axis=1)
    first = max(2, round(1.0 / _BLOCK))
    rest = np.median(means[:first], axis=0)
    # Only the beginning is known to be at rest: between turns a unit may rest for less time than it moves.
    moves = np.arange(count) >= first
    for _ in range(_ROUNDS):
        away = np.linalg.norm(means - rest, axis=1)
        noise = 1.4826 * float(np.median(away[~moves])) if (~moves).any() else 0.0
        moves = away > max(_STILL, 6 * noise)
        rest = np.median(means[~moves], axis=0) if (~moves).any() else rest
    motions = true_stretches(moves)
    for stop, start in zip(motions[:-1, 1], motions[1:, 0], strict=True):
        if (start - stop) * _BLOCK < _REST:
            moves[stop:start] = True
    wide = moves | np.roll(moves, 1) | np.roll(moves, -1)
    wide[[0, -1]] = moves[[0, -1]]
    found = np.concatenate([np.repeat(wide, block), np.full(len(rate) - count * block, bool(wide[-1]))])
    return found, rest


def _rows(
    columns: Mapping[str, np.ndarray],
    edges: np.ndarray,
    turns: Sequence[tuple[int, int, int, int]],
    angle: float,
    interval: float,
) -> dict[int, dict[str, np.ndarray]]:
    """Return the rows of each axis: its turns, the rest before each, and the last rest."""
    starts = np.concatenate([[0], edges[:, 1]])
    stops = np.concatenate([edges[:, 0], [len(columns[TIME])]])
    place = {int(first): n for n, first in enumerate(edges[:, 0])}
    spans: dict[int, list[tuple[int, int, float]]] = {}
    for first, last, axis, count in turns:
        own = spans.setdefault(axis, [])
        own.append((int(starts[place[first]]), first, 0.0))
        own.append((first, last, np.degrees(angle) * count / ((last - first) * interval)))
    _, last, axis, _ = turns[-1]
    final = place[turns[-1][0]] + 1
    spans[axis].append((last, int(stops[final]), 0.0))
    return {axis: _reduced(columns, [span for span in own if span[1] > span[0]]) for axis, own in spans.items()}


def _reduced(columns: Mapping[str, np.ndarray], spans: Sequence[tuple[int, int, float]]) -> dict[str, np.ndarray]:
    means = {
        name: np.array([np.nanmean(columns[name][first:last]) for first, last, _ in spans])
        for name in (TIME, *GYROS, TEMPERATURE)
        if name in columns
    }
    # The scatter of the readings is noise at rest alone.
    scatter = {
        f"{name}_sd": np.array(
            [np.nan if rate else np.nanstd(columns[name][first:last]) for first, last, rate in spans]
        )
        for name in GYROS
        if name in columns
    }
    rates = np.array([rate for *_, rate in spans])
    counts = np.array([float(last - first) for first, last, _ in spans])
    return {TIME: means.pop(TIME), TABLE_RATE: rates, SAMPLES: counts, **means, **scatter}

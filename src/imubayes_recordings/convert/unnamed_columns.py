"""Columns without names: what their numbers say, and what they do not.

A time increases.  Three accelerometers at rest read |f| = g in one of the usual units, three gyros little.  Only if
one reading of the columns fits is it taken, and it is said with its evidence; anything else is refused with what each
column looks like.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.foundations.errors import InputError, Issue
from imubayes_recordings.convert.column_names import ACCELEROMETERS, GYROS, TIME

GRAVITY = {"m/s^2": 9.81, "g": 1.0, "mg": 1000.0}
"""|f| at rest in the usual units."""
_NEAR_GRAVITY = 0.12  # largest bias and scale factor error together, relative to g
_WINDOW = 50  # samples, of which the mean is at rest where their scatter is small
_QUIET = 0.3  # share of the windows that rest, at least
_STILL = 10.0  # deg/s is more than the bias of a gyro; in rad/s it is any rate by hand
_ONE_DIRECTION = 0.9  # of the mean of unit vectors; 1 if all are the same
_LEADING = 3  # columns among which whole seconds are sought
_TORN = 1e-3  # share of the rows that may be late
READ = 400_000  # samples that are looked at


@dataclass(frozen=True)
class GuessedColumns:
    """Columns without names, and why they were taken so.

    Attributes
    ----------
    columns : target → position of the column, from 0.
    increments : whether the readings are integrals over a sample.
    fraction : position of the fractions of a second that are added to the whole seconds; None if there are none.
    """

    columns: dict[str, int]
    evidence: str
    increments: bool = False
    fraction: int | None = None


def rest_means(values: np.ndarray) -> np.ndarray:
    """Return means of windows at rest, shape (windows, columns); the rows themselves if there are few.

    Parameters
    ----------
    values : shape (N, columns), any units; NaN where empty.
    """
    values = values[:READ]
    values = values[np.isfinite(values).all(axis=1)]
    count = len(values) // _WINDOW
    if count < 4:
        return values
    parts = values[: count * _WINDOW].reshape(count, _WINDOW, -1)
    size = np.std(values, axis=0) + 1e-300
    scatter = np.sqrt(np.mean((parts.std(axis=1) / size) ** 2, axis=1))
    return parts.mean(axis=1)[scatter <= np.quantile(scatter, _QUIET)]


def gravity_unit(rest: np.ndarray) -> tuple[str, float]:
    """Return the unit in which three columns read |f| = g at rest, or none, and the median |f|; rest is (n, 3)."""
    norm = np.linalg.norm(rest, axis=1)
    size = float(np.median(norm)) if len(norm) else 0.0
    near = [unit for unit, gravity in GRAVITY.items() if abs(size / gravity - 1) < _NEAR_GRAVITY]
    steady = len(norm) and float(np.quantile(np.abs(norm - size), 0.8)) < _NEAR_GRAVITY * size
    return (near[0] if near and steady else ""), size


def unit_of_gravity(values: np.ndarray, rest: np.ndarray) -> tuple[str, float]:
    """Return the unit in which three columns read g: in each row, at rest, or as what turns on a drill or a wheel.

    The mean of a vector that turns is too short, and may be g in another unit: |f| of single rows goes first.  On a
    wheel the centripetal acceleration is constant in body axes, and gravity is the rest.

    Parameters
    ----------
    values, rest : all rows, and `rest_means` of them, shape (N, 3) and (n, 3).
    """
    rows = values[:READ][np.isfinite(values[:READ]).all(axis=1)]
    at_rest = gravity_unit(rest)
    for found in (gravity_unit(rows), at_rest, gravity_unit(rows - rows.mean(axis=0)) if len(rows) else at_rest):
        if found[0]:
            return found
    return at_rest


def is_clock(values: np.ndarray) -> bool:
    """Return whether a column never goes back by more than a reset, and mostly forward."""
    step = np.diff(values[np.isfinite(values)][:READ])
    return len(step) > 1 and float(np.mean(step > 0)) > 0.5 and float(np.mean(step < 0)) < 0.01


def parted_seconds(values: np.ndarray) -> int | None:
    """Return the column of whole seconds whose next one is their fraction, among the first; None if there is none.

    Logs of navigation receivers write week, second of the week, and fraction of the second.
    """
    values = values[: min(READ, len(values))]
    for place in range(min(_LEADING, values.shape[1] - 1)):
        whole, fraction = np.asarray(values[:, place]), np.asarray(values[:, place + 1])
        step, time = np.diff(whole), np.diff(whole + fraction)
        parted = (whole % 1 == 0).all() and (fraction >= 0).all() and (fraction < 1).all() and np.ptp(fraction) > 0
        if parted and (step >= 0).all() and (step > 0).any() and np.mean(time > 0) > 1 - _TORN:
            return place
    return None


def infer_layout(values: np.ndarray, kind: str, where: str, names: str, numbers: Sequence[int]) -> GuessedColumns:
    """Return which columns of a table without names are which.

    Parameters
    ----------
    values : all columns of numbers, shape (N, W).
    numbers : W, of these columns in the table, from 1, as messages and options name them.
    kind : ``a`` or ``g`` if the name of the file or topic says that it holds accelerometers or gyros.
    where : for the error.
    names : how the columns are headed, for the error.

    Raises
    ------
    InputError
        if no reading of the columns fits, or more than one.
    """
    width = values.shape[1]
    clock = next((place for place in (0, width - 1) if width > 3 and is_clock(np.asarray(values[:, place]))), None)
    seconds = None if clock is not None else parted_seconds(values)
    channels = [place for place in range(0 if seconds is None else seconds + 2, width) if place != clock]
    triples = [channels[k : k + 3] for k in range(0, len(channels) - 2, 3)]
    rest = rest_means(np.asarray(values[:READ]))
    heavy = [
        _Triple(places, numbers[places[0]], numbers[places[2]], *unit_of_gravity(values[:, places], rest[:, places]))
        for places in triples
    ]
    if len(channels) == 3:
        found = _of_three(heavy[0], kind)
    else:
        found = _of_several(values, rest, heavy) or _increments(values, rest, heavy, clock)
        found = found or _usual_order(values, channels, heavy)
    if found is None:
        raise _refusal(values, clock, heavy, where, names, numbers)
    return _with_time(found, clock, seconds)


def _with_time(found: GuessedColumns, clock: int | None, seconds: int | None) -> GuessedColumns:
    """Return a guess with its time: a column of it, whole seconds beside their fraction, or none."""
    if seconds is not None:
        return replace(found, columns={TIME: seconds} | found.columns, fraction=seconds + 1)
    return replace(found, columns=({} if clock is None else {TIME: clock}) | found.columns)


@dataclass(frozen=True)
class _Triple:
    """Three columns: their places, their first and last number in the table, and the unit in which |f| at rest is g.

    `unit` is empty if it is g in none; `size` is |f| at rest.
    """

    places: list[int]
    first: int
    last: int
    unit: str
    size: float

    @property
    def told(self) -> str:
        """Why they are accelerometers."""
        return f"columns {self.first} to {self.last} have |f| = {self.size:.4g} at rest: accelerometers in {self.unit}"


def _of_three(heavy: _Triple, kind: str) -> GuessedColumns | None:
    if heavy.unit and kind != "g":
        return GuessedColumns(_three(ACCELEROMETERS, heavy.places), heavy.told)
    names = {"a": ACCELEROMETERS, "g": GYROS}.get(kind)
    return None if names is None else GuessedColumns(_three(names, heavy.places), "by the name of the file")


def _of_several(values: np.ndarray, rest: np.ndarray, heavy: Sequence[_Triple]) -> GuessedColumns | None:
    """Return the only three columns that read g, and the gyros behind or before them."""
    fits = [place for place, each in enumerate(heavy) if each.unit]
    if len(fits) > 1:  # a bias of 1 deg/s has the size of 1 g, and one direction
        fits = [place for place in fits if _turns(rest[:, heavy[place].places])] or fits
    if len(fits) != 1 or len(heavy) < 2 or fits[0] > 1:
        return None
    forces = heavy[fits[0]]
    beside = [each.places for place, each in enumerate(heavy) if abs(place - fits[0]) == 1]
    found = [rates for rates in beside if _small(rest[:, rates], values[:, rates])]
    if len(found) != 1:  # a magnetometer before them reads little as well
        return None
    return GuessedColumns(_three(ACCELEROMETERS, forces.places) | _three(GYROS, found[0]), forces.told)


def _turns(rest: np.ndarray) -> bool:
    """Return whether the direction of three columns differs from rest to rest, (n, 3)."""
    unit = rest / np.maximum(np.linalg.norm(rest, axis=1, keepdims=True), 1e-300)
    return float(np.linalg.norm(unit.mean(axis=0))) < _ONE_DIRECTION


def _usual_order(values: np.ndarray, channels: list[int], heavy: Sequence[_Triple]) -> GuessedColumns | None:
    if len(channels) != 6 or any(each.unit for each in heavy) or not np.isfinite(values[0]).all():
        return None
    columns = _three(ACCELEROMETERS, channels[:3]) | _three(GYROS, channels[3:])
    return GuessedColumns(columns, "in the usual order, forces before rates: the numbers do not confirm it")


def _increments(
    values: np.ndarray, rest: np.ndarray, heavy: Sequence[_Triple], clock: int | None
) -> GuessedColumns | None:
    """Return the layout of PSINS: three angle increments, three velocity increments that are g times the step, time."""
    if clock is None or len(heavy) != 2 or (values[:1000, heavy[1].places] % 1 == 0).all():  # counts are none
        return None
    rates, forces = heavy
    step = float(np.median(np.diff(values[:READ, clock])))
    unit, size = gravity_unit(rest[:, forces.places] / step) if step > 0 else ("", 0.0)
    if unit != "m/s^2":
        return None
    columns = _three(GYROS, rates.places) | _three(ACCELEROMETERS, forces.places)
    evidence = (
        f"columns {forces.first} to {forces.last} over the step of the time are {size:.4g} at rest: "
        "increments in m/s, and those before them in rad (PSINS)"
    )
    return GuessedColumns(columns, evidence, True)


def _three(names: tuple[str, ...], triple: list[int]) -> dict[str, int]:
    return dict(zip(names, triple, strict=True))


def _small(rest: np.ndarray, values: np.ndarray) -> bool:
    """Return whether three columns are near zero at rest, as those of a gyro: in size, or beside other readings."""
    size = float(np.median(np.linalg.norm(rest, axis=1)))
    return size < _STILL and size < max(1.0, 0.5 * float(np.quantile(np.abs(values[:READ]), 0.999)))


def _refusal(
    values: np.ndarray, clock: int | None, heavy: Sequence[_Triple], where: str, names: str, numbers: Sequence[int]
) -> InputError:
    looks = [] if clock is None else [f"{numbers[clock]} increases like a time"]
    for each in heavy:
        means = f"like accelerometers in {each.unit}" if each.unit else "in no usual unit of g"
        looks.append(f"{each.first} to {each.last} have a magnitude of {each.size:.4g} at rest, {means}")
    known = {clock} | {place for each in heavy for place in each.places}
    looks += [
        f"{numbers[place]} begins with {values[0, place]:.5g}" for place in range(values.shape[1]) if place not in known
    ]
    fits = [each.first for each in heavy if each.unit]
    first = fits[0] if fits else numbers[1 if clock == 0 else 0]
    example = " ".join(f"--column {name}={place}" for place, name in enumerate((*ACCELEROMETERS, *GYROS), first))
    time = "" if clock is None else f" --column time_s={numbers[clock]}"
    issue = Issue(
        f"{names}, and the numbers do not show which are which",
        where,
        "by their numbers, columns " + "; ".join(looks),
        f"state the column of each channel, such as{time} {example}",
    )
    return InputError(issue)

"""Reduction of a free tumble that is given as means: one row for each pose, of unknown attitude, with |f| = g.

Without the motion between them the poses determine the accelerometers alone, and the biases of gyros that were read in
them.  A row may be one face of six, or one of a thousand attitudes.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from imubayes.campaign.reduction.free_tumble import ReducedTumble, one_axis_note, unturned, wrong_acceleration_unit
from imubayes.campaign.reduction.magnitude_calibration import LEAST_TO_JUDGE, MagnitudeFit, fit_magnitude
from imubayes.campaign.reduction.static_poses import body_vectors
from imubayes.foundations.campaign_data import Channel
from imubayes.foundations.errors import input_error
from imubayes.foundations.numerics import angle_between

LEAST_MEANS = 4
# About the median of the rows, which takes a bias out: far beyond Earth rate and what g-sensitivity leaves, rad/s.
_AT_REST = np.radians(5.0)
_LARGEST_BIAS = np.radians(30.0)
LEAST_APART = 10.0  # deg between some two poses


MOST_POSES = 150
"""Poses of a table that are fitted (effort): each brings two angles of its own.  The draws of a fit of 100 take half a
minute, of 200 more than three.  More are merged."""


def spread_over_the_sphere(direction: np.ndarray, most: int) -> np.ndarray:
    """Return the places of vectors, (n, 3), that fill the directions evenly, at most so many, in order.

    Directions are divided into cells about the points of a Fibonacci lattice, and one vector after the other is taken
    from each cell.
    """
    step = np.arange(most) + 0.5
    polar, azimuth = np.arccos(1 - 2 * step / most), np.pi * (1 + np.sqrt(5)) * step
    lattice = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
    cell = np.argmax(direction @ lattice.T, axis=1)
    order = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[order], cell[order])
    turn = np.empty(len(cell), dtype=int)
    turn[order] = np.arange(len(cell)) - first
    return np.sort(np.lexsort((np.arange(len(cell)), turn))[:most])


def reduce_means(
    numbers: Mapping[str, np.ndarray], channels: Sequence[Channel], gravity: float, file: str
) -> ReducedTumble:
    """Return the poses of a table of means.

    Parameters
    ----------
    numbers : column → shape (R,), in the units of the file, with `samples`, and `<channel>_sd` if recorded.
    channels : all channels of the campaign, with at least three accelerometers.
    gravity : local gravity, m/s².
    file : named in errors.

    Raises
    ------
    InputError
        if channels are missing, there are fewer than four poses, or all are of one attitude.
    """
    rows = len(numbers["samples"])
    unknown = np.full(rows, np.nan)
    readings = np.stack([numbers.get(channel.name, unknown) for channel in channels], axis=1)
    heavy = [index for index, channel in enumerate(channels) if channel.kind == "accelerometer"]
    complete = np.isfinite(readings[:, heavy]).all(axis=1)
    if complete.sum() < LEAST_MEANS:
        raise input_error(
            f"the table holds {int(complete.sum())} complete poses",
            file,
            f"{LEAST_MEANS} or more poses; 9 determine bias, scale factor and misalignment, 20 are recommended",
            "record more poses",
        )
    force, rate = body_vectors(np.where(np.isfinite(readings), readings, 0.0), channels, file)
    _refuse_turning(rate[np.isfinite(readings).all(axis=1)], file)
    refuse_one_attitude(force[complete], file)
    force, scatter = force[complete], _scatter(numbers, channels, heavy)[complete]
    fit = fit_magnitude(force, gravity, scatter)
    flagged = fit.outliers
    level, chosen, good = fit.apply(force), np.flatnonzero(~flagged), np.flatnonzero(~flagged)
    places = np.flatnonzero(complete)
    merged = len(good) > MOST_POSES
    if merged:
        chosen = good[spread_over_the_sphere(level[good], MOST_POSES)]
        tumble = unturned(np.arange(len(chosen)), level[chosen], np.zeros(len(chosen), dtype=bool), len(channels))
    else:
        tumble = unturned(chosen, level, flagged, len(channels))
    kept = {name: values[places[chosen]] for name, values in numbers.items()}
    used = f"merged by direction into {len(chosen)}" if merged else f"{len(chosen)} of them used"
    notes = [f"{rows} static poses given as means, {used}: each has |f| = g, its attitude is unknown"]
    notes += _calibration_notes(fit, places, force)
    return ReducedTumble(
        _merged(kept, {name: values[places] for name, values in numbers.items()}, channels, fit, force, chosen, good)
        if merged
        else kept,
        tumble,
        tuple(notes),
        tuple(wrong_acceleration_unit(force, gravity, file)),
    )


def _merged(
    kept: Mapping[str, np.ndarray],
    numbers: Mapping[str, np.ndarray],
    channels: Sequence[Channel],
    fit: MagnitudeFit,
    force: np.ndarray,
    chosen: np.ndarray,
    good: np.ndarray,
) -> dict[str, np.ndarray]:
    """Return the columns of some poses with the information of all poses of about the same direction.

    A pose of unknown attitude determines |f| alone.  Each chosen pose keeps its direction; its magnitude becomes the
    mean of the residuals |f| − g of its group, which the calibration by |f| = g leaves, and its samples are those of
    the group.

    Parameters
    ----------
    kept, numbers : columns of the chosen poses, and of all of `force`.
    force : shape (R, 3), m/s².
    chosen, good : places in `force` of the poses that are kept, and of all that are used, the chosen among them.
    """
    level = fit.apply(force)
    down = level / np.linalg.norm(level, axis=1, keepdims=True)
    group = np.argmax(down[good] @ down[chosen].T, axis=1)
    samples = numbers["samples"][good]
    total = np.bincount(group, samples, len(chosen))
    change = np.bincount(group, samples * fit.residual[good], len(chosen)) / total - fit.residual[chosen]
    moved = np.linalg.solve(fit.matrix, (down[chosen] * change[:, None]).T).T
    columns = dict(kept) | {"samples": total}
    for channel in channels:
        if channel.name in columns and channel.kind == "accelerometer":
            columns[channel.name] = kept[channel.name] + channel.scale_si * moved @ channel.axes[0]
        elif channel.name in columns:
            columns[channel.name] = np.bincount(group, samples * numbers[channel.name][good], len(chosen)) / total
    return columns


def _calibration_notes(fit: MagnitudeFit, rows: np.ndarray, force: np.ndarray) -> list[str]:
    """Return notes on the calibration by |f| = g of poses, the rows (n,) of a table, and on those that it excludes."""
    notes = [f"too few poses ({len(rows)}) to recognise a disturbed one by |f| = g: {LEAST_TO_JUDGE} are needed"]
    if fit.judges:
        notes = [f"calibration of {fit.parameters} parameters by |f| = g: scatter {fit.spread:.2g} m/s²"]
    return [
        *notes,
        *one_axis_note(force),
        *(
            f"row {row + 1} excluded as disturbed: |f| − g is {residual:.2g} m/s²"
            for row, residual in zip(rows[fit.outliers], fit.residual[fit.outliers], strict=True)
        ),
    ]


def _refuse_turning(rate: np.ndarray, file: str) -> None:
    """Raise InputError if rows, with rates (n, 3) in rad/s, are no poses at rest."""
    if not len(rate):
        return
    usual = np.median(rate, axis=0)
    about, size = float(np.linalg.norm(rate - usual, axis=1).max()), float(np.linalg.norm(usual))
    if about > _AT_REST or size > _LARGEST_BIAS:
        what = f"differ by up to {np.degrees(about):.3g}" if about > _AT_REST else f"are about {np.degrees(size):.3g}"
        raise input_error(
            f"the rates of the rows {what} deg/s: these are not static poses",
            file,
            f"means of poses at rest, or the raw log of a free tumble; rates within {np.degrees(_AT_REST):.3g} deg/s",
            "correct the procedure of the run, or give the raw log: the poses are found in it",
        )


def refuse_one_attitude(force: np.ndarray, file: str, rows: str = "poses") -> None:
    """Raise InputError if poses, with forces (n, 3), do not differ in attitude; `rows` is what they are called."""
    apart = float(np.rad2deg(angle_between(force, force[:1]).max()))
    if not apart > LEAST_APART:
        raise input_error(
            f"the {len(force)} {rows} are all of one attitude, within {apart:.2g} deg",
            file,
            "poses in different attitudes, each with |f| = g",
            "turn the unit from pose to pose, or correct the procedure of the run",
        )


def _scatter(numbers: Mapping[str, np.ndarray], channels: Sequence[Channel], heavy: Sequence[int]) -> np.ndarray:
    """Return the standard deviation of the mean |f| of each row as far as it was recorded, m/s², (R,)."""
    each = [
        np.nan_to_num(numbers.get(f"{channels[i].name}_sd", np.zeros(1))) / abs(channels[i].scale_si) for i in heavy
    ]
    return np.sqrt(np.mean([np.broadcast_to(sd, numbers["samples"].shape) ** 2 for sd in each], axis=0)) / np.sqrt(
        np.maximum(numbers["samples"], 1.0)
    )

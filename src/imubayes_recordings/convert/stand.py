"""The table and the mountings of a recording that stood on something, as far as its numbers determine them.

Nobody stated where north is, nor how level the bench is.  At rest, accelerometers determine which face is up.  On a
rate table, the gyros determine where the table axis is in body axes: each responds by the cosine of its angle to it, so
that a unit in a tilted fixture is read as such, and one that was seated anew for each recording has a mounting for
each.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imubayes.campaign.setup_gate.error_model import TABLE_UNSTATED
from imubayes.foundations.campaign_data import PRESETS
from imubayes.foundations.earth import towards
from imubayes.foundations.wording import counted
from imubayes_recordings.convert.column_names import ACCELEROMETERS, TABLE_RATE
from imubayes_recordings.convert.recorded_runs import RecordedRun, still_seconds
from imubayes_recordings.convert.stated_turns import BODY_TO_TABLE

PUT_ANYHOW: dict[str, Any] = {"azimuth_deg": "unknown", "elevation_deg": 90.0}
LEVEL = 60.0  # arcmin to which a bench is level, and a unit lies on it or in its seat, if nobody states it
_NOMINAL = (0.8, 1.25)  # of the table rate, what gyros of sound scale and unit measure in all
_DESIGN = np.cos(np.radians(3.0))  # of the angle to a direction that is taken for the design of a seat
_SAME = np.cos(np.radians(0.1))  # of the angle between two recordings in one seat; anew in it, a unit sits otherwise
_ATTITUDES = {90.0: "vertical", -90.0: "inverted", 0.0: "level"}  # of the table axis, by its elevation, deg
_UPRIGHT = 0.5  # share of g along the table axis from which on it is taken for vertical
_NOBODY = "the azimuth and the level of the {} are not stated: any azimuth, and a tilt of {:g} deg, are assumed"


@dataclass(frozen=True)
class Stand:
    """What recordings stood on.

    Attributes
    ----------
    table, mounting : entries of `campaign.toml`; empty if a procedure needs none.
    seats : for each recording, what its run says of them.
    notes : what is assumed.
    """

    table: list[dict[str, Any]]
    mounting: list[dict[str, Any]]
    seats: list[dict[str, str]]
    notes: list[str]


def lying(runs: Sequence[RecordedRun], *, seated: bool) -> Stand:
    """Return the stand of recordings by the face that is up: of each at rest, or of the longest on a table.

    Parameters
    ----------
    seated : whether there is a seat on a table; else the level of the bench is the uncertainty of the unit's own.
    """
    longest = max(runs, key=lambda run: len(next(iter(run.columns.values()))))
    axes = [_face_up(longest if seated else run) for run in runs]
    several = len({_face(axis) for axis in axes}) > 1
    names = [_face(axis).replace(" axis ", "-") if several else "aligned" for axis in axes]
    mountings = {
        name: _mounting(name, axis) | {"uncertainty_arcmin": LEVEL if seated else 0.0}
        for name, axis in zip(names, axes, strict=True)
    }
    notes = [_NOBODY.format("bench", LEVEL / 60)]
    if any(axis[2] != 1 for axis in axes):
        faces = ", ".join(dict.fromkeys(_face(axis) for axis in axes))
        notes.append(f"the unit rests with its {faces}, by its accelerometers")
    return Stand(
        [PUT_ANYHOW | {"name": "bench"}], list(mountings.values()), [_seat(name) for name in names], ["; ".join(notes)]
    )


def on_table(runs: Sequence[RecordedRun], rates: Sequence[np.ndarray]) -> Stand:
    """Return the stand of recordings on a rate table; each elevation of its axis is a table by itself.

    Parameters
    ----------
    rates : for each run, shape (N, G), of its gyros x, y, z at their nominal scale, deg/s.
    """
    axes: list[np.ndarray] = []
    mountings: list[dict[str, Any]] = []
    seats: list[str] = []
    elevations: list[float | None] = []
    notes = [_NOBODY.format("table", math.degrees(TABLE_UNSTATED))]
    for run, rate in zip(runs, rates, strict=True):
        found = _table_axis(run, rate)
        axis = np.array([0.0, 0.0, 1.0]) if found is None else found
        place = next((place for place, other in enumerate(axes) if axis @ other > _SAME), len(axes))
        if place == len(axes):
            axes.append(axis)
            name = "aligned" if found is None else f"mounting-{place + 1}"
            mountings.append(_mounting(name, axis) | {"uncertainty_arcmin": LEVEL})
            if found is not None:
                direction = ", ".join(f"{each:.3f}" for each in axis)
                told = "by the nominal scale factors of the gyros; 1 deg is assumed for it"
                notes.append(f"{name}: the table axis is ({direction}) in body axes, {told}")
        seats.append(mountings[place]["name"])
        elevations.append(_upright(run, axis))
    tables, names = _tables(elevations)
    if len(tables) > 1:
        of = [
            f"{_ATTITUDES[each['elevation_deg']]} in {counted(names.count(each['name']), 'recording')}"
            for each in tables
        ]
        notes.append(f"the table axis is {' and '.join(of)}, by the accelerometers: a table for each elevation")
    return Stand(tables, mountings, [_seat(*each) for each in zip(seats, names, strict=True)], notes)


def _tables(found: Sequence[float | None]) -> tuple[list[dict[str, Any]], list[str]]:
    """Return one table for each elevation that was found, deg, and the name of the table of each recording."""
    usual = next((each for each in found if each is not None), 90.0)
    elevations = [usual if each is None else each for each in found]
    distinct, level = list(dict.fromkeys(elevations)), round(3600 * math.degrees(TABLE_UNSTATED), 3)
    names = {each: f"bench-{_ATTITUDES[each]}" if len(distinct) > 1 else "bench" for each in distinct}
    tables = [
        PUT_ANYHOW | {"elevation_deg": each, "axis_uncertainty_arcsec": level, "name": names[each]} for each in distinct
    ]
    return tables, [names[each] for each in elevations]


def _seat(mounting: str, table: str = "bench") -> dict[str, str]:
    return {"table": table, "mounting": mounting}


def _table_axis(run: RecordedRun, rate: np.ndarray) -> np.ndarray | None:
    """Return the direction of the table axis in body axes, (3,); None if the gyros do not determine it."""
    if TABLE_RATE not in run.columns or rate.shape[1] != 3:
        return None
    table = run.columns[TABLE_RATE]
    kept = np.isfinite(table) & np.isfinite(rate).all(axis=1)
    centred = table[kept] - table[kept].mean()
    if not centred.any():
        return None
    slope = centred @ rate[kept] / (centred @ centred)
    size = float(np.linalg.norm(slope))
    return slope / size if _NOMINAL[0] < size < _NOMINAL[1] else None


def _upright(run: RecordedRun, axis: np.ndarray) -> float | None:
    """Return the elevation of the table axis by the accelerometers, deg; None without them."""
    if not all(name in run.columns for name in ACCELEROMETERS):
        return None
    force = np.array([np.nanmean(run.columns[name]) for name in ACCELEROMETERS])
    size = np.nanmean(np.linalg.norm([run.columns[name] for name in ACCELEROMETERS], axis=0))
    along = float(force @ axis / size)
    return 90.0 if along > _UPRIGHT else -90.0 if along < -_UPRIGHT else 0.0


def _face_up(run: RecordedRun) -> np.ndarray:
    """Return the body axis nearest to the mean specific force, (3,); z up if it moves or is not known."""
    axis = np.array([0.0, 0.0, 1.0])
    if not all(name in run.columns for name in ACCELEROMETERS) or not still_seconds(run):
        return axis
    place, sense = _nearest_face(np.array([np.nanmedian(run.columns[name]) for name in ACCELEROMETERS]))
    return sense * np.eye(3)[place]


def _nearest_face(direction: np.ndarray) -> tuple[int, float]:
    """Return the body axis nearest to a direction, 0 to 2, and its sense."""
    place = int(np.argmax(np.abs(direction)))
    return place, float(np.sign(direction[place]))


def _face(axis: np.ndarray) -> str:
    place, sense = _nearest_face(axis)
    return f"{'xyz'[place]} axis {'up' if sense > 0 else 'down'}"


def _mounting(name: str, axis: np.ndarray) -> dict[str, Any]:
    """Return a mounting that has a body axis along table z; what it has along table x is of no account."""
    for preset, matrix in PRESETS.items():
        if axis @ matrix[2] > _DESIGN:
            return {"name": name, "preset": preset}
    place, sense = _nearest_face(axis)
    turned = np.diag([1.0, sense, sense]) @ np.array(BODY_TO_TABLE[place])
    if sense * axis[place] < _DESIGN:
        turned = towards((turned @ axis).tolist()).T @ turned
    return {"name": name, "body_to_table": turned.round(9).tolist()}

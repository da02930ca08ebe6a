"""Quantities that the runs determined or did not, and the run that would: tables of a fit, and sensor axes.

Axes stand in body axes and in each mounting, as designed and as fitted, with their uncertainty cones.
"""

from collections.abc import Mapping

import numpy as np

from imubayes.display.fit_quality_tables import combination_sheet, contribution_sheet, next_run_sheet, weak_sheet
from imubayes.display.quantity_tables import derived_sheet, parameter_sheet
from imubayes.foundations.campaign_data import Channel
from imubayes.foundations.quantity_names import INPUT_AXIS, name_of
from imubayes.foundations.records import Record
from imubayes.results.result import Result
from imubayes_explorer.messages import ShownTable, shown_table

_LEVEL = 2.448
"""Radius, in standard deviations, that holds 95 % of a normal distribution in two dimensions."""


class SensorAxis(Record):
    """A sensor axis in one frame, unit vectors.

    Attributes
    ----------
    nominal, fitted : as designed, and the mean of its posterior; both alike if nothing tilts it.
    along, across : half axes of the 95 % cone as vectors; radians.
    tilt, cone : angle between the two axes, and the larger half axis; arcsec.
    """

    channel: str
    nominal: tuple[float, float, float]
    fitted: tuple[float, float, float]
    along: tuple[float, float, float]
    across: tuple[float, float, float]
    tilt: float
    cone: float


class AxisFrame(Record):
    """A frame: the body, or a mounting with the three axes of its table; its `body` axes are columns in it."""

    name: str
    body: tuple[tuple[float, float, float], ...]
    axes: tuple[SensorAxis, ...]


class KnownTables(Record):
    """The tables of what is known, the names of the quantities that can be asked for, and the sensor axes."""

    tables: tuple[ShownTable, ...]
    quantities: tuple[str, ...]
    frames: tuple[AxisFrame, ...]


def known_tables(result: Result) -> KnownTables:
    """Return what the runs of a result determined, and what they did not."""
    summary = result.summary
    sheets = (
        weak_sheet(summary), next_run_sheet(summary), combination_sheet(summary), derived_sheet(summary),
        parameter_sheet(summary), contribution_sheet(summary),
    )  # fmt: skip
    shown, names = tuple(map(shown_table, sheets)), tuple(result.quantities)
    return KnownTables(tables=shown, quantities=names, frames=axis_frames(result))


def axis_frames(result: Result) -> tuple[AxisFrame, ...]:
    """Return the sensor axes of a result in body axes, then in each mounting that a run has."""
    campaign, draws = result.fit.model.campaign, result.draws
    size = max((len(each) for each in draws.values()), default=1)
    channels = [each for each in campaign.channels if each.kind != "angle"]
    drawn = {each.name: _drawn(each, draws, size) for each in channels}
    used = list(dict.fromkeys(run.mounting for run in campaign.runs if run.mounting is not None))
    frames = [("body", np.eye(3), np.zeros((size, 3)))]
    for name in used:
        turned = [draws.get(name_of(f"mounting_error.{axis}", name), np.zeros(size)) for axis in "xyz"]
        frames.append((name, campaign.mountings[name].body_to_table, np.radians(np.stack(turned, axis=1) / 3600)))
    return tuple(
        AxisFrame(
            name=name, body=tuple(map(_vector, turn.T)),
            axes=tuple(_axis(each, turn, drawn[each.name] + np.cross(errors, drawn[each.name])) for each in channels),
        )
        for name, turn, errors in frames
    )  # fmt: skip


def _drawn(channel: Channel, draws: Mapping[str, np.ndarray], size: int) -> np.ndarray:
    """Return the draws of an axis in body axes, (S, 3)."""
    found = [draws.get(name_of(INPUT_AXIS, channel.name, axis)) for axis in "xyz"]
    told = [each for each in found if each is not None]
    return np.stack(told, axis=1) if len(told) == 3 else np.tile(channel.axes[0], (size, 1))


def _axis(channel: Channel, turn: np.ndarray, drawn: np.ndarray) -> SensorAxis:
    nominal, drawn = turn @ channel.axes[0], drawn[np.isfinite(drawn).all(axis=1)] @ turn.T
    mean = drawn.mean(axis=0) / np.linalg.norm(drawn.mean(axis=0))
    sizes, ways = np.linalg.eigh(np.cov(drawn.T, bias=True))
    half = _LEVEL * np.sqrt(np.maximum(sizes, 0.0)) * ways
    arcsec = 3600 * np.degrees(1)
    tilt = float(arcsec * np.arctan2(np.linalg.norm(np.cross(nominal, mean)), nominal @ mean))
    return SensorAxis(
        channel=channel.name, nominal=_vector(nominal), fitted=_vector(mean), along=_vector(half[:, 2]),
        across=_vector(half[:, 1]), tilt=tilt, cone=float(arcsec * np.linalg.norm(half[:, 2])),
    )  # fmt: skip


def _vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z

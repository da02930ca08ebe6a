"""Temperatures of a thermometer that resolves whole degrees, or some tenths: interpolated between its steps.

Such a thermometer shows the temperature itself at one instant only: when its reading steps, the temperature is half-way
between the two readings.  Between these instants it is interpolated in time.  The readings themselves would be off by a
sawtooth that looks like a lag of the sensor behind its temperature.
"""

from dataclasses import dataclass

import numpy as np

from imubayes.campaign.reduction.log_survey import BlockSurvey
from imubayes.foundations.covariates import TEMPERATURE_COLUMNS

COARSE = 0.2  # °C; the rounding of a finer step, 0.06 °C rms, is below the error of thermometers
COARSEST = 1.0  # °C; set-points of a chamber, which are recorded in place of readings, are farther apart
_HALF = 0.5
_LEAST_LEVELS = 3
_HELD = 0.9
"""Share of blocks whose reading is that of the block before: noise that dithers a reading averages its steps."""
_ALIKE = 1e-6  # °C


@dataclass(frozen=True)
class CoarseTemperature:
    """The step of a thermometer, °C, and the temperature of each block between its steps, °C, shape (B,)."""

    step: float
    values: np.ndarray


def coarse_temperatures(blocks: BlockSurvey) -> dict[str, CoarseTemperature]:
    """Return column → what its steps show, of the thermometers of a log that are coarse."""
    if blocks.interval is None:
        return {}
    time = blocks.mean["time_s"]
    found = {name: _interpolated(time, blocks.mean[name]) for name in TEMPERATURE_COLUMNS if name in blocks.mean}
    return {name: each for name, each in found.items() if each is not None}


def _interpolated(time: np.ndarray, reading: np.ndarray) -> CoarseTemperature | None:
    """Return the temperature between the steps of a reading, (B,) each; None of a thermometer that is not coarse."""
    used = np.isfinite(reading) & np.isfinite(time)
    t, r = time[used], reading[used]
    held = np.abs(np.diff(r)) < _ALIKE
    levels = np.unique(np.round(r[1:][held], 6))
    if len(r) < 2 or held.mean() < _HELD or len(levels) < _LEAST_LEVELS:
        return None
    step = float(np.median(np.diff(levels)))
    if not COARSE <= step <= COARSEST:
        return None
    nodes = _nodes(t, r, levels)
    if len(nodes) < _LEAST_LEVELS - 1:
        return None
    values = _ends(time, np.interp(time, *np.array(nodes).T), reading, nodes)
    within = np.clip(values, reading - _HALF * step, reading + _HALF * step)  # which the reading says at least
    return CoarseTemperature(step, np.where(used, within, np.nan))


def _nodes(time: np.ndarray, reading: np.ndarray, levels: np.ndarray) -> list[tuple[float, float]]:
    """Return instants and temperatures that are known: half-way at each step, and the reading where it turns back.

    A reading that toggles passes half-way about the middle of its toggles, if it ends on the other side.
    """
    crossings = []
    for half in (levels[1:] + levels[:-1]) / 2:
        places = np.flatnonzero(np.diff(reading > half))
        crossings += [(0.5 * (time[place] + time[place + 1]), float(half)) for place in places]
    crossings.sort()
    nodes: list[tuple[float, float]] = []
    cluster: list[float] = []
    for (instant, half), (after, following) in zip(crossings, [*crossings[1:], (np.nan, np.nan)], strict=True):
        cluster.append(instant)
        if following == half:
            continue
        if len(cluster) % 2:
            nodes.append((0.5 * (cluster[0] + cluster[-1]), half))
        else:
            stay = (cluster[0], cluster[-1])
            if max(np.diff(cluster)) < _HALF * (stay[1] - stay[0]):  # toggles about half-way
                nodes.append((_HALF * sum(stay), half))
            else:
                inside = (time > stay[0]) & (time < stay[1])
                arrival = stay[0] - nodes[-1][0] if nodes else np.inf
                nodes += _there_and_back(stay, half, float(np.median(reading[inside])), (arrival, after - stay[1]))
        cluster = []
    return nodes


def _there_and_back(
    stay: tuple[float, float], half: float, reading: float, steps: tuple[float, float]
) -> list[tuple[float, float]]:
    """Return the nodes of a stay beyond half-way, from one instant to another: it goes on to the reading, and keeps it.

    Parameters
    ----------
    steps : times that the steps before and after took, s; NaN or infinite if there is none.
    """
    middle = _HALF * sum(stay)
    reached, left = (_HALF * np.nan_to_num(each, nan=np.inf, posinf=np.inf) for each in steps)
    return [
        (stay[0], half),
        (min(stay[0] + reached, middle), reading),
        (max(stay[1] - left, middle), reading),
        (stay[1], half),
    ]


def _ends(time: np.ndarray, values: np.ndarray, reading: np.ndarray, nodes: list[tuple[float, float]]) -> np.ndarray:
    """Return temperatures, (B,), that go on before the first node and behind the last, at most to the reading."""
    values = values.copy()
    for (at, value), (other, beside), outside in (
        (nodes[0], nodes[1], time < nodes[0][0]),
        (nodes[-1], nodes[-2], time > nodes[-1][0]),
    ):
        slope = (beside - value) / (other - at)
        low, high = np.fmin(reading[outside], value), np.fmax(reading[outside], value)
        values[outside] = np.clip(value + slope * (time[outside] - at), low, high)
    return values

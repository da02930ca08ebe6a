"""From what a plan says shall be done to the rows of a run table, before anything is read.

Each procedure takes its own few keys.  Rows follow each other in time: a turning row lasts for whole turns, so that
what depends on the angle averages out, and steady rows are separated by the time that it takes to move on.
"""

import math

import numpy as np

from imubayes.campaign.toml_documents import Ledger
from imubayes.simulation.test_plan import PlannedRun

_RAMP = ("converter_temperature_degC", "rows", "rate_degC_per_h")
ASKED: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "rate_table": (("rates_deg_s",), ("converter_temperature_degC",)),
    "dividing_head": (("positions", "angles_deg"), ("converter_temperature_degC",)),
    "thermal_ramp": (("converter_temperature_degC",), ("rows", "rate_degC_per_h")),
    "current_injection": (("current_mA",), _RAMP),
}
"""Procedure → keys of which it needs one, and further keys it takes."""

_STEPS = (
    "rates_deg_s",
    "positions",
    "angles_deg",
    "converter_temperature_degC",
    "rows",
    "rate_degC_per_h",
    "current_mA",
)
_SECONDS_PER_ROW = 60.0
# Time to the next rate or position, s.
_PAUSE = {"rate_table": 20.0, "dividing_head": 10.0}


def judge_steps(run: PlannedRun, place: int, ledger: Ledger) -> None:
    """Note what a run of a known procedure says too much or too little of what is done."""
    one_of, further = ASKED[run.procedure]
    given = [key for key in _STEPS if getattr(run, key) is not None]
    for key in given:
        if key not in one_of + further:
            ledger.add(
                f"'{key}' means nothing in a run of procedure '{run.procedure}'",
                ("run", place, key),
                ", ".join((*one_of, *further)),
                "remove the key, or correct 'procedure'",
            )
    asked = [key for key in one_of if key in given]
    if len(asked) != 1:
        ledger.add(
            f"run '{run.name}' of procedure '{run.procedure}' has "
            + (f"both {' and '.join(asked)}" if asked else f"no '{one_of[0]}'"),
            ("run", place, *asked[1:2]),
            ", or ".join(one_of),
            "say what is done in one way",
        )
    if "rows" in further:
        _judge_ramp(run, place, ledger)


def _judge_ramp(run: PlannedRun, place: int, ledger: Ledger) -> None:
    ramp = run.converter_temperature_degC
    rising = ramp is not None and ramp[0] != ramp[1]
    timed = run.rate_degC_per_h is not None and run.seconds_per_row is not None
    if run.rate_degC_per_h is not None and not rising:
        ledger.add(
            f"run '{run.name}' has a rate of temperature and no change of it",
            ("run", place, "rate_degC_per_h"),
            "converter_temperature_degC = [from, to] with two different values",
            "give both ends of the ramp, or leave 'rate_degC_per_h' out",
        )
    elif timed and run.rows is not None:
        ledger.add(
            f"run '{run.name}' says twice how long it lasts",
            ("run", place, "rows"),
            "two of rows, rate_degC_per_h and seconds_per_row",
            "leave one of the three out",
        )
    elif not timed and run.rows is None:
        ledger.add(
            f"run '{run.name}' does not say how many rows it has",
            ("run", place, "rows"),
            "rows = …, or both rate_degC_per_h and seconds_per_row",
            "add 'rows'",
        )


def columns_of(run: PlannedRun) -> dict[str, np.ndarray]:
    """Return the columns of a run but for the readings, in the units of the file; an angle is NaN over whole turns."""
    columns: dict[str, np.ndarray] = {}
    if run.rates_deg_s is not None:
        rate = np.array(run.rates_deg_s)
        columns["table_rate_deg_s"] = rate
        columns["table_angle_deg"] = np.where(rate == 0, 0.0, np.nan)
        duration = np.array([_whole_turns(one, run.seconds_per_row or _SECONDS_PER_ROW) for one in run.rates_deg_s])
    elif run.procedure == "dividing_head":
        angle = np.array(run.angles_deg or 360.0 * np.arange(run.positions or 0) / (run.positions or 1))
        columns["table_angle_deg"] = angle
        duration = np.full(len(angle), run.seconds_per_row or _SECONDS_PER_ROW)
    else:
        duration = _ramp_durations(run)
    return _timed(run, columns, duration)


def _timed(run: PlannedRun, columns: dict[str, np.ndarray], duration: np.ndarray) -> dict[str, np.ndarray]:
    end = np.cumsum(duration + _PAUSE.get(run.procedure, 0.0)) - _PAUSE.get(run.procedure, 0.0)
    centre = end - duration / 2
    columns = {"time_s": np.round(centre, 6)} | columns
    if run.converter_temperature_degC is not None:
        low, high = run.converter_temperature_degC
        columns["converter_temperature_degC"] = low + (high - low) * centre / end[-1]
    if run.current_mA is not None:
        columns["current_mA"] = np.full(len(centre), run.current_mA)
    return columns | {"samples": np.full(len(centre), float(run.samples))}


def _whole_turns(rate: float, seconds: float) -> float:
    """Return the shortest time of at least so many seconds that holds whole turns."""
    if rate == 0:
        return seconds
    turn = 360.0 / abs(rate)
    return turn * max(1, math.ceil(seconds / turn - 1e-9))


def _ramp_durations(run: PlannedRun) -> np.ndarray:
    seconds = run.seconds_per_row or _SECONDS_PER_ROW
    if run.rate_degC_per_h is None or run.converter_temperature_degC is None:
        return np.full(run.rows or 1, seconds)
    low, high = run.converter_temperature_degC
    whole = 3600.0 * abs(high - low) / run.rate_degC_per_h
    rows = run.rows or max(1, round(whole / seconds))
    return np.full(rows, whole / rows)

"""The times of runs, held against the clock and against what a laboratory does: units, origin, overlaps.

The runs of a unit do not overlap.  A sample is not taken for seconds, a table is not left in one position for hours
unless the unit soaks, and it does not go from one position to the next, or turn once, in less time than that takes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cached_property
from itertools import combinations

import numpy as np

from imubayes.campaign.stream_checks import Finding, Severity
from imubayes.foundations.campaign_data import Run
from imubayes.procedures import PROCEDURES, Reduction
from imubayes.procedures.ambient import instant

UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9, "minutes": 60.0, "hours": 3600.0}
"""Units of time in seconds."""
SLOW_STEP, SLOW_SAMPLE, SLOWEST_STEP = 1800.0, 5.0, 3 * 3600.0
"""Longest time of a row, of a sample in rows that long, and of any row, s, of a unit that does not soak."""
SLOW_STATIC_SAMPLE = 60.0  # s, of a record at rest
_AHEAD = timedelta(days=2)  # of the clock of this machine, and of any time zone
SOAK = 0.5  # °C from row to row, by which a unit that soaks changes
FAST_SAMPLE = 5e-5  # s
FAST_ROW = 2.0
"""Least time of a position of a table, and of a row in which it turns slowly, s."""
USUAL_STEP = 60.0  # s
LEAST_SAMPLES, LEAST_ROWS = 10, 4
OVERLAP, WRONG_OVERLAP = 60.0, 0.5
"""Overlap, s, to which the start of a run is taken to be known, and share of the shorter run that is no rounding."""
EPOCH = 1e8  # s; no run begins years after its start
_DAY = 86400.0


@dataclass(frozen=True)
class Timed:
    """A run with its times.

    Attributes
    ----------
    run, file : the run and its table.
    time : shape (R,), s.
    step : median time from row to row, s; NaN of few rows.
    """

    run: Run
    file: str
    time: np.ndarray
    step: float

    @property
    def samples(self) -> float:
        """Median number of samples of a row."""
        return float(np.median(self.run.samples))

    @property
    def stands(self) -> bool:
        """Whether nothing moves in the run, so that its rows may take any time."""
        return PROCEDURES[self.run.procedure].reduction is Reduction.BLOCKS

    def slow(self, unit: float = 1.0) -> bool:
        """Whether rows of the run, its times in a unit, take longer than in a laboratory."""
        step, sample = self.step * unit, self.step * unit / self.samples
        if self.stands:
            return sample > SLOW_STATIC_SAMPLE
        warm = self.run.covariates.get("temperature", np.zeros(1))
        soaks = len(warm) > 1 and float(np.median(np.abs(np.diff(warm)))) > SOAK
        return (step > SLOW_STEP and sample > SLOW_SAMPLE and not soaks) or (step > SLOWEST_STEP and not soaks)

    def too_fast(self, unit: float = 1.0) -> str:
        """Return what takes more time than the rows of the run, its times in a unit; empty if they have it."""
        step = self.step * unit
        if self.samples >= LEAST_SAMPLES and step / self.samples < FAST_SAMPLE:
            return f"{self.samples:g} samples"
        # Rows of a log that is used whole are as short as the table's motion between levels asks.
        whole = np.any(self.run.covariates.get("table_acceleration", np.zeros(1)) != 0)
        if self.stands or self.run.tumble is not None or whole or self.samples < LEAST_SAMPLES:
            return ""
        angle, rate = self.run.covariates["table_angle"], np.abs(self.run.covariates["table_rate"])
        blind = np.isnan(angle) & (rate > 0)
        if step < FAST_ROW and blind.any() and np.mean(rate[blind] * step < 2 * math.pi) > 0.5:
            return "a whole turn of the table"
        moved = np.abs(np.diff(angle[rate == 0]))
        return "a position of the table" if step < FAST_ROW and np.sum(moved > 0) >= LEAST_ROWS - 1 else ""

    def odd(self, unit: float = 1.0) -> bool:
        """Whether the times, in a unit, are none of a laboratory."""
        return self.slow(unit) or bool(self.too_fast(unit))

    @property
    def late(self) -> bool:
        """Whether the times count from an epoch."""
        return bool(self.time[0] > EPOCH) and not self.slow()

    @cached_property
    def begin(self) -> datetime | None:
        """The start of a dated run; None of one without the time of day."""
        start = self.run.start
        return instant(start) if start is not None and "T" in start else None

    @cached_property
    def seen(self) -> np.ndarray:
        """Which channels have outputs, (C,)."""
        return np.isfinite(self.run.observed).any(axis=0)

    def span(self, unit: float = 1.0) -> tuple[datetime, datetime] | None:
        """Return the first and last instant of a dated run; None of one without the time of day."""
        begin = self.begin
        if begin is None:
            return None
        low, high = (min(float(each) * unit, 1e10) for each in (self.time[0], self.time[-1]))
        return begin + timedelta(seconds=low), begin + timedelta(seconds=high)


def check_times(runs: Sequence[Run], files: Sequence[str]) -> list[Finding]:
    """Return the findings about the times of the runs of a campaign."""
    timed = _timed(runs, files)
    found = [*_in_the_future(runs, files), *(_origin(each) for each in timed if each.late)]
    plain = [each for each in timed if not each.late]
    units = {each.run.name: unit for each in plain if (unit := _unit_of(each, plain))}
    found += [
        _unit_finding([each for each in plain if units.get(each.run.name) == unit], unit)
        for unit in dict.fromkeys(units.values())
    ]
    rest = [each for each in plain if each.run.name not in units]
    return found + [_overlapping(a, b) for a, b in combinations(rest, 2) if _meet(a, b)]


def _in_the_future(runs: Sequence[Run], files: Sequence[str]) -> list[Finding]:
    latest = datetime.now(UTC) + _AHEAD
    late = [(run, file) for run, file in zip(runs, files, strict=True) if run.start and instant(run.start) > latest]
    if not late:
        return []
    run, file = late[0]
    more = f", and so {'do' if len(late) > 2 else 'does'} {len(late) - 1} more" if len(late) > 1 else ""
    return [
        Finding(
            "start_in_future", "warning", run.name, f"the run begins on {run.start}, in the future{more}", file,
            "the date at which the run was made", "correct 'start' of the run",
        )
    ]  # fmt: skip


def _timed(runs: Sequence[Run], files: Sequence[str]) -> list[Timed]:
    """Return the runs with times."""
    known = [(run, file, run.covariates.get("time")) for run, file in zip(runs, files, strict=True)]
    return [
        Timed(run, file, time, _step(time))
        for run, file, time in known
        if time is not None and len(time) and np.isfinite(time).all()
    ]


def _meet(first: Timed, second: Timed) -> bool:
    return _overlap(first.span(), second.span()) and _share_channel(first, second)


def _step(time: np.ndarray) -> float:
    return float(np.median(np.diff(time))) if len(time) >= LEAST_ROWS else math.nan


def _unit_of(timed: Timed, others: Sequence[Timed]) -> str:
    """Return the unit in which the times of a run are as in a laboratory; empty if seconds are."""
    possible = [name for name, unit in UNITS.items() if not timed.odd(unit)]
    if not math.isnan(timed.step) and timed.odd():
        longer = [name for name in possible if (UNITS[name] < 1) == timed.slow()]
        return min(longer, key=lambda name: abs(math.log(timed.step * UNITS[name] / USUAL_STEP)), default="")
    longest = max((each for each in others), key=lambda each: each.time[-1] - each.time[0])
    if timed.time[-1] - timed.time[0] < 0.1 * (longest.time[-1] - longest.time[0]) or not _overlaps(timed, others, 1.0):
        return ""
    shorter = [name for name in possible if UNITS[name] < 1 and not _overlaps(timed, others, UNITS[name])]
    return next(iter(shorter), "")


def _overlaps(timed: Timed, others: Sequence[Timed], unit: float) -> bool:
    """Whether a run, its times and those of the runs that take as long in a unit, overlaps another one by far."""
    own = timed.span(unit)
    long = 0.1 * (timed.time[-1] - timed.time[0])
    return any(
        _overlap(own, each.span(unit if each.time[-1] - each.time[0] > long else 1.0))
        for each in others
        if each is not timed and _share_channel(timed, each)
    )


def _overlap(first: tuple[datetime, datetime] | None, second: tuple[datetime, datetime] | None) -> bool:
    if first is None or second is None:
        return False
    return (min(first[1], second[1]) - max(first[0], second[0])).total_seconds() > OVERLAP


def _share_channel(first: Timed, second: Timed) -> bool:
    """Whether two runs have a channel in common; those of other channels may be recorded at the same time."""
    return bool(np.any(first.seen & second.seen))


def _unit_finding(timed: Sequence[Timed], unit: str) -> Finding:
    first, names = timed[0], ", ".join(f"'{each.run.name}'" for each in timed)
    quick = first.too_fast()
    odd = f"{quick} in {first.step:.4g} s" if quick else f"rows {_said(first.step)} apart"
    if not first.odd():
        odd = f"a run of {_said(first.time[-1] - first.time[0])}, which overlaps others"
    size = UNITS[unit]
    by = f"divide the column by {1 / size:g}" if size < 1 else f"multiply the column by {size:g}"
    # A table may be quicker than most, no laboratory as slow as that.
    severity: Severity = "error" if not quick or quick.endswith("samples") else "warning"
    return Finding(
        "time_unit", severity, first.run.name if len(timed) == 1 else "",
        f"time_s appears to be in {unit} in {'run' if len(timed) == 1 else 'runs'} {names}: {odd}",
        f"{first.file}, column 'time_s'", "seconds since the start of the run", by,
    )  # fmt: skip


def _said(seconds: float) -> str:
    return f"{seconds:.6g} s" + (f" ({seconds / _DAY:.3g} days)" if seconds > _DAY / 4 else "")


def _origin(timed: Timed) -> Finding:
    return Finding(
        "time_origin", "error", timed.run.name,
        f"time_s begins at {timed.time[0]:.10g} s, {timed.time[0] / _DAY / 365:.3g} years after the start of the run",
        f"{timed.file}, column 'time_s'", "seconds since the start of the run",
        "subtract the first time from the column, and state 'start' of the run",
    )  # fmt: skip


def _overlapping(first: Timed, second: Timed) -> Finding:
    a, b = first.span(), second.span()
    assert a is not None
    assert b is not None
    overlap = (min(a[1], b[1]) - max(a[0], b[0])).total_seconds()
    shorter = min((high - low).total_seconds() for low, high in (a, b))
    wrong: Severity = "error" if overlap > WRONG_OVERLAP * shorter else "warning"
    names = f"'{first.run.name}' and '{second.run.name}'"
    when = [f"{low:%Y-%m-%d %H:%M:%S} to {high:%Y-%m-%d %H:%M:%S}" for low, high in (a, b)]
    return Finding(
        "runs_overlap", wrong, second.run.name,
        f"the runs {names} overlap by {_said(overlap)}: {when[0]}, and {when[1]}",
        f"{second.file}, column 'time_s'", "runs of a unit one after the other",
        f"correct 'start' or the times of {names}, or leave 'start' out if it is unknown",
    )  # fmt: skip

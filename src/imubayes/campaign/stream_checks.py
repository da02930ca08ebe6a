"""Findings in the recorded data, and the checks of a run table made while it is streamed.

The checks cover the cells, the time column and the raw channels.  Only counts and first rows are kept: a fault that
occurs a million times is one finding with its count.  Faults and peculiarities of the data are findings, each under a
fixed name.  Findings of severity error prevent the campaign from loading; warnings are kept as notes of their run.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from imubayes.campaign.run_tables import RowBatch, TableSource
from imubayes.campaign.sampling_rate import sampling_interval
from imubayes.foundations.covariates import RATE_COLUMNS, TEMPERATURE_COLUMNS
from imubayes.foundations.errors import Issue
from imubayes.foundations.units import ABSURD
from imubayes.foundations.wrong_records import WrongRecord

Severity = Literal["error", "warning"]

FINDINGS: dict[str, str] = {
    "time_not_increasing": "the time column does not increase",
    "time_unit": "the time column is in another unit",
    "time_origin": "the time column does not count from the start of the run",
    "start_in_future": "a run begins in the future",
    "runs_overlap": "runs of the unit overlap in time",
    "same_data": "two runs hold the same data",
    "gap": "samples are missing: a time step is much longer than the sampling interval",
    "duplicate_row": "a row is identical to the one before, time included",
    "stuck_channel": "a channel keeps one value while its input varies",
    "saturated_channel": "a channel is clipped at its maximum or minimum",
    "nan_values": "a cell holds NaN, infinity or a number that no instrument reads",
    "missing_values": "a required cell is empty",
    "empty_run": "the run has no usable row",
    "rate_unit": "the rate column or the gyro is in another unit of rate",
    "rate_impossible": "a rate is faster than any table turns",
    "angle_in_radians": "the angle column is in radians",
    "kelvin_temperature": "the temperature is in kelvin",
    "current_unit": "the injected current is in another unit",
    "acceleration_unit": "the accelerometer is in m/s² in place of g, or vice versa",
    "scale_far_from_nominal": "the observed scale factor is far from nominal",
    "sign_reversed": "the output has the opposite sign of the input",
    "axes_do_not_fit": "gyros and accelerometers are inconsistent: axes are exchanged or reversed",
    "latitude_sign": "the gyros show the Earth rate of the other hemisphere",
    "latitude_value": "the gyros show the Earth rate of another latitude",
    "temperature_unit": "temperatures are in degrees Fahrenheit, or lack their sign",
    "thermometers_exchanged": "the temperatures of sensor and converter are exchanged",
    "temperature_reversed": "a column of temperatures runs backwards in time",
    "temperature_value": "the outputs of a run belong to another temperature",
    "temperatures_exchanged": "the temperatures of two runs are exchanged",
    "other_unit": "a run is of another unit",
    "outputs_exchanged": "the outputs of two runs are exchanged",
    "outputs_apart": "the outputs of a channel in a run do not belong to this channel",
    "output_offset": "the outputs of a channel are off by the same amount in all rows of a run, or in all runs",
    "rate_without_sign": "the rates of a run are recorded without their sign",
    "rates_exchanged": "the rates of rows of a run are exchanged",
    "rates_missing": "the rate column is zero while the table turns",
    "reference_unit": "the rates of a reference gyro have another sign, unit or order",
    "files_exchanged": "the tables of two runs are exchanged",
    "mounting_mislabelled": "a run was made in another mounting of the campaign",
    "mountings_exchanged": "two mountings are exchanged",
    "mounting_wrong": "the matrix of a mounting is wrong",
    "mounting_turned": "a mounting is turned about the axis of the table",
    "table_reversed": "the table turns against the stated sense",
    "table_zero": "the zero of the table angle is off",
    "axis_zero": "the zero of the outer or middle axis of a table is off",
    "axis_reversed": "the outer or middle axis of a table turns against the stated sense",
    "axis_columns": "the columns of two axes of a table are exchanged",
    "table_elevation": "the elevation of the axis of a table is wrong",
    "table_azimuth": "the azimuth of the axis of a table is wrong",
    "axes_exchanged": "channels are exchanged",
    "input_axis_wrong": "the input axis of a channel is another one",
    "channel_unit": "a channel has another sign or unit",
    "angle_unit": "the angle column is in another unit",
    "table_rate": "the rates of the table in a run are wrong by a factor",
    "row_disagrees": "angle or rate of the table in one row contradicts its outputs",
    "time_shift": "outputs and table are shifted in time",
    "run_disagrees": "a run does not agree with the others under the model (`check --model`)",
    "setup_disagrees": "the outputs contradict the set-up, and no single mistake explains it",
    "standard_errors": "deviations of raw samples are standard errors of their means",
    "deviations_unlike": "the deviations of raw samples are in another unit than those of the other runs",
    "samples_missing": "standard deviations of raw samples are stated without the number of samples",
    "samples_unlike": "the number of samples is unlike that of the other runs",
    "not_settled": "an output does not become steady at a level of the stimulus",
    "segment_not_constant": "the stimulus varies within a labelled segment",
    "partial_turn": "a mean over less than one turn at an unknown angle",
    "gravity_improbable": "stated gravity differs from normal gravity by more than anomalies do",
    "turns_at_rest": "the gyros turn in a record of a unit at rest",
    "bad_count": "an impossible number of samples or standard deviation",
    "unfounded_uncertainty": "an uncertainty is stated for a temperature that is not recorded",
    "unused_columns": "columns that are not used",
}
"""Name of every finding → its meaning."""

SYMPTOMS = ("sign_reversed", "scale_far_from_nominal")
"""Findings of single runs that a mistake in the set-up explains."""
UNIT_FINDINGS = ("rate_unit", "acceleration_unit", "rate_impossible")
"""Findings of wrong units and values in single runs, which may be what a mistake `LIKE_UNITS` looks like there."""
LIKE_UNITS = (
    "files_exchanged", "mounting_mislabelled", "mountings_exchanged", "mounting_turned", "mounting_wrong",
    "table_zero", "axis_zero", "axis_reversed", "axis_columns", "table_elevation", "table_reversed", "axes_exchanged",
    "time_shift", "angle_unit", "rates_missing", "rate_without_sign", "reference_unit", "outputs_exchanged",
)  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes
    ----------
    name : a key of `FINDINGS`.
    severity : ``error`` or ``warning``.
    run : name of the run.
    what, where, allowed, remedy : as in `Issue`.
    record : what is wrong in the record of the run, if that is known; the most probable.

    Examples
    --------
    >>> import imubayes
    >>> [finding.name for finding in imubayes.check_campaign("data/accel-channel")]
    []
    """

    name: str
    severity: Severity
    run: str
    what: str
    where: str
    allowed: str
    remedy: str
    record: WrongRecord | None = None

    def problem(self) -> Issue:
        """Return the finding as an issue."""
        return Issue(f"{self.name}: {self.what}", self.where, self.allowed, self.remedy)

    def __str__(self) -> str:
        run = f" in run '{self.run}'" if self.run else ""
        return f"{self.severity}: {self.name}{run}: {self.what} [{self.where}]; {self.remedy}"


GAP_STEPS = 10.0  # a time step of this many sampling intervals is a gap
STUCK_RUN = 300  # raw samples of one value; coarse converters repeat tens of times at rest
COARSE_CODES = 100  # a channel that spans fewer codes than this repeats values for lack of resolution
PLATEAU_RUN = 5  # consecutive raw samples at the extreme
PLATEAU_RATIO = 3  # so many times longer than any run of one value inside the range, which coarse converters repeat
KELVIN_ABOVE = 200.0
KELVIN_BELOW = 400.0  # 127 °C, beyond which few chambers go
FAHRENHEIT_ABOVE = 100.0  # °C, beyond which few chambers go; 100 °F are 38 °C
FASTEST = 1e6  # deg/s, 170 000 rpm; tables and centrifuges stay far below
MUST_BE_FILLED = ("time_s", "table_rate_deg_s", "current_mA", "samples")


@dataclass
class _Tally:
    """Number of occurrences, and the row of the first."""

    count: int = 0
    first: int = -1

    def note(self, rows: np.ndarray) -> None:
        """Count occurrences at row numbers in increasing order, shape (n,)."""
        if len(rows):
            self.first = int(rows[0]) if self.count == 0 else self.first
            self.count += len(rows)


@dataclass
class _Repeat:
    """Longest run of one value in a channel, the longest runs at its extremes, and the longest between these."""

    value: float = np.nan
    length: int = 0
    longest: int = 0
    changed: bool = False
    low: float = np.inf
    high: float = -np.inf
    at_low: int = 0
    at_high: int = 0
    inside: int = 0
    present: int = 0
    quantum: float = np.inf

    def add(self, values: np.ndarray) -> None:
        """Add the next samples of the channel, shape (n,); NaN where empty."""
        values = values[~np.isnan(values)]
        if not len(values):
            return
        step = np.abs(np.diff(values))
        edges = np.flatnonzero(step) + 1
        self.quantum = min(self.quantum, float(step[edges - 1].min(initial=np.inf)))
        lengths = np.diff(np.concatenate([[0], edges, [len(values)]]))
        heads = values[np.concatenate([[0], edges])]
        if heads[0] == self.value:
            lengths[0] += self.length
        elif self.present:
            self.changed = True
        self.changed |= len(edges) > 0
        self.longest = max(self.longest, int(lengths.max()))
        self._extremes(heads, lengths)
        self.value, self.length = float(heads[-1]), int(lengths[-1])
        self.present += len(values)

    @property
    def coarse(self) -> bool:
        """Whether the channel only toggles between a few codes of its converter."""
        return self.high - self.low < COARSE_CODES * self.quantum

    def plateaus(self, all_move: bool) -> list[tuple[float, int]]:
        """Return the extremes at which the channel is clipped, and the length of the longest run there.

        Parameters
        ----------
        all_move : whether the input always changes; elsewhere a coarse converter repeats a value at rest.
        """
        if not self.changed or self.coarse:
            return []
        least = PLATEAU_RUN if all_move else max(PLATEAU_RUN, PLATEAU_RATIO * self.inside + 1)
        return [(value, n) for value, n in ((self.low, self.at_low), (self.high, self.at_high)) if n >= least]

    def _extremes(self, heads: np.ndarray, lengths: np.ndarray) -> None:
        low, high = float(heads.min()), float(heads.max())
        if low < self.low:
            self.inside = max(self.inside, self.at_low)
            self.low, self.at_low = low, 0
        if high > self.high:
            self.inside = max(self.inside, self.at_high)
            self.high, self.at_high = high, 0
        between = (heads != self.low) & (heads != self.high)
        self.inside = max(self.inside, int(lengths[between].max(initial=0)))
        self.at_low = max(self.at_low, int(lengths[heads == self.low].max(initial=0)))
        self.at_high = max(self.at_high, int(lengths[heads == self.high].max(initial=0)))


@dataclass
class Monitor:
    """Checks one table batch by batch.

    Attributes
    ----------
    source : the table.
    run : name of the run, for the findings.
    all_move : whether every channel must vary, as in a free tumble; a constant one is then an error.
    rows : number of rows so far.
    interval : sampling interval, s; None without a time column.
    """

    source: TableSource
    run: str
    all_move: bool = False
    rows: int = 0
    interval: float | None = None
    _back: _Tally = field(default_factory=_Tally)
    _same: _Tally = field(default_factory=_Tally)
    _gaps: _Tally = field(default_factory=_Tally)
    _empty: dict[str, _Tally] = field(default_factory=dict)
    _not_finite: dict[str, _Tally] = field(default_factory=dict)
    _kelvin: dict[str, _Tally] = field(default_factory=dict)
    _fahrenheit: dict[str, _Tally] = field(default_factory=dict)
    _parts: dict[str, _Tally] = field(default_factory=dict)
    _too_fast: dict[str, _Tally] = field(default_factory=dict)
    _repeats: dict[str, _Repeat] = field(default_factory=dict)
    _previous: dict[str, float] = field(default_factory=dict)
    _longest_gap: float = 0.0

    def push(self, batch: RowBatch) -> None:
        """Check the next batch."""
        self.rows = batch.first + batch.rows
        for name, rows in batch.not_finite.items():
            self._not_finite.setdefault(name, _Tally()).note(batch.first + rows)
        for name in MUST_BE_FILLED:
            if name in batch.numbers:
                empty = np.flatnonzero(np.isnan(batch.numbers[name]))
                bad = batch.not_finite.get(name, np.zeros(0, dtype=int))
                self._empty.setdefault(name, _Tally()).note(batch.first + np.setdiff1d(empty, bad))
        for name in TEMPERATURE_COLUMNS:
            if name in batch.numbers:
                hot = batch.numbers[name] > KELVIN_ABOVE
                huge = batch.numbers[name] > KELVIN_BELOW
                self._kelvin.setdefault(name, _Tally()).note(batch.first + np.flatnonzero(hot & ~huge))
                self._parts.setdefault(name, _Tally()).note(batch.first + np.flatnonzero(huge))
                warm = (batch.numbers[name] > FAHRENHEIT_ABOVE) & (batch.numbers[name] <= KELVIN_ABOVE)
                self._fahrenheit.setdefault(name, _Tally()).note(batch.first + np.flatnonzero(warm))
        for name in RATE_COLUMNS:
            if name in batch.numbers:
                fast = np.flatnonzero(np.abs(batch.numbers[name]) > FASTEST)
                self._too_fast.setdefault(name, _Tally()).note(batch.first + fast)
        for name in self.source.layout.channels:
            self._repeats.setdefault(name, _Repeat()).add(batch.numbers[name])
        if "time_s" in batch.numbers and batch.rows:
            self._follow_time(batch)
        self._previous = {name: float(values[-1]) for name, values in batch.numbers.items() if batch.rows}

    def findings(self) -> list[Finding]:
        """Return the findings of all batches so far."""
        found = [*self._cell_findings(), *self._time_findings()]
        return found if self.source.layout.reduced else [*found, *self._channel_findings()]

    def limits(self) -> dict[str, tuple[float, ...]]:
        """Return the values at which channels of a raw log are clipped, by channel."""
        if self.source.layout.reduced:
            return {}
        found = {name: seen.plateaus(self.all_move) for name, seen in self._repeats.items()}
        return {name: tuple(value for value, _ in plateaus) for name, plateaus in found.items() if plateaus}

    def _follow_time(self, batch: RowBatch) -> None:
        time = batch.numbers["time_s"]
        if self.interval is None:
            self.interval = sampling_interval(time)
        joined = np.concatenate([[self._previous.get("time_s", np.nan)], time])
        step = np.diff(joined)
        still = np.flatnonzero(step == 0)
        same = np.array([row for row in still.tolist() if self._repeats_previous(batch, row)], dtype=int)
        self._same.note(batch.first + same)
        self._back.note(batch.first + np.setdiff1d(np.flatnonzero(step <= 0), same))
        if self.interval is not None and not self.source.layout.reduced:
            wide = np.flatnonzero(step > GAP_STEPS * self.interval)
            self._gaps.note(batch.first + wide)
            self._longest_gap = max(self._longest_gap, float(step[wide].max(initial=0.0)))

    def _repeats_previous(self, batch: RowBatch, row: int) -> bool:
        for name, values in batch.numbers.items():
            before = values[row - 1] if row else self._previous[name]
            if not (values[row] == before or (np.isnan(values[row]) and np.isnan(before))):
                return False
        return True

    def _cell_findings(self) -> list[Finding]:
        found = []
        for name, tally in self._not_finite.items():
            what = f"'{name}' has {_count(tally, 'cell')} with NaN, infinity or a value beyond {ABSURD:g}"
            allowed = "a number that the instrument can read, or an empty cell for a missing value"
            found += self._at("nan_values", tally, name, what, allowed, "empty or correct the cell")
        for name, tally in self._empty.items():
            what = f"'{name}' has {_count(tally, 'empty cell')}"
            allowed = f"a number in every row of '{name}'"
            found += self._at("missing_values", tally, name, what, allowed, "fill the cell, or remove the row")
        for name, tally in self._kelvin.items():
            what = f"{_count(tally, 'value')} of '{name}' above {KELVIN_ABOVE:g}, as in kelvin or tenths of a degree"
            allowed = f"degrees Celsius up to {KELVIN_ABOVE:g}"
            remedy = "subtract 273.15 from the column, or divide it by 10"
            found += self._at("kelvin_temperature", tally, name, what, allowed, remedy)
        for name, tally in self._parts.items():
            what = (
                f"{_count(tally, 'value')} of '{name}' above {KELVIN_BELOW:g}, as in tenths or hundredths of a degree"
            )
            remedy = "divide the column by 10 or 100"
            found += self._at("temperature_unit", tally, name, what, "degrees Celsius", remedy)
        for name, tally in self._fahrenheit.items():
            what = f"{_count(tally, 'value')} of '{name}' above {FAHRENHEIT_ABOVE:g}, as in degrees Fahrenheit"
            what += " or tenths of a degree"
            remedy = "if they are degrees Fahrenheit, replace T by (T - 32) / 1.8 in the column; divide tenths by 10"
            found += self._at("temperature_unit", tally, name, what, "degrees Celsius", remedy, "warning")
        for name, tally in self._too_fast.items():
            what = f"{_count(tally, 'value')} of '{name}' above {FASTEST:g}, faster than any table turns"
            allowed = f"degrees per second up to {FASTEST:g}"
            found += self._at("rate_impossible", tally, name, what, allowed, "correct the cell, or remove the row")
        return found

    def _time_findings(self) -> list[Finding]:
        what = f"the time decreases or repeats {_count(self._back, 'time')}"
        allowed, remedy = "seconds that increase from row to row", "sort or split the log, or correct the clock"
        back = self._at("time_not_increasing", self._back, "time_s", what, allowed, remedy)
        what = f"{_count(self._same, 'row')} identical to the row before"
        same = self._at("duplicate_row", self._same, "time_s", what, "each row once", "remove the repeated rows")
        what = (
            f"{_count(self._gaps, 'gap')} in time, the longest {self._longest_gap:.4g} s "
            f"at a sampling interval of {self.interval or 0.0:.4g} s"
        )
        allowed, remedy = "a constant sampling interval", "check the logger; means are over the samples present"
        return [*back, *same, *self._at("gap", self._gaps, "time_s", what, allowed, remedy, "warning")]

    def _channel_findings(self) -> list[Finding]:
        found = []
        for name, seen in self._repeats.items():
            if seen.present >= 2 * STUCK_RUN and not seen.changed:
                what = f"channel '{name}' has the value {seen.value + 0.0:g} in all {seen.present} samples"
                found.append(self._about_channel("stuck_channel", "error" if self.all_move else "warning", name, what))
            if not seen.changed or seen.coarse:
                continue
            plateaus = seen.plateaus(self.all_move)
            for value, length in plateaus:
                what = (
                    f"channel '{name}' is clipped: it stays at its extreme {value:g} over {length} consecutive "
                    "samples; means and turns that hold such samples are left out"
                )
                found.append(self._about_channel("saturated_channel", "warning", name, what))
            if seen.longest >= STUCK_RUN and not plateaus:
                what = f"channel '{name}' keeps one value over {seen.longest} samples"
                found.append(self._about_channel("stuck_channel", "warning", name, what))
        return found

    def _about_channel(self, finding: str, severity: Severity, channel: str, what: str) -> Finding:
        return Finding(
            finding, severity, self.run, what, f"{self.source.file}, column '{channel}'",
            "samples that vary with the input and with noise",
            "check the cable, the range and the converter; leave the column empty if it cannot be used",
        )  # fmt: skip

    def _at(
        self, name: str, tally: _Tally, column: str, what: str, allowed: str, remedy: str, severity: Severity = "error"
    ) -> list[Finding]:
        """Return a finding at the first row of a tally; none if the tally is empty."""
        where = f"{self.source.place(tally.first)}, column '{column}'"
        return [Finding(name, severity, self.run, what, where, allowed, remedy)] if tally.count else []


def _count(tally: _Tally, noun: str) -> str:
    return f"{tally.count} {noun}{'' if tally.count == 1 else 's'}"

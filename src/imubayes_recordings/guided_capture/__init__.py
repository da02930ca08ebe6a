"""A recording that is taken step by step: hold, enough, turn, until the poses determine what was asked for.

The lines come from a file that grows; what comes from a port is copied to one first, so that nothing that was received
is lost.  After each rest the file is read as `convert` reads it, and its poses are found as those of any free tumble:
what is shown as done is what the campaign will hold.
"""

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from imubayes import load_campaign
from imubayes.campaign.reduction.magnitude_calibration import LEAST_TO_JUDGE
from imubayes.foundations.errors import InputError, closest_first, input_error
from imubayes.foundations.units import NUMBER_AND_UNIT, same_dimension, to_si
from imubayes_recordings.convert import read_recordings
from imubayes_recordings.convert.column_choice import TRIPLES, ChosenTable
from imubayes_recordings.convert.column_names import TIME
from imubayes_recordings.convert.formats.text import TextRecording
from imubayes_recordings.convert.recording import ForeignRecording
from imubayes_recordings.guided_capture.pose_design import COEFFICIENTS, PoseDesign, design_of
from imubayes_recordings.guided_capture.rest_watch import RestWatch

UNTIL = ("accel_bias=0.3mg", "accel_scale_factor=300ppm", "accel_misalignment=2arcmin", "gyro_bias=20deg/h",
         "gyro_scale_factor=0.1%", "gyro_misalignment=4arcmin")  # fmt: skip
"""What is asked for by default: what a small unit on a desk reaches in a quarter of an hour."""

_BEGIN = 200  # lines by which the columns are told
_FIRST, _SHORTEST, _LONGEST = 10.0, 2.0, 10.0  # s to hold the first rest, and any other
_PAUSE = 50.0  # mean steps without a sample: the rest is not known to have gone on
_POLL, _LOOK = 0.05, 0.25  # s between two looks at the file, and at the samples


@dataclass(frozen=True)
class Wanted:
    """A standard uncertainty that is asked for of every coefficient of an effect: as written, its number, in SI."""

    effect: str
    text: str
    number: float
    value: float


@dataclass(frozen=True)
class Guidance:
    """What the operator does now, and what is known.

    Attributes
    ----------
    state : begin, hold, turn, enough, done or ended.
    seconds, of : held so far, and to be held.
    poses : undisturbed poses of the recording so far.
    up : direction of the body to point up next, (3,), not normalised; None where any serves.
    largest : effect → its largest standard deviation, SI; empty before there are enough poses.
    open : the effects that are not reached.
    trouble : why the recording so far makes no campaign; empty where it does.
    """

    state: str
    seconds: float = 0.0
    of: float = 0.0
    poses: int = 0
    up: np.ndarray | None = None
    largest: Mapping[str, float] | None = None
    open: tuple[str, ...] = ()
    trouble: str = ""


def read_wanted(words: Sequence[str], gravity: float) -> Iterator[Wanted]:
    """Yield what is asked for, of words such as ``accel_bias=0.2mg``.

    Raises
    ------
    InputError
        for an effect that no rest or turn shows, or a unit of another dimension.
    """
    for word in words:
        effect, _, text = word.partition("=")
        if effect not in COEFFICIENTS:
            allowed = closest_first(effect, COEFFICIENTS, most=len(COEFFICIENTS))
            raise input_error(
                f"'{effect}' cannot be requested from rests and turns", "option until", allowed, "correct it"
            )
        match, usual = NUMBER_AND_UNIT.match(text), COEFFICIENTS[effect].unit
        size, unit = (float(match["number"]), match["unit"] or "") if match else (0.0, "")
        if not size > 0 or not unit or not same_dimension(unit, usual, "option until"):
            what = f"'{word}' has no uncertainty above 0 with a unit of {usual}"
            raise input_error(what, "option until", f"such as {effect}=1{usual}", "state number and unit")
        yield Wanted(effect, text, size, size * to_si(unit, gravity))


def growing_lines(file: Path, ended: Callable[[], bool], patience: float) -> Iterator[list[str]]:
    """Yield the new whole lines of a file until its writer has ended or is silent for `patience` seconds; none if so.

    A line that is torn, because it is still written, waits for its end.
    """
    rest, silent = b"", time.monotonic()
    with file.open("rb") as stream:
        while True:
            over = ended()  # asked before the read: what came in between is read once more
            new = stream.read(1 << 16)
            if new:
                silent = time.monotonic()
                *whole, rest = (rest + new).split(b"\n")
                yield [line.decode("utf-8", "replace") for line in whole]
            elif over or time.monotonic() - silent > patience:
                return
            else:
                time.sleep(_POLL)


class GuidedCapture:
    """Guides the operator of a recording that grows."""

    def __init__(self, file: Path, until: Sequence[str], options: Mapping[str, Any]) -> None:
        self.file, self._options = file, {"procedure": "free_tumble"} | dict(options)
        self._words, self._until = tuple(until), tuple(read_wanted(until, 9.81))  # refused before anything is recorded
        self._waiting: list[str] = []
        self._table: ChosenTable | None = None
        self._enough = False
        self._now = Guidance("begin", of=_FIRST)

    def follow(self, ended: Callable[[], bool], patience: float) -> Iterator[Guidance]:
        """Yield what to do, whenever lines have come; the last one is done, or ended."""
        with tempfile.TemporaryDirectory() as place:
            self._part = Path(place) / "part"
            for lines in growing_lines(self.file, ended, patience):
                yield from self._add(lines)
                if self._now.state == "done":
                    return
            if self._table is not None:
                self._judge()
                yield self._now if self._now.state == "done" else replace(self._now, state="ended")

    def _add(self, lines: Sequence[str]) -> Iterator[Guidance]:
        if self._table is None:
            self._waiting += lines
            if len(self._waiting) < _BEGIN:
                return
            self._keep(self._waiting)
            self._begin()
            self._feed(self._waiting)
            lines = ()
        piece = max(1, round(_LOOK / self._interval))
        for first in range(0, len(lines), piece):
            self._keep(lines[first : first + piece])
            self._feed(lines[first : first + piece])
            yield self._guide()
            if self._now.state == "done":
                return

    def _keep(self, lines: Sequence[str]) -> None:
        with self._part.open("a", encoding="utf-8") as stream:
            stream.writelines(f"{line}\n" for line in lines)

    def _begin(self) -> None:
        """Find columns, units and clock as `convert` does."""
        read = read_recordings([self._part], "capture", **self._options)
        table = next(table for table in read.tables if "a" in table.kinds)
        recording = self._text(table)
        columns = next(iter(read.campaign.tables.values()))
        names = [name for kind in ("a", "g") for name in TRIPLES[kind] if name in columns]
        self._names = [name for name in names if name in table.columns] if len(names) == 6 else names[:3]
        clock = columns[TIME]
        self._interval = float(clock[-1] - clock[0]) / max(len(clock) - 1, 1)
        gravity = float(read.campaign.document["site"].get("gravity_m_s2") or 9.81)
        self._until = tuple(read_wanted(self._words, gravity))
        self._until = tuple(each for each in self._until if len(names) == 6 or each.effect.startswith("accel"))
        self._scale, self._offset = self._nominal(read.campaign.document, table, gravity)
        least = _least_steps([columns[name] for name in self._names]) * np.abs(self._scale)
        self._watch = RestWatch(self._interval, least)
        self._table, self._recording = table, recording
        self._clock_step, self._last = float("nan"), float("nan")

    def _text(self, table: ChosenTable) -> TextRecording:
        recording = table.recording
        recording = recording.reader if isinstance(recording, ForeignRecording) else recording
        if isinstance(recording, TextRecording):
            return recording
        what = "the recording is not text"
        raise input_error(what, str(self.file), "lines of numbers", "record it completely, and convert it")

    def _nominal(
        self, document: Mapping[str, Any], table: ChosenTable, gravity: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return factor and offset of each column to SI, with its sign, from the nominal scales of the channels."""
        channels = {entry["name"]: entry for entry in document["channel"]}
        own = [channels[name] for name in self._names]
        scale = np.array([each["scale"] / to_si(each["per"], gravity) for each in own])
        sign = np.array([table.columns[name].sign for name in self._names])
        return sign / scale, np.array([each["offset"] for each in own]) / scale

    def _feed(self, lines: Sequence[str]) -> None:
        assert self._table is not None
        places = [self._table.columns[name].position for name in self._names]
        timed = TIME in self._table.columns and "sample_rate_hz" not in self._options
        clock = [self._table.columns[TIME].position] if timed else []
        rows = self._recording.parsed(lines, self._table.topic, [*places, *clock])
        rows = rows[np.isfinite(rows).all(axis=1)]
        if not len(rows):
            return
        if timed:
            steps = np.diff(rows[:, -1], prepend=self._last)
            usual = self._clock_step if np.isfinite(self._clock_step) else float(np.nanmean(steps))
            if (steps > _PAUSE * usual).any():
                self._watch.end(missing=True)
            self._clock_step, self._last = usual, float(rows[-1, -1])
        self._watch.add(rows[:, : len(places)] * self._scale - self._offset)

    def _guide(self) -> Guidance:
        watch = self._watch
        self._enough &= watch.still > 0
        if watch.still == 0 or (watch.repeated and not self._enough):
            self._now = replace(self._now, state="turn" if watch.rests else "begin", seconds=0.0)
        elif not self._enough:
            self._now = replace(self._now, state="hold", seconds=watch.still, of=self._to_hold())
            self._enough = watch.still >= self._now.of
            if self._enough:
                self._judge()
        return self._now

    def _to_hold(self) -> float:
        """Return how long a rest is held: until its mean is as well known as a bias shall be."""
        if self._watch.rests == 0:
            return _FIRST
        target = next((each.value for each in self._until if each.effect == "accel_bias"), float("inf"))
        return float(np.clip(self._interval * (self._watch.noise / target) ** 2, _SHORTEST, _LONGEST))

    def _judge(self) -> None:
        """Read the recording so far as a campaign, and say what it determines."""
        design, trouble = self._design()
        known = replace(self._now, state="enough", trouble=trouble, up=None, poses=self._watch.rests + 1)
        if design is not None:
            largest = {each.effect: float(design.deviations(each.effect).max()) for each in self._until}
            missing = {each.effect: each.value for each in self._until if largest[each.effect] > each.value}
            done = not missing and design.poses >= LEAST_TO_JUDGE
            up = None if done else design.next_up(missing or {each.effect: each.value for each in self._until})
            known = replace(known, poses=design.poses, largest=largest, open=tuple(missing), up=up)
            known = replace(known, state="done" if done else "enough")
        self._now = known

    def _design(self) -> tuple[PoseDesign | None, str]:
        try:
            with tempfile.TemporaryDirectory() as place:
                folder = Path(place) / "campaign"
                read_recordings([self._part], "capture", **self._options).write(folder)
                return design_of(load_campaign(folder, judge_setup=False), self._interval), ""
        except InputError as error:
            # Too few poses at the beginning are no trouble.
            few = self._watch.rests + 1 < LEAST_TO_JUDGE // 2
            return None, "" if few else error.issues[0].what

    @property
    def wanted(self) -> tuple[Wanted, ...]:
        """What is asked for, as far as the channels of the recording can tell it."""
        return self._until


def _least_steps(columns: Sequence[np.ndarray]) -> np.ndarray:
    """Return the least step of each column from row to row, 0 where it never changes."""
    steps = [np.abs(np.diff(values)) for values in columns]
    return np.array([step[step > 0].min() if step.any() else 0.0 for step in steps])

"""A recording that is taken step by step, until its poses or motions determine what was asked for.

The lines come from a file that grows; what comes from a port is copied to one first, so that nothing that was received
is lost.  Steps are poses (`pose_steps`: hold, enough, turn) or motions (`motion_steps`: turn it about this axis, now
about another; wave it).  After each the file is read as `convert` reads it, and reduced as any run of its procedure:
what is shown as done is what the campaign will hold.
"""

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from imubayes.foundations.errors import input_error
from imubayes.foundations.units import to_si
from imubayes_recordings.convert import ReadRecordings, read_recordings
from imubayes_recordings.convert.column_choice import TRIPLES, ChosenTable
from imubayes_recordings.convert.column_names import TIME
from imubayes_recordings.convert.formats.text import TextRecording
from imubayes_recordings.convert.recording import ForeignRecording
from imubayes_recordings.guided_capture.motion_steps import DrillSteps, MotionSteps, Parts, WaveSteps
from imubayes_recordings.guided_capture.motion_watch import DrillWatch, WaveWatch
from imubayes_recordings.guided_capture.planned_motion import PROCEDURE, SECONDS, expected_of_plan, noise_of
from imubayes_recordings.guided_capture.pose_steps import FIRST, PoseSteps
from imubayes_recordings.guided_capture.steps import UNTIL, Guidance, GuidedSteps, Motion, Wanted, read_wanted

__all__ = ["UNTIL", "Guidance", "GuidedCapture", "Motion", "Wanted", "growing_lines"]

_BEGIN = 200  # lines by which the columns are known
_PAUSE = 50.0  # mean steps without a sample: the motion is not known to have gone on
_POLL, _LOOK = 0.05, 0.25  # s between two looks at the file, and at the samples


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
    """Guides the operator of a recording that grows, through poses or motions."""

    def __init__(
        self,
        file: Path,
        until: Sequence[str],
        options: Mapping[str, Any],
        motion: Motion = "poses",
        seconds: float | None = None,
    ) -> None:
        self.file, self._motion = file, motion
        self._seconds = SECONDS.get(motion, 0.0) if seconds is None else seconds
        self._options = {"procedure": PROCEDURE.get(motion, "free_tumble")} | dict(options)
        self._words, self._until = tuple(until), tuple(read_wanted(until, 9.81))  # refused before anything is recorded
        self._waiting: list[str] = []
        self._head: list[str] = []
        self._table: ChosenTable | None = None
        self._steps: GuidedSteps | None = None
        self._now = Guidance("begin", of=FIRST)

    def follow(self, ended: Callable[[], bool], patience: float) -> Iterator[Guidance]:
        """Yield what to do, whenever lines have come; the last one is done, or ended."""
        with tempfile.TemporaryDirectory() as place:
            self._part = Path(place) / "part"
            for lines in growing_lines(self.file, ended, patience):
                yield from self._add(lines)
                if self._now.state == "done":
                    return
            if self._steps is not None:
                self._now = self._steps.judge()
                yield self._now if self._now.state == "done" else replace(self._now, state="ended")

    def write(self, folder: Path) -> None:
        """Write the campaign of the whole file, or of its motions.

        Raises
        ------
        InputError
            if it makes none.
        """
        if not isinstance(self._steps, MotionSteps):
            read_recordings([self.file], folder.name, **self._options).write(folder)
        elif self._steps.parts:
            self._write_parts(self._steps.parts, folder)
        else:
            raise input_error(
                "no motion of the recording lasted for long enough", str(self.file),
                f"turns about one axis, or waving, of {self._seconds:g} s each", "record again, or state --seconds",
            )  # fmt: skip

    def _add(self, lines: Sequence[str]) -> Iterator[Guidance]:
        begun = self._steps is not None
        if not begun:
            self._waiting += lines
            if len(self._waiting) < _BEGIN:
                return
            self._keep(self._waiting)
            yield from self._begin()
            lines = self._waiting[len(self._head) :]
        assert self._steps is not None
        piece = max(1, round(_LOOK / self._interval))
        for first in range(0, len(lines), piece):
            if begun:
                self._keep(lines[first : first + piece])
            self._feed(lines[first : first + piece])
            self._now = self._steps.guide()
            yield self._now
            if self._now.state == "done":
                return

    def _keep(self, lines: Sequence[str]) -> None:
        with self._part.open("a", encoding="utf-8") as stream:
            stream.writelines(f"{line}\n" for line in lines)

    def _begin(self) -> Iterator[Guidance]:
        """Find columns, units and clock as `convert` does; yield what planned motions are expected to determine."""
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
        recorded = [columns[name] for name in self._names]
        self._table, self._recording = table, recording
        self._head = self._waiting[: recording.layout.first - 1]
        self._clock_step, self._last = float("nan"), float("nan")
        self._steps = self._first_step(gravity, _least_steps(recorded) * np.abs(self._scale))
        if isinstance(self._steps, MotionSteps):
            noise = noise_of(np.stack(recorded, axis=1) * np.abs(self._scale), self._names)
            document = read.campaign.document
            yield self._steps.plan(expected_of_plan(self._motion, self._seconds, self._interval, noise, document))

    def _first_step(self, gravity: float, least: np.ndarray) -> GuidedSteps:
        """Return the steps of the kind of motion that was chosen; `least` as of `PoseSteps`."""
        if self._motion == "poses":
            return PoseSteps(self._interval, least, self._until, lambda folder: self._read([self._part]).write(folder))
        names, given = tuple(self._names), (self._seconds, self._until, self._write_parts)
        if self._motion == "wave":
            return WaveSteps(WaveWatch(self._interval, gravity, names), *given)
        if len(names) < 6:
            raise input_error(
                "turns on a drill need gyros, which the recording does not have", str(self.file),
                "columns ax, ay, az, gx, gy, gz; or --motion wave or poses with accelerometers alone",
                "record the gyros as well, or choose another motion",
            )  # fmt: skip
        return DrillSteps(DrillWatch(self._interval, names), *given)

    def _read(self, files: Sequence[Path], name: str = "capture") -> ReadRecordings:
        return read_recordings(files, name, **self._options)

    def _write_parts(self, parts: Parts, folder: Path) -> None:
        """Write the campaign of some parts of the recording, a file each with the head of the whole."""
        with tempfile.TemporaryDirectory() as place:
            files = [Path(place) / f"{name}.csv" for name in parts]
            for file, lines in zip(files, parts.values(), strict=True):
                file.write_text("".join(f"{line}\n" for line in (*self._head, *lines)), encoding="utf-8")
            self._read(files, folder.name).write(folder)

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
        assert self._steps is not None
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
                self._steps.gap()
            self._clock_step, self._last = usual, float(rows[-1, -1])
        self._steps.add(rows[:, : len(places)] * self._scale - self._offset, lines)

    @property
    def wanted(self) -> tuple[Wanted, ...]:
        """What is asked for, as far as the channels of the recording can determine it."""
        return self._until


def _least_steps(columns: Sequence[np.ndarray]) -> np.ndarray:
    """Return the least step of each column from row to row, 0 if it never changes."""
    steps = [np.abs(np.diff(values)) for values in columns]
    return np.array([step[step > 0].min() if step.any() else 0.0 for step in steps])

"""Steps of a capture that are motions: turns about one axis after the other, or a unit that is waved.

A turn that was held for long enough is a run of its own; a unit that is waved makes one run, which grows.  After each
the recording so far is read as a campaign, whose information says what is reached and what is open.
"""

import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imubayes import load_campaign
from imubayes.foundations.errors import InputError
from imubayes_recordings.convert.proposed_effects import DETERMINED, ExpectedUncertainty, propose_effects
from imubayes_recordings.guided_capture.motion_watch import DrillWatch, WaveWatch
from imubayes_recordings.guided_capture.planned_motion import TURNS
from imubayes_recordings.guided_capture.steps import Guidance, Wanted

Parts = Mapping[str, Sequence[str]]
"""Name → lines of each run that is recorded."""


class MotionSteps[Watch](ABC):
    """Guides through motions; one kind of motion says which are done and which are to be made."""

    def __init__(
        self, watch: Watch, seconds: float, until: Sequence[Wanted], write: Callable[[Parts, Path], object]
    ) -> None:
        """Begin.

        Parameters
        ----------
        watch : judges the motion as it goes on.
        seconds : of each motion.
        write : writes the campaign of some parts of the recording.
        """
        self._watch, self._seconds, self._until, self._write = watch, seconds, until, write
        self.parts: dict[str, list[str]] = {}
        self._lines: list[str] = []  # of a motion that goes on
        self._now = Guidance("begin", of=seconds, ask=self.next_motion())

    @abstractmethod
    def add(self, values: np.ndarray, lines: Sequence[str]) -> None:
        """Add samples of force and rate, (n, 6), SI, and the lines that they stand in."""

    @abstractmethod
    def gap(self) -> None:
        """Take note that samples are missing."""

    @abstractmethod
    def next_motion(self) -> str:
        """Return the motion to make next, in words."""

    def plan(self, expected: Sequence[ExpectedUncertainty]) -> Guidance:
        """Return what the planned motions are expected to determine, beforehand."""
        return Guidance("plan", of=self._seconds, expected=tuple(expected), ask=self.next_motion())

    def guide(self) -> Guidance:
        """Return what to do now."""
        return self._now

    def judge(self) -> Guidance:
        """Read the parts so far as a campaign, and say what they determine."""
        known = replace(self._now, state="enough", poses=len(self.parts), trouble="", fault="")
        if self.parts:
            try:
                with tempfile.TemporaryDirectory() as place:
                    folder = Path(place) / "campaign"
                    self._write(self.parts, folder)
                    expected = propose_effects(load_campaign(folder, judge_setup=False)).expected
            except InputError as error:
                known = replace(known, trouble=error.issues[0].what)
            else:
                largest = {each.effect: _largest(expected, each.effect) for each in self._until}
                missing = tuple(each.effect for each in self._until if largest[each.effect] > each.value)
                state = "enough" if missing else "done"
                known = replace(known, state=state, largest=largest, open=missing, expected=expected)
        self._now = replace(known, ask=self.next_motion())
        return self._now


class DrillSteps(MotionSteps[DrillWatch]):
    """Turns about each axis of the body, both ways."""

    _closed = False

    def add(self, values: np.ndarray, lines: Sequence[str]) -> None:
        """Add samples."""
        before = self._watch.turn
        took = self._watch.add(values)
        turn = self._watch.turn
        if before is not None and turn is not before:
            self._ended(before.seconds)
        if turn is None:
            self._now = replace(self._now, state="move", fault=self._now.fault if not took else "", seconds=0.0)
            return
        if took:
            self._lines += lines
        if self._closed:
            return
        axis, sense = turn.name
        known = f"{axis}-{sense}" in self.parts and self.next_motion() != _asked(axis, sense)
        fault = f"{axis} {sense} is recorded already: {self.next_motion()}" if known else self._watch.fault
        self._now = replace(
            self._now, state="moving", seconds=turn.seconds, of=self._seconds, fault=fault, part=f"{axis} {sense}"
        )
        if not fault and turn.seconds >= self._seconds:
            by_gyros, by_gravity, _ = turn.turns(self._watch.interval)
            self._closed = True
            self.parts[self._free(f"{axis}-{sense}")] = self._lines
            self._now = replace(
                self._now,
                part=f"{axis} {sense}, {abs(by_gravity):.1f} turns by gravity, {abs(by_gyros):.1f} by the gyros",
            )
            self.judge()

    def gap(self) -> None:
        """End the turn."""
        self._watch.end()
        self._lines, self._closed = [], False

    def next_motion(self) -> str:
        """Return the turn that has been made least, in the order of the plan."""
        made = [sum(name.startswith("-".join(turn)) for name in self.parts) for turn in TURNS]
        return _asked(*TURNS[int(np.argmin(made))])

    def _ended(self, seconds: float) -> None:
        short = not self._closed and self._now.state == "moving"
        fault = f"stopped after {seconds:.0f} s of {self._seconds:.0f} s" if short else ""
        self._now = replace(self._now, fault=fault)
        self._lines, self._closed = [], False

    def _free(self, name: str) -> str:
        again = sum(own == name or own.startswith(f"{name}-") for own in self.parts)
        return f"{name}-{again + 1}" if again else name


class WaveSteps(MotionSteps[WaveWatch]):
    """A unit that is waved until it has pointed all faces up, for long enough, and as often again as is needed."""

    _rounds = 1

    def add(self, values: np.ndarray, lines: Sequence[str]) -> None:
        """Add samples."""
        if self._watch.add(values) or self.parts:
            self.parts.setdefault("waved", []).extend(lines)
        of = self._rounds * self._seconds
        done = self._watch.seconds >= of
        self._now = replace(
            self._now, state="moving", seconds=self._watch.seconds, of=of, fault=self._watch.fault,
            ask=self._watch.missing() if done else "", part="waved",
        )  # fmt: skip
        if done and not self._watch.missing() and not self._watch.fault:
            self._rounds += 1
            self.judge()

    def gap(self) -> None:
        """A gap divides the recording: the reduction takes its parts."""

    def next_motion(self) -> str:
        """Return how to wave."""
        return "wave it slowly, a turn in 5 to 20 s, each face up once" if not self.parts else "go on waving"


def _asked(axis: str, sense: str) -> str:
    return f"turn it about {axis}, {sense}, the axis level"


def _largest(expected: Sequence[ExpectedUncertainty], effect: str) -> float:
    """Return the largest expected standard uncertainty of an effect, SI; infinite if the runs do not determine it."""
    own = [each for each in expected if each.effect == effect]
    if not own or min(each.told for each in own) < DETERMINED:
        return float("inf")
    return max(each.sd for each in own)

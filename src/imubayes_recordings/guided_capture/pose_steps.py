"""Steps of a capture that are poses: hold, enough, turn, until the poses determine what was asked for."""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imubayes import load_campaign
from imubayes.campaign.reduction.magnitude_calibration import LEAST_TO_JUDGE
from imubayes.foundations.errors import InputError
from imubayes_recordings.guided_capture.pose_design import PoseDesign, design_of
from imubayes_recordings.guided_capture.rest_watch import RestWatch
from imubayes_recordings.guided_capture.steps import Guidance, Wanted

FIRST = 10.0
"""Seconds to hold the first rest."""
_SHORTEST, _LONGEST = 2.0, 10.0  # s to hold any other


class PoseSteps:
    """Guides through rests and turns."""

    def __init__(
        self, interval: float, least: np.ndarray, until: Sequence[Wanted], write: Callable[[Path], object]
    ) -> None:
        """Begin.

        Parameters
        ----------
        interval : between samples, s.
        least : least step of each channel, SI.
        write : writes the campaign of the recording so far.
        """
        self._watch = RestWatch(interval, least)
        self._interval, self._until, self._write = interval, until, write
        self._enough = False
        self._now = Guidance("begin", of=FIRST)

    def add(self, values: np.ndarray, lines: Sequence[str]) -> None:
        """Add samples."""
        self._watch.add(values)

    def gap(self) -> None:
        """End the rest: it is not known to have gone on."""
        self._watch.end(missing=True)

    def guide(self) -> Guidance:
        """Return what to do now."""
        watch = self._watch
        self._enough &= watch.still > 0
        if watch.still == 0 or (watch.repeated and not self._enough):
            self._now = replace(self._now, state="turn" if watch.rests else "begin", seconds=0.0)
        elif not self._enough:
            self._now = replace(self._now, state="hold", seconds=watch.still, of=self._to_hold())
            self._enough = watch.still >= self._now.of
            if self._enough:
                self.judge()
        return self._now

    def _to_hold(self) -> float:
        """Return how long a rest is held: until its mean is as well known as a bias shall be."""
        if self._watch.rests == 0:
            return FIRST
        target = next((each.value for each in self._until if each.effect == "accel_bias"), float("inf"))
        return float(np.clip(self._interval * (self._watch.noise / target) ** 2, _SHORTEST, _LONGEST))

    def judge(self) -> Guidance:
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
        return known

    def _design(self) -> tuple[PoseDesign | None, str]:
        try:
            with tempfile.TemporaryDirectory() as place:
                folder = Path(place) / "campaign"
                self._write(folder)
                return design_of(load_campaign(folder, judge_setup=False), self._interval), ""
        except InputError as error:
            # Too few poses at the beginning are no trouble.
            few = self._watch.rests + 1 < LEAST_TO_JUDGE // 2
            return None, "" if few else error.issues[0].what

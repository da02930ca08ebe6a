"""The records of a guided capture: what is asked for, and what the operator does now."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from imubayes.foundations.errors import closest_first, input_error
from imubayes.foundations.units import NUMBER_AND_UNIT, same_dimension, to_si
from imubayes_recordings.convert.proposed_effects import ExpectedUncertainty
from imubayes_recordings.guided_capture.pose_design import COEFFICIENTS

Motion = Literal["poses", "drill", "wave"]
UNTIL: Mapping[str, tuple[str, ...]] = {
    "poses": ("accel_bias=0.3mg", "accel_scale_factor=300ppm", "accel_misalignment=2arcmin", "gyro_bias=20deg/h",
              "gyro_scale_factor=0.1%", "gyro_misalignment=4arcmin"),
    "drill": ("gyro_scale_factor=0.1%",),
    "wave": ("accel_bias=5mg", "accel_scale_factor=0.5%", "accel_misalignment=20arcmin", "gyro_bias=600deg/h",
             "gyro_scale_factor=0.5%", "gyro_misalignment=30arcmin"),
}  # fmt: skip
"""What is asked for by default: what a small unit reaches on a desk in a quarter of an hour, on a drill in three
minutes, and in the hand in two."""


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
    state : begin, hold, turn, enough, done or ended; of a motion also plan, move and moving.
    seconds, of : held or moved so far, and to be held or moved.
    poses : undisturbed poses of the recording so far; of a motion its parts.
    up : direction of the body to point up next, (3,), not normalised; None if any serves.
    largest : effect → its largest standard deviation, SI; empty before there are enough poses.
    open : the effects that are not reached.
    trouble : why the recording so far makes no campaign; empty if it does.
    ask : the motion to make next, in words.
    fault : what is wrong with the present motion; empty where nothing is.
    part : the motion that was completed last, in words.
    expected : what the planned motions, or those so far, are expected to determine.
    """

    state: str
    seconds: float = 0.0
    of: float = 0.0
    poses: int = 0
    up: np.ndarray | None = None
    largest: Mapping[str, float] | None = None
    open: tuple[str, ...] = ()
    trouble: str = ""
    ask: str = ""
    fault: str = ""
    part: str = ""
    expected: tuple[ExpectedUncertainty, ...] = ()


class GuidedSteps(Protocol):
    """The steps of a capture, poses or motions: they are given samples with their lines, and say what to do."""

    def add(self, values: np.ndarray, lines: Sequence[str]) -> None:
        """Add samples of force and rate, (n, 3) or (n, 6), SI, and the lines that they stand in."""

    def gap(self) -> None:
        """Take note that samples are missing."""

    def guide(self) -> Guidance:
        """Return what to do now."""
        ...

    def judge(self) -> Guidance:
        """Return what is known at the end."""
        ...


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

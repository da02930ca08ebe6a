"""A motion as it goes on: whether the one that was asked for is made, and what is wrong with it.

Every piece of some tenths of a second is judged by its mean rate and force at nominal scale.  A turn on a drill or a
wheel keeps one axis of the body; gravity must turn across it, or it counts nothing.  A unit that is waved never rests,
turns about all axes and points every face up once.  The campaign is made of the recording itself: what is found here
steers the operator.
"""

from dataclasses import dataclass, field

import numpy as np

from imubayes.foundations.numerics import true_stretches
from imubayes.procedures.carried import about_one_axis, fastest_rate
from imubayes.procedures.free_rotation import LEAST_TURNING

_TURNING = np.radians(30.0)  # rad/s: below, a drill stands still
_SLOW = np.pi / 2  # rad/s: less than five turns in 20 s
_SAME_AXIS = np.cos(np.radians(25.0))
_STOPPED = 1.0  # s without turning that end a turn
_JUDGED = 2.0  # s of a turn before its axis is judged
_COUNTED, _DISAGREE = 3.0, 0.1  # turns, and relative difference of gyros and gravity
_RESTING, _REST = np.radians(6.0), 2.0  # rad/s and s: a waved unit at rest
_FAST = np.radians(180.0)  # rad/s of a hand: windows become shorter than its strokes
_ROUGH = 0.2  # of g, by which the mean force of a piece may differ from it
_FACE = np.cos(np.radians(40.0))  # of the angle to up at which a face points up
_ALL_AXES = 20.0  # s of waving before its axes are judged
_STUCK = 6  # successive samples that repeat the largest reading of a channel
FACES = tuple(f"{sign}{axis}" for axis in "xyz" for sign in "+−")


@dataclass
class Turn:
    """A turn about one axis: its direction in the body, seconds that count, and what gyros and gravity measured."""

    axis: np.ndarray
    seconds: float = 0.0
    rates: list[np.ndarray] = field(default_factory=list)
    forces: list[np.ndarray] = field(default_factory=list)

    @property
    def name(self) -> tuple[str, str]:
        """Axis and sense, such as x and forward; the direction of an oblique axis."""
        place = int(np.argmax(np.abs(self.axis)))
        sense = "forward" if self.axis[place] > 0 else "reverse"
        if abs(self.axis[place]) < _SAME_AXIS:
            return (
                f"({', '.join(f'{part:.1f}' for part in abs(self.axis[place]) / self.axis[place] * self.axis)})",
                sense,
            )
        return "xyz"[place], sense

    def turns(self, interval: float) -> tuple[float, float, float]:
        """Return the turns by gyros and by gravity, and the share of g across the axis."""
        rate, force = np.concatenate(self.rates), np.concatenate(self.forces)
        mean = rate.mean(axis=0)
        axis = mean / np.linalg.norm(mean)
        across = np.linalg.svd(axis[None])[2][1:]
        across[1] = np.cross(axis, across[0])
        u, v = across @ force.T
        size = float(np.median(np.hypot(u, v)) / np.median(np.linalg.norm(force, axis=1)))
        angle = np.cumsum(rate @ axis) * interval
        # The gyros say how many turns there are between two samples, gravity the rest.
        turned = angle + np.unwrap(-np.arctan2(v, u) - angle)
        by_gyros, by_gravity = (float(each[-1] - each[0]) / (2 * np.pi) for each in (angle, turned))
        return by_gyros, by_gravity, size


class SaturationWatch:
    """The channels that repeat their largest reading again and again: they are at the end of their range."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names, self._largest = names, np.zeros(len(names))

    def at_the_end(self, values: np.ndarray) -> list[str]:
        """Return the channels of samples (n, C) that are saturated."""
        size = np.abs(values)
        self._largest = np.maximum(self._largest, size.max(axis=0, initial=0.0))
        held = (size == self._largest).T
        longest = [int(np.diff(true_stretches(own)).max(initial=0)) for own in held]
        return [name for name, own in zip(self._names, longest, strict=True) if own >= _STUCK]


class DrillWatch:
    """The turn that goes on, if any, and those that have ended."""

    def __init__(self, interval: float, names: tuple[str, ...]) -> None:
        self.interval, self._ends = interval, SaturationWatch(names)
        self.turn: Turn | None = None
        self.fault = ""
        self._stopped = 0.0

    def add(self, values: np.ndarray) -> bool:
        """Add samples (n, 6); return whether they belong to the turn that goes on, or begin one."""
        rate, self.fault = values[:, 3:], ""
        mean, seconds = rate.mean(axis=0), len(values) * self.interval
        speed = float(np.linalg.norm(mean))
        if speed < _TURNING:
            self._stopped += seconds
            if self._stopped > _STOPPED:
                self.end()
            return False
        if self.turn is not None and mean @ self.turn.axis < _SAME_AXIS * speed:
            self.end()
        self._stopped = 0.0
        begun = self.turn is None
        turn = self.turn = self.turn or Turn(mean / speed)
        turn.rates.append(rate)
        turn.forces.append(values[:, :3])
        if begun:  # the axis of a drill that just starts is not yet known
            return True
        self.fault = self._fault(turn, speed, self._ends.at_the_end(values))
        turn.seconds += 0.0 if self.fault else seconds
        return True

    def end(self) -> None:
        """End the turn."""
        self.turn = None

    def _fault(self, turn: Turn, speed: float, ends: list[str]) -> str:
        fastest = fastest_rate(self.interval)
        if ends:
            return f"{', '.join(ends)} at the end of its range: turn more slowly"
        if speed > fastest:
            allowed = f"below {np.degrees(fastest):.0f} deg/s"
            return f"{np.degrees(speed):.0f} deg/s is too fast for the sampling rate: {allowed}"
        if speed < _SLOW:
            return f"{np.degrees(speed):.0f} deg/s is too slow: above {np.degrees(_SLOW):.0f} deg/s"
        if len(turn.rates) * len(turn.rates[-1]) * self.interval < _JUDGED:
            return ""
        by_gyros, by_gravity, across = turn.turns(self.interval)
        if across < LEAST_TURNING:
            return "the axis is upright: gravity does not turn, and counts no turns; lay the axis level"
        if abs(by_gyros) > _COUNTED and abs(by_gyros / by_gravity - 1) > _DISAGREE:
            return f"the gyros count {by_gyros:.1f} turns, gravity {by_gravity:.1f}: check units and axes"
        return ""


class WaveWatch:
    """A unit that is waved: seconds of motion that count, and the faces that have pointed up."""

    def __init__(self, interval: float, gravity: float, names: tuple[str, ...]) -> None:
        self.interval, self._gravity, self._ends = interval, gravity, SaturationWatch(names)
        self._squares, self._still = np.zeros((3, 3)), 0.0
        self.faces: set[str] = set()
        self.seconds, self.fault = 0.0, ""

    def add(self, values: np.ndarray) -> bool:
        """Add samples (n, 3) or (n, 6); return whether they are of a unit that moves."""
        force, rate, seconds = values[:, :3], values[:, 3:], len(values) * self.interval
        size = float(np.linalg.norm(force.mean(axis=0)))
        speed = float(np.linalg.norm(rate.mean(axis=0))) if rate.shape[1] else _swept(force) / seconds
        self._still = self._still + seconds if speed < _RESTING else 0.0
        self.fault = self._fault(speed, size / self._gravity - 1, self._ends.at_the_end(values))
        if self._still > _REST:
            return False
        if not self.fault:
            self.seconds += seconds
            self._squares += rate.T @ rate if rate.shape[1] else 0.0
            up = force.mean(axis=0) / size
            self.faces |= {name for name, part in zip(FACES, _signed(up), strict=True) if part > _FACE}
        return True

    def missing(self) -> str:
        """Return what the motion lacks: faces to point up, or turns about further axes; empty if nothing."""
        left = [face for face in FACES if face not in self.faces]
        if left:
            return f"point {', '.join(left)} up once"
        if self.seconds > _ALL_AXES and self._squares.any() and about_one_axis(np.linalg.cholesky(self._squares).T):
            return "turn it about other axes as well"
        return ""

    def _fault(self, speed: float, beyond: float, ends: list[str]) -> str:
        if self._still > _REST:
            return "at rest: keep it moving"
        if ends:
            return f"{', '.join(ends)} at the end of its range: move more gently"
        if speed > _FAST:
            return f"{np.degrees(speed):.0f} deg/s is too fast: a turn in two seconds or more"
        if abs(beyond) > _ROUGH:
            return f"the hand accelerates by {1e3 * abs(beyond):.0f} mg: move more gently"
        return ""


def _swept(force: np.ndarray) -> float:
    """Return the angle by which the force of some samples turns, rad, by the means of the first and the last half."""
    first, last = (part.mean(axis=0) for part in np.array_split(force, 2))
    return 2 * float(np.arctan2(np.linalg.norm(np.cross(first, last)), first @ last))


def _signed(up: np.ndarray) -> list[float]:
    return [float(sign * part) for part in up for sign in (1, -1)]

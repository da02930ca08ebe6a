"""How a hand turns a unit from one rest to the next: a smooth path of attitude and position.

Each move takes the time of a minimum-jerk step, 10τ³ − 15τ⁴ + 6τ⁵, so rate and acceleration begin and end at
zero.  The main rotation about one body axis carries a passing sway about another, so that the axis of
rotation wanders as it does in a hand.  Attitude is R0·exp(θ(t) a)·exp(w(t) c); the body rate follows in closed form,
exp(w c)ᵀ·a·dθ/dt + c·dw/dt.
"""

from dataclasses import dataclass

import numpy as np

from kinematics import rotation


@dataclass(frozen=True)
class Move:
    """One move; axes and angles in the body at its start, the displacement (m) in local level."""

    start: float
    duration: float
    attitude: np.ndarray
    axis: np.ndarray
    angle: float
    sway_axis: np.ndarray
    sway: float
    displacement: np.ndarray

    @property
    def final_attitude(self) -> np.ndarray:
        return self.attitude @ rotation(self.angle * self.axis)


def step(t):
    """Minimum-jerk step from 0 to 1, its first and its second derivative."""
    return t**3 * (10 - 15 * t + 6 * t**2), 30 * t**2 * (1 - t) ** 2, 60 * t * (1 - t) * (1 - 2 * t)


def sway(t):
    """A bump that is 0 at both ends and 1 in the middle, and its derivative."""
    return 64 * (t * (1 - t)) ** 3, 192 * (t * (1 - t)) ** 2 * (1 - 2 * t)


def path(moves: list[Move], times: np.ndarray):
    """Attitude body to level (T, 3, 3), body rate (T, 3), acceleration in level axes (T, 3) at `times`."""
    attitude = np.repeat(moves[0].attitude[None], len(times), axis=0)
    rate, acceleration = np.zeros((len(times), 3)), np.zeros((len(times), 3))
    for move in moves:
        begun = times >= move.start
        attitude[begun] = move.final_attitude
        inside = begun & (times < move.start + move.duration)
        t = (times[inside] - move.start) / move.duration
        progress, speed, surge = (column[:, None] for column in step(t))
        lean, lean_speed = (column[:, None] for column in sway(t))
        swayed = rotation(move.sway * lean * move.sway_axis)
        attitude[inside] = move.attitude @ rotation(move.angle * progress * move.axis) @ swayed
        main = move.angle * speed / move.duration * move.axis
        rate[inside] = np.einsum("tji,tj->ti", swayed, main) + move.sway * lean_speed / move.duration * move.sway_axis
        acceleration[inside] = surge / move.duration**2 * move.displacement
    return attitude, rate, acceleration


def unit_vector(generator: np.random.Generator) -> np.ndarray:
    vector = generator.normal(size=3)
    return vector / np.linalg.norm(vector)


def hand_moves(poses: int, first_rest: float, generator: np.random.Generator) -> tuple[list[Move], float]:
    """Moves between `poses` rests that spread over the sphere, and the time of the last rest's end.

    Of many random turns the hand takes the one that ends farthest from every earlier direction of gravity.
    """
    attitude = rotation(generator.uniform(-np.pi, np.pi) * np.array([0.0, 0.0, 1.0]))
    upward = [attitude[2]]
    clock, moves = first_rest, []
    for _ in range(poses - 1):
        turns = [(unit_vector(generator), np.radians(generator.uniform(60, 180))) for _ in range(80)]
        ends = np.array([(attitude @ rotation(angle * axis))[2] for axis, angle in turns])
        nearest = (ends @ np.array(upward).T).max(axis=1)
        axis, angle = turns[int(nearest.argmin())]
        move = Move(
            start=clock,
            duration=generator.uniform(1.5, 2.5),
            attitude=attitude,
            axis=axis,
            angle=angle,
            sway_axis=unit_vector(generator),
            sway=np.radians(generator.normal(0.0, 10.0)),
            displacement=generator.normal(0.0, 0.03, 3),
        )
        moves.append(move)
        attitude = move.final_attitude
        upward.append(attitude[2])
        clock += move.duration + generator.uniform(2.7, 3.4)
    return moves, clock

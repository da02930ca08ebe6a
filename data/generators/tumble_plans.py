"""Free tumbles drawn at random: a unit turned by hand between rests whose attitudes nobody knows.

What such a record tells is, of every rest, the mean of all channels, and of every turn the rotation that the gyros
integrate from one rest to the next.  Attitudes of the rests are free: whatever they could explain is not seen.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import desk_imu
import truth
import write
from kinematics import Site, rotation
from motion import Move, hand_moves
from plan import Plan, Row, Run
from sensor import Values

POSES = 24
TRIMMED = 0.3
"""s cut off either end of a rest."""
ATTITUDE = 0.02
"""rad, by which the attitude of a rest may differ; a hundred times what the accelerometers leave open."""


@dataclass(frozen=True)
class TumblePlan(Plan):
    """A plan of one free tumble; `runs` hold its rests and its turns, as far as the noise needs them."""

    moves: tuple[Move, ...] = ()
    end: float = 0.0

    def moments(self) -> "TumbleMoments":
        return TumbleMoments(self)

    @property
    def nuisances(self) -> dict[str, float]:
        """One sigma of the attitudes of the rests, rad."""
        return {f"attitude.{axis}[{rest}]": ATTITUDE for rest in range(len(self.moves) + 1) for axis in "xyz"}

    @property
    def times(self) -> np.ndarray:
        """Instants of the raw samples, s."""
        return np.arange(round(self.end * desk_imu.SAMPLE_RATE)) / desk_imu.SAMPLE_RATE

    @cached_property
    def rests(self) -> list[tuple[int, int]]:
        """First sample and the one after the last of each rest."""
        begin = [0.0, *(move.start + move.duration for move in self.moves)]
        until = [*(move.start for move in self.moves), self.end]
        rate = desk_imu.SAMPLE_RATE
        return [(round((a + TRIMMED) * rate), round((b - TRIMMED) * rate)) for a, b in zip(begin, until, strict=True)]


class TumbleMoments:
    """Means of the rests, then of each turn the mean rate (rad/s) by which its rotation differs from the true one."""

    def __init__(self, plan: TumblePlan):
        self.plan = plan
        self.run_of_row = np.repeat(np.arange(len(plan.runs)), [len(run.rows) for run in plan.runs])
        self._samples = lru_cache(maxsize=4)(self._evaluated)

    def _evaluated(self, values: tuple[tuple[str, float], ...]) -> np.ndarray:
        return desk_imu.exact_outputs(self.plan, dict(values), list(self.plan.moves), self.plan.times)

    def outputs(self, values: Values) -> np.ndarray:
        """Noise-free rows (rests + turns, channels)."""
        attitude = {name: value for name, value in values.items() if name.startswith("attitude.")}
        samples = self._samples(tuple((name, value) for name, value in values.items() if name not in attitude))
        rests, kinds = self.plan.rests, [channel.kind for channel in self.plan.channels]
        turned = [
            rotation(np.array([attitude.get(f"attitude.{axis}[{k}]", 0.0) for axis in "xyz"]))
            for k in range(len(rests))
        ]
        still = np.array([samples[first:last].mean(axis=0) for first, last in rests])
        felt = [place for place, kind in enumerate(kinds) if kind == "accelerometer"]
        still[:, felt] = np.einsum("kji,kj->ki", turned, still[:, felt])
        gyros = [place for place, kind in enumerate(kinds) if kind == "gyro"]
        turns = np.zeros((len(rests) - 1, len(kinds)))
        turns[:, gyros] = self._differences(samples[:, gyros], turned)
        return np.concatenate([still, turns])

    def _differences(self, rate: np.ndarray, turned: list[np.ndarray]) -> np.ndarray:
        """Rotation vectors over time of what is integrated against the true rotation, (turns, 3)."""
        rests, moves = self.plan.rests, self.plan.moves
        found = []
        for k, move in enumerate(moves):
            first, last = rests[k][1], rests[k + 1][0]
            whole = turned[k].T @ integrated(rate[first:last] / desk_imu.SAMPLE_RATE) @ turned[k + 1]
            exact = move.attitude.T @ move.final_attitude
            by = Rotation.from_matrix(whole @ exact.T).as_rotvec()
            found.append(by / (last - first) * desk_imu.SAMPLE_RATE)
        return np.array(found)

    def means(self, outputs: np.ndarray) -> np.ndarray:
        return outputs


def integrated(steps: np.ndarray) -> np.ndarray:
    """The product of small rotations by `steps` (n, 3), in order, by pairs."""
    found = rotation(steps)
    while len(found) > 1:
        if len(found) % 2:
            found = np.concatenate([found, np.eye(3)[None]])
        found = found[0::2] @ found[1::2]
    return found[0]


def tumble(generator: np.random.Generator, site: Site) -> TumblePlan:
    """Rests in attitudes over the whole sphere and turns between them."""
    moves, end = hand_moves(POSES, desk_imu.FIRST_REST, generator)
    base = desk_imu.plan()
    plan = TumblePlan(
        name="random-free_tumble", purpose="A plan of the procedure 'free_tumble' alone, drawn at random.",
        serial="R0004", site=site, channels=base.channels, tables=(), mountings=(), runs=(), script="hidden",
        moves=tuple(moves), end=end,
    )  # fmt: skip
    gyros = tuple(channel.name for channel in plan.channels if channel.kind == "gyro")
    rests = [Row(first / desk_imu.SAMPLE_RATE, last - first, 25.0) for first, last in plan.rests]
    turns = [
        Row(move.start, after[0] - before[1], 25.0, rate=1.0)
        for move, before, after in zip(moves, plan.rests, plan.rests[1:], strict=False)
    ]
    runs = (Run("tumble", "free_tumble", rests), Run("turns", "free_tumble", turns, recorded=gyros))
    return replace(plan, runs=runs)


def write_tumble(folder: Path, plan: TumblePlan, seed: int, values: Values, hidden: dict) -> dict[str, float]:
    """Write the raw samples of a tumble into `folder`; return the true parameters and derived quantities."""
    run = Run("tumble", "free_tumble", [], start="2026-04-01T08:00:00+00:00")
    outputs = desk_imu.exact_outputs(plan, values, list(plan.moves), plan.times)
    desk_imu.write_samples(folder, plan, seed, values, plan.times, outputs)
    write.write_campaign_file(folder, plan, seed, [write.run_entry(run, "parquet", temperature_degC=25.0)])
    derived = truth.scale_factors(plan.channels, values)
    write.write_truth(folder, plan, seed, dict(values), derived, {}, hidden)
    return dict(values) | derived

"""Plans of one procedure on a table of several axes or on a centrifuge, drawn at random."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import centrifuge
import multi_axis_table
from kinematics import Site
from plan import Plan, Row, Run
from sensor import Values
from serial_table import Pose, SerialRun, exact, middles, since_first, write_campaign

RAW_RATE = 50.0


@dataclass(frozen=True)
class SerialPlan(Plan):
    """A plan whose rows are poses; `runs` hold what is needed of them for the noise."""

    poses: tuple[SerialRun, ...] = ()

    def moments(self) -> "SerialMoments":
        return SerialMoments(self)


class SerialMoments:
    """The rows of a plan of poses, run after run: their means are evaluated one by one."""

    def __init__(self, plan: SerialPlan):
        self.plan = plan
        self.run_of_row = np.repeat(np.arange(len(plan.runs)), [len(run.rows) for run in plan.runs])

    def outputs(self, values: Values) -> np.ndarray:
        """Noise-free means of the rows (rows, channels)."""
        runs = list(self.plan.poses)
        means = [exact(self.plan, run, values, since)[0] for run, since in zip(runs, since_first(runs), strict=True)]
        return np.concatenate(means)

    def means(self, outputs: np.ndarray) -> np.ndarray:
        return outputs


def write_serial(folder: Path, plan: SerialPlan, seed: int, values: Values, hidden: dict) -> dict[str, float]:
    """Write a campaign of poses into `folder`; return the true parameters and derived quantities."""
    return write_campaign(folder, plan, list(plan.poses), seed, RAW_RATE, values, hidden=hidden)


def _row(pose: Pose, time: float, temperature: float) -> Row:
    fastest = max(pose.rate, key=abs)
    return Row(time, round(pose.seconds * RAW_RATE), temperature, fastest, None if fastest else pose.angle[2])


def _plan(name: str, site: Site, base: Plan, poses: list[SerialRun]) -> SerialPlan:
    runs = []
    for run in poses:
        rows = [_row(*each, run.temperature) for each in zip(run.poses, middles(run).tolist(), strict=True)]
        runs.append(Run(run.name, run.procedure, rows, run.table, run.mounting, run.start, run.recorded))
    return SerialPlan(
        name=f"random-{name}", purpose=f"A plan of the procedure '{name}' alone, drawn at random.", serial="R0003",
        site=site, channels=base.channels, tables=base.tables, mountings=base.mountings, runs=tuple(runs),
        script="hidden", poses=tuple(poses),
    )  # fmt: skip


def _start(day: int) -> str:
    return f"2026-04-{1 + day:02d}T08:00:00+00:00"


def _some(generator: np.random.Generator, poses: list[Pose], count: int) -> list[Pose]:
    return [poses[place] for place in generator.permutation(len(poses))[:count]]


def several_axes(generator: np.random.Generator, site: Site) -> SerialPlan:
    """Positions, a tumble, rates about each axis, the outer axis fast in held positions, and all axes at once."""
    still, table = multi_axis_table.upright() + multi_axis_table.sideways(), multi_axis_table.TABLE.name
    rates = [float(generator.choice(choice)) for choice in ((10.0, 20.0, 40.0), (100.0, 150.0, 200.0))]
    rest = Pose((0.0, 0.0, 0.0), seconds=60.0)
    made = {"positions": _some(generator, still, 14), "tumble": _some(generator, multi_axis_table.tumble(), 12)}
    for axis, name in enumerate(("outer", "middle", "inner")):
        turns = [multi_axis_table.alone(axis, sign * rate) for rate in rates for sign in (1.0, -1.0)]
        made[f"{name}-rates"] = [rest, *turns, rest]
    made["held"] = _some(generator, multi_axis_table.held(), 8)
    made["together"] = _some(generator, multi_axis_table.together(), 8)
    poses = [
        SerialRun(name, "multi_axis_table", table, "plate", found, _start(day))
        for day, (name, found) in enumerate(made.items())
    ]
    return _plan("multi_axis_table", site, multi_axis_table.plan(), poses)


def on_an_arm(generator: np.random.Generator, site: Site) -> SerialPlan:
    """The accelerometer at four angles of the platform, then both sensors counter-rotated in three seats."""
    table, first = centrifuge.TABLE.name, float(generator.choice([0.0, 30.0, 45.0]))
    levels = np.sqrt(np.sort(generator.uniform(0.5, 20.0, 4)) * site.gravity) / np.radians(1)
    rates = [0.0, *(float(np.round(level)) for level in levels), 0.0]
    poses = [
        SerialRun(
            f"fixed-{quarter + 1}", "centrifuge", table, "z-up",
            [centrifuge.level(rate, (first + 90.0 * quarter) % 360, False) for rate in rates], _start(quarter),
            recorded=("a",),
        )
        for quarter in range(4)
    ]  # fmt: skip
    poses += [
        SerialRun(
            f"counter-{seat}", "centrifuge", table, seat,
            [centrifuge.level(rate, angle, True) for angle in (first, first + 90.0) for rate in rates], _start(4 + day),
        )
        for day, seat in enumerate(centrifuge.SEATS)
    ]  # fmt: skip
    return _plan("centrifuge", site, centrifuge.plan(), poses)

"""What a unit on a table of several axes, or on a centrifuge, reads: from its attitude and place as functions of time.

Neither rates nor accelerations are worked out: attitude and place of every sensor in inertial axes are composed for a
few instants about the one of interest, and differentiated numerically.  Whatever the axes do at the same time is in it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np

import truth
import write
from kinematics import ARCSEC, Mounting, Site, Table, about, rotation
from plan import Plan, Readings, Run
from sensor import Surroundings, Values, accelerometer_signal, converted, gyro_signal

PAUSE = 10.0  # s, from the end of a row to the start of the next
STEP = 1e-3  # s, of the differences
STENCIL = STEP * np.arange(-2, 3)
FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / (12 * STEP)
SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / (12 * STEP**2)
INSTANTS = 64  # of a row that turns, at the points of Gauss and Legendre
Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class SerialTable(Table):
    """A table with an inner axis, and a middle one or an arm; directions in the frame of the outer axis at zero."""

    inner_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    middle_axis: tuple[float, float, float] | None = None
    arm_radius_m: float | None = None
    zero_uncertainty_arcsec: float | None = None
    squareness_uncertainty_arcsec: float | None = None
    intersection_uncertainty_um: float | None = None
    arm_uncertainty_um: float | None = None
    stretch_um_per_g: float = field(default=0.0, metadata={"one sigma": True})

    @property
    def more(self) -> dict:
        """What the campaign file says of it besides what it says of every table."""
        keys = (
            "inner_axis", "middle_axis", "arm_radius_m", "zero_uncertainty_arcsec", "squareness_uncertainty_arcsec",
            "intersection_uncertainty_um", "arm_uncertainty_um",
        )  # fmt: skip
        found = {key: getattr(self, key) for key in keys}
        return {key: list(value) if isinstance(value, tuple) else value for key, value in found.items()}

    def spreads(self) -> dict[str, float]:
        """One sigma of each error of its axes."""
        zero, square, apart = (
            self.zero_uncertainty_arcsec, self.squareness_uncertainty_arcsec, self.intersection_uncertainty_um
        )  # fmt: skip
        named = {"inner_axis_zero.zero": zero}
        if self.arm_radius_m is None:
            named |= {"outer_axis_zero.zero": zero, "outer_axis_squareness.angle": square}
            named |= {"outer_axis_intersection.distance": apart}
        else:
            named |= {"platform_tilt.x": square, "platform_tilt.y": square}
            named |= {"arm_error.radius": self.arm_uncertainty_um, "arm_error.stretch": self.stretch_um_per_g}
        if self.middle_axis is not None:
            named |= {"middle_axis_zero.zero": zero, "middle_axis_squareness.angle": square}
            named |= {"middle_axis_intersection.distance": apart, "middle_axis_intersection.along": apart}
        return {f"{name}[{self.name}]": spread for name, spread in named.items() if spread}


def shortest(axis) -> np.ndarray:
    """The smallest rotation that takes z to a direction: about their common normal."""
    axis = np.asarray(axis, dtype=float)
    normal = np.cross(Z, axis)
    length = np.linalg.norm(normal)
    if length < 1e-12:
        return np.eye(3) if axis[2] > 0 else np.diag([1.0, -1.0, -1.0])
    return rotation(normal / length * np.arctan2(length, axis[2]))


@dataclass(frozen=True)
class Pose:
    """One row: mean angles and rates of the outer, the middle and the inner axis (deg, deg/s), and how long it lasts.

    `unknown` are the axes whose angle is not written: they make whole turns.
    """

    angle: tuple[float, float, float]
    rate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seconds: float = 30.0
    unknown: tuple[int, ...] = ()


@dataclass(frozen=True)
class SerialRun:
    """One run of poses in a mounting; `recorded` are its channels, all where none is named."""

    name: str
    procedure: str
    table: str
    mounting: str
    poses: list[Pose]
    start: str
    temperature: float = 25.0
    recorded: tuple[str, ...] = ()


class Chain:
    """Attitude and place of a unit at any time within a row, with all errors of axes and seat."""

    def __init__(self, table: SerialTable, mounting: Mounting, values: Values, gravity: float):
        def error(name: str) -> float:
            return values.get(f"{name}[{table.name}]", 0.0)

        self.stand = table.stand([error(f"table_axis_tilt.{axis}") * ARCSEC for axis in "xy"])
        names = ("outer_axis_zero", "middle_axis_zero", "inner_axis_zero")
        self.zero = np.array([error(f"{name}.zero") * ARCSEC for name in names])
        self.faster = 1 + 1e-6 * error("table_rate_error.rate_error")
        inner = shortest(table.inner_axis)
        first = inner if table.middle_axis is None else shortest(table.middle_axis)
        self.links = [first, first.T @ inner]
        self.arms = [np.array([table.arm_radius_m or 0.0, 0.0, 0.0]), np.zeros(3)]
        for place, name in enumerate(("outer", "middle")):
            normal = np.cross(Z, self.links[place][:, 2])
            if (length := np.linalg.norm(normal)) > 1e-3:
                normal /= length
                self.arms[place] = self.arms[place] + 1e-6 * error(f"{name}_axis_intersection.distance") * normal
                squared = rotation(normal * error(f"{name}_axis_squareness.angle") * ARCSEC)
                self.links[place] = squared @ self.links[place]
        self.arms[1] = self.arms[1] + 1e-6 * error("middle_axis_intersection.along") * Z
        self.links[0] = self.links[0] @ rotation([error(f"platform_tilt.{axis}") * ARCSEC for axis in "xy"] + [0.0])
        self.radius, self.stretch = 1e-6 * error("arm_error.radius"), 1e-6 * error("arm_error.stretch") / gravity
        self.nominal_arm = table.arm_radius_m or 0.0
        self.seat = truth.true_seat(mounting, values)

    def at(self, pose: Pose, time: np.ndarray, lever: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Body to local level (..., 3, 3) and place in local level (..., 3) at times from the middle of a row, s."""
        rate = np.radians(pose.rate) * self.faster
        turned = np.radians(pose.angle) + self.zero + time[..., None] * rate
        arm = self.arms[0]
        if self.nominal_arm:
            arm = arm + np.array([self.radius + self.stretch * rate[0] ** 2 * self.nominal_arm, 0.0, 0.0])
        attitude = self.stand @ about(2, turned[..., 0])
        place = attitude @ arm
        attitude = attitude @ self.links[0] @ about(2, turned[..., 1])
        place = place + attitude @ self.arms[1]
        attitude = attitude @ self.links[1] @ about(2, turned[..., 2]) @ self.seat
        return attitude, place + attitude @ lever


class Felt:
    """Inertial rate (K, 3) and specific force in body axes at times from the middle of a row."""

    def __init__(self, chain: Chain, pose: Pose, site: Site, time: np.ndarray):
        self.body, self.place = chain.at(pose, time[:, None] + STENCIL, np.zeros(3))
        self.site = site
        self.spin = rotation(STENCIL[:, None] * site.earth_rate)  # local level at the instant is inertial
        attitude = self.spin @ self.body
        self.now = attitude[:, 2]
        turning = np.einsum("kji,kjl->kil", self.now, np.einsum("s,ksij->kij", FIRST, attitude))
        self.rate = np.stack([turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]], axis=-1)

    def force(self, lever: np.ndarray) -> np.ndarray:
        """Specific force (K, 3) of a sensor at `lever`."""
        place = np.einsum("sij,ksj->ksi", self.spin, self.place + self.body @ lever)
        force = np.einsum("s,ksi->ki", SECOND, place) + self.site.upward_force
        return np.einsum("kji,kj->ki", self.now, force)


def instants(pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Times from the middle of a row, s, and their weights."""
    if not any(pose.rate):
        return np.zeros(1), np.ones(1)
    share = 1.0
    if pose.unknown:  # of many whole turns of steady motion one stands for all
        share = 360 / max(abs(pose.rate[axis]) for axis in pose.unknown) / pose.seconds
    points, weights = np.polynomial.legendre.leggauss(INSTANTS)
    return 0.5 * points * pose.seconds * share, weights / 2


def felt(chain: Chain, pose: Pose, site: Site, time: np.ndarray, lever: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inertial rate and specific force in body axes, (K, 3) each, of a sensor at `lever`."""
    here = Felt(chain, pose, site, time)
    return here.rate, here.force(lever)


def since_first(runs: list[SerialRun]) -> list[float]:
    """Hours from the start of the first run to the start of each."""
    starts = [datetime.fromisoformat(run.start) for run in runs]
    return [(start - min(starts)).total_seconds() / 3600 for start in starts]


def table_of(plan: Plan, name: str) -> SerialTable:
    """The table of a plan by its name."""
    return next(each for each in plan.tables if isinstance(each, SerialTable) and each.name == name)


def middles(run: SerialRun) -> np.ndarray:
    """Times of the middles of the rows, s."""
    ends = np.cumsum([pose.seconds + PAUSE for pose in run.poses])
    return np.array([end - PAUSE - pose.seconds / 2 for end, pose in zip(ends, run.poses, strict=True)])


def exact(plan: Plan, run: SerialRun, values: Values, since: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Noise-free means and variances within the rows, (rows, channels) each; `since` are hours since the first run."""
    table = table_of(plan, run.table)
    seat = next(each for each in plan.mountings if each.name == run.mounting)
    chain, hours = Chain(table, seat, values, plan.site.gravity), since + middles(run) / 3600
    mean, variance = np.empty((2, len(run.poses), len(plan.channels)))
    for row, pose in enumerate(run.poses):
        time, weight = instants(pose)
        time = time / chain.faster  # the clock errs, the angles are read
        here = Felt(chain, pose, plan.site, time)
        around = Surroundings(temperature=run.temperature, hours=float(hours[row]))
        for column, channel in enumerate(plan.channels):
            arm = 1e-3 * np.array([values.get(f"lever_arm.{axis}[{channel.name}]", 0.0) for axis in "xyz"])
            if channel.kind == "gyro":
                signal = gyro_signal(channel, values, plan.site, here.rate, here.force(arm), around)
            else:
                signal = accelerometer_signal(channel, values, plan.site, here.force(arm), around)
            read = converted(channel, values, plan.site, signal, around)
            mean[row, column] = weight @ read
            variance[row, column] = weight @ (read - mean[row, column]) ** 2
    return mean, variance


def read_out(plan: Plan, runs: list[SerialRun], values: Values, seed: int, raw_rate: float) -> list[Readings]:
    """For each run means and standard deviations of noisy samples, and one offset per run and channel."""
    readings = []
    for run, since in zip(runs, since_first(runs), strict=True):
        mean, variance = exact(plan, run, values, since)
        samples = np.array([round(pose.seconds * raw_rate) for pose in run.poses])
        sd, offset = np.empty_like(mean), np.empty(len(plan.channels))
        for column, channel in enumerate(plan.channels):
            generator = truth.stream(seed, f"{plan.name}/{run.name}/{channel.name}")
            sigma = values[f"white_noise.sigma[{channel.name}]"]
            offset[column] = generator.normal(0.0, values[f"run_scatter.tau[{channel.name}]"])
            mean[:, column] += offset[column] + generator.normal(0.0, sigma / np.sqrt(samples))
            squares = generator.noncentral_chisquare(samples - 1, samples * variance[:, column] / sigma**2)
            sd[:, column] = sigma * np.sqrt(squares / (samples - 1))
        readings.append(Readings(mean, sd, offset))
    return readings


def columns(plan: Plan, run: SerialRun, readings: Readings, raw_rate: float, decimals: int) -> dict[str, list[str]]:
    """The columns of a run table."""
    table = table_of(plan, run.table)
    found = {"time_s": [f"{middle:.3f}" for middle in middles(run).tolist()]}
    for axis, name in enumerate(("outer", "middle", "table")):
        if name == "middle" and table.middle_axis is None:
            continue
        found[f"{name}_rate_deg_s"] = [f"{pose.rate[axis]:g}" for pose in run.poses]
        found[f"{name}_angle_deg"] = ["" if axis in pose.unknown else f"{pose.angle[axis]:g}" for pose in run.poses]
        spans = [360.0 if axis in pose.unknown else abs(pose.rate[axis]) * pose.seconds for pose in run.poses]
        found[f"{name}_angle_span_deg"] = [f"{span:g}" for span in spans]
    found["temperature_degC"] = [f"{run.temperature:g}"] * len(run.poses)
    found["samples"] = [str(round(pose.seconds * raw_rate)) for pose in run.poses]
    for form, values in (("{}", readings.mean), ("{}_sd", readings.sd)):
        for channel, column in zip(plan.channels, values.T, strict=True):
            if not run.recorded or channel.name in run.recorded:
                found[form.format(channel.name)] = [f"{value:.{decimals}f}" for value in column]
    return found


def write_campaign(
    folder: Path,
    plan: Plan,
    runs: list[SerialRun],
    seed: int,
    raw_rate: float,
    values: Values | None = None,
    more: Callable[[Values], dict[str, float]] = lambda values: {},
    hidden: dict | None = None,
) -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities.

    `hidden` is what is said in the truth file of effects that the model lacks.
    """
    folder = Path(folder)
    values = dict(drawn(plan, seed) if values is None else values)
    entries = [Run(run.name, run.procedure, [], run.table, run.mounting, run.start) for run in runs]
    write.write_campaign_file(folder, plan, seed, [write.run_entry(run) for run in entries])
    (folder / "runs").mkdir(exist_ok=True)
    nuisance = {}
    for run, readings in zip(runs, read_out(plan, runs, values, seed, raw_rate), strict=True):
        table = columns(plan, run, readings, raw_rate, decimals=5)
        lines = [",".join(table), *(",".join(cells) for cells in zip(*table.values(), strict=True))]
        (folder / "runs" / f"{run.name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        for channel, offset in zip(plan.channels, readings.run_offset, strict=True):
            nuisance[f"run_offset[{channel.name},{run.name}]"] = float(offset)
    derived = truth.mounting_angles(plan.channels, plan.mountings, values)
    derived |= truth.scale_factors(plan.channels, values) | more(values)
    write.write_truth(folder, plan, seed, values, derived, nuisance, hidden)
    return values | derived


def drawn(plan: Plan, seed: int) -> dict[str, float]:
    """True values of everything that goes wrong in the plan."""
    effects = truth.effects_of(plan.model or plan.name)
    listed = {effect["name"] for effect in effects}
    spreads = truth.equipment_spreads(plan.mountings, plan.tables, {each.name for each in plan.tables})
    for table in plan.tables:
        spreads |= table_of(plan, table.name).spreads()
    spreads = {name: spread for name, spread in spreads.items() if name.split(".")[0] in listed}
    return truth.from_spreads(spreads, seed) | truth.from_model(effects, plan.channels, seed)


def whole_turns(rate: float, at_least: float) -> float:
    """The shortest time that is at least so long and holds whole turns, s."""
    turn = 360 / abs(rate)
    return turn * np.ceil(at_least / turn - 1e-9)

"""Raw logs as benches write them, simulated in plain NumPy: ramps, ringing, noise and rounding of the table's columns.

The table follows its command with a profile of its own; the unit feels the true motion.  What the log says of the
motion is the command, the true rate with noise, or the differences of a rounded angle.
"""

from dataclasses import dataclass

import numpy as np

RATES = (0.0, 20.0, -20.0, 60.0, -60.0, 150.0, -150.0, 5.0, -5.0, 1.0, -1.0, 0.0)
EARTH, GRAVITY = 15.041067 / 3600, 9.80665


@dataclass(frozen=True)
class Bench:
    """How a bench moves and what it logs.

    Attributes
    ----------
    profile : `linear`, `jerk` (S-shaped), `servo` (exponential) or `ringing` (second order).
    ramp : duration of a ramp, s; of a servo 3 and of ringing 6 time constants.
    column : `command`, `measured` or `encoder`, differences of a rounded angle.
    noise : of a measured rate, deg/s.
    quantum : of the encoder, deg.
    hz, hold : of the log, and duration of each level, s.
    delay : of the motion after the command, s.
    angle : whether the angle of the encoder is logged too.
    """

    profile: str = "linear"
    ramp: float = 3.0
    column: str = "command"
    noise: float = 0.001
    quantum: float = 1e-4
    hz: float = 20.0
    hold: float = 40.0
    delay: float = 0.05
    angle: bool = False


@dataclass(frozen=True)
class Unit:
    """A gyro and an accelerometer: scale factors, biases, noise of one sample, tilt of the table's axis in rad."""

    scale: float = 1000.0
    bias: float = 3.0
    gyro_noise: float = 8.0
    force_scale: float = 20000.0
    force_noise: float = 2.0
    tilt: float = 1e-3
    lever: float = 0.02


def _course(profile: str, share: np.ndarray) -> np.ndarray:
    """Share of a step that has passed at a share of the ramp's duration."""
    late = np.maximum(share, 0.0)
    if profile == "linear":
        return np.clip(late, 0, 1)
    if profile == "jerk":
        x = np.clip(late, 0, 1)
        return x**3 * (10 - 15 * x + 6 * x**2)
    if profile == "servo":
        return 1 - np.exp(-3 * late)
    # A servo of 3 time constants that rings with a tenth of the step.
    swing = 0.1 * np.exp(-6 * late) * np.sin(40 * late)
    return np.clip(late, 0, 1) + swing * (late > 0)


def true_rate(bench: Bench, time: np.ndarray, rates: tuple[float, ...]) -> np.ndarray:
    """True rate of the table, deg/s, shape of time."""
    rate = np.full(len(time), rates[0])
    for number in range(1, len(rates)):
        start = number * bench.hold + bench.delay
        rate += (rates[number] - rates[number - 1]) * _course(bench.profile, (time - start) / bench.ramp)
    return rate


def rate_log(
    bench: Bench, unit: Unit, generator: np.random.Generator, rates: tuple[float, ...] = RATES
) -> dict[str, np.ndarray]:
    """Columns of a log: time, rate and perhaps angle of the table, gyro `g` and accelerometer `a`."""
    fine = 5  # steps of the integration in each sample
    count = round(len(rates) * bench.hold * bench.hz)
    steps = (np.arange(count * fine) + 0.5) / (bench.hz * fine)
    motion = true_rate(bench, steps, rates)
    angle = np.cumsum(motion) / (bench.hz * fine)
    mean = lambda values: values.reshape(count, fine).mean(axis=1)  # noqa: E731
    swing = np.sin(np.deg2rad(angle))
    gyro = motion + EARTH * (0.56 + 0.8 * unit.tilt * swing)
    force = GRAVITY * unit.tilt * swing + np.deg2rad(motion) ** 2 * unit.lever
    time = (np.arange(count) + 0.5) / bench.hz
    read = bench.quantum * np.round(mean(angle) / bench.quantum)
    commanded = np.asarray(rates)[np.minimum((time // bench.hold).astype(int), len(rates) - 1)]
    column = {
        "command": commanded,
        "measured": mean(motion) + bench.noise * generator.normal(size=count),
        "encoder": np.gradient(read) * bench.hz,
    }[bench.column]
    columns = {"time_s": time, "table_rate_deg_s": column}
    if bench.angle:
        columns["table_angle_deg"] = np.mod(read, 360.0)
    columns["g"] = unit.scale * mean(gyro) + unit.bias + unit.gyro_noise * generator.normal(size=count)
    columns["a"] = unit.force_scale * mean(force) / GRAVITY + unit.force_noise * generator.normal(size=count)
    return columns


def head_log(bench: Bench, generator: np.random.Generator, positions: int = 12) -> dict[str, np.ndarray]:
    """Columns of a log of a dividing head: the angle commanded or read, and an accelerometer `a` of 20 000 per g."""
    count = round(positions * bench.hold * bench.hz)
    time = (np.arange(count) + 0.5) / bench.hz
    step = 360.0 / positions
    angle = np.zeros(count)
    for number in range(1, positions):
        angle += step * _course(bench.profile, (time - number * bench.hold - bench.delay) / bench.ramp)
    commanded = step * (time // bench.hold)
    read = bench.quantum * np.round(angle / bench.quantum)
    column = commanded if bench.column == "command" else read + bench.noise * generator.normal(size=count)
    output = 20000 * np.cos(np.deg2rad(angle)) + 2 * generator.normal(size=count)
    return {"time_s": time, "table_angle_deg": np.mod(column, 360.0), "a": output}

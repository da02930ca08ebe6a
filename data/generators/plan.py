"""A test plan, and the readings it would give: rows are means of raw samples under a steady stimulus.

A row that turns is a mean over whole turns; one with a changing converter temperature a mean over its ramp.
Both are evaluated at instants spread evenly over the row, whose mean and variance go into the row's mean and into
the standard deviation of its raw samples.
"""

from dataclasses import dataclass
from math import radians

import numpy as np

import truth
from kinematics import ARCSEC, Mounting, Site, Table, experienced
from sensor import (
    Channel,
    Values,
    accelerometer_signal,
    converted,
    gyro_signal,
    injected_signal,
    lever_arm_force,
)

ANGLES_PER_TURN = 72
INSTANTS_PER_RAMP = 12


@dataclass(frozen=True)
class Row:
    """One line of a run table; an angle of None means whole turns, other None that there is no such column."""

    time: float
    samples: int
    temperature: float
    rate: float = 0.0
    angle: float | None = 0.0
    converter_temperature: float | None = None
    converter_rise: float = 0.0
    current: float | None = None


@dataclass(frozen=True)
class Run:
    name: str
    procedure: str
    rows: list[Row]
    table: str | None = None
    mounting: str | None = None
    start: str | None = None


@dataclass(frozen=True)
class Plan:
    name: str
    purpose: str
    serial: str
    site: Site
    channels: tuple[Channel, ...]
    tables: tuple[Table, ...]
    mountings: tuple[Mounting, ...]
    runs: tuple[Run, ...]

    def draw(self, seed: int) -> dict[str, float]:
        """True values of everything that goes wrong in this plan."""
        turning = {run.table for run in self.runs if any(row.rate for row in run.rows)}
        return truth.from_equipment(self.mountings, self.tables, turning, seed) | truth.from_model(
            self.name, self.channels, seed
        )


@dataclass(frozen=True)
class Readings:
    """Simulated means and standard deviations, both (rows, channels), and each channel's offset in the run."""

    mean: np.ndarray
    sd: np.ndarray
    run_offset: np.ndarray


def _one(items, name):
    return next(item for item in items if item.name == name)


def instants(plan: Plan, run: Run, row: Row, values: Values) -> np.ndarray:
    """Noise-free outputs (instants, channels) during one row."""
    site = plan.site
    if run.mounting is not None:
        table, mounting = _one(plan.tables, run.table), _one(plan.mountings, run.mounting)
        tilt = [values.get(f"table_axis_tilt.{axis}[{table.name}]", 0.0) * ARCSEC for axis in "xy"]
        rate = radians(row.rate) * (1 + 1e-6 * values.get(f"table_rate_error.rate_error[{table.name}]", 0.0))
        turn = np.arange(ANGLES_PER_TURN) * 360 / ANGLES_PER_TURN
        angles = np.radians(turn if row.angle is None else [row.angle])
        body_rate, force, table_rate = experienced(
            site, table.attitude(tilt, angles), truth.true_seat(mounting, values), rate
        )
    converter = np.array([25.0])
    if row.converter_temperature is not None:
        across = (np.arange(INSTANTS_PER_RAMP) + 0.5) / INSTANTS_PER_RAMP - 0.5
        converter = row.converter_temperature + row.converter_rise * across
    outputs = []
    for channel in plan.channels:
        if row.current is not None:
            signal = injected_signal(channel, values, site, row.current)
        elif channel.kind == "gyro":
            signal = gyro_signal(channel, values, site, body_rate, force, row.temperature)
        else:
            felt = force + lever_arm_force(channel, values, table_rate)
            signal = accelerometer_signal(channel, values, site, felt, row.temperature)
        outputs.append(converted(channel, values, site, signal, converter))
    return np.stack(outputs, axis=-1)


def read_out(plan: Plan, run: Run, values: Values, seed: int) -> Readings:
    """Means and standard deviations of raw samples with white noise, and one offset per run and channel."""
    exact = [instants(plan, run, row, values) for row in run.rows]
    mean = np.array([outputs.mean(axis=0) for outputs in exact])
    variance = np.array([outputs.var(axis=0) for outputs in exact])
    samples = np.array([row.samples for row in run.rows])
    sd, run_offset = np.empty_like(mean), np.empty(len(plan.channels))
    for column, channel in enumerate(plan.channels):
        generator = truth.stream(seed, f"{plan.name}/{run.name}/{channel.name}")
        sigma = values[f"white_noise.sigma[{channel.name}]"]
        run_offset[column] = generator.normal(0.0, values[f"run_scatter.tau[{channel.name}]"])
        mean[:, column] += run_offset[column] + generator.normal(0.0, sigma / np.sqrt(samples))
        # squares of normal samples about their mean, the stimulus varying underneath: noncentral chi-square
        squares = generator.noncentral_chisquare(samples - 1, samples * variance[:, column] / sigma**2)
        sd[:, column] = sigma * np.sqrt(squares / (samples - 1))
    return Readings(mean, sd, run_offset)


def whole_turn_seconds(rate: float, at_least: float = 60.0) -> float:
    """Shortest time of at least `at_least` seconds that holds whole turns at `rate` (deg/s)."""
    turn = 360.0 / abs(rate)
    return turn * np.ceil(at_least / turn - 1e-9)


def rate_table_rows(rates, temperatures, raw_rate: float, static: float = 60.0, settle: float = 20.0) -> list[Row]:
    """Static record, each rate forward then reverse from large to small, static record."""
    steps = [0.0, *(sign * rate for rate in rates for sign in (1.0, -1.0)), 0.0]
    rows, clock = [], 0.0
    for rate, temperature in zip(steps, temperatures, strict=True):
        duration = whole_turn_seconds(rate) if rate else static
        angle = None if rate else 0.0
        rows.append(Row(clock + duration / 2, round(duration * raw_rate), temperature, rate, angle))
        clock += duration + settle
    return rows


def dividing_head_rows(positions: int, temperatures, raw_rate: float, dwell: float = 30.0) -> list[Row]:
    """A full circle of equally spaced positions, each held for `dwell` seconds."""
    step, pause = 360.0 / positions, 10.0
    return [
        Row(k * (dwell + pause) + dwell / 2, round(dwell * raw_rate), temperature, angle=k * step)
        for k, temperature in zip(range(positions), temperatures, strict=True)
    ]


def chamber(nominal: float, rows: int, generator: np.random.Generator) -> np.ndarray:
    """Temperatures of a chamber: half a degree of constant error, a slow drift, a few hundredths of ripple."""
    drift = np.linspace(-0.5, 0.5, rows) * generator.normal(0.0, 0.4)
    return np.round(nominal + generator.normal(0.0, 0.5) + drift + generator.normal(0.0, 0.03, rows), 3)


def square_pyramid_axis(half_angle_deg: float, azimuth_deg: float) -> tuple[float, float, float]:
    """Direction at `half_angle_deg` to body z; rounded as it is written to the campaign file."""
    half, azimuth = radians(half_angle_deg), radians(azimuth_deg)
    axis = [np.sin(half) * np.cos(azimuth), np.sin(half) * np.sin(azimuth), np.cos(half)]
    return tuple(float(round(component, 9)) + 0.0 for component in axis)

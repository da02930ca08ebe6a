"""A test plan, and the readings it would give: rows are means of raw samples under a steady stimulus.

A row that turns is a mean over whole turns; one with a changing converter temperature a mean over its ramp.
Both are evaluated at instants spread evenly over the row, whose mean and variance go into the row's mean and into
the standard deviation of its raw samples.
"""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from math import radians
from pathlib import Path
from typing import Protocol

import numpy as np

import truth
from kinematics import ARCSEC, Mounting, Site, Table, experienced, named_attitude, rotation
from sensor import (
    PPM,
    REFERENCE_TEMPERATURE,
    Channel,
    Surroundings,
    Values,
    accelerometer_signal,
    converted,
    gyro_signal,
    injected_signal,
    lever_arm_force,
)

THERMAL = ("drift", "drift_quadratic", "leakage", "temperature_rate", "lag", "hysteresis")
INSTANTS_PER_RAMP = 12
INSTANTS_PER_ARC = 24


@dataclass(frozen=True)
class Row:
    """One line of a run table; an angle of None means whole turns, other None that there is no such column.

    `temperature_rate` in °C/min and `rate_rise` in deg/s² are the true ones; no column gives them.  `span` is what the
    table turns by during the row, `axes` the letters of the directions of a gyro's input and output axes.
    """

    time: float
    samples: int
    temperature: float
    rate: float = 0.0
    angle: float | None = 0.0
    converter_temperature: float | None = None
    converter_rise: float = 0.0
    current: float | None = None
    temperature_rate: float = 0.0
    power_on: float | None = None
    span: float | None = None
    rate_rise: float = 0.0
    axes: tuple[str, str] | None = None


@dataclass(frozen=True)
class Run:
    name: str
    procedure: str
    rows: list[Row]
    table: str | None = None
    mounting: str | None = None
    start: str | None = None
    recorded: tuple[str, ...] = ()

    def records(self, channel: Channel) -> bool:
        """Whether a channel is recorded: all are where none is named."""
        return not self.recorded or channel.name in self.recorded


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
    angles_per_turn: int = 72

    model: str | Path | None = None
    script: str | None = None

    def shows(self, effect: str) -> bool:
        """Whether any run of this plan carries what the effect acts on."""
        rows = [row for run in self.runs for row in run.rows]
        if effect == "injection_error":
            return any(row.current is not None for row in rows)
        if effect.startswith("converter_") and effect.endswith(THERMAL):
            return any(row.converter_temperature is not None for row in rows)
        if effect.startswith(("reference_", "time_")):
            return any(run.procedure == "reference_gyro" for run in self.runs)
        if effect == "table_rate_error":
            return any(row.rate for run in self.runs for row in run.rows if run.procedure != "reference_gyro")
        directed = any(row.axes is not None for row in rows)
        if effect.startswith("station_"):
            return directed
        if effect == "gyro_scale_factor" and directed:
            return True  # the Earth rate is the input
        if effect in ("lever_arm", "gyro_scale_factor", "gyro_scale_temperature"):
            return any(row.rate for row in rows) or any(run.procedure == "free_tumble" for run in self.runs)
        return True

    @property
    def effects(self) -> list[dict]:
        """The effects of the plan's model that its runs can show."""
        return [effect for effect in truth.effects_of(self.model or self.name) if self.shows(effect["name"])]

    @property
    def equipment(self) -> dict[str, float]:
        """One sigma of each error of seats and tables that the plan's model lists."""
        commanded = [run for run in self.runs if run.procedure != "reference_gyro"]
        turning = {run.table for run in commanded if run.table is not None and any(row.rate for row in run.rows)}
        spreads = truth.equipment_spreads(self.mountings, self.tables, turning)
        for table in self.tables:
            spreads |= getattr(table, "spreads", dict)()
        listed = {effect["name"] for effect in self.effects}
        return {name: spread for name, spread in spreads.items() if name.split(".")[0] in listed}

    @property
    def nuisances(self) -> dict[str, float]:
        """One sigma of what is unknown besides the parameters of the model."""
        return {}

    def moments(self) -> "NoiseFree":
        """All instants at which the truth is evaluated."""
        return Moments(self)

    def draw(self, seed: int) -> dict[str, float]:
        """True values of everything that goes wrong in this plan."""
        beside = dict.fromkeys(str(run.table) for run in self.runs if run.procedure == "reference_gyro")
        drawn = truth.from_spreads(self.equipment, seed) | truth.from_model(self.effects, self.channels, seed)
        return drawn | truth.of_reference(self.effects, beside, seed)


@dataclass(frozen=True)
class Readings:
    """Simulated means and standard deviations, both (rows, channels), and each channel's offset in the run.

    `reference` are the means of a reference gyro in deg/s, (rows, 3), None where none rides along.
    """

    mean: np.ndarray
    sd: np.ndarray
    run_offset: np.ndarray
    reference: np.ndarray | None = None


def _one(items, name):
    return next(item for item in items if item.name == name)


def _spacing(run: Run) -> float:
    """Time from the middle of one row to that of the next, s; 1 where a run has one row."""
    return run.rows[1].time - run.rows[0].time if len(run.rows) > 1 else 1.0


def lagged(time: np.ndarray, temperature: np.ndarray, tau: float) -> np.ndarray:
    """Temperature behind a first-order lag of `tau` (s) that starts in equilibrium, between rows along straight lines.

    Against a straight line T the lagged temperature tends to T − slope·tau, and what differs from that fades.
    """
    behind = np.array(temperature, dtype=float)
    for row in range(1, len(time)):
        step = time[row] - time[row - 1]
        trailing = tau * (temperature[row] - temperature[row - 1]) / step
        differs = behind[row - 1] - temperature[row - 1] + trailing
        behind[row] = temperature[row] - trailing + differs * np.exp(-step / tau)
    return behind


def place_in_loop(temperature: np.ndarray, play: float) -> np.ndarray:
    """Where a temperature is in a loop that it drags along with a play of ±`play`, −1 … 1; 0 at the start."""
    middle, place = temperature[0], np.zeros(len(temperature))
    for index, now in enumerate(temperature):
        middle = min(max(middle, now - play), now + play)
        place[index] = (now - middle) / play
    return place


class NoiseFree(Protocol):
    """What evaluates the rows of a plan without noise."""

    run_of_row: np.ndarray

    @property
    def plan(self) -> Plan:
        """Unit, equipment and runs."""
        ...

    def outputs(self, values: Values) -> np.ndarray:
        """Noise-free outputs (instants, channels)."""
        ...

    def means(self, outputs: np.ndarray) -> np.ndarray:
        """Means over the instants of each row, (rows, channels)."""
        ...


class Moments:
    """All instants of a plan, run after run and row after row, at which the truth is evaluated."""

    def __init__(self, plan: Plan):
        self.plan = plan
        self.rows = [row for run in plan.runs for row in run.rows]
        self.run_of_row = np.repeat(np.arange(len(plan.runs)), [len(run.rows) for run in plan.runs])
        parts = [self._instants(row) for row in self.rows]
        self.count = np.array([len(angle) for angle, _ in parts])
        self.row = np.repeat(np.arange(len(self.rows)), self.count)
        self.run = self.run_of_row[self.row]
        self.angle = np.radians(np.concatenate([angle for angle, _ in parts]))
        self.converter = np.concatenate([converter for _, converter in parts])
        self.converter_rate, self.time = self._of_ramps()
        self.rate = np.radians([row.rate for row in self.rows])[self.row]
        self.rate_rise = np.radians([row.rate_rise for row in self.rows])[self.row]
        injected = [0.0 if row.current is None else row.current for row in self.rows]
        self.current = np.array(injected)[self.row]
        self.injected = np.array([row.current is not None for row in self.rows])[self.row]

    def _instants(self, row: Row) -> tuple[np.ndarray, np.ndarray]:
        """Angles in deg and converter temperatures of one row."""
        turn = np.arange(self.plan.angles_per_turn) * 360 / self.plan.angles_per_turn
        angle = turn if row.angle is None else np.array([row.angle])
        if row.span is not None and row.angle is not None:
            angle = row.angle + row.span * ((np.arange(INSTANTS_PER_ARC) + 0.5) / INSTANTS_PER_ARC - 0.5)
        converter = np.full(1, REFERENCE_TEMPERATURE)
        if row.converter_temperature is not None:
            across = (np.arange(INSTANTS_PER_RAMP) + 0.5) / INSTANTS_PER_RAMP - 0.5
            converter = row.converter_temperature + row.converter_rise * across
        size = max(len(angle), len(converter))
        return np.resize(angle, size), np.resize(converter, size)

    def _of_ramps(self) -> tuple[np.ndarray, np.ndarray]:
        """Rate of the converter's temperature in °C/min, and time in s, of every instant; ramps have no gaps."""
        lasts = np.concatenate([np.full(len(run.rows), _spacing(run)) for run in self.plan.runs])[self.row]
        rise = np.array([row.converter_rise for row in self.rows])[self.row]
        ramps = np.array([row.converter_temperature is not None for row in self.rows])[self.row]
        first = (np.cumsum(self.count) - self.count)[self.row]
        across = (np.arange(len(self.row)) - first + 0.5) / self.count[self.row] - 0.5
        time = np.array([row.time for row in self.rows])[self.row] + np.where(ramps, across * lasts, 0.0)
        return 60 * rise / lasts, time

    def _along(self, memory: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """Apply a function of time and temperature to the instants of each ramp of the converter; 0 elsewhere."""
        found = np.zeros(len(self.row))
        for index, run in enumerate(self.plan.runs):
            if run.rows[0].converter_temperature is not None:
                at = self.run == index
                found[at] = memory(self.time[at], self.converter[at])
        return found

    def _converter_lag(self, tau_min: float) -> np.ndarray:
        """Lagged minus true temperature of the converter."""
        return self._along(lambda time, warmth: lagged(time, warmth, 60 * tau_min) - warmth)

    def _converter_loop(self, play: float) -> np.ndarray:
        return self._along(lambda _, warmth: place_in_loop(warmth, play))

    @cached_property
    def around(self) -> Surroundings:
        """What surrounds the unit at every instant."""
        hours = np.concatenate([self._hours(run) for run in self.plan.runs])
        progress = np.concatenate([(np.arange(len(run.rows)) + 0.5) / len(run.rows) for run in self.plan.runs])
        power_on = np.array([np.inf if row.power_on is None else row.power_on / 60 for row in self.rows])
        return Surroundings(
            temperature=np.array([row.temperature for row in self.rows])[self.row],
            temperature_rate=np.array([row.temperature_rate for row in self.rows])[self.row],
            lag=self._lag,
            loop=self._loop,
            hours=hours[self.row],
            power_on_min=power_on[self.row],
            rate=self.rate,
            angle=self.angle,
            converter=self.converter,
            converter_rate=self.converter_rate,
            converter_lag=self._converter_lag,
            converter_loop=self._converter_loop,
            run=self.run,
            progress=progress[self.row],
        )

    def _hours(self, run: Run) -> np.ndarray:
        time = np.array([row.time for row in run.rows]) / 3600
        if run.start is None:
            return time
        first = min(datetime.fromisoformat(other.start) for other in self.plan.runs if other.start is not None)
        return time + (datetime.fromisoformat(run.start) - first).total_seconds() / 3600

    def _lag(self, tau_min: float) -> np.ndarray:
        """Lagged minus true temperature of the sensor."""
        lag = []
        for run in self.plan.runs:
            time = np.array([row.time for row in run.rows])
            temperature = np.array([row.temperature for row in run.rows])
            lag.append(lagged(time, temperature, 60 * tau_min) - temperature)
        return np.concatenate(lag)[self.row]

    def _loop(self, play: float) -> np.ndarray:
        """Place of the sensor in its loop of hysteresis."""
        runs = [np.array([row.temperature for row in run.rows]) for run in self.plan.runs]
        return np.concatenate([place_in_loop(warmth, play) for warmth in runs])[self.row]

    def motion(self, values: Values) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Body rate, specific force and the table's own rotation, each (instants, 3) in body axes."""
        felt = tuple(np.zeros((len(self.row), 3)) for _ in range(3))
        for index, run in enumerate(self.plan.runs):
            at = self.run == index
            if run.rows[0].axes is not None:
                stand = np.stack(
                    [named_attitude(*row.axes, self.plan.channels[0].axes) for row in run.rows if row.axes]
                )
                station = [values.get(f"station_level.{axis}[all]", 0.0) for axis in ("east", "north")]
                station = rotation(np.array([*station, values.get("station_heading.heading[all]", 0.0)]) * ARCSEC)
                local = station @ stand[self.row[at] - self.row[at].min()]
                for whole, vector in zip(felt, (self.plan.site.earth_rate, self.plan.site.upward_force), strict=False):
                    whole[at] = np.einsum("j,kji->ki", vector, local)
                continue
            if run.mounting is None:
                continue
            table, mounting = _one(self.plan.tables, run.table), _one(self.plan.mountings, run.mounting)

            def error(parameter: str, table=table.name) -> float:
                return values.get(f"{parameter}[{table}]", 0.0)

            angle, faster = self.angle[at], 1 + PPM * error("table_rate_error.rate_error")
            later = self.rate_rise[at] * 1e-3 * error("time_skew.skew")
            encoder, wobble = np.zeros_like(angle), np.zeros((len(angle), 3))
            for order in (1, 2):
                cosine, sine = np.cos(order * angle), np.sin(order * angle)
                encoder += error(f"encoder_harmonic.sin_{order}") * sine
                encoder += error(f"encoder_harmonic.cos_{order}") * cosine
                for column, axis in enumerate("xy"):
                    wobble[:, column] += error(f"table_wobble.{axis}_cos_{order}") * cosine
                    wobble[:, column] += error(f"table_wobble.{axis}_sin_{order}") * sine
            tilt = [error(f"table_axis_tilt.{axis}") * ARCSEC for axis in "xy"]
            moved = experienced(
                self.plan.site,
                table.stand(tilt),
                wobble * ARCSEC if np.any(wobble) else None,
                angle + encoder * ARCSEC,
                self.rate[at] * faster + later,
                truth.true_seat(mounting, values),
            )
            for whole, part in zip(felt, moved, strict=True):
                whole[at] = part
        return felt[0], felt[1], felt[2]

    def outputs(self, values: Values) -> np.ndarray:
        """Noise-free outputs (instants, channels)."""
        site = self.plan.site
        body_rate, force, table_rate = self.motion(values)
        turning = np.where(self.rate == 0.0, 1.0, self.rate)
        rising = table_rate * (self.rate_rise / turning)[:, None]
        outputs = []
        for channel in self.plan.channels:
            if channel.kind == "gyro":
                signal = gyro_signal(channel, values, site, body_rate, force, self.around, body_rate - table_rate)
            else:
                felt = force + lever_arm_force(channel, values, table_rate, rising)
                signal = accelerometer_signal(channel, values, site, felt, self.around)
            if np.any(self.injected) and channel.current_mA_per_g is not None:
                signal = np.where(self.injected, injected_signal(channel, values, site, self.current), signal)
            outputs.append(converted(channel, values, site, signal, self.around))
        return np.stack(outputs, axis=-1)

    def means(self, outputs: np.ndarray) -> np.ndarray:
        """Means over the instants of each row, (rows, channels)."""
        first = np.cumsum(self.count) - self.count
        return np.add.reduceat(outputs, first, axis=0) / self.count[:, None]

    def variances(self, outputs: np.ndarray) -> np.ndarray:
        """Variances within each row, (rows, channels)."""
        return self.means((outputs - self.means(outputs)[self.row]) ** 2)


def correlated(generator: np.random.Generator, rows: int, sd: float, correlation: float) -> np.ndarray:
    """A stationary first-order autoregression from row to row."""
    shocks = sd * np.sqrt(1 - correlation**2) * generator.standard_normal(rows)
    shocks[0] = sd * generator.standard_normal()
    for row in range(1, rows):
        shocks[row] += correlation * shocks[row - 1]
    return shocks


def referenced(plan: Plan, values: Values, seed: int, moments: Moments) -> list[np.ndarray | None]:
    """For each run what a reference gyro beside the unit reads, deg/s; it reads what is, before any delay.

    Its axes are those of the body turned back by the alignment: r = (1 + s) Aᵀ ω + b, with white noise.
    """
    felt = moments.means(moments.motion({name: one for name, one in values.items() if "time_skew" not in name})[0])
    turn = rotation([values.get(f"reference_alignment.{axis}[all]", 0.0) * ARCSEC for axis in "xyz"])
    scale = 1 + PPM * np.array([values.get(f"reference_scale_factor.{axis}[all]", 0.0) for axis in "xyz"])
    bias = np.array([values.get(f"reference_bias.{axis}[all]", 0.0) for axis in "xyz"]) / 3600
    readings = []
    for index, run in enumerate(plan.runs):
        if run.procedure != "reference_gyro":
            readings.append(None)
            continue
        generator = truth.stream(seed, f"{plan.name}/{run.name}/reference")
        sigma = values["reference_noise.sigma[all]"] / np.sqrt([[row.samples] for row in run.rows])
        exact = np.degrees(felt[moments.run_of_row == index] @ turn) * scale + bias
        readings.append(exact + sigma * generator.normal(size=exact.shape))
    return readings


def rate_noise(plan: Plan, run: Run, channel: Channel, values: Values) -> np.ndarray:
    """Standard deviation of what grows with the rate about the input axis, for each row, output units."""
    share = PPM * values.get(f"rate_proportional_noise.k[{channel.name}]", 0.0)
    if run.mounting is None or share == 0.0:
        return np.zeros(len(run.rows))
    seen = _one(plan.mountings, run.mounting).body_to_table[2] @ channel.axes[0]
    rates = np.radians([row.rate for row in run.rows])
    return share * channel.scale_si(plan.site) * np.abs(rates * seen)


def read_out(plan: Plan, values: Values, seed: int) -> list[Readings]:
    """For each run the means and standard deviations of raw noisy samples, and one offset per run and channel."""
    moments = Moments(plan)
    outputs = moments.outputs(values)
    exact, within = moments.means(outputs), moments.variances(outputs)
    beside, readings = referenced(plan, values, seed, moments), []
    for index, run in enumerate(plan.runs):
        at = moments.run_of_row == index
        mean, variance = exact[at], within[at]
        samples = np.array([row.samples for row in run.rows])
        sd, run_offset = np.empty_like(mean), np.empty(len(plan.channels))
        for column, channel in enumerate(plan.channels):
            generator = truth.stream(seed, f"{plan.name}/{run.name}/{channel.name}")
            sigma = values[f"white_noise.sigma[{channel.name}]"]
            run_offset[column] = generator.normal(0.0, values.get(f"run_scatter.tau[{channel.name}]", 0.0))
            mean[:, column] += run_offset[column] + generator.normal(0.0, sigma / np.sqrt(samples))
            # squares of normal samples about their mean, the stimulus varying underneath: noncentral chi-square
            squares = generator.noncentral_chisquare(samples - 1, samples * variance[:, column] / sigma**2)
            sd[:, column] = sigma * np.sqrt(squares / (samples - 1))
            if np.any(flicker := rate_noise(plan, run, channel, values)):
                mean[:, column] += generator.normal(0.0, flicker)
            if slow := values.get(f"correlated_noise.sigma[{channel.name}]", 0.0):
                correlation = values[f"correlated_noise.correlation[{channel.name}]"]
                mean[:, column] += correlated(generator, len(run.rows), slow, correlation)
        readings.append(Readings(mean, sd, run_offset, beside[index]))
    return readings


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


def turning_rows(rate: np.ndarray, rise: np.ndarray, seconds: float, raw_rate: float, warmth: np.ndarray) -> list[Row]:
    """Rows of a table that turns at these mean rates; the angle is that at the middle of each row."""
    swept = rate * seconds
    angle = np.cumsum(swept) - swept / 2
    return [
        Row(
            seconds * (k + 0.5), round(seconds * raw_rate), float(warmth[k]), float(rate[k]), float(angle[k] % 360.0),
            span=float(swept[k]), rate_rise=float(rise[k]),
        )
        for k in range(len(rate))
    ]  # fmt: skip


def chamber(nominal: float, rows: int, generator: np.random.Generator) -> np.ndarray:
    """Temperatures of a chamber: half a degree of constant error, a slow drift, a few hundredths of ripple."""
    drift = np.linspace(-0.5, 0.5, rows) * generator.normal(0.0, 0.4)
    return np.round(nominal + generator.normal(0.0, 0.5) + drift + generator.normal(0.0, 0.03, rows), 3)


def square_pyramid_axis(half_angle_deg: float, azimuth_deg: float) -> tuple[float, float, float]:
    """Direction at `half_angle_deg` to body z; rounded as it is written to the campaign file."""
    half, azimuth = radians(half_angle_deg), radians(azimuth_deg)
    axis = [np.sin(half) * np.cos(azimuth), np.sin(half) * np.sin(azimuth), np.cos(half)]
    x, y, z = (float(round(component, 9)) + 0.0 for component in axis)
    return x, y, z

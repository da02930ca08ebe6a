"""Test plans drawn at random from a few templates.

A template fixes which runs there are, how many rows and which channels, so that what is compiled for one campaign
serves all others; what the rows hold is drawn: mountings, rates, head positions, temperatures and ramps, times, noise.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from kinematics import X_UP, Y_UP, Z_UP, Mounting, Site, Table, trihedral
from plan import Plan, Row, Run, square_pyramid_axis, whole_turn_seconds
from sensor import AXES, Channel

RAW_RATE = 20.0
GYROS = tuple(Channel(f"g{n}", "gyro", i, "pulse/s", 1000.0, "deg/s", 8.0, o) for n, i, o in AXES)
ACCELEROMETERS = tuple(Channel(f"a{n}", "accelerometer", i, "pulse/s", 20000.0, "g", 2.0, o) for n, i, o in AXES)
WITH_CURRENT = tuple(
    Channel(f"a{n}", "accelerometer", i, "pulse/s", 20000.0, "g", 2.0, o, current_mA_per_g=1.2) for n, i, o in AXES
)
PYRAMID = tuple(
    Channel(name, "gyro", square_pyramid_axis(half, azimuth), "pulse/s", 1000.0, "deg/s", 8.0)
    for name, half, azimuth in (("g1", 54.7356, 0.0), ("g2", 54.7356, 90.0), ("g3", 50.0, 180.0), ("g4", 58.0, 270.0))
)
SEATS = {
    "x-up": X_UP, "y-up": Y_UP, "z-up": Z_UP,
    "x-down": X_UP * [[1], [-1], [-1]], "y-down": Y_UP * [[1], [-1], [-1]], "z-down": Z_UP * [[1], [-1], [-1]],
}  # fmt: skip
CHAMBER_MINUTES = 4.0
"""The chamber follows its set point with a first-order lag of this, so that ramps have rounded corners."""


def mounting(name: str) -> Mounting:
    if name == "pyramid":
        return Mounting("pyramid", trihedral(), 5.0, preset="trihedral")
    return Mounting(name, SEATS[name], 5.0)


def steady(generator: np.random.Generator, nominal: float, rows: int) -> np.ndarray:
    """Temperatures of a chamber that holds: some constant error and a slow drift."""
    drift = np.linspace(-0.5, 0.5, rows) * generator.normal(0.0, 0.1)
    return np.round(nominal + generator.normal(0.0, 0.5) + drift, 3)


def rate_rows(generator: np.random.Generator, rates: int, nominal: float) -> list[Row]:
    """Rest, `rates` magnitudes forward and reverse from large to small, rest."""
    largest = generator.choice([100, 150, 200, 300])
    smaller = generator.choice(np.arange(5, largest - 20, 5), rates - 1, replace=False)
    magnitudes = [float(largest), *sorted(map(float, smaller), reverse=True)]
    steps = [0.0, *(sign * rate for rate in magnitudes for sign in (1.0, -1.0)), 0.0]
    seconds, settle = generator.choice([60.0, 90.0, 120.0]), 20.0
    rows, clock = [], 0.0
    for rate, temperature in zip(steps, steady(generator, nominal, len(steps)), strict=True):
        duration = whole_turn_seconds(rate, seconds) if rate else seconds
        rows.append(Row(clock + duration / 2, round(duration * RAW_RATE), temperature, rate, None if rate else 0.0))
        clock += duration + settle
    return rows


def head_rows(generator: np.random.Generator, positions: int, nominal: float) -> list[Row]:
    """A full circle from a drawn first position."""
    first = 360.0 / positions * generator.integers(positions) + float(generator.choice([0.0, 5.0, 7.5]))
    dwell = generator.choice([30.0, 60.0])
    return [
        Row(
            k * (dwell + 10) + dwell / 2,
            round(dwell * RAW_RATE),
            temperature,
            angle=(first + k * 360 / positions) % 360,
        )
        for k, temperature in zip(range(positions), steady(generator, nominal, positions), strict=True)
    ]


def set_points(generator: np.random.Generator, minutes: np.ndarray, shape: str) -> np.ndarray:
    """Set point of the chamber: one ramp, two ramp rates, up and down again, or two cycles."""
    cold, warm = generator.uniform(-20, 15), generator.uniform(40, 65)
    ends = [cold, warm] if generator.random() < 0.5 else [warm, cold]
    share = minutes / minutes[-1]
    knots = {
        "ramp": ([0.0, 0.15, 0.85, 1.0], [0, 0, 1, 1]),
        "two rates": ([0.0, 0.1, 0.25, 0.4, 0.9, 1.0], [0, 0, 0.5, 0.5, 1, 1]),
        "cycle": ([0.0, 0.1, 0.4, 0.6, 0.9, 1.0], [0, 0, 1, 1, 0, 0]),
        "two cycles": ([0.0, 0.08, 0.25, 0.42, 0.5, 0.7, 0.92, 1.0], [0, 0, 1, 0, 0, 1, 0, 0]),
    }[shape]
    return ends[0] + (ends[1] - ends[0]) * np.interp(share, *knots)


def followed(generator: np.random.Generator, rows: int, shape: str, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Temperatures at the ends of rows (rows + 1) and their means (rows) in a chamber that follows its set points."""
    grid = np.arange(rows * 60 + 1) * seconds / 60
    aim = set_points(generator, grid / 60, shape)
    temperature = np.empty_like(aim)
    temperature[0] = aim[0]
    fade = np.exp(-(grid[1] / 60) / CHAMBER_MINUTES)
    for k in range(1, len(aim)):
        temperature[k] = aim[k] + (temperature[k - 1] - aim[k]) * fade
    means = [float(np.mean(temperature[60 * k : 60 * k + 61])) for k in range(rows)]
    return temperature[::60], np.array(means)


def thermal_rows(generator: np.random.Generator, rows: int, shape: str, seconds: float) -> list[Row]:
    """Rows of `seconds` at rest while the chamber follows its set points; power is switched on at the start."""
    edges, means = followed(generator, rows, shape, seconds)
    return [
        Row(
            (k + 0.5) * seconds,
            round(seconds * RAW_RATE),
            round(float(means[k]), 3),
            temperature_rate=float(edges[k + 1] - edges[k]) / (seconds / 60),
            power_on=(k + 0.5) * seconds,
        )
        for k in range(rows)
    ]


def converter_rows(generator: np.random.Generator, rows: int, current: float | None) -> list[Row]:
    """The converter warms or cools steadily, the sensor is held."""
    seconds, low, high = 120.0, generator.uniform(0, 18), generator.uniform(38, 55)
    start, stop = (low, high) if generator.random() < 0.5 else (high, low)
    rise = (stop - start) / rows
    return [
        Row(
            (k + 0.5) * seconds,
            round(seconds * RAW_RATE),
            25.0,
            converter_temperature=round(start + (k + 0.5) * rise, 4),
            converter_rise=rise,
            current=current,
        )
        for k in range(rows)
    ]


def converter_cycle_rows(generator: np.random.Generator, rows: int, shape: str, current: float | None) -> list[Row]:
    """The converter follows the set points of its chamber after a soak, the sensor is held."""
    seconds = 120.0
    edges, _ = followed(generator, rows, shape, seconds)
    middle, rise = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    return [
        Row(
            (k + 0.5) * seconds,
            round(seconds * RAW_RATE),
            25.0,
            converter_temperature=round(float(middle[k]), 4),
            converter_rise=float(rise[k]),
            current=current,
        )
        for k in range(rows)
    ]


def _names(generator: np.random.Generator, count: int, pyramid: bool) -> list[str]:
    """Seats that show all three axes, turned over at random, and the pyramid."""
    upright = [f"{axis}-{generator.choice(['up', 'down'])}" for axis in generator.permutation(["x", "y", "z"])]
    others = [name for name in SEATS if name not in upright]
    more = [str(name) for name in generator.choice(others, max(count - 3 - pyramid, 0), replace=False)]
    chosen = [*(["pyramid"] if pyramid else []), *upright, *more]
    return chosen[:count]


Content = list[tuple[str, str, str | None, list[Row]]]
"""Procedure, table, mounting and rows of each run."""


def table(generator: np.random.Generator) -> tuple[tuple[Channel, ...], Content]:
    """Rate table in four mountings, dividing head in three, one temperature."""
    names, warm = _names(generator, 4, pyramid=True), generator.uniform(10, 40)
    content: Content = [("rate_table", "rate", name, rate_rows(generator, 5, warm)) for name in names]
    content += [("dividing_head", "head", name, head_rows(generator, 12, warm)) for name in names[1:]]
    return (*GYROS, *ACCELEROMETERS), content


def temperatures(generator: np.random.Generator) -> tuple[tuple[Channel, ...], Content]:
    """Rate table in two mountings and dividing head in two, at three temperatures."""
    names = _names(generator, 3, pyramid=True)
    content: Content = []
    for warm in (generator.uniform(-35, -5), generator.uniform(15, 30), generator.uniform(45, 70)):
        content += [("rate_table", "rate", name, rate_rows(generator, 4, warm)) for name in names[:2]]
        content += [("dividing_head", "head", name, head_rows(generator, 8, warm)) for name in names[1:]]
    return (*GYROS, *ACCELEROMETERS), content


def head(generator: np.random.Generator) -> tuple[tuple[Channel, ...], Content]:
    """Three accelerometers on the dividing head in four mountings, two of them at a second temperature."""
    names, warm = _names(generator, 4, pyramid=False), generator.uniform(10, 40)
    other = warm + generator.choice([-1, 1]) * generator.uniform(10, 35)
    seats = [*((name, warm) for name in names), *((name, other) for name in names[:2])]
    return ACCELEROMETERS, [("dividing_head", "head", name, head_rows(generator, 24, warm)) for name, warm in seats]


def cycle(generator: np.random.Generator) -> tuple[tuple[Channel, ...], Content]:
    """Two long thermal runs, rate table in three mountings, dividing head in two."""
    names = _names(generator, 4, pyramid=True)
    shape = str(generator.choice(["ramp", "two rates", "cycle", "two cycles"]))
    seconds = float(generator.choice([90.0, 120.0, 180.0]))
    content: Content = [
        ("thermal_ramp", "rate", name, thermal_rows(generator, 60, shape, seconds)) for name in names[:2]
    ]
    content += [("rate_table", "rate", name, rate_rows(generator, 4, 25.0)) for name in names[:3]]
    content += [("dividing_head", "head", name, head_rows(generator, 12, 25.0)) for name in names[1:3]]
    return (*GYROS, *ACCELEROMETERS), content


def converter(generator: np.random.Generator) -> tuple[tuple[Channel, ...], Content]:
    """Three accelerometers with current output: converter ramps at rest and with injected current, dividing head."""
    names = _names(generator, 3, pyramid=True)
    content: Content = [("thermal_ramp", "rate", name, converter_rows(generator, 30, None)) for name in names]
    for current in (-1.2 * generator.uniform(2, 6), 1.2 * generator.uniform(6, 12)):
        content.append(("current_injection", "rate", None, converter_rows(generator, 30, round(current, 3))))
    content += [("dividing_head", "head", name, head_rows(generator, 12, 25.0)) for name in names[1:]]
    return WITH_CURRENT, content


def converter_cycle(generator: np.random.Generator) -> tuple[tuple[Channel, ...], Content]:
    """The same with converter temperatures up and down again, at one rate or two."""
    names = _names(generator, 3, pyramid=True)
    shapes = ["two rates", "cycle", "two cycles"]

    def ramp(current: float | None) -> list[Row]:
        return converter_cycle_rows(generator, 50, str(generator.choice(shapes)), current)

    content: Content = [("thermal_ramp", "rate", name, ramp(None)) for name in names]
    for current in (-1.2 * generator.uniform(2, 6), 1.2 * generator.uniform(6, 12)):
        content.append(("current_injection", "rate", None, ramp(round(current, 3))))
    content += [("dividing_head", "head", name, head_rows(generator, 12, 25.0)) for name in names[1:]]
    return WITH_CURRENT, content


def gyros(generator: np.random.Generator) -> tuple[tuple[Channel, ...], Content]:
    """Four gyros on a pyramid: rate table in three mountings at two temperatures, and a thermal run."""
    names, warm = _names(generator, 3, pyramid=False), generator.uniform(-20, 15)
    content: Content = []
    for one in (warm, generator.uniform(35, 65)):
        content += [("rate_table", "rate", name, rate_rows(generator, 5, one)) for name in names]
    shape = str(generator.choice(["two rates", "cycle", "two cycles"]))
    content.append(("thermal_ramp", "rate", names[0], thermal_rows(generator, 60, shape, 120.0)))
    return PYRAMID, content


TEMPLATES: dict[str, Callable[[np.random.Generator], tuple[tuple[Channel, ...], Content]]] = {
    "table": table, "temperatures": temperatures, "head": head, "cycle": cycle, "converter": converter, "gyros": gyros,
    "converter_cycle": converter_cycle,
}  # fmt: skip


def random_plan(template: str, generator: np.random.Generator, model: str | Path | None = None) -> Plan:
    """Draw a plan; its runs are an hour or two apart, in drawn order."""
    channels, content = TEMPLATES[template](generator)
    used = list(dict.fromkeys(name for _, _, name, _ in content if name is not None))
    order = generator.permutation(len(content))
    hour = np.empty(len(content), dtype=int)
    hour[order] = np.cumsum(generator.integers(2, 5, len(content)))
    runs = []
    for index, (procedure, stand, name, rows) in enumerate(content):
        start = f"2026-04-{1 + hour[index] // 24:02d}T{hour[index] % 24:02d}:00:00+00:00"
        label = f"{index + 1:02d}-{procedure.split('_')[0]}-{name or 'injected'}"
        at_table = stand if name is not None else None
        runs.append(Run(label, procedure, rows, at_table, name, start))
    stands = {run.table for run in runs}
    tables = (Table("rate", 0.0, 90.0, 20.0, 5.0), Table("head", 90.0, 0.0, 20.0))
    return Plan(
        name=f"random-{template}",
        purpose=f"A plan drawn at random from the template '{template}'.",
        serial="R0001",
        site=Site(float(np.round(generator.uniform(-60, 65), 2)), float(np.round(generator.uniform(0, 2000)))),
        channels=channels,
        tables=tuple(table for table in tables if table.name in stands),
        mountings=tuple(mounting(name) for name in used),
        runs=tuple(runs),
        angles_per_turn=16,
        model=model,
        script="hidden",
    )

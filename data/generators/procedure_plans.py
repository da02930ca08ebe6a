"""Test plans drawn at random that hold one procedure alone, each with its own unit, equipment and model.

`random_plans` has templates that mix rate table, dividing head and thermal ramps; here every other procedure is by
itself: what it does not show, nothing else does.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import geographic_tumble
import polar_tumble
import random_plans
import reference_gyro
import rotation_modulation
from kinematics import Mounting, Site, Table
from plan import Plan, Row, Run, turning_rows
from random_plans import WITH_CURRENT, Content, converter_cycle_rows, mounting, rate_rows, steady
from reference_gyro import wandering
from sensor import Channel
from serial_plans import on_an_arm, several_axes
from tumble_plans import tumble

_POLAR_SEATS = {
    "O-north": polar_tumble.NORTH, "O-south": polar_tumble.SOUTH, "I-north": polar_tumble.ALONG,
    "I-south": Mounting("I-south", np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]]), 0.5),
    "S-north": Mounting("S-north", np.eye(3), 0.5),
    "S-south": Mounting("S-south", np.array([[-1.0, 0, 0], [0, 1, 0], [0, 0, -1]]), 0.5),
}  # fmt: skip


@dataclass(frozen=True)
class Alone:
    """How a plan with one procedure is drawn, and the shipped model that belongs to it."""

    draw: Callable[[np.random.Generator], Plan]
    model: str


def _site(generator: np.random.Generator) -> Site:
    sign = generator.choice([-1.0, 1.0])
    return Site(float(np.round(sign * generator.uniform(20, 60), 2)), float(np.round(generator.uniform(0, 2000))))


def _start(day: int, hour: int = 8) -> str:
    return f"2026-04-{1 + day:02d}T{hour:02d}:00:00+00:00"


def _plan(name: str, site: Site, channels: tuple[Channel, ...], runs: list[Run], **equipment) -> Plan:
    return Plan(
        name=f"random-{name}", purpose=f"A plan of the procedure '{name}' alone, drawn at random.", serial="R0002",
        site=site, channels=channels, tables=equipment.get("tables", ()), mountings=equipment.get("mountings", ()),
        runs=tuple(runs), angles_per_turn=16, script="hidden",
    )  # fmt: skip


def polar(generator: np.random.Generator) -> Plan:
    """Sweeps with O, I and S along the pole, one of them repeated or at another temperature."""
    site = replace(_site(generator), latitude_deg=float(np.round(generator.uniform(20, 60), 2)))
    names = [f"{axis}-{generator.choice(['north', 'south'])}" for axis in "OIS"]
    seats = [*names, *(name for name in ("O-north", "O-south") if name not in names)]
    warm, other = generator.uniform(15, 35), generator.uniform(45, 60)
    content = [(name, warm) for name in seats] + [(seats[0], other), (seats[1], other)]
    runs = []
    for order, (name, nominal) in enumerate(content):
        dwell, positions = float(generator.choice([60.0, 120.0])), 16
        rows = [
            Row(k * (dwell + 10) + dwell / 2, round(dwell), float(warmth), angle=k * 360 / positions)
            for k, warmth in enumerate(steady(generator, nominal, positions))
        ]
        runs.append(Run(f"{order + 1:02d}-{name}", "polar_tumble", rows, "polar", name, _start(order)))
    used = tuple(_POLAR_SEATS[name] for name in dict.fromkeys(name for name, _ in content))
    tables = (Table("polar", 0.0, site.latitude_deg, 20.0),)
    return _plan("polar_tumble", site, (polar_tumble.GYRO,), runs, tables=tables, mountings=used)


def geographic(generator: np.random.Generator) -> Plan:
    """The positions in drawn order, three times, the last at another temperature."""
    runs = []
    for number, nominal in enumerate((25.0, 25.0, generator.uniform(45, 60))):
        order = generator.permutation(len(geographic_tumble.POSITIONS))
        dwell = float(generator.choice([120.0, 180.0]))
        warmth = steady(generator, nominal, len(order))
        rows = [
            Row((dwell + 60) * k + dwell / 2, round(dwell), float(warmth[k]), axes=geographic_tumble.POSITIONS[place])
            for k, place in enumerate(order)
        ]
        runs.append(Run(f"series-{number + 1}", "geographic_tumble", rows, start=_start(number)))
    return _plan("geographic_tumble", _site(generator), (geographic_tumble.GYRO,), runs)


def modulation(generator: np.random.Generator) -> Plan:
    """A pyramid unit turned forward and reverse, at two rates, whole turns and once an unfinished one."""
    runs = []
    fast, slow = float(generator.choice([6.0, 10.0])), float(generator.choice([2.0, 3.0]))
    for order, (rate, turns) in enumerate(((fast, 6), (-fast, 6), (slow, 2), (-slow, 1.5))):
        arc, count = 30.0, round(turns * 12)
        warmth = steady(generator, 25.0, count)
        rows = turning_rows(np.full(count, rate), np.zeros(count), arc / abs(rate), 50.0, warmth)
        runs.append(Run(f"turn-{order + 1}", "rotation_modulation", rows, "rotary", "pyramid", _start(order)))
    pyramid = replace(mounting("pyramid"), uncertainty_arcmin=2.0)
    tables = (Table("rotary", 0.0, 90.0, 20.0, 20.0),)
    return _plan(
        "rotation_modulation", _site(generator), rotation_modulation.CHANNELS, runs, tables=tables, mountings=(pyramid,)
    )


def reference(generator: np.random.Generator) -> Plan:
    """Three gyros beside a reference gyro, turned about each axis both ways at two speeds, which wander."""
    runs, speeds = [], (float(generator.choice([40.0, 60.0, 100.0])), float(generator.choice([10.0, 20.0])))
    for seat in reference_gyro.SEATS:
        for speed in (*speeds, *(-speed for speed in speeds)):
            rate, rise = wandering(40, 2.0, speed, 0.05, generator)
            rows = turning_rows(rate, rise, 2.0, 100.0, steady(generator, 25.0, len(rate)))
            runs.append(Run(f"{seat} {speed:+g}", "reference_gyro", rows, "ordinary", seat, _start(len(runs))))
    return _plan(
        "reference_gyro", _site(generator), reference_gyro.GYROS, runs, tables=(Table("ordinary", 0.0, 90.0, 20.0),),
        mountings=tuple(Mounting(name, seat, 3.0) for name, seat in reference_gyro.SEATS.items()),
    )  # fmt: skip


def _from_content(name: str, channels: tuple[Channel, ...], content: Content, generator: np.random.Generator) -> Plan:
    runs = [
        Run(f"{k + 1:02d}-{seat or 'injected'}", procedure, rows, stand if seat else None, seat, _start(k))
        for k, (procedure, stand, seat, rows) in enumerate(content)
    ]
    used = tuple(mounting(seat) for seat in dict.fromkeys(seat for _, _, seat, _ in content) if seat is not None)
    return _plan(name, _site(generator), channels, runs, tables=(Table("rate", 0.0, 90.0, 20.0, 5.0),), mountings=used)


def rates(generator: np.random.Generator) -> Plan:
    """Rate series in the three upright mountings and the pyramid, those of the first two at a second temperature."""
    names = [f"{axis}-{generator.choice(['up', 'down'])}" for axis in "xyz"] + ["pyramid"]
    seats = [*((name, 25.0) for name in names), *((name, generator.uniform(40, 60)) for name in names[:2])]
    content: Content = [("rate_table", "rate", name, rate_rows(generator, 6, warm)) for name, warm in seats]
    return _from_content("rate_table", (*random_plans.GYROS, *random_plans.ACCELEROMETERS), content, generator)


def ramps(generator: np.random.Generator) -> Plan:
    """Converter temperatures up and down again, at rest in three mountings and with two injected currents."""
    shapes = ["two rates", "cycle", "two cycles"]

    def ramp(current: float | None) -> list[Row]:
        return converter_cycle_rows(generator, 50, str(generator.choice(shapes)), current)

    names = [f"{generator.choice(['x', 'y', 'z'])}-{way}" for way in ("up", "down")] + ["pyramid"]
    content: Content = [("thermal_ramp", "rate", name, ramp(None)) for name in names]
    for current in (-1.2 * generator.uniform(2, 6), 1.2 * generator.uniform(6, 12)):
        content.append(("current_injection", "rate", None, ramp(round(float(current), 3))))
    return _from_content("thermal_ramp", WITH_CURRENT, content, generator)


def record(generator: np.random.Generator) -> Plan:
    """Five hours at rest from power-on in a room whose temperature drifts; rows are means of three minutes."""
    rows, seconds = 100, 180.0
    hours = np.arange(rows + 1) * seconds / 3600
    swing, period, phase = generator.uniform(1, 3), generator.uniform(2, 6), generator.uniform(0, 2 * np.pi)
    room = generator.uniform(20, 30) + swing * np.sin(2 * np.pi * hours / period + phase)
    held = [
        Row(
            (k + 0.5) * seconds, round(seconds * random_plans.RAW_RATE), round(float(room[k] + room[k + 1]) / 2, 3),
            temperature_rate=float(room[k + 1] - room[k]) / (seconds / 60), power_on=(k + 0.5) * seconds,
        )
        for k in range(rows)
    ]  # fmt: skip
    runs = [Run("night", "static_record", held, "rate", "z-up", _start(0, 20))]
    return _plan(
        "static_record", _site(generator), (*random_plans.GYROS, *random_plans.ACCELEROMETERS), runs,
        tables=(Table("rate", 0.0, 90.0, 20.0),), mountings=(mounting("z-up"),),
    )  # fmt: skip


PLANS = {
    "rate_table": Alone(rates, "hidden-effects"),
    "thermal_ramp": Alone(ramps, "hidden-effects-thermal"),
    "polar_tumble": Alone(polar, "polar-tumble"),
    "geographic_tumble": Alone(geographic, "geographic-tumble"),
    "rotation_modulation": Alone(modulation, "rotation-modulation"),
    "reference_gyro": Alone(reference, "reference-gyro"),
    "free_tumble": Alone(lambda generator: tumble(generator, _site(generator)), "desk-imu"),
    "static_record": Alone(record, "static-record"),
    "multi_axis_table": Alone(lambda generator: several_axes(generator, _site(generator)), "multi-axis-table"),
    "centrifuge": Alone(lambda generator: on_an_arm(generator, _site(generator)), "centrifuge"),
}
"""Procedure → how its plans are drawn.  A dividing head by itself is the template `head` of `random_plans`."""

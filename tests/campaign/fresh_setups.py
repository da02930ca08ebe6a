# pyright: reportMissingImports=false
"""Fresh campaigns of three benches, and one set-up mistake of a drawn kind and size in each.

A dividing-head tumble of a triad of accelerometers in two seats at two temperatures, a rate table of a gyro, and both
of a six-axis unit are simulated here in NumPy; nothing is shared with the package.
"""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import tomlkit
from campaign_files import Files
from kinematics import X_UP, Z_UP, Site, about, rotation
from seeded_mistakes import ANGLED, MISTAKES, Planted

ROOT = Path(__file__).parents[2]

BENCHES = ("triad", "gyro", "imu")
THERMAL = {"accelerometer": "accel_bias_temperature", "gyro": "gyro_bias_temperature"}
SEATS = {
    "up": Z_UP, "down": np.diag([1.0, -1.0, -1.0]), "x": X_UP, "y": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    "a": Z_UP, "b": X_UP.copy(),
}  # fmt: skip
ARCMIN, DEG = np.pi / 10800, np.pi / 180


@dataclass(frozen=True)
class Sensor:
    """Errors of the channels of a kind, SI or ratios: bias, its slope per °C, scale factor, misalignment, noise."""

    names: tuple[str, ...]
    unit: str
    scale: float
    per: str
    noise: float
    bias: float
    slope: float
    ppm: float = 2000.0
    skew: float = 10 * ARCMIN


ACCELEROMETER = Sensor(("ax", "ay", "az"), "LSB", 16384.0, "g", 4.0, 0.05, 4e-4)
GYROS = Sensor(("gx", "gy", "gz"), "LSB", 131.0, "deg/s", 8.0, 1 * DEG, 0.004 * DEG)


def write_campaign(folder: Path, bench: str, seed: int) -> None:
    """Write a campaign without a mistake."""
    draw = np.random.default_rng([seed, BENCHES.index(bench)])
    site = Site(float(np.round(draw.uniform(-60, 60), 1)), 100.0)
    sensors = {"triad": (ACCELEROMETER,), "gyro": (_one_gyro(draw),), "imu": (ACCELEROMETER, GYROS)}[bench]
    zero = float(draw.choice([0.0, 90.0, np.round(draw.uniform(0, 360), 1)]))
    document = {
        "format": 1, "name": f"{bench}-{seed}",
        "site": {"latitude_deg": site.latitude_deg, "height_m": 100.0, "gravity_m_s2": site.gravity},
        "unit": {"serial": f"{bench}-{seed}"},
        "channel": [entry for sensor in sensors for entry in _channels(sensor)],
        "table": [
            {"name": "head", "azimuth_deg": 90.0, "elevation_deg": 0.0, "zero_angle_deg": zero,
             "axis_uncertainty_arcsec": 20.0},
            {"name": "rate", "azimuth_deg": 0.0, "elevation_deg": 90.0, "axis_uncertainty_arcsec": 20.0,
             "rate_uncertainty_ppm": 5.0},
        ],
    }  # fmt: skip
    errors = {
        name: (*draw.normal(0, [s.bias, s.slope, s.ppm * 1e-6]), draw.normal(0, s.skew, 3), _axis(k, s), s)
        for s in sensors for k, name in enumerate(s.names)
    }  # fmt: skip
    runs = _plan(bench, draw)
    used = {seat for _, _, seat, _, _ in runs}
    seats = {seat: SEATS[seat] @ rotation(draw.normal(0, 5 * ARCMIN, 3)) for seat in sorted(used)}
    document["mounting"] = [
        {"name": seat, "body_to_table": SEATS[seat].tolist(), "uncertainty_arcmin": 10.0} for seat in sorted(used)
    ]
    document["run"] = []
    folder.mkdir(parents=True)
    for number, (name, procedure, seat, warm, start) in enumerate(runs):
        table = document["table"][procedure == "rate_table"]
        document["run"].append({
            "name": name, "procedure": procedure, "file": f"{name}.csv", "table": table["name"], "mounting": seat,
            "start": start,
        })  # fmt: skip
        columns, stand, turn = _course(procedure, table, seats[seat], number, draw)
        columns["temperature_degC"] = np.round(warm + 0.6 * np.tanh(columns["time_s"] / 400), 2)
        columns["samples"] = np.full(len(stand), 600)
        force, rate = stand @ site.upward_force, stand @ site.earth_rate + turn
        for channel, (bias, slope, ppm, skew, axis, s) in errors.items():
            felt = (force if s.per == "g" else rate) @ (axis + np.cross(skew, axis))
            gain = s.scale / (site.gravity if s.per == "g" else DEG)
            value = gain * ((1 + ppm) * felt + bias + slope * (columns["temperature_degC"] - 25))
            offset = 2500.0 if s.unit == "mV" else 0.0
            columns[channel] = np.round(offset + value + draw.normal(0, s.noise / np.sqrt(600), len(value)), 5)
            columns[f"{channel}_sd"] = np.round(s.noise * draw.uniform(0.95, 1.05, len(value)), 4)
        body = np.column_stack([columns[name] for name in columns])
        lines = [",".join(columns), *(",".join(f"{value:.9g}" for value in row) for row in body)]
        (folder / f"{name}.csv").write_text("\n".join(lines).replace("nan", "") + "\n", encoding="utf-8")
    if bench != "imu":
        document["table"] = [t for t in document["table"] if any(r["table"] == t["name"] for r in document["run"])]
    (folder / "campaign.toml").write_text(tomlkit.dumps(document), encoding="utf-8")
    start = (ROOT / "models" / "start.toml").read_text(encoding="utf-8")
    kinds = {entry["kind"] for entry in document["channel"]}
    thermal = "".join(f'\n[[effect]]\nname = "{THERMAL[kind]}"\n' for kind in sorted(kinds))
    (folder / "model.toml").write_text(start + thermal, encoding="utf-8")


def _one_gyro(draw: np.random.Generator) -> Sensor:
    return Sensor(("g1",), "mV", float(np.round(draw.uniform(5, 40), 1)), "deg/s", 0.15, 0.2 * DEG, 0.002 * DEG)


def _axis(place: int, sensor: Sensor) -> np.ndarray:
    return np.eye(3)[place if len(sensor.names) == 3 else 2]


def _channels(sensor: Sensor) -> list[dict]:
    kind = "accelerometer" if sensor.per == "g" else "gyro"
    return [
        {
            "name": name, "kind": kind, "input_axis": _axis(k, sensor).tolist(),
            "output_axis": np.roll(_axis(k, sensor), 1).tolist(), "output_unit": sensor.unit, "scale": sensor.scale,
            "per": sensor.per, "noise": sensor.noise, "offset": 2500.0 if sensor.unit == "mV" else 0.0,
        }
        for k, name in enumerate(sensor.names)
    ]  # fmt: skip


def _plan(bench: str, draw: np.random.Generator) -> list[tuple[str, str, str, float, object]]:
    """Runs as name, procedure, seat, temperature and start, two to five hours apart."""
    cold, hot = float(np.round(draw.uniform(18, 24), 1)), float(np.round(draw.uniform(40, 55), 1))
    seats = {"triad": [("dividing_head", "ab")], "gyro": [("rate_table", ["up", "down"])]}
    tests = seats.get(bench, [("rate_table", ["up", "x", "y"]), ("dividing_head", "ab")])
    runs, at = [], datetime(2026, 5, 4, 8, tzinfo=UTC)
    for warm, letter in ((cold, "c"), (hot, "h")):
        for procedure, names in tests:
            for seat in names:
                runs.append((f"{procedure[0]}_{seat}_{letter}", procedure, seat, warm, at))
                at += timedelta(hours=float(draw.integers(2, 6)))
    return runs


def _course(
    procedure: str, table: dict, seat: np.ndarray, number: int, draw: np.random.Generator
) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """Columns of the table, local level → body of each row, and the rate of the table in body axes."""
    level = about(2, -table["azimuth_deg"] * DEG) @ about(0, -(90 - table["elevation_deg"]) * DEG)
    if procedure == "dividing_head":
        step = float(draw.choice([15.0, 30.0]))
        reading = np.arange(0.0, 360.0, step)
        angle = (reading - table.get("zero_angle_deg", 0.0)) * DEG
        stand = seat.T @ np.swapaxes(about(2, angle), 1, 2) @ level.T
        pace = float(np.round(draw.uniform(20, 90)))
        columns = {"time_s": 15 + pace * np.arange(len(reading)), "table_angle_deg": reading}
        return columns, stand, np.zeros((len(reading), 3))
    top = float(draw.choice([50.0, 100.0, 200.0]))
    steps = np.array([0.1, 0.25, 0.5, 0.75, 1.0]) * top
    rate = np.concatenate([[0.0], np.column_stack([steps, -steps]).ravel(), [0.0]])
    columns = {"time_s": 20 + 90.0 * np.arange(len(rate)), "table_rate_deg_s": rate}
    # A whole turn leaves what lies along the axis; at rest the angle is 0.
    along = np.array([0.0, 0, 1])
    mean = np.where((rate == 0)[:, None, None], np.eye(3), np.outer(along, along))
    columns["table_angle_deg"] = np.where(rate == 0, 0.0, np.nan)
    return columns, seat.T @ mean @ level.T, rate[:, None] * DEG * seat[2]


def _column(files: Files, run: dict, name: str, change: Callable[[float], float]) -> None:
    def edit(columns: dict[str, list[str]]) -> None:
        columns[name] = ["" if cell == "" else f"{change(float(cell)):.9g}" for cell in columns[name]]

    files.edit(run, edit)


def _some(files: Files, draw: np.random.Generator, runs: Sequence[dict] | None = None) -> list[dict]:
    """All runs, or one of them."""
    runs = files.runs if runs is None else runs
    return list(runs) if draw.random() < 0.5 else [runs[draw.integers(len(runs))]]


def _names(runs: Sequence[dict]) -> tuple[str, ...]:
    return tuple(f"'{run['name']}'" for run in runs)


TIMES = {"millisecond": 1e3, "microsecond": 1e6, "nanosecond": 1e9, "minute": 1 / 60, "hour": 1 / 3600}


def time_unit(files: Files, draw: np.random.Generator) -> Planted | None:
    """Write the times of all runs, or one, in another unit."""
    unit, runs = str(draw.choice(list(TIMES))), _some(files, draw)
    for run in runs:
        _column(files, run, "time_s", lambda value: value * TIMES[unit])
    return Planted("time_unit", ("time_s", unit, _names(runs)))


def file_twice(files: Files, draw: np.random.Generator) -> Planted | None:
    """Let one run read the file of another of its procedure, by name, as a copy, or as a copy of most rows."""
    pairs = [(a, b) for a in files.runs for b in files.runs if a["procedure"] == b["procedure"] and a is not b]
    first, second = pairs[draw.integers(len(pairs))]
    how = draw.integers(3)
    if how == 0:
        next(each for each in files.document["run"] if each["name"] == second["name"])["file"] = first["file"]
        files.save()
    else:
        shutil.copy(files.folder / first["file"], files.folder / second["file"])
    if how == 2:
        files.edit(second, lambda columns: columns.update({n: cells[3:] for n, cells in columns.items()}))
    return Planted("same_data", (*_names([first, second]),))


def no_temperature(files: Files, draw: np.random.Generator) -> Planted | None:
    """Leave out the column of temperatures in one run."""
    run = files.runs[draw.integers(len(files.runs))]
    files.edit(run, lambda columns: columns.pop("temperature_degC"))
    return Planted("covariate", (*_names([run]), "temperature_degC", "_bias_temperature"))


def temperature_unit(files: Files, draw: np.random.Generator) -> Planted | None:
    """Write the temperatures of all runs or one in K or °F, or in tenths or hundredths of a degree."""
    unit, factor, add = [("kelvin", 1, 273.15), ("Fahrenheit", 1.8, 32), ("tenths", 10, 0), ("hundredths", 100, 0)][
        draw.integers(4)
    ]
    runs = _some(files, draw)
    for run in runs:
        _column(files, run, "temperature_degC", lambda value: value * factor + add)
    return Planted("temperature_unit", ("temperature_degC", unit, _names(runs)))


def angle_unit(files: Files, draw: np.random.Generator) -> Planted | None:
    """Write the angles of all heads, or one, in radians, gon or turns."""
    if not files.of(*ANGLED):
        return None
    unit, factor = [(("rad",), np.pi / 180), (("gon",), 1 / 0.9), (("turns",), 1 / 360)][draw.integers(3)]
    runs = _some(files, draw, files.of(*ANGLED))
    for run in runs:
        _column(files, run, "table_angle_deg", lambda value: value * factor)
    return Planted("angle_unit", ("table_angle_deg", unit, (*_names(runs), "'head'")))


def scale_doubled(files: Files, draw: np.random.Generator) -> Planted | None:
    """State twice or half the scale of one channel."""
    entries = files.document["channel"]
    channel = entries[draw.integers(len(entries))]
    channel["scale"] = float(channel["scale"]) * float(draw.choice([2.0, 0.5]))
    files.save()
    return Planted("scale", (f"'{channel['name']}'", "scale"))


def seat_turned(files: Files, draw: np.random.Generator) -> Planted | None:
    """State a mounting turned about one of its axes by 90 or 180 degrees."""
    entries = files.document["mounting"]
    mounting = entries[draw.integers(len(entries))]
    turn = about(int(draw.integers(3)), float(draw.choice([np.pi / 2, -np.pi / 2, np.pi])))
    angled = any(run["mounting"] == mounting["name"] for run in files.of(*ANGLED))
    if not angled and turn[2, 2] > 0.5:
        return None  # about the axis of the table, of which means over whole turns show nothing
    mounting["body_to_table"] = np.round(turn @ np.array(mounting["body_to_table"], dtype=float), 6).tolist()
    files.save()
    runs = [run for run in files.runs if run["mounting"] == mounting["name"]]
    return Planted("mounting", ((f"'{mounting['name']}'", *_names(runs)), ("mounting", "seat", "body_to_table")))


def elevation_sign(files: Files, draw: np.random.Generator) -> Planted | None:
    """State a vertical axis as pointing down, or a horizontal one as vertical: of one gyro the Earth rate, a bias."""
    if not files.channels("accelerometer"):
        return None
    tables = files.document["table"]
    table = tables[draw.integers(len(tables))]
    table["elevation_deg"] = -90.0 if float(table["elevation_deg"]) else 90.0
    files.save()
    return Planted("elevation", (f"'{table['name']}'", ("elevation", "sense")))


def rate_off(files: Files, draw: np.random.Generator) -> Planted | None:
    """Write the rates of one run 0.5 to 5 % too large or small."""
    runs = files.of("rate_table")
    if not runs:
        return None
    run, factor = runs[draw.integers(len(runs))], 1 + draw.choice([-1, 1]) * draw.uniform(0.005, 0.05)
    _column(files, run, "table_rate_deg_s", lambda value: value * factor)
    return Planted("rate", (*_names([run]), "rate"))


def thermometer_off(files: Files, draw: np.random.Generator) -> Planted | None:
    """Let the thermometer of one run be 10 to 25 °C off."""
    run, off = files.runs[draw.integers(len(files.runs))], draw.choice([-1, 1]) * draw.uniform(10, 25)
    _column(files, run, "temperature_degC", lambda value: value + off)
    return Planted("thermometer", (*_names([run]), "temperature"))


def one_typed(files: Files, draw: np.random.Generator) -> Planted | None:
    """Mistype one angle or one rate by some per cent of the range."""
    run = files.runs[draw.integers(len(files.runs))]
    name = "table_angle_deg" if run["procedure"] in ANGLED else "table_rate_deg_s"

    def edit(columns: dict[str, list[str]]) -> None:
        row = int(draw.integers(1, len(columns[name]) - 1))
        columns[name][row] = f"{float(columns[name][row]) + draw.choice([-1, 1]) * draw.uniform(2, 10):.6g}"

    files.edit(run, edit)
    return Planted("typed", (*_names([run]), name))


def rows_swapped(files: Files, draw: np.random.Generator) -> Planted | None:
    """Exchange the angles, or the rates, of two rows."""
    run = files.runs[draw.integers(len(files.runs))]
    name = "table_angle_deg" if run["procedure"] in ANGLED else "table_rate_deg_s"

    def edit(columns: dict[str, list[str]]) -> None:
        a, b = draw.choice(np.arange(1, len(columns[name]) - 1), 2, replace=False)
        columns[name][a], columns[name][b] = columns[name][b], columns[name][a]

    files.edit(run, edit)
    return Planted("swapped", (*_names([run]), name))


OWN = (
    time_unit, file_twice, no_temperature, temperature_unit, angle_unit, scale_doubled, seat_turned, elevation_sign,
)  # fmt: skip
SHARED = (
    "rate_unit", "axes_exchanged", "sense_reversed", "mislabelled", "files_exchanged", "axis_reversed", "zero_of_run",
)  # fmt: skip
"""What a single run or the set-up shows."""
AGREEMENT = (rate_off, thermometer_off, one_typed, rows_swapped)
"""Mistakes that show in a run that does not agree with the others."""
KINDS: dict[str, Callable[[Files, np.random.Generator], Planted | None]] = {
    **{each.__name__: each for each in OWN}, **{name: MISTAKES[name] for name in SHARED},
    **{each.__name__: each for each in AGREEMENT},
}  # fmt: skip

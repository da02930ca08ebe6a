"""Mistakes planted into campaigns drawn at random: what was done to the files, and what a remedy has to say.

A mistake edits `campaign.toml` or the columns of run tables as text, so that nothing here is shared with the package.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from campaign_files import Files

ANGLED, RATED = ("dividing_head", "polar_tumble"), ("rate_table", "rotation_modulation")


@dataclass(frozen=True)
class Angle:
    """An angle that a message has to state, deg.

    Attributes
    ----------
    stated : pattern of the statement, with the value as its group.
    value : that was planted.
    within : tolerance if the outputs determine the angle well, and the widest if they do not.
    """

    stated: str
    value: float
    within: tuple[float, float]

    def said(self, text: str, uncertainty: float) -> bool:
        """Whether a message states the angle within its tolerance or three times its uncertainty by the outputs."""
        least, most = self.within
        tolerance = max(least, min(3 * uncertainty, most))
        found = [float(each) for each in re.findall(self.stated, text)]
        return any(abs((each - self.value + 180) % 360 - 180) <= tolerance + 1e-9 for each in found)


@dataclass(frozen=True)
class Planted:
    """A mistake in a campaign.

    Attributes
    ----------
    kind : of the mistake.
    named : what the message has to contain; alternatives in a tuple.
    more : plants the same mistake with another angle, deg; None if it has none.
    """

    kind: str
    named: tuple[str | tuple[str, ...] | Angle, ...]
    more: Callable[[Files, float], None] | None = None


CLOSE, LOOSE = (1.0, 5.0), (10.0, 30.0)
"""Tolerances of angles that gravity determines, and of those that the Earth rate determines."""


Mistake = Callable[[Files, np.random.Generator], Planted | None]


def _numbers(cells: list[str], change: Callable[[float], float]) -> list[str]:
    return ["" if cell == "" else f"{change(float(cell)):.9g}" for cell in cells]


def _angle(generator: np.random.Generator) -> float:
    """An offset of 5 to 180 deg, either way, often a right angle."""
    if generator.random() < 0.4:
        return float(generator.choice([90.0, -90.0, 180.0]))
    return float(generator.choice([-1, 1]) * np.round(generator.uniform(5, 175), 1))


def _rows(matrix: np.ndarray) -> str:
    return str((np.round(matrix, 6) + 0.0).tolist())


def _turn(offset: float) -> Callable[[dict[str, list[str]]], None]:
    def change(columns: dict[str, list[str]]) -> None:
        columns["table_angle_deg"] = _numbers(columns["table_angle_deg"], lambda angle: (angle + offset) % 360)

    return change


_ZERO = r"zero of the table angle is off by ([+-][\d.]+) deg"


def _raised(section: str, key: str, name: str = "") -> Callable[[Files, float], None]:
    """Return what adds to an angle that a campaign states."""

    def more(files: Files, by: float) -> None:
        stated = files.document[section]
        entry = stated if not name else next(each for each in stated if each["name"] == name)
        entry[key] = float(entry[key]) + by
        files.save()

    return more


def zero_of_table(files: Files, generator: np.random.Generator) -> Planted | None:
    """Read all angles of the dividing head from another zero."""
    heads, offset = files.of(*ANGLED), _angle(generator)
    if not heads:
        return None
    table = heads[generator.integers(len(heads))]["table"]

    def more(edited: Files, by: float) -> None:
        for run in edited.of(*ANGLED, "rotation_modulation"):
            if run["table"] == table:
                edited.edit(run, _turn(by))

    more(files, offset)
    return Planted("table_zero", (f"'{table}'", Angle(_ZERO, offset, CLOSE)), more)


def zero_of_run(files: Files, generator: np.random.Generator) -> Planted | None:
    """Read the angles of one run from another zero."""
    heads, offset = files.of(*ANGLED), _angle(generator)
    if not heads:
        return None
    run = heads[generator.integers(len(heads))]
    files.edit(run, _turn(offset))
    return Planted(
        "table_zero", (f"'{run['name']}'", Angle(_ZERO, offset, CLOSE)), lambda edited, by: edited.edit(run, _turn(by))
    )


def elevation(files: Files, generator: np.random.Generator) -> Planted | None:
    """State another elevation of the table."""
    used = {run.get("table") for run in files.runs}
    tables = [table for table in files.document["table"] if table["name"] in used]
    table = tables[generator.integers(len(tables))]
    right = float(table["elevation_deg"])
    step = float(generator.choice([5, 10, 15, 30, 45, 60, 90]))
    step = step if generator.random() < 0.6 else float(np.round(generator.uniform(3, 90), 1))
    table["elevation_deg"] = right + step * (-1 if right > 0 else float(generator.choice([-1, 1])))
    files.save()
    said = Angle(r"elevation_deg = (-?[\d.]+)", right, CLOSE)
    return Planted("table_elevation", (f"'{table['name']}'", said), _raised("table", "elevation_deg", table["name"]))


def mislabelled(files: Files, generator: np.random.Generator) -> Planted | None:
    """Name another mounting for one run."""
    runs = files.of(*RATED, *ANGLED)
    run = runs[generator.integers(len(runs))]
    names = [str(mounting["name"]) for mounting in files.document["mounting"] if mounting["name"] != run["mounting"]]
    if not names:
        return None
    wrong = str(generator.choice(names))
    next(entry for entry in files.document["run"] if entry["name"] == run["name"])["mounting"] = wrong
    files.save()
    return Planted("mounting_mislabelled", (f"'{run['mounting']}'", f"'{run['name']}'"))


def files_exchanged(files: Files, generator: np.random.Generator) -> Planted | None:
    """Exchange the files of two runs of a procedure in different mountings."""
    procedure = str(generator.choice([*RATED, *ANGLED]))
    pairs = [(a, b) for a in files.of(procedure) for b in files.of(procedure) if a["mounting"] < b["mounting"]]
    if not pairs:
        return None
    first, second = pairs[generator.integers(len(pairs))]
    for run, other in ((first, second), (second, first)):
        next(entry for entry in files.document["run"] if entry["name"] == run["name"])["file"] = other["file"]
    files.save()
    written = [f"file = \"{run['file']}\" for run '{run['name']}'" for run in (first, second)]
    return Planted("files_exchanged", ("exchange", *written))


def axes_exchanged(files: Files, generator: np.random.Generator) -> Planted | None:
    """Exchange two channels of a kind, in all runs or one."""
    kinds = [kind for kind in ("gyro", "accelerometer") if len(files.channels(kind)) > 1]
    if not kinds:
        return None
    names = files.channels(str(generator.choice(kinds)))
    a, b = (names[k] for k in generator.choice(len(names), 2, replace=False))
    runs = files.of(*RATED, *ANGLED, "thermal_ramp", "current_injection", "reference_gyro")
    if generator.random() < 0.5:
        runs = files.of(*(RATED if a.startswith("g") else ANGLED))
        runs = [run for run in runs if not a.startswith("g") or files.contrast(run, a, b) > 0.1]
        runs = [runs[generator.integers(len(runs))]] if runs else []

    def change(columns: dict[str, list[str]]) -> None:
        for suffix in ("", "_sd"):
            if a + suffix in columns and b + suffix in columns:
                columns[a + suffix], columns[b + suffix] = columns[b + suffix], columns[a + suffix]

    for run in runs:
        files.edit(run, change)
    where = (f"'{runs[0]['name']}'",) if len(runs) == 1 else ()
    return Planted("axes_exchanged", (f"'{a}' holds '{b}'", f"'{b}' holds '{a}'", *where)) if runs else None


def axis_reversed(files: Files, generator: np.random.Generator) -> Planted | None:
    """Reverse the stated input axis of a channel."""
    entries = files.document["channel"]
    channel = entries[generator.integers(len(entries))]
    right = np.array(channel["input_axis"], dtype=float)
    channel["input_axis"] = [-float(value) for value in right]
    files.save()
    axis = _rows(right / np.linalg.norm(right))
    return Planted("channel_unit", ("reversed", f"input_axis = {axis} for '{channel['name']}'"))


def column_reversed(files: Files, generator: np.random.Generator) -> Planted | None:
    """Reverse the sign of a channel in one run, whose input it sees."""
    kind = str(generator.choice([str(channel["kind"]) for channel in files.document["channel"]]))
    name = str(generator.choice(files.channels(kind)))
    procedures = RATED if kind == "gyro" else ("dividing_head",)
    runs = [run for run in files.of(*procedures) if files.has(run, name) and files.input_along(run, name, kind) > 0.1]
    if not runs:
        return None
    run = runs[generator.integers(len(runs))]
    offset = next(float(each.get("offset", 0.0)) for each in files.document["channel"] if each["name"] == name)

    def change(columns: dict[str, list[str]]) -> None:
        columns[name] = _numbers(columns[name], lambda value: 2 * offset - value)

    files.edit(run, change)
    return Planted(
        "channel_unit", (("reversed", "sign_reversed", "-1"), f"'{name}'", (f"'{run['name']}'", run["file"]))
    )


def sense_reversed(files: Files, generator: np.random.Generator) -> Planted | None:
    """Write rates and angles of a table with the opposite sign."""
    heads = files.of(*ANGLED)
    runs = heads if heads and generator.random() < 0.5 else files.of(*RATED)
    if not runs:
        return None
    runs = [run for run in runs if run["table"] == runs[0]["table"]]

    def change(columns: dict[str, list[str]]) -> None:
        for name in ("table_rate_deg_s", "table_angle_deg"):
            if name in columns:
                columns[name] = _numbers(columns[name], lambda value: -value + 0.0)

    for run in runs:
        files.edit(run, change)
    return Planted("table_reversed", ("sense", f"'{runs[0]['table']}'"))


def rate_unit(files: Files, generator: np.random.Generator) -> Planted | None:
    """Write the rates in another unit, in one run or all."""
    runs = files.of(*RATED)
    if not runs:
        return None
    unit, factor = [("rpm", 1 / 6), ("rad/s", np.pi / 180), ("deg/h", 3600.0)][generator.integers(3)]
    whole = generator.random() < 0.5
    chosen = runs if whole else [runs[generator.integers(len(runs))]]

    def change(columns: dict[str, list[str]]) -> None:
        columns["table_rate_deg_s"] = _numbers(columns["table_rate_deg_s"], lambda rate: rate * factor)

    for run in chosen:
        files.edit(run, change)
    where = () if whole else ((f"'{chosen[0]['name']}'", chosen[0]["file"]),)
    return Planted("rate_unit", ("table_rate_deg_s", unit, *where))


def latitude(files: Files, generator: np.random.Generator) -> Planted | None:
    """Negate the latitude."""
    if not files.channels("gyro"):
        return None
    files.document["site"]["latitude_deg"] = -float(files.document["site"]["latitude_deg"])
    files.save()
    return Planted("latitude_sign", ("latitude",))


def _shifted(shift: int) -> Callable[[dict[str, list[str]]], None]:
    """Let the outputs stand so many rows later than the columns of the table."""

    def change(columns: dict[str, list[str]]) -> None:
        for name, cells in columns.items():
            if name in ("table_rate_deg_s", "table_angle_deg"):
                columns[name] = cells[shift:] if shift > 0 else cells[:shift]
            else:
                columns[name] = cells[:-shift] if shift > 0 else cells[-shift:]

    return change


def time_shift(files: Files, generator: np.random.Generator) -> Planted | None:
    """Shift the outputs of a run by a row or two against the table."""
    runs = files.of(*RATED)
    if not runs:
        return None
    run, shift = runs[generator.integers(len(runs))], int(generator.choice([-2, -1, 1, 2]))
    files.edit(run, _shifted(shift))
    return Planted("time_shift", ("later" if shift > 0 else "earlier", f"{abs(shift)} rows", f"'{run['name']}'"))


def time_shift_of_head(files: Files, generator: np.random.Generator) -> Planted | None:
    """Shift the outputs of a head against its angles by a row or two: at equal steps the same as another zero."""
    heads = files.of(*ANGLED)
    if not heads:
        return None
    run, shift = heads[generator.integers(len(heads))], int(generator.choice([-2, -1, 1, 2]))
    files.edit(run, _shifted(shift))
    shifted = f"{abs(shift)} rows {'later' if shift > 0 else 'earlier'}"
    return Planted("time_shift", ((shifted, "zero of the table angle"), f"'{run['name']}'"))


def azimuth(files: Files, generator: np.random.Generator) -> Planted | None:
    """State another azimuth of a table."""
    used = {run.get("table") for run in files.of(*ANGLED)}
    tables = [table for table in files.document["table"] if table["name"] in used]
    if not tables or not files.channels("gyro"):
        return None
    table = tables[generator.integers(len(tables))]
    right = float(table["azimuth_deg"])
    off = float(generator.choice([90, 180, 270])) if generator.random() < 0.6 else float(generator.integers(30, 330))
    table["azimuth_deg"] = (right + off) % 360
    files.save()
    said = Angle(r"azimuth_deg = (-?[\d.]+)", right, LOOSE)
    return Planted("table_azimuth", (f"'{table['name']}'", said), _raised("table", "azimuth_deg", table["name"]))


def mounting_matrix(files: Files, generator: np.random.Generator) -> Planted | None:
    """State a mounting as its transpose, or turned over."""
    used = {run.get("mounting") for run in files.of(*RATED, *ANGLED)}
    stated = [each for each in files.document["mounting"] if each["name"] in used and "body_to_table" in each]
    if not stated:
        return None
    mounting = stated[generator.integers(len(stated))]
    matrix = np.array(mounting["body_to_table"], dtype=float)
    turned_over = matrix * [[1], [-1], [-1]]
    wrong = matrix.T if generator.random() < 0.5 and not np.allclose(matrix, matrix.T) else turned_over
    mounting["body_to_table"] = [[float(value) for value in row] for row in wrong]
    files.save()
    # Without angles a turn about the axis of the table does not show.
    turned = any(run["mounting"] == mounting["name"] for run in files.of(*ANGLED))
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turns = [np.linalg.matrix_power(quarter, k) @ matrix for k in range(1 if turned else 4)]
    return Planted("mounting_wrong", (f"'{mounting['name']}'", tuple(f"body_to_table = {_rows(m)}" for m in turns)))


def mountings_exchanged(files: Files, generator: np.random.Generator) -> Planted | None:
    """Exchange the names of two mountings in all runs of one procedure."""
    procedure = str(generator.choice([*RATED, *ANGLED]))
    names = list(dict.fromkeys(run["mounting"] for run in files.of(procedure)))
    if len(names) < 2:
        return None
    first, second = (names[k] for k in generator.choice(len(names), 2, replace=False))
    chosen = [run for run in files.of(procedure) if run["mounting"] in (first, second)]
    for run in chosen:
        entry = next(each for each in files.document["run"] if each["name"] == run["name"])
        entry["mounting"] = second if run["mounting"] == first else first
    files.save()
    said = f"'{chosen[0]['name']}'" if len(chosen) == 2 else f"'{first}'"
    return Planted("mounting_mislabelled", (said, f"'{second}'" if len(chosen) > 2 else f"'{chosen[1]['name']}'"))


def channel_unit(files: Files, generator: np.random.Generator) -> Planted | None:
    """State the scale of one channel, or of all of a kind, in another unit."""
    kinds = [kind for kind in ("gyro", "accelerometer") if files.channels(kind)]
    kind = str(generator.choice(kinds))
    factor = float(generator.choice([180 / np.pi, np.pi / 180, 3600.0] if kind == "gyro" else [9.80665, 1000.0]))
    entries = [each for each in files.document["channel"] if each["kind"] == kind]
    chosen = entries if generator.random() < 0.5 else [entries[generator.integers(len(entries))]]
    for channel in chosen:
        channel["scale"] = float(channel["scale"]) * factor
    files.save()
    name = f"'{chosen[0]['name']}'"
    named = (name, "every gyro") if chosen is entries else (name,)
    return Planted(
        "channel_unit", (named, ("times too", "times its nominal scale", "'per'", "correct the gyros' scale"))
    )


def angle_unit(files: Files, generator: np.random.Generator) -> Planted | None:
    """Write the angles of all heads in radians."""
    heads = files.of(*ANGLED)

    def change(columns: dict[str, list[str]]) -> None:
        columns["table_angle_deg"] = _numbers(columns["table_angle_deg"], np.radians)

    for run in heads:
        files.edit(run, change)
    return Planted("angle_unit", ("table_angle_deg", ("radians", "in rad"))) if heads else None


def latitude_value(files: Files, generator: np.random.Generator) -> Planted | None:
    """State another latitude."""
    right = float(files.document["site"]["latitude_deg"])
    wrong = [value for value in (0.0, 15.0, -25.0, 34.25, 48.0, -60.0, 75.0) if abs(value - right) > 20]
    files.document["site"]["latitude_deg"] = float(generator.choice(wrong))
    files.save()
    said = Angle(r"latitude_deg = (-?[\d.]+)", right, (15.0, LOOSE[1]))
    return Planted("latitude_value", (said,), _raised("site", "latitude_deg"))


def height(files: Files, generator: np.random.Generator) -> Planted | None:
    """State the height in feet, or one that is 3 km off."""
    right = float(files.document["site"]["height_m"])
    files.document["site"]["height_m"] = float(generator.choice([right * 3.2808, right + 3000.0]))
    files.save()
    return Planted("height", ("height_m",))


def _with_temperatures(files: Files) -> list[dict]:
    return files.of(*RATED, *ANGLED, "thermal_ramp")


def _fahrenheit(columns: dict[str, list[str]]) -> None:
    for name in ("temperature_degC", "converter_temperature_degC"):
        if name in columns:
            columns[name] = _numbers(columns[name], lambda value: 1.8 * value + 32)


def fahrenheit(files: Files, generator: np.random.Generator) -> Planted | None:
    """Write the temperatures of one run in degrees Fahrenheit."""
    runs = _with_temperatures(files)
    run = runs[generator.integers(len(runs))]
    files.edit(run, _fahrenheit)
    return Planted("temperature_unit", ("Fahrenheit", f"'{run['name']}'"))


def fahrenheit_throughout(files: Files, generator: np.random.Generator) -> Planted | None:
    """Write all temperatures in degrees Fahrenheit."""
    for run in files.runs:
        files.edit(run, _fahrenheit)
    return Planted("temperature_unit", ("Fahrenheit",))


def thermometers(files: Files, generator: np.random.Generator) -> Planted | None:
    """Exchange the thermometers of sensor and converter, in all runs or one."""
    names = ("temperature_degC", "converter_temperature_degC")
    runs = [run for run in _with_temperatures(files) if files.has(run, names[1])]
    if not runs:
        return None
    chosen = runs if generator.random() < 0.5 else [runs[generator.integers(len(runs))]]

    def change(columns: dict[str, list[str]]) -> None:
        columns[names[0]], columns[names[1]] = columns[names[1]], columns[names[0]]

    for run in chosen:
        files.edit(run, change)
    return Planted("thermometers_exchanged", (names[1], "exchanged"))


def temperature_reversed(files: Files, generator: np.random.Generator) -> Planted | None:
    """Turn the columns of temperatures of a thermal run round."""
    runs = files.of("thermal_ramp")
    if not runs:
        return None
    run = runs[generator.integers(len(runs))]

    def change(columns: dict[str, list[str]]) -> None:
        for name in ("temperature_degC", "converter_temperature_degC"):
            if name in columns:
                columns[name] = columns[name][::-1]

    files.edit(run, change)
    return Planted("temperature_reversed", ("backwards", f"'{run['name']}'"))


MISTAKES: dict[str, Mistake] = {
    function.__name__: function
    for function in (
        zero_of_table, zero_of_run, elevation, mislabelled, files_exchanged, axes_exchanged, axis_reversed,
        sense_reversed, rate_unit, latitude, time_shift, azimuth, mounting_matrix, channel_unit, angle_unit,
        column_reversed, time_shift_of_head, mountings_exchanged,
        latitude_value, height, fahrenheit, fahrenheit_throughout, thermometers, temperature_reversed,
    )
}  # fmt: skip


def plant(folder: Path, name: str, seed: int) -> Planted | None:
    """Plant a mistake into the files of a campaign; None if it cannot be made there."""
    return MISTAKES[name](Files(folder), np.random.default_rng([seed, 2]))


def says(planted: Planted, text: str, uncertainty: float = 0.0) -> bool:
    """Whether a message names a planted mistake, its angle to within so many degrees of standard deviation."""
    plain = re.sub(r"\s+", " ", text)

    def said(part: str | tuple[str, ...] | Angle) -> bool:
        if isinstance(part, Angle):
            return part.said(plain, uncertainty)
        return any(each in plain for each in ((part,) if isinstance(part, str) else part))

    return all(said(part) for part in planted.named)

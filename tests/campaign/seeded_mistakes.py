"""Mistakes planted into campaigns drawn at random: what was done to the files, and what a remedy has to say.

The campaigns come from `data/generators`; a mistake edits `campaign.toml` or the columns of run tables as text, so that
nothing here is shared with the package.
"""

import csv
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomlkit
from random_plans import TEMPLATES, random_plan
from simulate import write_simulated

PLANS = ("table", "temperatures", "head", "cycle", "gyros", "converter")
MODELS = {"head": "hidden-effects", "converter": "hidden-effects-thermal", "cycle": "hidden-effects-thermal"}


@dataclass(frozen=True)
class Planted:
    """A mistake in a campaign.

    Attributes
    ----------
    kind : of the mistake.
    named : texts, each of which the message has to contain; alternatives in a tuple.
    """

    kind: str
    named: tuple[str | tuple[str, ...], ...]


class Files:
    """The files of a campaign, for edits."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.document = tomlkit.parse((folder / "campaign.toml").read_text(encoding="utf-8"))
        self.runs = [dict(run) for run in self.document["run"]]

    def of(self, *procedures: str) -> list[dict]:
        return [run for run in self.runs if run["procedure"] in procedures]

    def channels(self, kind: str) -> list[str]:
        return [str(channel["name"]) for channel in self.document["channel"] if channel["kind"] == kind]

    def contrast(self, run: dict, first: str, second: str) -> float:
        """Difference of the rates that two channels see in a run, as a share of that of the table.

        Decides beforehand whether an exchange of the two can be seen.
        """
        mounting = next(each for each in self.document["mounting"] if each["name"] == run["mounting"])
        axis = np.array(mounting.get("body_to_table", [[3**-0.5] * 3] * 3)[2], dtype=float)
        inputs = {str(each["name"]): np.array(each["input_axis"], dtype=float) for each in self.document["channel"]}
        return abs(float(axis @ (inputs[first] - inputs[second])))

    def save(self) -> None:
        (self.folder / "campaign.toml").write_text(tomlkit.dumps(self.document), encoding="utf-8")

    def edit(self, run: dict, change: Callable[[dict[str, list[str]]], None]) -> None:
        """Change the columns of a run table, name → cells."""
        file = self.folder / run["file"]
        with file.open(encoding="utf-8", newline="") as stream:
            head, *rows = list(csv.reader(stream))
        columns = {name: [row[place] for row in rows] for place, name in enumerate(head)}
        change(columns)
        with file.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))


Mistake = Callable[[Files, np.random.Generator], Planted | None]


def _numbers(cells: list[str], change: Callable[[float], float]) -> list[str]:
    return ["" if cell == "" else f"{change(float(cell)):.9g}" for cell in cells]


def _angle(generator: np.random.Generator) -> float:
    """An offset of 5 to 180 deg, either way, often a right angle."""
    if generator.random() < 0.4:
        return float(generator.choice([90.0, -90.0, 180.0]))
    return float(generator.choice([-1, 1]) * np.round(generator.uniform(5, 175), 1))


def _turn(offset: float) -> Callable[[dict[str, list[str]]], None]:
    def change(columns: dict[str, list[str]]) -> None:
        columns["table_angle_deg"] = _numbers(columns["table_angle_deg"], lambda angle: (angle + offset) % 360)

    return change


def zero_of_table(files: Files, generator: np.random.Generator) -> Planted | None:
    """Read all angles of the dividing head from another zero."""
    heads, offset = files.of("dividing_head"), _angle(generator)
    for run in heads:
        files.edit(run, _turn(offset))
    return Planted("table_zero", ("zero of the table angle", "'head'", _angle_text(offset))) if heads else None


def zero_of_run(files: Files, generator: np.random.Generator) -> Planted | None:
    """Read the angles of one run from another zero."""
    heads, offset = files.of("dividing_head"), _angle(generator)
    if not heads:
        return None
    run = heads[generator.integers(len(heads))]
    files.edit(run, _turn(offset))
    return Planted("table_zero", ("zero of the table angle", f"'{run['name']}'", _angle_text(offset)))


def _angle_text(offset: float) -> tuple[str, ...]:
    """How an offset may be written to within a degree."""
    folded = (offset + 180) % 360 - 180
    near = [folded + step / 10 for step in range(-10, 11)]
    texts = [f"{(value + 180) % 360 - 180:+.0f}" for value in near]
    return tuple(dict.fromkeys(texts)) + (("+180",) if abs(abs(folded) - 180) < 1 else ())


def elevation(files: Files, generator: np.random.Generator) -> Planted | None:
    """State another elevation of the table."""
    used = {run.get("table") for run in files.runs}
    tables = [table for table in files.document["table"] if table["name"] in used]
    table = tables[generator.integers(len(tables))]
    if table["name"] == "rate" and not files.channels("accelerometer"):
        return None
    right = float(table["elevation_deg"])
    step = float(generator.choice([5, 10, 15, 30, 45, 60, 90]))
    table["elevation_deg"] = right + step * (-1 if right > 0 else float(generator.choice([-1, 1])))
    files.save()
    return Planted("table_elevation", ("elevation", f"'{table['name']}'"))


def mislabelled(files: Files, generator: np.random.Generator) -> Planted | None:
    """Name another mounting for one run."""
    runs = files.of("rate_table", "dividing_head")
    run = runs[generator.integers(len(runs))]
    names = [str(mounting["name"]) for mounting in files.document["mounting"] if mounting["name"] != run["mounting"]]
    wrong = str(generator.choice(names))
    next(entry for entry in files.document["run"] if entry["name"] == run["name"])["mounting"] = wrong
    files.save()
    return Planted("mounting_mislabelled", (f"'{run['mounting']}'", f"'{run['name']}'"))


def files_exchanged(files: Files, generator: np.random.Generator) -> Planted | None:
    """Exchange the files of two runs of a procedure in different mountings."""
    procedure = str(generator.choice(["rate_table", "dividing_head"]))
    pairs = [(a, b) for a in files.of(procedure) for b in files.of(procedure) if a["mounting"] < b["mounting"]]
    if not pairs:
        return None
    first, second = pairs[generator.integers(len(pairs))]
    for run, other in ((first, second), (second, first)):
        next(entry for entry in files.document["run"] if entry["name"] == run["name"])["file"] = other["file"]
    files.save()
    return Planted("files_exchanged", ("exchange", f"'{first['name']}'", f"'{second['name']}'"))


def axes_exchanged(files: Files, generator: np.random.Generator) -> Planted | None:
    """Exchange two channels of a kind, in all runs or one."""
    kinds = [kind for kind in ("gyro", "accelerometer") if files.channels(kind)]
    names = files.channels(str(generator.choice(kinds)))
    a, b = (names[k] for k in generator.choice(len(names), 2, replace=False))
    runs = files.of("rate_table", "dividing_head", "thermal_ramp", "current_injection")
    if generator.random() < 0.5:
        runs = files.of("rate_table" if a.startswith("g") else "dividing_head")
        runs = [run for run in runs if not a.startswith("g") or files.contrast(run, a, b) > 0.1]
        runs = [runs[generator.integers(len(runs))]] if runs else []

    def change(columns: dict[str, list[str]]) -> None:
        for suffix in ("", "_sd"):
            if a + suffix in columns and b + suffix in columns:
                columns[a + suffix], columns[b + suffix] = columns[b + suffix], columns[a + suffix]

    for run in runs:
        files.edit(run, change)
    return Planted("axes_exchanged", (f"'{a}'", f"'{b}'")) if runs else None


def axis_reversed(files: Files, generator: np.random.Generator) -> Planted | None:
    """Reverse the stated input axis of a channel."""
    entries = files.document["channel"]
    channel = entries[generator.integers(len(entries))]
    channel["input_axis"] = [-float(value) for value in channel["input_axis"]]
    files.save()
    return Planted("channel_unit", ("reversed", f"'{channel['name']}'"))


def sense_reversed(files: Files, generator: np.random.Generator) -> Planted | None:
    """Write rates and angles of a table with the opposite sign."""
    heads = files.of("dividing_head")
    runs = heads if heads and generator.random() < 0.5 else files.of("rate_table")
    if not runs:
        return None

    def change(columns: dict[str, list[str]]) -> None:
        for name in ("table_rate_deg_s", "table_angle_deg"):
            if name in columns:
                columns[name] = _numbers(columns[name], lambda value: -value + 0.0)

    for run in runs:
        files.edit(run, change)
    return Planted("table_reversed", ("sense", f"'{runs[0]['table']}'"))


def rate_unit(files: Files, generator: np.random.Generator) -> Planted | None:
    """Write the rates in another unit, in one run or all."""
    runs = files.of("rate_table")
    if not runs:
        return None
    unit, factor = [("rpm", 1 / 6), ("rad/s", np.pi / 180), ("deg/h", 3600.0)][generator.integers(3)]
    whole = generator.random() < 0.5
    chosen = runs if whole else [runs[generator.integers(len(runs))]]

    def change(columns: dict[str, list[str]]) -> None:
        columns["table_rate_deg_s"] = _numbers(columns["table_rate_deg_s"], lambda rate: rate * factor)

    for run in chosen:
        files.edit(run, change)
    return Planted("rate_unit", ("table_rate_deg_s", unit))


def latitude(files: Files, generator: np.random.Generator) -> Planted | None:
    """Negate the latitude."""
    if not files.channels("gyro"):
        return None
    files.document["site"]["latitude_deg"] = -float(files.document["site"]["latitude_deg"])
    files.save()
    return Planted("latitude_sign", ("latitude",))


def time_shift(files: Files, generator: np.random.Generator) -> Planted | None:
    """Shift the outputs of a run by a row or two against the table."""
    runs = files.of("rate_table")
    if not runs:
        return None
    run, shift = runs[generator.integers(len(runs))], int(generator.choice([-2, -1, 1, 2]))

    def change(columns: dict[str, list[str]]) -> None:
        for name in ("table_rate_deg_s", "table_angle_deg"):
            cells = columns[name]
            columns[name] = cells[shift:] if shift > 0 else cells[:shift]
        for name, cells in columns.items():
            if name not in ("table_rate_deg_s", "table_angle_deg"):
                columns[name] = cells[:-shift] if shift > 0 else cells[-shift:]

    files.edit(run, change)
    return Planted("time_shift", ("later" if shift > 0 else "earlier", f"{abs(shift)} rows", f"'{run['name']}'"))


MISTAKES: dict[str, Mistake] = {
    function.__name__: function
    for function in (
        zero_of_table, zero_of_run, elevation, mislabelled, files_exchanged, axes_exchanged, axis_reversed,
        sense_reversed, rate_unit, latitude, time_shift,
    )
}  # fmt: skip


def valid_campaign(folder: Path, seed: int) -> str:
    """Write a valid campaign drawn at random; return the name of its template."""
    generator = np.random.default_rng([seed, 1])
    template = PLANS[seed % len(PLANS)]
    assert template in TEMPLATES
    plan = random_plan(template, generator, MODELS.get(template, "hidden-effects"))
    write_simulated(folder, plan, seed)
    return template


def plant(folder: Path, name: str, seed: int) -> Planted | None:
    """Plant a mistake into the files of a campaign; None where it cannot be made there."""
    return MISTAKES[name](Files(folder), np.random.default_rng([seed, 2]))


def says(planted: Planted, text: str) -> bool:
    """Whether a message names a planted mistake."""
    plain = re.sub(r"\s+", " ", text)
    return all(any(each in plain for each in ((part,) if isinstance(part, str) else part)) for part in planted.named)

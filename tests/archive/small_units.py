"""Campaigns of many units for tests: the shipped polar tumble with other readings, and ten ways of damaging one."""

import csv
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

DATA = Path(__file__).parents[2] / "data"
MODELS = Path(__file__).parents[2] / "models"
MODEL = MODELS / "polar-tumble.toml"


def make_units(folder: Path, count: int, seed: int = 0, source: str = "polar-tumble") -> list[Path]:
    """Write campaigns of units U000, U001, …: readings of the shipped one with an offset and noise of their own."""
    random = np.random.default_rng(seed)
    made = []
    for place in range(count):
        unit = folder / f"unit-{place:03d}"
        shutil.copytree(DATA / source, unit)
        (unit / "truth.toml").unlink()
        edit(unit / "campaign.toml", 'serial = "', f'serial = "U{place:03d}-')
        offset = random.normal(0, 2e-3)
        for file in sorted((unit / "runs").glob("*.csv")):
            change_readings(file, lambda values, offset=offset: values + offset + random.normal(0, 4e-4, len(values)))
        made.append(unit)
    return made


def edit(file: Path, old: str, new: str) -> None:
    """Replace a text that occurs in a file."""
    text = file.read_text()
    assert old in text, (file, old)
    file.write_text(text.replace(old, new))


def change_readings(file: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Change the readings of the gyro in a table."""
    with file.open() as stream:
        head, *rows = csv.reader(stream)
    place = head.index("g")
    values = change(np.array([float(row[place]) for row in rows]))
    for row, value in zip(rows, values, strict=True):
        row[place] = f"{value:.5f}"
    with file.open("w", newline="") as stream:
        csv.writer(stream).writerows([head, *rows])


def _first_table(unit: Path) -> Path:
    return sorted((unit / "runs").glob("*.csv"))[0]


def _without_readings(unit: Path) -> None:
    for file in (unit / "runs").glob("*.csv"):
        change_readings(file, lambda values: np.full(len(values), np.nan))


DAMAGE: dict[str, Callable[[Path], object]] = {
    "the table of a run is missing": lambda unit: _first_table(unit).unlink(),
    "a table is empty": lambda unit: _first_table(unit).write_text(""),
    "a table is cut off within a row": lambda unit: _first_table(unit).write_text(_first_table(unit).read_text()[:120]),
    "a reading is no number": lambda unit: edit(_first_table(unit), "0.0", "O.O"),
    "a column is missing": lambda unit: edit(_first_table(unit), ",g,", ",h,"),
    "no reading at all": _without_readings,
    "the campaign file is no TOML": lambda unit: edit(unit / "campaign.toml", "[site]", "[site"),
    "a key is missing": lambda unit: edit(unit / "campaign.toml", "latitude_deg = 34.25", ""),
    "an unknown procedure": lambda unit: edit(unit / "campaign.toml", 'procedure = "polar_tumble"', 'procedure = "x"'),
    "the model does not fit": lambda unit: edit(unit / "campaign.toml", 'kind = "gyro"', 'kind = "accelerometer"'),
}

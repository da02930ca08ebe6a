"""Forty and more spoilt campaigns and model files: each is refused in four parts, at the right place."""
# ruff: noqa: E501

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest
from small_files import MODEL, write_csv

from imubayes.campaign import load_campaign, read_model_file
from imubayes.foundations.errors import InputError, Issue

Spoil = Callable[[Path], None]


def swap(file: str, old: str, new: str, every: bool = False) -> Spoil:
    def spoil(folder: Path) -> None:
        text = (folder / file).read_text()
        assert old in text, f"{old!r} is not in {file}"
        (folder / file).write_text(text.replace(old, new) if every else text.replace(old, new, 1))

    return spoil


def toml(old: str, new: str) -> Spoil:
    return swap("campaign.toml", old, new)


def with_thermometer(old: str, new: str) -> Spoil:
    def spoil(folder: Path) -> None:
        for spoilt in (toml("[unit]", '[[thermometer]]\nname = "Pt"\n[unit]'), toml(old, new)):
            spoilt(folder)

    return spoil


def column(file: str, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    def spoil(folder: Path) -> None:
        table = pacsv.read_csv(folder / file)
        columns = {key: table.column(key).combine_chunks() for key in table.column_names}
        columns[name] = change(columns[name].to_numpy().astype(float))
        write_csv(folder / file, columns)

    return spoil


def rename(file: str, old: str, new: str) -> Spoil:
    return swap(file, f'"{old}"', f'"{new}"')


def cells(file: str, line: int, position: int, value: str) -> Spoil:
    def spoil(folder: Path) -> None:
        lines = (folder / file).read_text().splitlines()
        parts = lines[line - 1].split(",")
        parts[position] = value
        lines[line - 1] = ",".join(parts)
        (folder / file).write_text("\n".join(lines) + "\n")

    return spoil


def cut(file: str, keep: float) -> Spoil:
    def spoil(folder: Path) -> None:
        data = (folder / file).read_bytes()
        (folder / file).write_bytes(data[: int(len(data) * keep)])

    return spoil


def lines(file: str, change: Callable[[list[str]], list[str]]) -> Spoil:
    def spoil(folder: Path) -> None:
        (folder / file).write_text("\n".join(change((folder / file).read_text().splitlines())) + "\n")

    return spoil


def remove(file: str) -> Spoil:
    return lambda folder: (folder / file).unlink()


def nan_in_parquet(folder: Path) -> None:
    table = pq.read_table(folder / "runs/ramp.parquet")
    values = table.column("az").to_numpy().copy()
    values[6] = np.nan
    pq.write_table(
        table.set_column(table.column_names.index("az"), "az", pa.array(values)), folder / "runs/ramp.parquet"
    )


def text_in_parquet(folder: Path) -> None:
    table = pq.read_table(folder / "runs/ramp.parquet")
    texts = pa.array(["warm"] * table.num_rows)
    place = table.column_names.index("converter_temperature_degC")
    pq.write_table(table.set_column(place, "converter_temperature_degC", texts), folder / "runs/ramp.parquet")


RATES, POSITIONS, RAW = "runs/rates.csv", "runs/positions.csv", "runs/raw.csv"
HEADER = 1

# name → how it is spoilt, what the message must say, where it must point, what it must offer
CAMPAIGNS: dict[str, tuple[Spoil, str, str, str]] = {
    "no campaign file": (remove("campaign.toml"), "no file 'campaign.toml'", "campaign.toml", "a folder with campaign.toml"),
    "broken toml": (toml("height_m = 100.0", "height_m = = 1"), "not valid TOML", r"campaign\.toml:6", "key = value"),
    "open toml": (
        lambda f: (f / "campaign.toml").write_text("rates = [", encoding="utf-8"),
        "not valid TOML", r"campaign\.toml, at its end", "key",
    ),
    "key twice": (toml("height_m = 100.0", "height_m = 1.0\nheight_m = 2.0"), "not valid TOML", r"campaign\.toml:7", "key"),
    "not utf-8": (lambda f: (f / "campaign.toml").write_bytes(b"name = \xff"), "not UTF-8", r"campaign\.toml:1", "Latin-1"),
    "a later line not utf-8": (
        lambda f: (f / "campaign.toml").write_bytes(b"format = 1\r\nname = \"Pr\xfcfling\"\r\n"), "not UTF-8", r"campaign\.toml:2", "Latin-1",
    ),
    "other format": (toml("format = 1", "format = 7"), "format = 7", r"campaign\.toml:1, format", "1"),
    "no name": (toml('name = "small"\n', ""), "has no 'name'", r"campaign\.toml", "name"),
    "unknown section": (toml("[unit]", "[units]"), "unknown key 'units'", r"campaign\.toml:9, units", "unit"),
    "unknown key": (toml("height_m", "heigth_m"), "unknown key 'heigth_m'", r"campaign\.toml:6, site\.heigth_m", "height_m"),
    "unknown key of a channel": (toml("offset = 0.0", "ofset = 0.0"), "unknown key", r":19, channel\[0\]\.ofset", "offset"),
    "latitude out of range": (toml("latitude_deg = 45.0", "latitude_deg = 145.0"), "145", r":5, site\.latitude_deg", "at most 90"),
    "latitude is text": (toml("latitude_deg = 45.0", 'latitude_deg = "45"'), "latitude_deg", r":5, site", "number"),
    "gravity in g": (toml("gravity_m_s2 = 9.8", "gravity_m_s2 = 1.0"), "1.0", r":7, site\.gravity", "at least 9.5"),
    "negative noise": (toml("noise = 2.0", "noise = -2.0"), "noise: the value should be greater than 0 (it is -2.0)", r":20, channel\[0\]\.noise", "more than 0"),
    "noise absurd": (toml("noise = 2.0", "noise = 1e308"), "1e+308 is not a physical size", r":20, channel\[0\]\.noise", "more than 0"),
    "scale absurd": (toml("scale = 1000.0", "scale = 1e-300"), "1e-300 is not a physical size", r":17, channel\[0\]\.scale", "number"),
    "axis absurd": (toml("input_axis = [1, 0, 0]", "input_axis = [1e308, 0, 0]"), "not a physical size", r":15, channel\[0\]", "three numbers"),
    "noise infinite": (toml("noise = 2.0", "noise = inf"), "finite", r":20, channel\[0\]\.noise", "number"),
    "unknown kind": (toml('kind = "gyro"', 'kind = "giro"'), "'giro'", r":14, channel\[0\]\.kind", "gyro"),
    "unit of the output open": (
        toml('output_unit = "pulse/s"\nscale = 1000.0', 'output_unit = "?"\nscale = 1000.0'), "the unit of the output is not stated",
        r"\.output_unit", "text in quotes",
    ),
    "unknown per": (toml('per = "deg/s"', 'per = "deg/sec"'), "deg/sec", r":18, channel\[0\]\.per", "deg/s"),
    "per of the wrong kind": (toml('per = "deg/s"', 'per = "g"'), "per 'g'", r":18, channel\[0\]\.per", "deg/s"),
    "azimuth is a word": (
        toml("azimuth_deg = 90.0", 'azimuth_deg = "north"'), "'north'", r"table\[1\]\.azimuth_deg", '360, or "unknown"'
    ),
    "zero scale": (toml("scale = 1000.0", "scale = 0.0"), "scale", r":17, channel\[0\]\.scale", "output units"),
    "input axis without length": (toml("input_axis = [1, 0, 0]", "input_axis = [0, 0, 0]"), "zero vector", r":15, channel\[0\]", "direction"),
    "input axis of two numbers": (toml("input_axis = [1, 0, 0]", "input_axis = [1, 0]"), "at least 3", r":15, channel\[0\]", "three numbers"),
    "output axis along input": (
        toml("input_axis = [1, 0, 0]", "input_axis = [1, 0, 0]\noutput_axis = [1, 0.1, 0]"),
        "not orthogonal", r":16, channel\[0\]\.output_axis", "orthogonal to",
    ),
    "channel twice": (toml('name = "gy"', 'name = "gx"'), "given twice", r"channel\[1\]\.name", "not yet used"),
    "channel named like a column": (toml('name = "gy"', 'name = "samples"'), "is reserved", r"channel\[1\]\.name", "name"),
    "no channel table": (toml("[[channel]]", "[[chanel]]"), "chanel", r"campaign\.toml:1\d, chanel", "channel"),
    "elevation out of range": (toml("elevation_deg = 90.0", "elevation_deg = 200.0"), "200", r"table\[0\]\.elevation_deg", "at most 90"),
    "negative uncertainty": (
        toml("axis_uncertainty_arcsec = 20.0", "axis_uncertainty_arcsec = -1.0"), "-1", r"table\[0\]\.axis", "at least 0",
    ),
    "uncertainty of an axis of more than half a turn": (
        toml("axis_uncertainty_arcsec = 20.0", "axis_uncertainty_arcsec = 1e18"), "1e+18", r"table\[0\]\.axis",
        "at most 648000",
    ),
    "uncertainty of an attitude of more than half a turn": (
        toml('preset = "trihedral"', 'preset = "trihedral"\nuncertainty_arcmin = 1e18'), "1e+18",
        r"mounting\[1\]\.uncertainty", "at most 10800",
    ),
    "uncertainty of gravity beyond gravity": (
        toml("[unit]", "gravity_uncertainty_ug = 1e9\n[unit]"), "1000000000.0", "gravity_uncertainty_ug", "at most 1e+06",
    ),
    "negative uncertainty of a temperature": (
        toml("temperature_degC = 25.0", "temperature_degC = 25.0\ntemperature_uncertainty_degC = -0.5"),
        "-0.5", r"run\[0\]\.temperature_uncertainty_degC", "at least 0",
    ),
    "uncertainty of a temperature without end": (
        toml("temperature_degC = 25.0", "temperature_degC = 25.0\ntemperature_uncertainty_degC = inf"),
        "finite", r"run\[0\]\.temperature_uncertainty_degC", "number",
    ),
    "uncertainty of a temperature in mK": (
        toml("temperature_degC = 25.0", "temperature_degC = 25.0\ntemperature_uncertainty_degC = 500"),
        "500", r"run\[0\]\.temperature_uncertainty_degC", "at most 100",
    ),
    "uncertainty of no temperature": (
        toml("temperature_degC = 25.0", "converter_temperature_uncertainty_degC = 0.5"),
        "is stated without converter_temperature_degC", r"rates\.csv, header", "a column of that name",
    ),
    "thermometer that is not defined": (
        toml("temperature_degC = 25.0", 'temperature_degC = 25.0\nthermometer = "Pt 7"'),
        "refers to the thermometer 'Pt 7'", r"run\[0\]\.thermometer", "add a [[thermometer]]",
    ),
    "thermometer of no temperature": (
        with_thermometer("temperature_degC = 25.0", 'converter_thermometer = "Pt"'),
        "converter_thermometer is stated without converter_temperature_degC", r"rates\.csv, header", "a column of that name",
    ),
    "thermometer of sensors and converter": (
        with_thermometer("temperature_degC = 25.0",
             'temperature_degC = 25.0\nconverter_temperature_degC = 25.0\nthermometer = "Pt"\nconverter_thermometer = "Pt"'),
        "'Pt' is the converter_thermometer of run 'rates', and the thermometer of run 'rates'",
        r"run\[0\]\.converter_thermometer", "either the temperature of the sensors or that of the converter",
    ),
    "time base known to no part": (
        toml("[unit]", "[instruments]\ntime_base_uncertainty_ppm = -1\n[unit]"),
        "-1", r"instruments\.time_base_uncertainty_ppm", "at least 0",
    ),
    "table twice": (toml('name = "head"', 'name = "rate"'), "given twice", r"table\[1\]\.name", "not yet used"),
    "singular mounting": (toml("[[1, 0, 0], [0, 1, 0]", "[[1, 0, 0], [1, 0, 0]"), "singular", r"mounting\[0\]", "orthonormal"),
    "mirrored mounting": (toml("[[1, 0, 0], [0, 1, 0]", "[[0, 1, 0], [1, 0, 0]"), "mirror", r"mounting\[0\]", "determinant"),
    "mounting not orthonormal": (toml("[[1, 0, 0], [0, 1, 0]", "[[1, 0.2, 0], [0, 1, 0]"), "orthonormality", r"mounting\[0\]", "orthonormal"),
    "unknown preset": (toml('preset = "trihedral"', 'preset = "triheadral"'), "triheadral", r"mounting\[1\]", "trihedral"),
    "preset and matrix missing": (toml('preset = "trihedral"', "uncertainty_arcmin = 1.0"), "either", r"mounting\[1\]", "preset"),
    "run twice": (toml('name = "positions"', 'name = "rates"'), "given twice", r"run\[1\]\.name", "not yet used"),
    "unknown procedure": (toml('procedure = "rate_table"', 'procedure = "rate_tabel"'), "rate_tabel", r"run\[0\]\.procedure", "rate_table"),
    "wrong procedure": (toml('procedure = "dividing_head"', 'procedure = "rate_table"'), "table_rate_deg_s", r"positions\.csv, header", "table_rate"),
    "missing covariate": (toml('procedure = "dividing_head"', 'procedure = "servo_table"'), "time_s", r"positions\.csv, header", "time_s"),
    "injected current unknown": (
        toml('procedure = "thermal_ramp"', 'procedure = "current_injection"'), "current", r"run\[2\]\.procedure", "current_mA_per_g",
    ),
    "unknown table": (toml('table = "head"', 'table = "heed"'), "'heed'", r"run\[1\]\.table", "head"),
    "unknown mounting": (toml('mounting = "pyramid"', 'mounting = "piramid"'), "piramid", r"run\[0\]\.mounting", "pyramid"),
    "no mounting": (toml('mounting = "pyramid"\n', ""), "no 'mounting'", r"run\[0\]", "pyramid"),
    "bad date": (toml("start = 2026-03-01T08:00:00Z", 'start = "yesterday"'), "start", r"run\[0\]\.start", ""),
    "missing file": (remove(RATES), "does not exist", r"campaign\.toml:\d+, run\[0\]\.file", "runs/"),
    "misspelt file": (toml("runs/rates.csv", "runs/rate.csv"), "does not exist", r"run\[0\]\.file", "runs/rates.csv"),
    "file is a folder": (toml("runs/rates.csv", "runs"), "is a folder", r"run\[0\]\.file", "csv"),
    "empty file": (lambda f: (f / RATES).write_text(""), "empty", r"rates\.csv:1", "header"),
    "a table in Latin-1": (
        lambda f: (f / RATES).write_bytes((f / RATES).read_bytes().replace(b"gx", b"g\xfc", 1)), "not UTF-8", r"rates\.csv:1", "Latin-1",
    ),
    "header alone": (lines(RATES, lambda rows: rows[:1]), "empty_run", r"rates\.csv", "rows"),
    "a word between semicolons": (
        lines(RATES, lambda rows: [rows[0].replace(",", ";"), "x" + rows[1].replace(",", ";"), *rows[2:]]),
        "is not a number", r"rates\.csv:2", "a number",
    ),
    "unknown column": (rename(RATES, "table_angle_deg", "table_angel_deg"), "table_angel_deg", r"rates\.csv, column", "table_angle_deg"),
    "column twice": (rename(RATES, "gy", "gx"), "is repeated", r"rates\.csv, header", "each used once"),
    "no channel in the table": (
        lambda f: write_csv(f / RATES, {"table_rate_deg_s": np.arange(3.0)}), "no channel", r"rates\.csv, header", "gx",
    ),
    "ragged line": (lines(RATES, lambda rows: [*rows[:3], rows[3] + ",1", *rows[4:]]), "cells", r"rates\.csv:4", "16 cells"),
    "short line": (lines(RATES, lambda rows: [*rows[:4], "1,2", *rows[5:]]), "2 cells", r"rates\.csv:5", "16 cells"),
    "not a number": (cells(RATES, 6, 5, "12.5V"), "'12.5V' is not a number", r"rates\.csv:6, column 'gy'", "decimal point"),
    "decimal comma": (cells(RATES, 3, 5, '"1,5"'), "'1,5' is not a number", r"rates\.csv:3, column 'gy'", "decimal point"),
    "nan": (cells(RATES, 4, 5, "nan"), "nan_values", r"rates\.csv:4, column 'gy'", "empty cell"),
    "infinity": (cells(RATES, 5, 6, "-inf"), "nan_values", r"rates\.csv:5, column 'gz'", "empty cell"),
    "absurd": (cells(RATES, 4, 5, "1e308"), "nan_values", r"rates\.csv:4, column 'gy'", "the instrument can read"),
    "absurd angle": (cells(RATES, 4, 2, "-1e200"), "nan_values", r"rates\.csv:4, column 'table_angle_deg'", "can read"),
    "oversized cell": (cells(RATES, 4, 5, "x" * 200_000), "more than 131072 characters", r"rates\.csv:4", "a number"),
    "quotation not closed": (cells(RATES, 4, 5, '"' + "1.0\n" * 50_000), "more than 131072 characters", r"rates\.csv", "a number"),
    "file above": (toml("runs/rates.csv", "../rates.csv"), "'../rates.csv'", r"run\[0\]\.file", "in the same folder or below"),
    "file anywhere": (toml("runs/rates.csv", "/tmp/rates.csv"), "'/tmp/rates.csv'", r"run\[0\]\.file", "in the same folder or below"),
    "name that steers": (toml('name = "rates"', 'name = "ra\\u001b[31mtes"'), "not allowed", r"run\[0\]\.name", "control characters"),
    "nan in parquet": (nan_in_parquet, "nan_values", r"ramp\.parquet, row 7", "empty cell"),
    "text in parquet": (text_in_parquet, "not numbers", r"ramp\.parquet, column", "floating-point"),
    "truncated parquet": (cut("runs/ramp.parquet", 0.6), "damaged or truncated", r"ramp\.parquet", "Parquet"),
    "parquet that is text": (lambda f: (f / "runs/ramp.parquet").write_text("a,b\n1,2\n"), "damaged", r"ramp\.parquet", "Parquet"),
    "empty rate": (cells(RATES, 4, 1, ""), "missing_values", r"rates\.csv:4, column 'table_rate_deg_s'", "every row"),
    "no samples": (cells(RATES, 4, 3, "0"), "bad_count", r"rates\.csv:4, column 'samples'", "1 or more"),
    "absurd samples": (cells(RATES, 4, 3, "1e18"), "the first is 1e+18", r"rates\.csv:4, column 'samples'", "raw samples"),
    "part of a sample": (cells(RATES, 4, 3, "2.5"), "the first is 2.5", r"rates\.csv:4, column 'samples'", "whole number"),
    "negative deviation": (cells(RATES, 5, 10, "-2"), "bad_count", r"rates\.csv:5, column 'gx_sd'", "0 or more"),
    "reversed time": (column(RATES, "time_s", lambda t: t[::-1]), "time_not_increasing", r"rates\.csv:3, column 'time_s'", "increase"),
    "time stands still": (cells(RATES, 4, 0, "90"), "time_not_increasing", r"rates\.csv:4", "increase"),
    "repeated row": (lines(RAW, lambda rows: [*rows[:9], rows[8], *rows[9:]]), "duplicate_row", r"raw\.csv:10", "each row once"),
    "kelvin": (column(POSITIONS, "temperature_degC", lambda t: t + 273.15), "kelvin", r"positions\.csv:2", "Celsius"),
    "angle in radians": (column(POSITIONS, "table_angle_deg", np.deg2rad), "angle_in_radians", r"positions\.csv, column", "degrees"),
    "angle in radians while turning": (column(RAW, "table_angle_deg", np.deg2rad), "angle_in_radians", r"raw\.csv, column", "degrees"),
    "rate in radians": (column(RATES, "table_rate_deg_s", np.deg2rad), "rate_unit", r"rates\.csv, column 'table_rate_deg_s'", "degrees per second"),
    "gyro in radians": (column(RATES, "gy", np.deg2rad), "rate_unit", r"rates\.csv, column 'gy'", "1000 pulse/s per deg/s"),
    "gyro per hour": (toml('per = "deg/s"', 'per = "deg/h"'), "(deg/s instead of deg/h)", r"channel\[0\]\.scale", "'scale' of them per 'per'"),
    "accelerometer in m/s²": (column(POSITIONS, "ax", lambda a: a * 9.80665), "acceleration_unit", r"column 'ax'", "per g"),
    "stuck channel": (column(RATES, "gz", np.zeros_like), "stuck_channel", r"rates\.csv, column 'gz'", "vary"),
    "means of a free tumble": (toml('procedure = "rate_table"', 'procedure = "free_tumble"'), "not static poses", r"rates\.csv", "raw log"),
    "free tumble at rest": (
        toml('procedure = "thermal_ramp"', 'procedure = "free_tumble"'), "static poses", r"ramp\.parquet", "4 or more",
    ),
}  # fmt: skip

MODELS: dict[str, tuple[str, str, str, str, str]] = {
    "model: broken toml": ("[[effect]]", "[effect", "not valid TOML", r"m\.toml:4", "key"),
    "model: other format": ("format = 1", "format = 2", "format = 2", r"m\.toml:1, format", "1"),
    "model: no effects": (MODEL[MODEL.index("[[effect]]") :], "", "has no 'effect'", r"m\.toml", "effect"),
    "model: no name": ('name = "gyro_scale_factor"\n', "", "has no 'name'", r"m\.toml:4, effect\[0\]", "name"),
    "model: unknown section": ("[[effect]]", "[[efect]]", "efect", r"m\.toml:4, efect", "effect"),
    "model: unknown per": ('per = "channel"', 'per = "chanel"', "chanel", r"m\.toml:7, effect\[0\]\.per", "channel"),
    "model: channels not a list": ('["gx", "gz"]', '"gx"', "channels", r"m\.toml:6, effect\[0\]\.channels", ""),
    "model: empty channels": ('["gx", "gz"]', "[]", "channels", r"m\.toml:6, effect\[0\]\.channels", ""),
    "model: channel twice": ('["gx", "gz"]', '["gx", "gx"]', "twice", r"m\.toml:6, effect\[0\]\.channels", ""),
    "model: prior is a number": ('"normal(0, 2000 ppm)"', "2000", "prior", r"m\.toml:8, effect\[0\]\.prior", ""),
    "model: missing file": ('name = "small"', 'name = "small"\nfiles = ["own.py"]', "'own.py' does not exist", r"m\.toml:3, files", "Python file"),
    "model: optional is text": ('name = "gyro_scale_factor"', 'name = "gyro_scale_factor"\noptional = "no"', "boolean", r"m\.toml:6, effect\[0\]\.optional", "without quotes"),
    "model: option is a table": ("reference_degC = 25.0", "reference_degC = [25.0]", "finite number", r"m\.toml:12, effect\[1\]", ""),
    "model: option not finite": ("reference_degC = 25.0", "reference_degC = nan", "finite", r"m\.toml:12, effect\[1\]", ""),
}  # fmt: skip


def expect(problems: tuple[Issue, ...], what: str, where: str, allowed: str) -> None:
    fitting = [p for p in problems if what in p.what and re.search(where, p.where) and allowed in p.allowed]
    assert fitting, "\n".join(map(str, problems))
    for problem in problems:
        assert problem.what
        assert problem.where
        assert problem.remedy
        assert "Traceback" not in str(problem)
        assert "error:" in str(problem)
        assert "do:" in str(problem)


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_campaign(name: str, small: Path) -> None:
    spoil, what, where, allowed = CAMPAIGNS[name]
    spoil(small)
    with pytest.raises(InputError) as caught:
        load_campaign(small)
    expect(caught.value.issues, what, where, allowed)


@pytest.mark.parametrize("name", MODELS)
def test_model_file(name: str, tmp_path: Path) -> None:
    old, new, what, where, allowed = MODELS[name]
    assert old in MODEL
    (tmp_path / "m.toml").write_text(MODEL.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_model_file(tmp_path / "m.toml")
    expect(caught.value.issues, what, where, allowed)


def test_a_value_of_one_of_two_types_is_reported_once(small: Path) -> None:
    toml("azimuth_deg = 90.0", 'azimuth_deg = "north"')(small)
    with pytest.raises(InputError) as caught:
        load_campaign(small)
    assert len(caught.value.issues) == 1


def test_no_such_campaign(small: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_campaign(small.parent / "smell")
    expect(caught.value.issues, "no folder", "smell", "small")
    with pytest.raises(InputError) as caught:
        load_campaign(small.parent)
    expect(caught.value.issues, "no file", "campaign.toml", "small")


def test_model_file_missing(tmp_path: Path) -> None:
    (tmp_path / "base.toml").write_text(MODEL)
    with pytest.raises(InputError) as caught:
        read_model_file(tmp_path / "bass.toml")
    expect(caught.value.issues, "no file", "bass.toml", "base.toml")


def test_a_misspelt_section_is_one_problem(small: Path) -> None:
    file = small / "campaign.toml"
    file.write_text(file.read_text().replace("[[channel]]", "[[chanel]]"))
    with pytest.raises(InputError) as raised:
        load_campaign(small)
    (issue,) = raised.value.issues
    assert (issue.what, issue.remedy) == ("unknown key 'chanel'", "write 'channel' in place of 'chanel'")


def test_all_problems_at_once(small: Path) -> None:
    for name in ("latitude out of range", "unknown kind", "unknown preset"):
        CAMPAIGNS[name][0](small)
    with pytest.raises(InputError) as caught:
        load_campaign(small)
    assert len(caught.value.issues) == 3


def test_files_and_references_at_once(small: Path) -> None:
    for name in ("unknown mounting", "singular mounting", "not a number", "truncated parquet"):
        CAMPAIGNS[name][0](small)
    with pytest.raises(InputError) as caught:
        load_campaign(small)
    assert len(caught.value.issues) == 4


def test_structure_and_data_at_once(small: Path) -> None:
    for name in ("unknown key", "unknown kind", "singular mounting", "unknown table", "not a number", "kelvin"):
        CAMPAIGNS[name][0](small)
    with pytest.raises(InputError) as caught:
        load_campaign(small)
    assert len(caught.value.issues) == 6


def test_injected_current_in_amperes(small: Path) -> None:
    swap("campaign.toml", 'per = "g"', 'per = "g"\ncurrent_mA_per_g = 1.2')(small)
    swap("campaign.toml", 'procedure = "thermal_ramp"', 'procedure = "current_injection"')(small)
    table = pq.read_table(small / "runs/ramp.parquet")
    for current, fine in ((14.4, True), (0.0144, False)):
        columns = {"current_mA": np.full(table.num_rows, current), "ax": 240000.0 + np.arange(table.num_rows) % 7}
        kept = {name: table.column(name) for name in ("time_s", "converter_temperature_degC")}
        pq.write_table(pa.table(kept | columns), small / "runs/ramp.parquet")
        if fine:
            run = load_campaign(small).runs[2]
            assert run.covariates["current"][0] == pytest.approx(0.0144)
        else:
            with pytest.raises(InputError, match="current_unit"):
                load_campaign(small)


def test_enough_of_them() -> None:
    assert len(CAMPAIGNS) + len(MODELS) >= 40

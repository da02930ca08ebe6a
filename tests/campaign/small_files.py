"""A small campaign as files, with every form a run can have."""

import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

DEGREE = math.pi / 180
GRAVITY = 9.806
EARTH = 15.041067 / 3600 * DEGREE
LATITUDE = 45 * DEGREE
NAMES = ("gx", "gy", "gz", "ax", "ay", "az")

CAMPAIGN = """\
format = 1
name = "small"

[site]
latitude_deg = 45.0
height_m = 100.0
gravity_m_s2 = 9.806

[unit]
serial = "SN1"
{channels}
[[table]]
name = "rate"
elevation_deg = 90.0
axis_uncertainty_arcsec = 20.0

[[table]]
name = "head"
azimuth_deg = 90.0
elevation_deg = 0.0

[[mounting]]
name = "flat"
body_to_table = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
uncertainty_arcmin = 5.0

[[mounting]]
name = "pyramid"
preset = "trihedral"

[[run]]
name = "rates"
procedure = "rate_table"
file = "runs/rates.csv"
table = "rate"
mounting = "pyramid"
temperature_degC = 25.0
start = 2026-03-01T08:00:00Z

[[run]]
name = "positions"
procedure = "dividing_head"
file = "runs/positions.csv"
table = "head"
mounting = "flat"

[[run]]
name = "ramp"
procedure = "thermal_ramp"
file = "runs/ramp.parquet"
table = "rate"
mounting = "flat"

[[run]]
name = "raw"
procedure = "rate_table"
file = "runs/raw.csv"
table = "rate"
mounting = "flat"
"""

CHANNEL = """
[[channel]]
name = "{name}"
kind = "{kind}"
input_axis = {axis}
output_unit = "pulse/s"
scale = {scale}
per = "{per}"
offset = 0.0
{more}"""

MODEL = """\
format = 1
name = "small"

[[effect]]
name = "gyro_scale_factor"
channels = ["gx", "gz"]
per = "channel"
prior = { scale = "normal(0, 2000 ppm)" }

[[effect]]
name = "gyro_bias_temperature"
reference_degC = 25.0

[[effect]]
name = "white_noise"
"""


def channel_text() -> str:
    parts = []
    for index, name in enumerate(NAMES):
        gyro = name.startswith("g")
        parts.append(
            CHANNEL.format(
                name=name,
                kind="gyro" if gyro else "accelerometer",
                axis=[int(index % 3 == axis) for axis in range(3)],
                scale=1000.0 if gyro else 20000.0,
                per="deg/s" if gyro else "g",
                more="noise = 2.0\n" if name == "gx" else "",
            )
        )
    return "".join(parts)


def outputs(rate_deg_s: np.ndarray, force: np.ndarray, rng: np.random.Generator, samples: np.ndarray) -> dict:
    """Noisy outputs of the six channels for body rates in deg/s and forces in m/s², shape (R, 3) each."""
    signal = np.hstack([1000.0 * rate_deg_s, 20000.0 * force / GRAVITY])
    noise = rng.normal(size=signal.shape) * 2.0 / np.sqrt(samples)[:, None]
    return {name: signal[:, i] + noise[:, i] for i, name in enumerate(NAMES)}


def trihedral() -> np.ndarray:
    azimuth = np.array([0, 120, 240]) * DEGREE
    return np.stack([math.sqrt(2 / 3) * np.cos(azimuth), math.sqrt(2 / 3) * np.sin(azimuth), np.full(3, 3**-0.5)])


def write_csv(file: Path, columns: dict) -> None:
    columns = {name: pa.array(values, from_pandas=True) for name, values in columns.items()}
    pacsv.write_csv(pa.table(columns), file, pacsv.WriteOptions(quoting_style="none"))


def write_rates(file: Path, rng: np.random.Generator) -> None:
    rate = np.array([0.0, 300, -300, 100, -100, 20, -20, 0])
    samples = np.full(len(rate), 100.0)
    body = (rate[:, None] + EARTH / DEGREE * math.sin(LATITUDE)) * trihedral()[2]
    columns = outputs(body, np.outer(np.ones(len(rate)), GRAVITY * trihedral()[2]), rng, samples)
    angle = pa.array([0.0 if r == 0 else None for r in rate])
    time = 30.0 + 60 * np.arange(len(rate))
    write_csv(
        file,
        {"time_s": time, "table_rate_deg_s": rate, "table_angle_deg": angle, "samples": samples}
        | columns
        | {f"{name}_sd": np.full(len(rate), 2.0) for name in NAMES},
    )


def write_positions(file: Path, rng: np.random.Generator) -> None:
    # Axis to the East: at angle 0 x_t is South and y_t down, and the table's angle turns the body under gravity.
    angle = 30.0 * np.arange(12)
    up = -GRAVITY * np.stack([np.sin(angle * DEGREE), np.cos(angle * DEGREE), 0 * angle], axis=1)
    samples = np.full(len(angle), 100.0)
    columns = outputs(np.zeros((len(angle), 3)), up, rng, samples)
    write_csv(
        file,
        {"table_angle_deg": angle, "temperature_degC": np.full(12, 24.0), "samples": samples} | columns,
    )


def write_ramp(file: Path, rng: np.random.Generator) -> None:
    time = np.arange(0.0, 600.0, 0.5)
    up = np.outer(np.ones(len(time)), [0.0, 0.0, GRAVITY])
    columns = outputs(np.zeros_like(up), up, rng, np.ones(len(time)))
    temperature = 20 + time / 300
    pq.write_table(pa.table({"time_s": time, "converter_temperature_degC": temperature} | columns), file)


def write_raw(file: Path, rng: np.random.Generator, hz: float = 50.0) -> None:
    """Rest, 90 deg/s for ten seconds and a bit, rest, all with a ramp between."""
    time = np.arange(0, 30, 1 / hz)
    rate = np.interp(time, [0, 8, 9, 19.3, 20.3, 30], [0, 0, 90, 90, 0, 0])
    angle = np.cumsum(np.concatenate([[0], 0.5 * (rate[1:] + rate[:-1]) / hz]))
    up = np.outer(np.ones(len(time)), [0.0, 0.0, GRAVITY])
    body = np.zeros_like(up)
    body[:, 2] = rate
    columns = outputs(body, up, rng, np.ones(len(time)))
    write_csv(file, {"time_s": time, "table_rate_deg_s": rate, "table_angle_deg": np.mod(angle, 360)} | columns)


def write_small_campaign(folder: Path) -> None:
    (folder / "runs").mkdir(parents=True)
    rng = np.random.default_rng(1)
    (folder / "campaign.toml").write_text(CAMPAIGN.format(channels=channel_text()))
    write_rates(folder / "runs/rates.csv", rng)
    write_positions(folder / "runs/positions.csv", rng)
    write_ramp(folder / "runs/ramp.parquet", rng)
    write_raw(folder / "runs/raw.csv", rng)

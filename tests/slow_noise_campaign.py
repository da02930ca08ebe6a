"""A gyro with white noise, flicker and random walk, on a rate table and at rest; no code of the package."""

from pathlib import Path

import numpy as np
import polars as pl
import static_record as generator  # pyright: ignore[reportMissingImports]

DT = 0.2
"""Sampling interval, s."""
NOISE = {"white": 0.05, "flicker": 2.0, "random_walk": 10.0}
"""°/√h, °/h and °/h/√h."""
ROW_S = 60.0
RATES = (0.0, 100.0, 50.0, 20.0, -20.0, -50.0, -100.0, 0.0)
LATITUDE = 40.0
EARTH = 15.041067 * np.sin(np.radians(LATITUDE))
"""Earth rate along the vertical input axis, °/h."""

HEAD = f"""\
format = 1
name = "slow"

[site]
latitude_deg = {LATITUDE}

[[channel]]
name = "gx"
kind = "gyro"
input_axis = [1.0, 0.0, 0.0]
output_unit = "deg/s"
scale = 1.0
per = "deg/s"
noise = 0.002

[[table]]
name = "rate"
elevation_deg = 90.0
axis_uncertainty_arcsec = 0.0
rate_uncertainty_ppm = 0.0

[[mounting]]
name = "x-up"
body_to_table = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
uncertainty_arcmin = 0.0
"""
RUN = """
[[run]]
name = "{name}"
procedure = "{procedure}"
file = "{name}.{form}"
table = "rate"
mounting = "x-up"
temperature_degC = 25.0
"""


def slow_noise(samples: int, random: np.random.Generator, terms: dict[str, float] | None = None) -> np.ndarray:
    """Noise of single samples, °/s."""
    known = {term: generator.in_si("gyro", term, value) for term, value in (terms or NOISE).items()}
    return np.degrees(generator.noise(known, samples, DT, random))


def rate_rows(repeats: int, random: np.random.Generator, bias: float, scale_ppm: float, terms=None) -> pl.DataFrame:
    """Rows of a minute each: the sequence of rates, repeated; bias in °/h."""
    rates = np.tile(RATES, repeats)
    each = round(ROW_S / DT)
    noise = slow_noise(each * len(rates), random, terms).reshape(len(rates), each)
    true = rates * (1 + 1e-6 * scale_ppm) + (EARTH * (1 + 1e-6 * scale_ppm) + bias) / 3600
    return pl.DataFrame(
        {
            "time_s": ROW_S * (np.arange(len(rates)) + 0.5),
            "table_rate_deg_s": rates,
            "samples": np.full(len(rates), each),
            "gx": true + noise.mean(axis=1),
        }
    )


def still_record(hours: float, random: np.random.Generator, bias: float, terms=None) -> pl.DataFrame:
    """Raw samples at rest."""
    samples = round(hours * 3600 / DT)
    noise = slow_noise(samples, random, terms)
    return pl.DataFrame({"time_s": DT * np.arange(samples), "gx": (EARTH + bias) / 3600 + noise})


def write(folder: Path, rows: pl.DataFrame | None, still: pl.DataFrame | None = None) -> Path:
    """Write a campaign of a rate table run, a static record, or both."""
    folder.mkdir(parents=True)
    text = HEAD
    if rows is not None:
        rows.write_csv(folder / "turns.csv")
        text += RUN.format(name="turns", procedure="rate_table", form="csv")
    if still is not None:
        still.write_parquet(folder / "night.parquet")
        text += RUN.format(name="night", procedure="static_record", form="parquet")
    (folder / "campaign.toml").write_text(text)
    return folder

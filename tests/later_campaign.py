"""A later calibration of the shipped accelerometer channel: the same runs with other readings."""

import shutil
from pathlib import Path

import numpy as np
import polars as pl


def write_later(campaign: Path, folder: Path) -> None:
    """Write a copy of a campaign whose means deviate by half of their standard uncertainty."""
    shutil.copytree(campaign, folder)
    random = np.random.default_rng(20270301)
    for file in sorted((folder / "runs").glob("*.csv")):
        rows = pl.read_csv(file)
        deviation = pl.Series(random.normal(0, 0.5, len(rows)))
        rows.with_columns(pl.col("ax") + deviation * pl.col("ax_sd") / pl.col("samples").sqrt()).write_csv(file)

"""Columns of the residuals as arrays and names, and the covariates that vary in them."""

import numpy as np
import polars as pl

from imubayes.covariates import Covariate
from imubayes.display.labels import covariates


def numbers(frame: pl.DataFrame, column: str) -> np.ndarray:
    """Return a column as float64, NaN where it is null or not there at all."""
    if column not in frame.columns:
        return np.full(frame.height, np.nan)
    return frame.get_column(column).cast(pl.Float64).to_numpy().astype(np.float64)


def varies(values: np.ndarray) -> bool:
    """Tell whether there are at least two different finite values."""
    finite = values[np.isfinite(values)]
    return finite.size > 1 and bool(np.ptp(finite) > 1e-9 * np.max(np.abs(finite)))


def covariates_of(residuals: pl.DataFrame) -> list[Covariate]:
    """Return the covariates that the data have, those that vary."""
    return [known for known in covariates() if varies(numbers(residuals, known.column))]


def ordered(residuals: pl.DataFrame, column: str) -> list[str]:
    """Return the distinct names of a column in order of appearance."""
    return residuals.get_column(column).unique(maintain_order=True).to_list()

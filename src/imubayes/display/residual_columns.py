"""Columns of the residuals, as figures and the page read them: arrays, covariates that vary, names, temperature levels.

Apart from the figures, because a page that draws by itself needs no drawing library.
"""

import numpy as np
import polars as pl

from imubayes.display.numbers_and_labels import covariates, with_minus
from imubayes.foundations.covariates import COVARIATES, Covariate

NORMAL = 1.959964
"""97.5 % point of the standard normal."""
_ALIKE, _RAMP = 5.0, 8.0
"""Temperatures of one level differ by less, those of a ramp by more; degrees Celsius."""
_MOST_LEVELS = 5


def numbers(frame: pl.DataFrame, column: str) -> np.ndarray:
    """Return a column as float64, NaN where it is null or not there at all."""
    if column not in frame.columns:
        return np.full(frame.height, np.nan)
    return frame.get_column(column).cast(pl.Float64).to_numpy().astype(np.float64)


def varies(values: np.ndarray) -> bool:
    """Return whether there are at least two different finite values."""
    finite = values[np.isfinite(values)]
    return finite.size > 1 and bool(np.ptp(finite) > 1e-9 * np.max(np.abs(finite)))


def band(residuals: pl.DataFrame) -> np.ndarray:
    """Return half the width of the 95 % band of each output, noise and model together, (E,), output units."""
    return NORMAL * np.hypot(numbers(residuals, "sd"), np.nan_to_num(numbers(residuals, "model_sd")))


def covariates_of(residuals: pl.DataFrame) -> list[Covariate]:
    """Return the covariates that the data have, those that vary."""
    return [known for known in covariates() if varies(numbers(residuals, known.column))]


def ordered(residuals: pl.DataFrame, column: str) -> list[str]:
    """Return the distinct names of a column in order of appearance."""
    return residuals.get_column(column).unique(maintain_order=True).to_list()


def temperature_levels(residuals: pl.DataFrame) -> dict[str, str]:
    """Return the temperature level of each run, "−40 °C" or "ramp"; nothing for runs that recorded none."""
    columns = [COVARIATES[name].column for name in ("temperature", "converter_temperature")]
    known = [pl.col(column) for column in columns if column in residuals.columns]
    if not known:
        return {}
    own = pl.coalesce(known)
    table = residuals.group_by("run").agg(own.median().alias("middle"), (own.max() - own.min()).alias("range"))
    table = table.drop_nulls().filter(pl.col("middle").is_finite()).sort("middle")
    ramps = dict.fromkeys(table.filter(pl.col("range") > _RAMP)["run"].to_list(), "ramp")
    steady = table.filter(pl.col("range") <= _RAMP)
    if steady.is_empty():
        return ramps
    middle = steady["middle"].to_numpy()
    level = np.cumsum(np.diff(middle, prepend=middle[0]) > _ALIKE)
    if level[-1] >= _MOST_LEVELS:
        return ramps
    names = [with_minus(f"{np.mean(middle[level == place]):.0f} °C") for place in level]
    return ramps | dict(zip(steady["run"].to_list(), names, strict=True))

"""The residuals of a fit as a table."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import lazy_loader
import polars as pl

from imubayes.json_record import finite
from imubayes.results.summary import RunSummary

if TYPE_CHECKING:
    import pandas
    import xarray
else:
    xarray = lazy_loader.load("xarray")  # takes long to import, and few commands need it


# Columns that every residuals table has, besides the covariates.
COLUMNS = (
    "run", "procedure", "row", "channel", "kind", "observed", "predicted", "sd", "model_sd", "residual",
    "output_unit", "input_residual", "input_sd", "input_unit", "whitened",
)  # fmt: skip


@dataclass(frozen=True)
class Residuals:
    """Residuals as a table, one line per run, row and channel."""

    table: pl.DataFrame

    def to_dataframe(self) -> pl.DataFrame:
        """Return one row per run, row and channel, with covariates, observed and predicted output and residuals."""
        return self.table

    def to_polars(self) -> pl.DataFrame:
        """Return the table; the same as `to_dataframe`."""
        return self.table

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the table for pandas."""
        return self.table.to_pandas()

    def to_xarray(self) -> "xarray.Dataset":
        """Return the table as a dataset with the dimension `entry`."""
        return xarray.Dataset({name: ("entry", self.table[name].to_numpy()) for name in self.table.columns})

    @property
    def chi2(self) -> float:
        """Sum of squares of the whitened residuals."""
        return float((self.table["whitened"] ** 2).sum())

    def by_run_and_channel(self) -> tuple[RunSummary, ...]:
        """Return n, χ², rms, rms within the run and noise for each run and channel, in input units.

        What is not finite is None.
        """
        grouped = self.table.group_by("run", "channel", maintain_order=True).agg(
            pl.len().alias("n"),
            (pl.col("whitened") ** 2).sum().alias("chi2"),
            (pl.col("input_residual") ** 2).mean().sqrt().alias("rms"),
            pl.col("input_residual").std(ddof=0).alias("within"),
            (pl.col("input_sd") ** 2).mean().sqrt().alias("noise"),
            pl.col("input_unit").first().alias("unit"),
        )
        return tuple(
            RunSummary(
                name=line["run"],
                channel=line["channel"],
                n=line["n"],
                chi2=finite(line["chi2"]),
                rms=finite(line["rms"]),
                within=finite(line["within"]),
                noise=finite(line["noise"]),
                unit=line["unit"],
            )
            for line in grouped.iter_rows(named=True)
        )

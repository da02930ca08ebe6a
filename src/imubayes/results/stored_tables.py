"""Tables of a stored result, read without its fit: summary, residuals, and draws by the names of the summary.

A draw of ``gyro_bias.bias[gx]`` is one of the variable ``gyro_bias.bias``.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import polars.selectors as cs

from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import InputError, Issue
from imubayes.foundations.quantity_names import family_of
from imubayes.results.folder_files import AGAIN, POSTERIOR, RESIDUALS, SUMMARY, checked, damaged, read_record
from imubayes.results.summary import RunSummary, Summary

if TYPE_CHECKING:
    import pandas
    import xarray
else:
    xarray = DeferredModule("xarray")  # takes long to import, and few commands need it


_SAMPLE = ("chain", "draw")


Draws = dict[str, np.ndarray]


def draws_of(
    posterior: "xarray.DataTree | xarray.Dataset | Draws | Path | str", names: Iterable[str], group: str = "posterior"
) -> Draws:
    """Return the draws of the named members, each (chain · draw,); what is not there is left out.

    Parameters
    ----------
    posterior : tree with the group, that group or its dataset, the path of such a file, or draws by name.
    names : as in the summary.
    group : of a tree or of a file.

    Raises
    ------
    OSError, KeyError, ValueError
        if a file is not a readable posterior.
    """
    if isinstance(posterior, str | Path):
        with xarray.open_dataset(posterior, group=group, engine="h5netcdf") as opened:
            return draws_of(opened, names)
    if isinstance(posterior, dict):
        return {name: posterior[name].reshape(-1) for name in names if name in posterior}
    own = posterior[group] if group in getattr(posterior, "children", ()) else posterior
    data = own.to_dataset() if isinstance(own, xarray.DataTree) else own
    wanted = list(dict.fromkeys(names))
    found: dict[str, np.ndarray] = {}
    for variable in dict.fromkeys(family_of(name) for name in wanted):
        if variable in data.data_vars:
            found |= _members(variable, data[variable])
    return {name: found[name] for name in wanted if name in found}


def _members(name: str, variable: "xarray.DataArray") -> dict[str, np.ndarray]:
    """Return the members of a variable by name; combinations of labels that do not exist are left out."""
    dimensions = [dimension for dimension in variable.dims if dimension not in _SAMPLE]
    values = variable.transpose(*_SAMPLE, *dimensions).to_numpy()
    flat = values.reshape(values.shape[0] * values.shape[1], -1)
    labels = [map(str, variable[dimension].to_numpy()) for dimension in dimensions]
    named = {
        f"{name}[{','.join(label) or 'all'}]": column for label, column in zip(product(*labels), flat.T, strict=True)
    }
    return {member: column for member, column in named.items() if np.isfinite(column).any()}


def complete(draws: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return those draws in which every member is known; derived quantities are computed for some draws only."""
    if not draws:
        return {}
    known = np.isfinite(np.stack(list(draws.values()))).all(axis=0)
    return {name: column[known] for name, column in draws.items()}


def thinned(draws: Mapping[str, np.ndarray], most: int) -> dict[str, np.ndarray]:
    """Return at most `most` draws, evenly spaced."""
    count = len(next(iter(draws.values()), ()))
    chosen = slice(None) if count <= most else np.linspace(0, count - 1, most).astype(int)
    return {name: column[chosen] for name, column in draws.items()}


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

        A number that is not finite is None.
        """
        grouped = self.table.group_by("run", "channel", maintain_order=True).agg(
            pl.len().alias("n"),
            (pl.col("whitened") ** 2).sum().alias("chi2"),
            (pl.col("input_residual") ** 2).mean().sqrt().alias("rms"),
            pl.col("input_residual").std(ddof=0).alias("within"),
            (pl.col("input_sd") ** 2).mean().sqrt().alias("noise"),
            pl.col("input_unit").first().alias("unit"),
        )
        known = grouped.with_columns(pl.when(cs.float().is_finite()).then(cs.float())).rename({"run": "name"})
        return tuple(RunSummary(**line) for line in known.iter_rows(named=True))


def read_summary_and_residuals(folder: Path) -> tuple[Summary, Residuals]:
    """Read what every result folder has.

    Raises
    ------
    InputError
        if it is missing, incomplete, altered or damaged; every issue is in it.
    """
    manifest, issues = checked(folder), []
    try:
        summary = read_record(folder / SUMMARY, Summary)
    except InputError as error:
        summary, issues = None, [*error.issues]
    residuals = _read_residuals(folder / RESIDUALS, issues)
    if summary is not None and summary.sampled and not manifest.holds(POSTERIOR):
        where = str(folder / POSTERIOR)
        issues.append(Issue("the posterior is missing", where, f"{POSTERIOR}, as written by the fit", AGAIN))
    if issues or summary is None or residuals is None:
        raise InputError(issues)
    return summary, residuals


def _read_residuals(file: Path, issues: list[Issue]) -> Residuals | None:
    try:
        frame = pl.read_parquet(file)
    except (OSError, pl.exceptions.PolarsError) as error:
        issues.append(damaged(file, error))
        return None
    absent = [name for name in COLUMNS if name not in frame.columns]
    if absent:
        issues.append(
            Issue(f"the residuals lack the columns {', '.join(absent)}", str(file), ", ".join(COLUMNS), AGAIN)
        )
        return None
    if frame.is_empty():
        issues.append(Issue("the residuals have no rows", str(file), "one row per run, row and channel", AGAIN))
        return None
    return Residuals(frame)

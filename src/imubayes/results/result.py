"""A fit with everything that is reported of it, in memory or in a result folder."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader
import polars as pl

from imubayes.errors import InputError, Issue, closest_first
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_groups import posterior_groups
from imubayes.representation import Presented
from imubayes.results.fit_file import read_fit
from imubayes.results.manifest import checked, same_fit
from imubayes.results.posterior_draws import Draws, draws_of
from imubayes.results.posterior_tree import posterior_tree
from imubayes.results.read_folder import read_summary_and_residuals
from imubayes.results.record_files import damaged
from imubayes.results.record_names import POSTERIOR
from imubayes.results.residual_table import Residuals
from imubayes.results.residuals import residuals_of
from imubayes.results.summarise import summarise
from imubayes.results.summary import Quantity, Summary

if TYPE_CHECKING:
    import pandas
    import xarray
else:
    xarray = lazy_loader.load("xarray")  # takes long to import, and few commands need it


@dataclass(frozen=True, repr=False)
class Result(Presented):
    """A fit with everything that is reported of it; shows itself in a terminal and in a notebook.

    Attributes
    ----------
    summary : every number that is reported, as in `summary.json`.
    residuals : one row per run, row and channel.
    folder : the result folder; None for none.
    identity : of the fit in the folder, by its manifest; empty where none was written yet.
    """

    summary: Summary
    residuals: Residuals
    folder: Path | None = None
    identity: str = ""
    _fit: Fit | None = field(default=None, repr=False)

    @property
    def converged(self) -> bool:
        """Whether fit and sampling converged."""
        return self.summary.converged

    @cached_property
    def fit(self) -> Fit:
        """The fit; of a result folder, its campaign is read and its model bound again, nothing is refitted.

        Raises
        ------
        InputError
            where the folder holds no fit, the campaign is gone, or campaign or model are not those that were fitted.
        """
        if self._fit is not None:
            return self._fit
        assert self.folder is not None
        same_fit(self.folder, self.identity)
        return read_fit(self.folder)

    @property
    def posterior_file(self) -> Path | None:
        """The file with the posterior draws; None where there is none.

        Raises
        ------
        InputError
            where the folder no longer holds the result as it was read.
        """
        if self.folder is None or not self.identity:
            return None
        return self.folder / POSTERIOR if same_fit(self.folder, self.identity).holds(POSTERIOR) else None

    @cached_property
    def posterior(self) -> "xarray.DataTree":
        """The posterior as an ArviZ tree.

        Raises
        ------
        InputError
            where the fit did not converge, or the file with the draws cannot be read.
        """
        if self._fit is not None and self._fit.posterior is not None:
            return posterior_tree(posterior_groups(self._fit))
        file = self.posterior_file
        if file is None:
            where = str(self.folder) if self.folder is not None else "this fit"
            issue = Issue("there are no posterior draws", where, "a fit that converged", self.summary.message)
            raise InputError(issue)
        try:
            return xarray.open_datatree(file, engine="h5netcdf")
        except (OSError, ValueError, KeyError) as error:
            raise InputError(damaged(file, error)) from error

    @cached_property
    def draws(self) -> Draws:
        """The posterior draws of parameters and derived quantities by name, (S,) each, from the file if there is one.

        Raises
        ------
        InputError
            as for `posterior`.
        """
        return draws_of(self.posterior_file or self.posterior, self.quantities)

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Parameters and derived quantities by name: ``result.quantities["scale_factor[gx]"].mean``."""
        return {quantity.name: quantity for quantity in (*self.summary.parameters, *self.summary.derived)}

    def __getitem__(self, name: str) -> Quantity:
        """Return a parameter or derived quantity: ``result["scale_factor[gx]"].sd``.

        Raises
        ------
        KeyError
            with the closest names, for a name that the result does not have.
        """
        if name in self.quantities:
            return self.quantities[name]
        raise KeyError(f"no quantity '{name}'; there are {closest_first(name, list(self.quantities))}")

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.quantities)

    def to_polars(self) -> pl.DataFrame:
        """Return parameters and derived quantities, one row each, with the columns of `summary.json`."""
        return self.to_dataframe()

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the table of `to_polars` for pandas, with the name as index."""
        return self.to_polars().to_pandas().set_index("name")

    def to_xarray(self) -> "xarray.Dataset":
        """Return the table of `to_polars` as a dataset with the dimension `name`; the draws are in `posterior`."""
        frame = self.to_polars()
        columns = {name: ("name", frame[name].to_numpy()) for name in frame.columns if name != "name"}
        return xarray.Dataset(columns, {"name": frame["name"].to_numpy()})

    def to_dataframe(self) -> pl.DataFrame:
        """Return parameters and derived quantities, one row each; the same as `to_polars`."""
        rows = [
            {"kind": kind} | quantity.model_dump(exclude={"within"})
            for kind, quantities in (("parameter", self.summary.parameters), ("derived", self.summary.derived))
            for quantity in quantities
        ]
        return pl.DataFrame(rows, infer_schema_length=None)


def result_of(fit: Fit, folder: Path | None = None, seed: int = 0, load_seconds: float = 0.0) -> Result:
    """Return everything that is reported of a fit; `folder` is where it is to be written."""
    residuals = residuals_of(fit)
    return Result(summarise(fit, residuals, load_seconds, seed), residuals, folder, _fit=fit)


def read_result(folder: str | Path) -> Result:
    """Read a result folder: summary and residuals at once, fit and posterior when they are asked for.

    Raises
    ------
    InputError
        if it is missing, incomplete, altered or damaged; every issue is in it.
    """
    folder = Path(folder)
    identity = checked(folder).identity
    return Result(*read_summary_and_residuals(folder), folder, identity)

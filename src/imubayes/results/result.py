"""A fit with everything that is reported of it, in memory or in a result folder.

This includes the residuals in output and input units, with every covariate, which are what compare and criticism look
at, and the posterior as an ArviZ tree.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from imubayes.foundations.arrays import cholesky, solve_lower
from imubayes.foundations.campaign_data import INPUT_UNIT
from imubayes.foundations.covariates import shown
from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import InputError, closest_first, input_error
from imubayes.foundations.records import Presented
from imubayes.foundations.units import to_si
from imubayes.inference.candidate_runs import NextRun
from imubayes.inference.experiment_design import best_runs
from imubayes.inference.fitted_model import Fit
from imubayes.inference.nested_laplace import posterior_precision
from imubayes.model.bind import Model
from imubayes.model.likelihood import pseudo_values
from imubayes.model.noise_covariance import noise_deviation, whiten, whitener
from imubayes.model.problem import Problem
from imubayes.results.fit_file import read_fit
from imubayes.results.folder_files import POSTERIOR, checked, damaged, same_fit
from imubayes.results.posterior_groups import Group, Groups, Labelled, posterior_groups
from imubayes.results.stored_tables import Draws, Residuals, draws_of, read_summary_and_residuals
from imubayes.results.summarise import summarise
from imubayes.results.summary import Quantity, Summary

if TYPE_CHECKING:
    import pandas
    import xarray
else:
    xarray = DeferredModule("xarray")  # takes long to import, and few commands need it


def _at_mode(problem: Problem, mode):
    """Return prediction, its standard deviation, the noise's and the whitened residual, each (E,)."""
    by = whitener(problem, mode.h)
    whitened = whiten(problem, by, pseudo_values(problem, mode.h, mode.about.misfit))
    spread = solve_lower(cholesky(posterior_precision(problem, mode)), mode.about.jacobian.T)
    predicted = problem.observations.value - mode.about.misfit
    return predicted, np.sqrt(np.sum(spread**2, axis=0)), noise_deviation(problem, by), whitened


def to_input_units(model: Model) -> np.ndarray:
    """Return the factor from the output of each entry to its input unit, (E,); of closing rotations from rad to deg."""
    entries, campaign, closing = model.entries, model.campaign, np.asarray(model.entries.closing)
    units = [to_si(INPUT_UNIT[c.kind], campaign.site.gravity) for c in campaign.channels]
    per_output = np.array([1 / (c.scale_si * unit) for c, unit in zip(campaign.channels, units, strict=True)])
    return np.where(closing, 1 / to_si("deg"), per_output[np.where(closing, 0, entries.channel)])


@dataclass(frozen=True)
class Predicted:
    """What is said of every entry of a model, (E,) each, output units.

    Attributes
    ----------
    value, model_sd : the prediction, and its standard deviation.
    noise_sd : standard deviation of the noise.
    whitened : residual in units of what it spreads by.
    """

    value: np.ndarray
    model_sd: np.ndarray
    noise_sd: np.ndarray
    whitened: np.ndarray


def residuals_of(fit: Fit) -> Residuals:
    """Return the residuals of a fit made in this process, at its mode."""
    assert fit.mode is not None, "a fit read from a folder has its residuals there"
    return residual_table(fit.model, Predicted(*(np.asarray(part) for part in _at_mode(fit.model.problem, fit.mode))))


def residual_table(model: Model, predicted: Predicted) -> Residuals:
    """Return the entries of a model with what is predicted of them, and with every covariate."""
    campaign, entries = model.campaign, model.entries
    channels = campaign.channels
    closing = np.asarray(entries.closing)
    place = np.where(closing, 0, entries.channel)
    kind = np.where(closing, "closure", np.array([c.kind for c in channels])[place])
    output_unit = np.where(closing, "deg", np.array([c.output_unit for c in channels])[place])
    input_unit = np.where(closing, "deg", np.array([INPUT_UNIT[c.kind] for c in channels])[place])
    to_output, to_input = np.where(closing, 1 / to_si("deg"), 1.0), to_input_units(model)
    offset = np.where(closing, 0.0, np.array([c.offset for c in channels])[place])
    residual = entries.value - predicted.value
    # The angle of a table that a gyro drives is an output, and is shown on the scale of the table as well.
    zeros = np.array([campaign.tables[run.table].zero_angle if run.table else 0.0 for run in campaign.runs])
    reading = np.where(kind == "angle", np.degrees(zeros)[entries.run], 0.0)
    table = {
        "run": np.array([run.name for run in campaign.runs])[entries.run],
        "procedure": np.array([run.procedure for run in campaign.runs])[entries.run],
        "mounting": pl.Series([run.mounting for run in campaign.runs], dtype=pl.String).gather(entries.run),
        "row": entries.row,
        "channel": model.output_names[entries.channel],
        "kind": kind,
        **_covariates(model),
        "samples": entries.samples,
        "observed": entries.value * to_output + reading,
        "predicted": predicted.value * to_output + reading,
        "sd": predicted.noise_sd * to_output,
        "model_sd": predicted.model_sd * to_output,
        "residual": residual * to_output,
        "output_unit": output_unit,
        "input_observed": (entries.value - offset) * to_input,
        "input_residual": residual * to_input,
        "input_sd": predicted.noise_sd * np.abs(to_input),
        "input_unit": input_unit,
        "whitened": predicted.whitened,
    }
    return Residuals(pl.DataFrame(table))


def _covariates(model: Model) -> dict[str, pl.Series]:
    """Return each covariate per entry as it was read; null where a run lacks it and for closing rotations."""
    campaign, entries = model.campaign, model.entries
    found = {}
    for covariate in shown():
        name, column = covariate.name, covariate.column
        values, known = np.zeros(len(entries)), np.zeros(len(entries), dtype=bool)
        for index, run in enumerate(campaign.runs):
            chosen = (entries.run == index) & ~entries.closing
            if name in run.covariates and (run.table is not None or not name.startswith("table_")):
                read = campaign.as_read(run, name) / covariate.factor(campaign.site.gravity)
                values[chosen] = read[entries.row[chosen]]
                known[chosen] = True
        found[column] = pl.Series(column, [v if k else None for v, k in zip(values, known, strict=True)], pl.Float64)
    return found


def posterior_tree(groups: Groups) -> "xarray.DataTree":
    """Return groups as a tree, with what is said of the whole at its root."""
    tree = xarray.DataTree.from_dict({name: _dataset(group) for name, group in groups.named.items()})
    tree.attrs = dict(groups.attributes)
    return tree


def _dataset(group: Group) -> "xarray.Dataset":
    variables = {name: _variable(each) for name, each in group.variables.items()}
    coordinates = {name: _variable(each) for name, each in group.coordinates.items()}
    return xarray.Dataset(variables, coordinates, dict(group.attributes))


def _variable(each: Labelled) -> "xarray.Variable":
    return xarray.Variable(each.dimensions, each.values, dict(each.attributes))


@dataclass(frozen=True, repr=False)
class Result(Presented):
    """A fit with everything that is reported of it; shows itself in a terminal and in a notebook.

    Attributes
    ----------
    summary : every number that is reported, as in `summary.json`.
    residuals : one row per run, row and channel.
    folder : the result folder; None for none.
    identity : of the fit in the folder, by its manifest; empty if none was written yet.

    Examples
    --------
    >>> import imubayes
    >>> result = imubayes.load("results/accel-channel")
    >>> result.to_polars().columns[:5]
    ['kind', 'name', 'unit', 'mean', 'sd']
    >>> sorted(result.draws)[0], result.draws["accel_bias.bias[ax]"].ndim
    ('accel_bias.bias[ax]', 1)
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
            if the folder holds no fit, the campaign is gone, or campaign or model are not those that were fitted.
        """
        if self._fit is not None:
            return self._fit
        assert self.folder is not None
        same_fit(self.folder, self.identity)
        return read_fit(self.folder)

    @property
    def posterior_file(self) -> Path | None:
        """The file with the posterior draws; None if there is none.

        Raises
        ------
        InputError
            if the folder no longer holds the result as it was read.
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
            if the fit did not converge, or the file with the draws cannot be read.
        """
        if self._fit is not None and self._fit.posterior is not None:
            return posterior_tree(posterior_groups(self._fit))
        file = self.posterior_file
        if file is None:
            where = str(self.folder) if self.folder is not None else "this fit"
            raise input_error("there are no posterior draws", where, "a fit that converged", self.summary.message)
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

    def next_runs(self, names: Sequence[str]) -> tuple[NextRun, ...]:
        """Return the run that would narrow each named quantity most: expected standard deviation before and after it.

        `summary.next_runs` has the same for what the runs left open. The candidates are the runs that the equipment of
        the campaign allows. A quantity that none of them narrows by at least a tenth has no entry.

        Parameters
        ----------
        names : parameters or derived quantities, as in the summary.

        Raises
        ------
        InputError
            for a name that the result does not have, for a fit that did not converge, and as for `fit`.
        """
        for name in names:
            if name not in self.quantities:
                raise input_error(f"no quantity '{name}'", "names", closest_first(name, list(self.quantities)),
                                  "choose one of these")  # fmt: skip
        if self.summary.log_evidence is None:
            raise input_error("the fit did not converge", str(self.folder or "this fit"), "a fit that converged",
                              self.summary.message or "fit again")  # fmt: skip
        return best_runs(self.fit, list(dict.fromkeys(names)))

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


def opened(result: Result | str | Path) -> Result:
    """Return a result, read if it is given by its folder; see `read_result`."""
    return result if isinstance(result, Result) else read_result(result)


def read_result(folder: str | Path) -> Result:
    """Read a result folder: summary and residuals at once, fit and posterior when they are accessed.

    Parameters
    ----------
    folder : the result folder.

    Raises
    ------
    InputError
        if it is missing, incomplete, altered or damaged; every issue is in it.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.read_result("results/accel-channel").summary.model
    'accel-channel'
    """
    folder = Path(folder)
    identity = checked(folder).identity
    return Result(*read_summary_and_residuals(folder), folder, identity)

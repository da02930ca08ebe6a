"""A fit with everything that is reported of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray

from imubayes.inference.experiment_design import next_runs
from imubayes.inference.joint_fit import JointFit
from imubayes.inference.posterior_tree import posterior_tree
from imubayes.inference.procedure_contributions import contributions
from imubayes.results.presentation import html_of, text_of
from imubayes.results.residuals import Residuals, residuals_of
from imubayes.results.result_folder import write_result
from imubayes.results.summarise import summarise


@dataclass(frozen=True)
class Result:
    """A fit with everything that is reported of it; shows itself in a terminal and in a notebook.

    Attributes
    ----------
    fit : the joint fit.
    summary : contents of `summary.json`.
    residuals : one line per run, row and channel.
    folder : the result folder, None where none was written.
    """

    fit: JointFit
    summary: dict[str, Any]
    residuals: Residuals
    folder: Path | None = None

    @property
    def converged(self) -> bool:
        """Whether fit and sampling converged."""
        return self.fit.converged

    def posterior(self) -> xarray.DataTree:
        """Return the posterior as an ArviZ tree."""
        return posterior_tree(self.fit)

    def __repr__(self) -> str:
        return text_of(self)

    def _repr_html_(self) -> str | None:
        return html_of(self)


def result_of(fitted: JointFit, folder: Path | None = None, seed: int = 0, load_seconds: float = 0.0) -> Result:
    """Return everything that is reported of a fit, and write the result folder where one is given."""
    residuals = residuals_of(fitted)
    summary = summarise(fitted, residuals)
    summary["seconds"]["load"] = load_seconds
    summary["next_runs"] = next_runs(fitted, summary)
    summary["contributions"] = contributions(fitted)
    if folder is not None:
        write_result(folder, fitted, summary, residuals, seed)
    return Result(fitted, summary, residuals, folder)

"""Fit every campaign of an archive with one model, and ask all units at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import polars as pl

from imubayes.display.progress import progress_of
from imubayes.foundations.campaign_data import Campaign
from imubayes.model.model_file import ModelSpec
from imubayes.results.result_folder import write_model
from imubayes_archive.dataset.store import pack_campaigns
from imubayes_archive.display.batch_report import progress_text
from imubayes_archive.population.drift import Drifts, drifts
from imubayes_archive.population.hierarchical_fit import HierarchicalFit, hierarchical_fit
from imubayes_archive.population.parameter_population import Populations, populations
from imubayes_archive.population.units_in_doubt import UnitInDoubt, units_in_doubt
from imubayes_archive.unit_fits.batch_folder import BatchSettings, Sampling
from imubayes_archive.unit_fits.pooled_discovery import PooledDiscovery, pooled_discovery
from imubayes_archive.unit_fits.posterior_table import chosen_model, read_parameters, read_units
from imubayes_archive.unit_fits.run_batch import BatchProgress, run_batch
from imubayes_archive.unit_fits.unit_scores import complete_scores
from imubayes_archive.unit_fits.workers import executor_of


@dataclass(frozen=True)
class BatchResult:
    """The fits of all units of an archive, as a results folder keeps them.

    Attributes
    ----------
    folder : the results folder.
    model : hash of model, settings and code.
    state : how far the batch was when it ended; None for one that was read.

    Examples
    --------
    >>> import imubayes
    >>> fits = imubayes.batch("campaigns", "accel-channel", "results/units")
    >>> fits.parameters.filter(parameter="converter_gain_drift.slope[ax]")["unit"].len()
    1
    """

    folder: Path
    model: str
    state: BatchProgress | None = None

    @cached_property
    def units(self) -> pl.DataFrame:
        """A row for each campaign: unit, date, status with its reason, convergence, χ², posterior."""
        return read_units(self.folder, self.model)

    @cached_property
    def parameters(self) -> pl.DataFrame:
        """A row for each campaign and parameter: mean, sd and quantiles in the unit of the parameter."""
        return read_parameters(self.folder, self.model)

    def population(self, progress: Callable[[str], None] | None = None) -> Populations:
        """Return groups of units, mean and spread of every parameter, and the units that differ from the others.

        Each unit is fitted again with the population of the others as its prior; the results folder keeps that.
        """
        return self._hierarchical(progress).populations

    def given_population(self, progress: Callable[[str], None] | None = None) -> pl.DataFrame:
        """Return the estimates of every unit alone and with the population as prior."""
        return self._hierarchical(progress).units

    def _hierarchical(self, progress: Callable[[str], None] | None) -> HierarchicalFit:
        with progress_of(progress) as tell:
            return hierarchical_fit(self.folder, self.model, progress=tell)

    def in_doubt(self) -> tuple[UnitInDoubt, ...]:
        """Return the units that need a person: without estimates, with doubtful noise, or unlike the others."""
        return units_in_doubt(self.units, populations(self.parameters, self.units)[0])

    def drift(self) -> Drifts:
        """Return the drift between calibrations of one unit; trends over units are structures of `population`."""
        return drifts(self.parameters, self.units)[0]

    def diagnose(self, progress: Callable[[str], None] | None = None) -> PooledDiscovery:
        """Return the effects that the model lacks, with the evidence of all units added up.

        Raises
        ------
        InputError
            if no campaign has an estimate, and for effect files that are not trusted.
        """
        with progress_of(progress) as tell:
            scores = complete_scores(self.folder, self.model, lambda done, all_: tell(f"scores of {done} of {all_}"))
            tell("adding up the evidence")
            return pooled_discovery(scores.table, self.units)


def batch(
    archive: str | Path | Sequence[Campaign],
    model: str | Path | ModelSpec,
    out: str | Path,
    *,
    sample: Sampling = "none",
    diagnose: bool = False,
    seed: int = 0,
    retry: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> BatchResult:
    """Fit every campaign of an archive, or of a folder of campaigns, that has no result yet.

    An interrupted batch goes on when it is called again.  A campaign that cannot be fitted is a row with its reason.

    Parameters
    ----------
    archive : archive, folder with campaign folders, or campaigns in memory, which are kept in the results folder.
    model : model, its file, or the name of a shipped one.
    out : results folder.
    sample : units whose posterior is sampled: all, none, or flagged, those whose importance weights put the Laplace
        approximation in doubt.
    diagnose : whether each fit is diagnosed.
    seed : of the sampler.
    retry : whether campaigns without estimates are tried again, not only those whose files have changed.
    workers, scheduler : number of local worker processes, or address of a Dask scheduler; in this process if neither
        is given.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for a place without campaigns, a model that cannot be read, or a results folder that is in use.

    Examples
    --------
    >>> import imubayes
    >>> fits = imubayes.batch("campaigns", "accel-channel", "results/units")
    >>> fits.units["status"].to_list()
    ['fitted']
    """
    settings = BatchSettings(sample, diagnose, seed)
    with progress_of(progress) as tell, executor_of(workers, scheduler) as execute:
        tell("listing the campaigns")
        place = archive if isinstance(archive, str | Path) else pack_campaigns(archive, Path(out) / _CAMPAIGNS).folder
        file = _written(model, Path(out) / _MODEL) if isinstance(model, ModelSpec) else model
        state = run_batch(
            place, file, out, execute, settings, retry=retry, progress=lambda state: tell(progress_text(state))
        )
    return BatchResult(Path(out), state.key, state)


_CAMPAIGNS, _MODEL = "campaigns", "model.toml"


def _written(model: ModelSpec, file: Path) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    write_model(model, file)
    return file


def load_batch(folder: str | Path, model: str | None = None) -> BatchResult:
    """Return the fits that a results folder of a batch holds.

    Parameters
    ----------
    folder : as written by `batch` or `imubayes batch`.
    model : hash of the model, or its beginning; the only one if None.

    Raises
    ------
    InputError
        if there is no such model, or several and none is named.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.batch("campaigns", "accel-channel", "results/units").units.height
    1
    >>> imubayes.load_batch("results/units").units.height
    1
    """
    return BatchResult(Path(folder), chosen_model(folder, model))

"""The hierarchical fit of an archive: every unit is fitted again with the population of noise scales as their prior.

The uncertainty of a unit rests on its noise scales, and two runs of one unit hardly determine the scatter between runs.
The runs of all units do.  Each unit has the population of the others as the prior of its scales
(`population.noise_scale_population`), and is fitted again.  Its parameters keep the priors of the model in that
fit, which are then divided out: means, spreads and units are estimated jointly from the likelihoods of all units
(`population.joint_population`).

Results are kept beside the parts of the batch, by the digests of the campaigns that they are of.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from imubayes.foundations.errors import kept_if_possible
from imubayes.foundations.files import new_folder, remove
from imubayes.foundations.records import Record
from imubayes.model.model_file import ModelSpec, read_carried_model
from imubayes.results.folder_files import seal, unbroken
from imubayes_archive.population.parameter_population import SHRUNK, Populations, estimates_alone, populations
from imubayes_archive.population.population_priors import KnownPrior, with_priors
from imubayes_archive.population.unit_populations import UnitPopulation, unit_populations
from imubayes_archive.unit_fits import posterior_table as tables
from imubayes_archive.unit_fits.batch_folder import BatchSettings, UnitSource
from imubayes_archive.unit_fits.fit_chunk import in_process
from imubayes_archive.unit_fits.run_batch import ChunkTask, Executor, chunks_of

_PREFIX, _DIGITS = "population-", 16
_REMEDY = "remove that folder and run `imubayes batch population` again"
_ORDER = ["unit", "date", "digest"]
_REACH, _PRIOR_DIGITS = 1.3, 12


@dataclass(frozen=True)
class HierarchicalFit:
    """Units of an archive given their population.

    Attributes
    ----------
    populations : of every parameter.
    units : schema `population.parameter_population.SHRUNK`; the unit's own estimate is that of its fit alone.
    fitted : number of units that were fitted again; the others have no noise scale that their population determines.
    left_out : units that could not be fitted again, with the reason; their fits alone are used.
    doubted : units whose noise contradicts the model: their intervals do not hold.
    """

    populations: Populations
    units: pl.DataFrame
    fitted: int
    left_out: tuple[str, ...]
    doubted: tuple[str, ...]


def hierarchical_fit(
    results: str | Path,
    model: str | None = None,
    executor: Executor = in_process,
    progress: Callable[[str], None] = lambda _: None,
) -> HierarchicalFit:
    """Return the populations of a batch, all units fitted again with them as priors; what is kept is not fitted again.

    Parameters
    ----------
    results, model : the batch.
    executor : fits the units.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for a folder without results, and effect files that are not trusted.
    """
    key = tables.chosen_model(results, model)
    folder = tables.model_folder(results, key)
    alone = tables.read_parameters(results, key), tables.read_units(results, key)
    latest = _latest(alone[1])
    place = folder / f"{_PREFIX}{_digest(latest)}"
    if not place.is_dir():
        spec = read_carried_model(tables.kept_model(results, key))
        found = fitted_again(spec, key, alone, executor, progress)
        with kept_if_possible(folder), new_folder(place, durable=True) as scratch:
            found.write(scratch)
            seal(scratch)
        for stale in folder.glob(f"{_PREFIX}*"):
            if stale != place:
                remove(stale)
        return _result(alone, found)
    return _result(alone, FittedAgain.read(unbroken(place, _REMEDY)))


def _latest(units: pl.DataFrame) -> pl.DataFrame:
    """Return the latest fitted campaign of each unit."""
    fitted = units.filter(pl.col("status") == "fitted").sort("date", "digest", nulls_last=False, maintain_order=True)
    return fitted.unique("unit", keep="last", maintain_order=True)


def _digest(latest: pl.DataFrame) -> str:
    return hashlib.sha256("\0".join(sorted(latest["digest"])).encode()).hexdigest()[:_DIGITS]


@dataclass(frozen=True)
class FittedAgain:
    """The tables of units that were fitted with the population of their noise scales, and how many of them were."""

    parameters: pl.DataFrame
    units: pl.DataFrame
    fitted: int

    def write(self, folder: Path) -> None:
        """Write the tables into a folder."""
        self.parameters.write_parquet(folder / tables.PARAMETER_FILE)
        self.units.write_parquet(folder / tables.UNIT_FILE)
        (folder / _ENDING_FILE).write_text(RefitEnding(fitted=self.fitted).json_text(), encoding="utf-8")

    @staticmethod
    def read(folder: Path) -> "FittedAgain":
        """Return what a folder holds."""
        ending = RefitEnding.model_validate_json((folder / _ENDING_FILE).read_text(encoding="utf-8"))
        parameters, units = (pl.read_parquet(folder / name) for name in (tables.PARAMETER_FILE, tables.UNIT_FILE))
        return FittedAgain(parameters, units, ending.fitted)


_ENDING_FILE = "refit.json"


class RefitEnding(Record):
    """How many units were fitted again."""

    fitted: int


def _result(alone: tuple[pl.DataFrame, pl.DataFrame], found: FittedAgain) -> HierarchicalFit:
    """Return the populations, over the campaigns of the batch."""
    record, units = populations(found.parameters, found.units)
    own = estimates_alone(*alone)
    units = units.drop("estimate", "estimate_sd").join(own, on=["digest", "parameter"], how="left")
    counts = {
        "units": alone[1]["unit"].n_unique(), "campaigns": alone[1].height,
        "left_out": alone[1].filter(pl.col("status") != "fitted").height,
    }  # fmt: skip
    failed = found.units.filter(pl.col("reason") != "")
    left = tuple(f"{unit}: {reason}" for unit, reason in failed.select("unit", "reason").iter_rows())
    doubted = tuple(dict.fromkeys(tables.doubted(_latest(alone[1]))["unit"]))
    return HierarchicalFit(record.model_copy(update=counts), units.select(*SHRUNK.names()), found.fitted, left, doubted)


def fitted_again(
    spec: ModelSpec,
    model: str,
    alone: tuple[pl.DataFrame, pl.DataFrame],
    executor: Executor,
    progress: Callable[[str], None],
) -> FittedAgain:
    """Return the latest campaign of each unit fitted with the population of its noise scales.

    A unit that cannot be fitted again keeps its fit alone, with the reason.

    Parameters
    ----------
    spec, model : the model of the batch, and its hash.
    alone : tables of parameters and units of the batch.
    executor : fits the units.
    progress : called with a short text as the work goes on.
    """
    latest = _latest(alone[1])
    parameters, units = (each.filter(pl.col("digest").is_in(latest["digest"].to_list())) for each in alone)
    sources = [UnitSource.of_row(row) for row in latest.iter_rows(named=True)]
    # The noise of a unit that contradicts its model is not that of the others.
    doubted = set(tables.doubted(units)["digest"])
    found = scale_priors(list(unit_populations(parameters, units)))
    priors = {digest: known for digest, known in found.items() if digest not in doubted}
    names = dict(latest.select("digest", "names").iter_rows())
    models = {digest: with_priors(spec, known, names[digest], _PRIOR_DIGITS)[0] for digest, known in priors.items()}
    tasks = (
        ChunkTask(spec, BatchSettings(), group, {each.digest: models[each.digest] for each in group})
        for group in chunks_of([each for each in sources if each.digest in models])
    )
    new: list[tables.UnitPosterior] = []
    for fitted in executor(tasks):
        new.extend(fitted)
        progress(f"{len(new)} of {len(models)} units given their population")
    return _with_new_fits(model, latest, parameters, units, new)


def _with_new_fits(
    model: str,
    latest: pl.DataFrame,
    parameters: pl.DataFrame,
    units: pl.DataFrame,
    new: Sequence[tables.UnitPosterior],
) -> FittedAgain:
    """Return tables with the new fits in the place of those alone; a failed one leaves its reason."""
    good = [each for each in new if each.outcome.status == "fitted"]
    reasons = {each.identity.digest: each.outcome.reason for each in new if each.outcome.status != "fitted"}
    replaced = pl.col("digest").is_in([each.identity.digest for each in good])
    # The likelihood of a noise scale is known from the fit alone over its whole range, here about its prior.
    again = tables.parameter_table(model, good).filter(pl.col("kind") != "noise")
    kept = parameters.filter(~replaced | (pl.col("kind") == "noise"))
    left = units.filter(~replaced).with_columns(
        reason=pl.col("digest").replace_strict(reasons, default=pl.col("reason"), return_dtype=pl.String)
    )
    code = latest["code"][0] if latest.height else ""
    return FittedAgain(
        pl.concat([kept, again]).sort(_ORDER, maintain_order=True),
        pl.concat([left, tables.unit_table(model, code, good)]).sort(_ORDER, maintain_order=True),
        len(good),
    )


def scale_priors(found: Sequence[UnitPopulation]) -> Mapping[str, Mapping[str, KnownPrior]]:
    """Return the priors of noise scales that the population gives to each unit, by digest and parameter."""
    priors: dict[str, dict[str, KnownPrior]] = {}
    for each in found:
        if each.units is None or each.units.others is None:
            continue
        parameter, unit = each.table["parameter"][0], each.table["unit_of_measure"][0]
        mean, sd = each.units.others
        # A lognormal prior that reaches beyond that of the model would not be what the other units say.
        reach = each.posteriors.prior_mean + _REACH * each.posteriors.prior_sd
        for place in np.flatnonzero(mean + 2 * sd < reach):
            prior = KnownPrior(each.scale, float(mean[place]), float(sd[place]), unit)
            priors.setdefault(each.table["digest"][int(place)], {})[parameter] = prior
    return priors

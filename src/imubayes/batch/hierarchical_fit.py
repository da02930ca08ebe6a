"""The hierarchical fit of an archive: every unit is fitted again with the population of the others as its prior.

A population is estimated from the likelihoods of the units, and the likelihood of one parameter depends on what is
known of the others: a bias is known to the scatter between runs, which two runs of one unit do not determine and the
runs of all units do.  Populations and units are therefore estimated in turn, by expectation propagation (T. Minka,
2001).  By its approximate likelihood N(y, v) and the population, each unit has a posterior N(M, S²) of every parameter.
The normal prior that gives this posterior,

    1/B² = 1/S² − 1/v,    A = B² (M/S² − y/v),

is the prior of the next fit of that unit, and its new posterior divided by that prior is its new likelihood.  A unit
that is linear with known noise has the same likelihood in every round.  B² is not taken below a tenth of v, as the
quotient of two nearly equal distributions is mostly rounding.

The rounds end if neither the means nor the spreads of the populations move.  Results are kept beside the parts of the
batch, with the digests of the campaigns that they are of.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from imubayes.batch import posterior_table as tables
from imubayes.batch.batch_folder import BatchSettings, UnitSource
from imubayes.batch.fit_chunk import in_process
from imubayes.batch.parameter_population import (
    SHRUNK,
    Populations,
    StatedPriors,
    UnitPopulation,
    populations,
    unit_populations,
)
from imubayes.batch.population import ShrunkUnits, UnitPosteriors
from imubayes.batch.population_priors import KnownPrior, with_priors
from imubayes.batch.run_batch import CHUNK, ChunkTask, Executor
from imubayes.foundations.errors import kept_if_possible
from imubayes.foundations.files import new_folder, remove
from imubayes.foundations.records import Record
from imubayes.model.model_file import ModelSpec, read_carried_model
from imubayes.results.folder_files import seal, unbroken

_PREFIX, _DIGITS = "population-", 16
_REMEDY = "remove that folder and run `imubayes batch population` again"
_ORDER = ["unit", "date", "digest"]
_ROUNDS, _LEAST_WIDTH, _REACH, _PRIOR_DIGITS = 4, 0.1, 1.3, 12
# Change of a population mean, in its standard deviations, and of the logarithm of a spread, that ends the rounds.
_SETTLED_MEAN, _SETTLED_SPREAD = 0.2, 0.1


@dataclass(frozen=True)
class HierarchicalFit:
    """Units of an archive given their population.

    Attributes
    ----------
    populations : of every parameter.
    units : schema `imubayes.batch.parameter_population.SHRUNK`; the unit's own estimate is that of its fit alone.
    rounds : in which all units were fitted again; 0 if none could be.
    settled : whether the populations did not move in the last one.
    left_out : units that could not be fitted again, with the reason; their fits alone are used.
    """

    populations: Populations
    units: pl.DataFrame
    rounds: int
    settled: bool
    left_out: tuple[str, ...]


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
        found = _Rounds(spec, key, alone, latest, executor, progress).run()
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
    """The tables of the last round, with the priors of the model and how the rounds ended."""

    parameters: pl.DataFrame
    units: pl.DataFrame
    stated: StatedPriors
    rounds: int
    settled: bool

    def write(self, folder: Path) -> None:
        """Write the tables into a folder."""
        self.parameters.write_parquet(folder / tables.PARAMETER_FILE)
        self.units.write_parquet(folder / tables.UNIT_FILE)
        ending = RoundsEnding(stated=dict(self.stated), rounds=self.rounds, settled=self.settled)
        (folder / _ENDING_FILE).write_text(ending.model_dump_json(), encoding="utf-8")

    @staticmethod
    def read(folder: Path) -> "FittedAgain":
        """Return what a folder holds."""
        ending = RoundsEnding.model_validate_json((folder / _ENDING_FILE).read_text(encoding="utf-8"))
        parameters, units = (pl.read_parquet(folder / name) for name in (tables.PARAMETER_FILE, tables.UNIT_FILE))
        return FittedAgain(parameters, units, ending.stated, ending.rounds, ending.settled)


_ENDING_FILE = "rounds.json"


class RoundsEnding(Record):
    """How the rounds ended: the priors of the model, their number, and whether the populations settled."""

    stated: dict[str, tuple[float, float]]
    rounds: int
    settled: bool


def _result(alone: tuple[pl.DataFrame, pl.DataFrame], found: FittedAgain) -> HierarchicalFit:
    """Return the populations of the last round, over the campaigns of the batch."""
    record, units = populations(found.parameters, found.units, found.stated)
    own = populations(*alone)[1].select("digest", "parameter", "estimate", "estimate_sd")
    units = units.drop("estimate", "estimate_sd").join(own, on=["digest", "parameter"], how="left")
    counts = {
        "units": alone[1]["unit"].n_unique(), "campaigns": alone[1].height,
        "left_out": alone[1].filter(pl.col("status") != "fitted").height,
    }  # fmt: skip
    failed = found.units.filter(pl.col("reason") != "")
    left = tuple(f"{unit}: {reason}" for unit, reason in failed.select("unit", "reason").iter_rows())
    return HierarchicalFit(
        record.model_copy(update=counts), units.select(*SHRUNK.names()), found.rounds, found.settled, left
    )


@dataclass(frozen=True)
class _Rounds:
    """Rounds of fits and populations."""

    spec: ModelSpec
    model: str
    alone: tuple[pl.DataFrame, pl.DataFrame]
    latest: pl.DataFrame
    executor: Executor
    progress: Callable[[str], None]

    def run(self) -> FittedAgain:
        """Return the tables of the round in which the populations settled."""
        digests = self.latest["digest"].implode()
        parameters, units = (each.filter(pl.col("digest").is_in(digests)) for each in self.alone)
        found = list(unit_populations(parameters, units))
        stated = {name: prior for name, prior in map(_stated, found) if np.isfinite(prior).all()}
        settled, rounds = False, 0
        while rounds < _ROUNDS and not settled and any(each.units is not None for each in found):
            again, units = self._fitted(found, parameters, units, rounds + 1)
            # The likelihood of a noise scale is known from the fit alone over its whole range, here about its prior.
            scales = parameters.filter(pl.col("kind") == "noise")
            parameters = pl.concat([again.filter(pl.col("kind") != "noise"), scales]).sort(_ORDER, maintain_order=True)
            before, found, rounds = found, list(unit_populations(parameters, units, stated)), rounds + 1
            settled = _is_settled(before, found)
        return FittedAgain(parameters, units, stated, rounds, settled)

    def _fitted(
        self, found: Sequence[UnitPopulation], parameters: pl.DataFrame, units: pl.DataFrame, number: int
    ) -> tuple[pl.DataFrame, pl.DataFrame]:
        """Return the tables of all units given the population; a unit that fails keeps its fit before."""
        priors = unit_priors(found)
        sources = [
            UnitSource(row["digest"], row["unit"], row["campaign"], row["file"], row["file"].endswith(".parquet"))
            for row in self.latest.iter_rows(named=True)
        ]
        models = {digest: with_priors(self.spec, known, _PRIOR_DIGITS)[0] for digest, known in priors.items() if known}
        tasks = (
            ChunkTask(self.spec, BatchSettings(), group, {each.digest: models[each.digest] for each in group})
            for group in _chunks([each for each in sources if each.digest in models])
        )
        new: list[tables.UnitPosterior] = []
        for fitted in self.executor(tasks):
            new.extend(fitted)
            self.progress(f"round {number}: {len(new)} of {len(models)} units given their population")
        good = [each for each in new if each.outcome.status == "fitted"]
        reasons = {each.identity.digest: each.outcome.reason for each in new if each.outcome.status != "fitted"}
        replaced = {each.identity.digest for each in good}
        kept = [each.filter(~pl.col("digest").is_in(list(replaced))) for each in (parameters, units)]
        kept[1] = kept[1].with_columns(
            reason=pl.col("digest").replace_strict(reasons, default=pl.col("reason"), return_dtype=pl.String)
        )
        code = self.latest["code"][0]
        return (
            pl.concat([kept[0], tables.parameter_table(self.model, good)]).sort(_ORDER, maintain_order=True),
            pl.concat([kept[1], tables.unit_table(self.model, code, good)]).sort(_ORDER, maintain_order=True),
        )


def _chunks(sources: Sequence[UnitSource]) -> Iterator[tuple[UnitSource, ...]]:
    return (tuple(sources[start : start + CHUNK]) for start in range(0, len(sources), CHUNK))


def _stated(found: UnitPopulation) -> tuple[str, tuple[float, float]]:
    """Return mean and standard deviation of the prior of the model, with the parameter."""
    name, posteriors = found.table["parameter"][0], found.posteriors
    return name, (float(np.median(posteriors.prior_mean)), float(np.median(posteriors.prior_sd)))


def unit_priors(found: Sequence[UnitPopulation]) -> Mapping[str, Mapping[str, KnownPrior]]:
    """Return the priors that the population gives to each unit, by digest and parameter."""
    priors: dict[str, dict[str, KnownPrior]] = {}
    for each in found:
        if each.units is None or each.table["kind"][0] == "derived":
            continue
        parameter, unit = each.table["parameter"][0], each.table["unit_of_measure"][0]
        mean, sd = each.units.others or _given_others(each.posteriors, each.units)
        # A lognormal prior that reaches beyond that of the model would not be what the other units say.
        reach = each.posteriors.prior_mean + _REACH * each.posteriors.prior_sd
        known = np.isfinite(sd) & ((each.table["kind"][0] != "noise") | (mean + 2 * sd < reach))
        for place in np.flatnonzero(known):
            prior = KnownPrior(each.scale, float(mean[place]), float(sd[place]), unit)
            priors.setdefault(each.table["digest"][int(place)], {})[parameter] = prior
    return priors


def _given_others(posteriors: UnitPosteriors, units: ShrunkUnits) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and sd of the normal prior that gives each unit its posterior; infinite sd under heavy tails."""
    linear, precision = posteriors.natural
    width = 1 / units.sd**2 - precision
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = np.where(width > 0, 1 / width, np.inf)
        mean = np.where(width > 0, variance * (units.mean / units.sd**2 - linear), 0.0)
        least = np.where(precision > 0, _LEAST_WIDTH / precision, 0.0)
    return mean, np.sqrt(np.maximum(variance, least))


def _is_settled(before: Sequence[UnitPopulation], after: Sequence[UnitPopulation]) -> bool:
    """Whether no population moved."""
    old = {each.table["parameter"][0]: each.population for each in before}
    for each in after:
        was, now = old.get(each.table["parameter"][0]), each.population
        if was is None or was.posterior is None or now.posterior is None or each.table["kind"][0] == "derived":
            continue
        if abs(now.mean - was.mean) > _SETTLED_MEAN * max(now.mean_sd, was.mean_sd):
            return False
        if abs(now.spread - was.spread) > max(_SETTLED_SPREAD * now.spread, 0.2 * now.spread_sd):
            return False
    return True

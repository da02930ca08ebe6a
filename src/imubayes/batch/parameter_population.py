"""From the table of a batch to the population of every parameter, and to the prior of the next unit.

A unit counts once, with its latest calibration: two calibrations of one unit are not two draws from the population.
Parameters are taken on the scale on which their prior is normal, or nearly: as they are, or as logarithms.  A prior
that is neither normal nor lognormal is replaced by the one with its mean and standard deviation; for a parameter that
the data determine this matters little, and the others carry no information.  Each parameter is treated by itself,
with its marginal posterior: correlations between parameters of a unit are not used.

The predictive distribution of the next unit, N(μ, τ²) with mean and spread uncertain, replaces the prior of each
parameter whose population is known; the others keep theirs.  Parameters of mountings and tables keep theirs too: they
belong to the equipment of a campaign, not to a kind of unit.  A parameter that cannot be negative and whose prior
reaches down to zero keeps it there: a half-normal prior with the second moment of the population.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import polars as pl

from imubayes.batch.population import Population, ShrunkUnits, UnitPosteriors, population, shrunk
from imubayes.foundations.errors import input_error
from imubayes.foundations.quantity_names import QuantityName
from imubayes.foundations.records import Record, finite
from imubayes.model.effect_registry import Registry
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.parameters.declarations import declared_parameters

# Relative agreement of (sd/prior sd)² with 1 − from_data, which is computed where the prior is normal.
_NORMAL_PRIOR = 0.05

SHRUNK = pl.Schema(
    {
        "unit": pl.String, "digest": pl.String, "date": pl.Date, "parameter": pl.String, "unit_of_measure": pl.String,
        "estimate": pl.Float64, "estimate_sd": pl.Float64, "shrunk": pl.Float64, "shrunk_sd": pl.Float64,
        "distance": pl.Float64, "p": pl.Float64, "outlying": pl.Boolean,
    }
)  # fmt: skip
"""One row per unit and parameter: the unit's own estimate without the prior of its model, and with the population."""


class OutlyingUnit(Record):
    """A unit that is unlike the others in a parameter.

    Attributes
    ----------
    value, sd : its own estimate, the prior of its model divided out; on the scale of the population.
    distance : from the population mean, in standard deviations.
    p : two-sided p-value of the distance.
    """

    unit: str
    value: float
    sd: float
    distance: float
    p: float


class ParameterPopulation(Record):
    """The population of one parameter; numbers are None where `reason` says why there is no estimate.

    Attributes
    ----------
    scale : ``linear``, or ``log``: the numbers below are of the natural logarithm of the parameter in its unit.
    units, informative : number of units, and of those whose data carry information.
    law, freedom : ``normal`` or ``student`` with its degrees of freedom.
    mean, mean_sd, mean_interval : of the population mean, with its 95 % interval.
    spread, spread_sd, spread_interval : half the width of the central 68.3 % of the population.
    predictive_sd : standard deviation of the next unit, mean and spread being uncertain.
    information_error : bits lost to the Monte Carlo error of the units' posteriors.
    outlying : units at a false discovery rate of 5 %.
    """

    parameter: str
    unit_of_measure: str
    kind: str
    scale: Literal["linear", "log"]
    units: int
    informative: int
    reason: str
    law: Literal["normal", "student"]
    freedom: float | None
    mean: float | None
    mean_sd: float | None
    mean_interval: tuple[float, float] | None
    spread: float | None
    spread_sd: float | None
    spread_interval: tuple[float, float] | None
    predictive_sd: float | None
    information_error: float
    outlying: tuple[OutlyingUnit, ...]


class Populations(Record):
    """The populations of all parameters of a batch; `left_out` counts campaigns without estimates."""

    format: Literal[1] = 1
    model: str
    units: int
    campaigns: int
    left_out: int
    parameters: tuple[ParameterPopulation, ...]


def populations(parameters: pl.DataFrame, units: pl.DataFrame) -> tuple[Populations, pl.DataFrame]:
    """Return the population of every parameter, and the units with it as prior (schema `SHRUNK`).

    Parameters
    ----------
    parameters, units : as `imubayes.batch.posterior_table.read_parameters` and `read_units` return them.
    """
    found, frames = [], [SHRUNK.to_frame()]
    for rows in usable_rows(parameters):
        # Rows are in the order of the dates: the last one of a unit is its latest calibration.
        table = rows.unique("unit", keep="last", maintain_order=True).sort("unit")
        posteriors, scale = posteriors_of(table, units)
        outcome = population(posteriors)
        shares = shrunk(posteriors, outcome) if outcome.posterior is not None else None
        found.append(_record(table, scale, posteriors, outcome, shares))
        if shares is not None:
            frames.append(_frame(table, scale, posteriors, shares))
    record = Populations(
        model=units["model"][0] if units.height else "",
        units=units["unit"].n_unique(),
        campaigns=units.height,
        left_out=units.filter(pl.col("status") != "fitted").height,
        parameters=tuple(found),
    )
    return record, pl.concat(frames)


def usable_rows(parameters: pl.DataFrame) -> Iterator[pl.DataFrame]:
    """Yield the rows of each parameter that have an estimate, in the order of their dates, undated ones first."""
    usable = parameters.filter((pl.col("status") == "fitted") & pl.col("mean").is_not_null())
    ordered = usable.sort("date", "digest", nulls_last=False, maintain_order=True)
    for (_,), rows in ordered.group_by(["parameter"], maintain_order=True):
        yield rows


def posteriors_of(table: pl.DataFrame, units: pl.DataFrame) -> tuple[UnitPosteriors, Literal["linear", "log"]]:
    """Return the posteriors of one parameter on the scale on which its prior is nearly normal.

    Parameters
    ----------
    table : rows of the parameter.
    units : table of the units, with the number of draws behind each.
    """
    draws = dict(zip(units["digest"], units["draws"].fill_null(np.inf), strict=True))
    columns = {name: table[name].cast(pl.Float64).fill_null(np.nan).to_numpy() for name in _NUMBERS}
    mean, sd, prior_mean, prior_sd = (columns[name] for name in _NUMBERS[:4])
    number = np.array([draws[digest] for digest in table["digest"]], dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        as_normal = np.abs((sd / prior_sd) ** 2 / (1 - columns["from_data"]) - 1) < _NORMAL_PRIOR
    positive = bool(np.all(columns["q2_5"] > 0))
    if np.mean(as_normal) >= 0.5 or not positive:
        flat = ~np.isfinite(prior_sd) | ~np.isfinite(prior_mean) | (prior_sd <= 0)
        prior = np.where(flat, 0.0, prior_mean), np.where(flat, np.inf, prior_sd)
        return UnitPosteriors(mean, sd, *prior, number), "linear"
    # Of a lognormal distribution; the quantiles are those of the logarithm.
    middle = np.log(columns["q50"])
    width = (np.log(columns["q97_5"]) - np.log(columns["q2_5"])) / (2 * 1.959964)
    with np.errstate(divide="ignore", invalid="ignore"):
        square = np.log1p((prior_sd / prior_mean) ** 2)
        median = np.log(prior_mean) - square / 2
    known = np.isfinite(square) & np.isfinite(median) & (square > 0)
    prior = np.where(known, median, 0.0), np.where(known, np.sqrt(np.where(known, square, 1.0)), np.inf)
    return UnitPosteriors(middle, width, *prior, number), "log"


_NUMBERS = ("mean", "sd", "prior_mean", "prior_sd", "from_data", "q2_5", "q50", "q97_5")


def _record(
    table: pl.DataFrame,
    scale: Literal["linear", "log"],
    posteriors: UnitPosteriors,
    outcome: Population,
    shares: ShrunkUnits | None,
) -> ParameterPopulation:
    given = outcome.posterior is not None
    return ParameterPopulation(
        parameter=table["parameter"][0],
        unit_of_measure=table["unit_of_measure"][0],
        kind=table["kind"][0],
        scale=scale,
        units=outcome.units,
        informative=outcome.informative,
        reason=outcome.reason,
        law="normal" if np.isinf(outcome.freedom) else "student",
        freedom=finite(outcome.freedom),
        mean=finite(outcome.mean),
        mean_sd=finite(outcome.mean_sd),
        mean_interval=outcome.mean_interval if given else None,
        spread=finite(outcome.spread),
        spread_sd=finite(outcome.spread_sd),
        spread_interval=outcome.spread_interval if given else None,
        predictive_sd=finite(outcome.predictive_sd),
        information_error=outcome.information_error,
        outlying=_outlying(table, posteriors, shares) if shares is not None else (),
    )


def _outlying(table: pl.DataFrame, posteriors: UnitPosteriors, shares: ShrunkUnits) -> tuple[OutlyingUnit, ...]:
    """Return the outlying units, the farthest first."""
    estimate, variance = posteriors.likelihood
    places = sorted(np.flatnonzero(shares.outlying), key=lambda place: -abs(shares.distance[place]))
    return tuple(
        OutlyingUnit(
            unit=table["unit"][int(place)],
            value=float(estimate[place]),
            sd=float(np.sqrt(variance[place])),
            distance=float(shares.distance[place]),
            p=float(shares.p[place]),
        )
        for place in places
    )


def _frame(table: pl.DataFrame, scale: str, posteriors: UnitPosteriors, shares: ShrunkUnits) -> pl.DataFrame:
    """Return the units of a parameter with the population as prior; logarithms become values again."""
    estimate, variance = posteriors.likelihood
    known = posteriors.informative
    own, own_sd = np.where(known, estimate, np.nan), np.where(known, np.sqrt(np.where(known, variance, 1.0)), np.nan)
    mean, sd = shares.mean, shares.sd
    if scale == "log":
        own, mean = np.exp(own), np.exp(mean)
        own_sd, sd = own * own_sd, mean * sd
    columns = {
        "estimate": own, "estimate_sd": own_sd, "shrunk": mean, "shrunk_sd": sd,
        "distance": shares.distance, "p": shares.p, "outlying": shares.outlying,
    }  # fmt: skip
    kept = table.select("unit", "digest", "date", "parameter", "unit_of_measure")
    return kept.with_columns(pl.Series(name, values) for name, values in columns.items()).with_columns(
        pl.col(pl.Float64).fill_nan(None)
    )


_DIGITS = 4


@dataclass(frozen=True)
class ReplacedPrior:
    """A prior of the new model, and the one that it replaces; empty where that was the default of the effect."""

    parameter: str
    prior: str
    before: str


# Families of priors with their mode at zero.
_FROM_ZERO = ("halfnormal", "halfcauchy")


def prior_text(found: ParameterPopulation, before: str) -> str:
    """Return the predictive distribution of the next unit as a prior of a model file; `before` is that of the batch."""
    assert found.mean is not None, found.reason
    assert found.predictive_sd is not None, found.reason
    unit = f" {found.unit_of_measure}" if found.unit_of_measure not in ("", "1") else ""
    if found.scale == "log":
        return f"lognormal({math.exp(found.mean):.{_DIGITS}g}{unit}, {found.predictive_sd:.{_DIGITS}g})"
    if before.partition("(")[0] in _FROM_ZERO:
        return f"halfnormal({math.hypot(found.mean, found.predictive_sd):.{_DIGITS}g}{unit})"
    return f"normal({found.mean:.{_DIGITS}g}{unit}, {found.predictive_sd:.{_DIGITS}g}{unit})"


def next_unit_model(spec: ModelSpec, found: Populations, name: str = "") -> tuple[ModelSpec, list[ReplacedPrior]]:
    """Return the model of the next unit, with what was replaced.

    An effect whose channels have priors of their own is written once for each channel.

    Parameters
    ----------
    spec : the model of the batch.
    found : its populations.
    name : of the new model; that of the old one with ``-population`` where empty.

    Raises
    ------
    InputError
        where no parameter has a population.
    """
    registry = Registry().with_files(spec.files)
    known = {each.parameter: each for each in found.parameters if each.kind != "derived"}
    effects: list[EffectSpec] = []
    replaced: list[ReplacedPrior] = []
    for effect in spec.effects:
        kind = registry.find(effect.name, effect.where)
        of_channel = (effect.per or ",".join(kind.per)) == "channel"
        channels = _channels(effect, known) if of_channel else []
        before = len(replaced)
        defaults = {field: each.prior for field, each in declared_parameters(kind).items()}
        parts = [_with_priors(effect, defaults, channel, known, replaced) for channel in channels]
        effects.extend(parts if len(replaced) > before else [effect])
    if not replaced:
        raise input_error(
            "no parameter has a population",
            f"results of model {found.model}",
            "parameters that five units or more carry information on",
            "fit more units, or see the reasons with `imubayes batch population`",
        )
    return replace(spec, name=name or f"{spec.name}-population", effects=tuple(effects)), replaced


def _channels(effect: EffectSpec, known: Mapping[str, ParameterPopulation]) -> list[str]:
    """Return the channels that an effect has parameters on in the batch."""
    labels = (QuantityName.of(key).labels for key in _own(effect.name, known))
    found = dict.fromkeys(each[0] for each in labels if len(each) == 1)
    return [label for label in found if effect.channels is None or label in effect.channels]


def _own(name: str, known: Mapping[str, ParameterPopulation]) -> Sequence[str]:
    return [key for key in known if QuantityName.of(key).effect == name]


def _with_priors(
    effect: EffectSpec,
    defaults: Mapping[str, str],
    channel: str,
    known: Mapping[str, ParameterPopulation],
    replaced: list[ReplacedPrior],
) -> EffectSpec:
    """Return an effect on one channel with the priors that the population gives it; `defaults` are those declared."""
    priors = dict(effect.prior)
    for field, each in _fields(effect.name, channel, known):
        if each.mean is not None:
            before = priors.get(field, "")
            text = prior_text(each, before or defaults[field])
            replaced.append(ReplacedPrior(each.parameter, text, before))
            priors[field] = text
    # The next unit may lack a channel that others had.
    return replace(effect, channels=(channel,), prior=priors, optional=True)


def _fields(
    name: str, channel: str, known: Mapping[str, ParameterPopulation]
) -> Iterator[tuple[str, ParameterPopulation]]:
    for key in _own(name, known):
        parts = QuantityName.of(key)
        if parts.labels == (channel,):
            yield parts.parameter, known[key]

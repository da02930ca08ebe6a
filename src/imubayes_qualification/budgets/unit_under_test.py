"""The unit under test as a specification and the standards see it: quantities with draws, and what it was tested at."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import polars as pl

from imubayes.foundations.quantity_names import name_of
from imubayes.inference.identifiability import WEAK_SHARE
from imubayes.results.marginal import Marginal
from imubayes.results.posterior_quantities import (
    PosteriorQuantities,
    posterior_quantities,
    with_combinations,
)
from imubayes.results.result import Result
from imubayes.results.summary import Quantity, is_constant
from imubayes.results.temperature_range import ThermalModel, thermal_model
from imubayes_qualification.budgets.standard_quantities import STANDARD_QUANTITIES, UnitUnderTest, draws_of_standard
from imubayes_qualification.budgets.taken_as_exact import ExactInput, TakenAsExact, standard_draws
from imubayes_qualification.evaluation.coverage import (
    NORMAL_FACTOR,
    Coverage,
    KnownUncertainty,
    coverage_of,
    coverage_of_length,
    coverage_with_scatter,
)

# Share of a standard deviation from which on a scatter between runs gives the posterior a shape of its own.
_MATTERS = 0.1


@dataclass(frozen=True)
class RangeDraws:
    """Draws of a quantity at T temperatures, and what the next run adds.

    Attributes
    ----------
    centre : shape (S, T), without the offset of a run.
    scatter : shape (S, T), standard deviation of that offset, which is the same at all temperatures.
    """

    centre: np.ndarray
    scatter: np.ndarray

    @cached_property
    def values(self) -> np.ndarray:
        """Draws with the offset, one for each draw: the same draws give the same report, (S, T)."""
        if not self.scatter.any():
            return self.centre
        return self.centre + self.scatter * np.random.default_rng(20260401).standard_normal((len(self.centre), 1))


@dataclass(frozen=True)
class TestedUnit(UnitUnderTest):
    """What a specification is held against.

    Attributes
    ----------
    temperatures : lowest and highest sensor temperature of the runs, °C; None if none was recorded.
    thermal : thermal terms of the model.
    lengths : quantity → the length of its mean vector, if it is the length of one.
    known : quantity → its uncertainty, if a budget gives it.
    added : quantity → standard deviation by what is included of equipment that the model takes as exact.
    unstated : quantity → standard deviation by equipment that the model takes as exact, in no uncertainty.
    jointly : the same with its correlation: quantity → shape (r,), by r independent causes, if it depends on
        temperature.
    floors : quantity → the smallest expanded uncertainty that may be stated of it.
    nonnegative : quantities that cannot be negative: their prior allows no such value, or they are lengths.
    """

    __test__ = False  # no test, whatever its name says to pytest

    temperatures: tuple[float, float] | None
    thermal: ThermalModel
    lengths: Mapping[str, float] = field(default_factory=dict)
    known: Mapping[str, KnownUncertainty] = field(default_factory=dict)
    added: Mapping[str, float] = field(default_factory=dict)
    unstated: Mapping[str, float] = field(default_factory=dict)
    jointly: Mapping[str, np.ndarray] = field(default_factory=dict)
    floors: Mapping[str, float] = field(default_factory=dict)
    nonnegative: frozenset[str] = frozenset()

    def with_floor(self, name: str, values: "RangeDraws") -> "RangeDraws":
        """Return draws at T temperatures, widened if U would be below the floor of their quantity."""
        if (floor := self.floors.get(name)) is None:
            return values
        expanded = np.array([each.expanded for each in self.coverage_at(name, values)])
        factor, middle = np.maximum(floor / expanded, 1.0), values.centre.mean(axis=0)
        return RangeDraws(middle + (values.centre - middle) * factor, values.scatter * factor)

    def coverage_at(self, name: str, values: "RangeDraws") -> list[Coverage]:
        """Return what is stated of a quantity at T temperatures; what was added moves no estimate.

        If the temperature changes nothing, that is what is stated of it everywhere.
        """
        effective, own = self.quantities.effective[name], self.quantities.marginal(name).draws
        return [
            self.coverage(name)
            if not scatter.any() and np.array_equal(centre, own)
            else self._coverage_at(name, Marginal(centre, effective), scatter)
            for centre, scatter in zip(values.centre.T, values.scatter.T, strict=True)
        ]

    def _coverage_at(self, name: str, centre: Marginal, scatter: np.ndarray) -> Coverage:
        added = self.added.get(name, 0.0)
        if float(np.mean(scatter**2)) > (_MATTERS * centre.sd) ** 2:
            return coverage_with_scatter(centre, scatter, added)
        # k of what it is made of: that of the bias contains how well the scatter of its runs is known.
        known = self.known.get(name)
        factor = NORMAL_FACTOR if known is None or known.factor is None else known.factor
        standard = float(np.sqrt(centre.sd**2 + np.mean(scatter**2)))
        if not standard > 0:
            return coverage_of(centre)
        own = max(centre.sd**2 - added**2, 0.0)
        of_mean = float(np.sqrt(own / centre.effective))
        # What was added has its standard deviation exactly, and a chance correlation with the draws.
        share = own / centre.sd**2 if centre.sd > 0 else 0.0
        of_sd = float(np.hypot(centre.errors.sd * share, of_mean if added else 0.0))
        return coverage_of(centre, KnownUncertainty(standard, of_sd, factor, of_mean))

    def coverage(self, name: str) -> Coverage:
        """Return what is stated of a quantity: the same in every table."""
        marginal, known = self.quantities.marginal(name), self.known.get(name)
        if name in self.lengths:
            return coverage_of_length(marginal, self.lengths[name], known)
        return coverage_of(marginal, known)


def unit_under_test(result: Result, exact: TakenAsExact | None = None) -> TestedUnit:
    """Return what a specification is held against: quantities of the result, their combinations, and the standards'.

    Parameters
    ----------
    result : a fit of the unit, with its campaign in place.
    exact : what the model takes as exact; what is included in the uncertainties widens the draws.  None for none.

    Raises
    ------
    InputError
        if the fit did not converge.
    """
    exact = exact or TakenAsExact()
    quantities = with_combinations(widened(posterior_quantities(result), exact.included), result.summary.combinations)
    model = result.fit.model
    channels, gravity = model.campaign.channels, model.campaign.site.gravity
    changes = np.asarray(model.assembly.nodes.ambient.values.get("temperature_rate", 0.0))
    thermal = thermal_model(
        model.spec,
        {name: entry.unit for name, entry in quantities.entries.items()},
        float(np.nanmax(np.abs(changes), initial=0.0)),
        {channel.name: channel.scale_si for channel in channels},
    )
    inputs = inputs_over_range(result.residuals.table)
    unit = TestedUnit(quantities, channels, inputs, gravity, _temperatures(result), thermal)
    known, lengths = with_standards(unit)
    added: dict[str, float] = {}
    for shift in (shift for each in exact.included for shift in each.shifts):
        added[shift.name] = float(np.hypot(added.get(shift.name, 0.0), shift.value))
    unstated = {each.name: each.value for each in exact.unstated}
    jointly = {each.name: np.array(each.values) for each in exact.jointly}
    parameters = (*model.layout.parameters, *model.hyper_layout.parameters)
    nonnegative = frozenset(each.name for each in parameters if each.prior.support()[0] >= 0).union(lengths)
    return replace(
        unit, quantities=known, lengths=lengths, nonnegative=nonnegative, added=added, unstated=unstated,
        jointly=jointly,
    )  # fmt: skip


def widened(known: PosteriorQuantities, exact: Sequence[ExactInput]) -> PosteriorQuantities:
    """Return quantities with draws that contain parameters that the model takes as exact."""
    draws, entries = dict(known.draws), dict(known.entries)
    for place, each in enumerate(exact):
        for shift in each.shifts:
            if shift.name in draws:
                # One parameter moves all quantities together, and no estimate.
                moved = shift.value * standard_draws(place, len(draws[shift.name]))
                draws[shift.name] = draws[shift.name] + moved
    for name, values in draws.items():
        share, before = entries[name].from_data, np.nanvar(known.draws[name])
        if share is not None and before > 0:
            share = max(0.0, 1 - (1 - share) * float(np.nanvar(values) / before))
            entries[name] = entries[name].model_copy(update={"from_data": share})
    return replace(known, entries=entries, draws=draws)


def with_standards(unit: UnitUnderTest) -> tuple[PosteriorQuantities, dict[str, float]]:
    """Return the quantities of a result with those of the standards that are none of its parameters; and lengths.

    A limit may name them: ``nonlinearity[gx]``, ``gyro_misalignment_total``.  Of a quantity that is the length of a
    vector, the length of the mean vector is returned.
    """
    known, lengths = unit.quantities, dict[str, float]()
    entries, draws, effective = dict(known.entries), dict(known.draws), dict(known.effective)
    for quantity in STANDARD_QUANTITIES:
        for found in draws_of_standard(quantity, unit):
            if len(found.members) == 1 and np.array_equal(found.draws, known.draws[found.members[0]], equal_nan=True):
                continue
            name = name_of(quantity.key, found.label)
            share = determined_share([known.entries[member] for member in found.members])
            if found.length:
                means = [float(np.nanmean(known.draws[member])) for member in found.members]
                lengths[name] = float(np.linalg.norm(means))
            entries[name] = Quantity(name=name, unit=found.unit, from_data=share)
            draws[name] = found.draws
            effective[name] = min(known.effective[member] for member in found.members)
    return PosteriorQuantities(entries, draws, effective), lengths


def determined_share(members: Sequence[Quantity]) -> float | None:
    """Return the share of information from the data of a function of quantities: the least of them; None if unknown."""
    shares = [each.from_data for each in members if each.from_data is not None]
    return min(shares) if len(shares) == len(members) else None


def is_measured(quantity: Quantity, draws: np.ndarray) -> bool:
    """Return whether the data determine a quantity: an exact one was never measured, nor one known from its prior."""
    share = quantity.from_data
    return not is_constant(draws[np.isfinite(draws)]) and (share is None or share >= WEAK_SHARE)


# A run was made over the range if it came this near to an end; of longer records so many rows stand for all.
_OVER_RANGE, _MOST_ROWS = 0.9, 500


def inputs_over_range(table: pl.DataFrame) -> dict[str, np.ndarray]:
    """Return the inputs of each channel, deg/s or g, in order: of all rows of the runs that reach an end of its range.

    A run in which the axis is inclined has a part of the range at other rates, and is no test of its linearity.
    Injected currents are no inputs.

    Parameters
    ----------
    table : rows of the residuals.
    """
    sensed = table.filter(
        (pl.col("procedure") != "current_injection") & pl.col("kind").is_in(["gyro", "accelerometer"])
    )
    return {str(name): _tested(own) for (name,), own in sensed.group_by("channel")}


def _tested(own: pl.DataFrame) -> np.ndarray:
    """Return the inputs of the rows of a channel, of the runs over its range."""
    values = own.select("run", pl.col("input_observed").alias("input")).filter(pl.col("input").is_finite())
    if not values.height:
        return np.zeros(1)
    low, high = float(values["input"].min()), float(values["input"].max())  # pyright: ignore[reportArgumentType]
    ends = values.group_by("run").agg(pl.col("input").min().alias("low"), pl.col("input").max().alias("high"))
    at_an_end = (pl.col("low") <= _OVER_RANGE * low) & (low < 0) | (pl.col("high") >= _OVER_RANGE * high) & (high > 0)
    whole = ends.filter(at_an_end)["run"].to_list()
    chosen = values.filter(pl.col("run").is_in(whole)) if whole else values
    ordered = np.sort(chosen["input"].to_numpy())
    return ordered[np.linspace(0, len(ordered) - 1, min(len(ordered), _MOST_ROWS)).round().astype(int)]


def _temperatures(result: Result) -> tuple[float, float] | None:
    """Return the lowest and the highest sensor temperature of all rows, °C; None if none was recorded."""
    table = result.residuals.table
    if "temperature_degC" not in table.columns:
        return None
    values = table["temperature_degC"].cast(pl.Float64).drop_nulls().to_numpy()
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if len(values) else None

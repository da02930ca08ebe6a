"""The unit under test as a specification and the standards see it: quantities with draws, and what it was tested at."""

from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from imubayes.qualification.posterior_quantities import (
    PosteriorQuantities,
    posterior_quantities,
    with_combinations,
)
from imubayes.qualification.standard_quantities import STANDARD_QUANTITIES, UnitUnderTest, draws_of_standard
from imubayes.qualification.temperature_range import ThermalModel, thermal_model
from imubayes.results.result import Result
from imubayes.results.summary import Quantity


@dataclass(frozen=True)
class TestedUnit(UnitUnderTest):
    """What a specification is held against.

    Attributes
    ----------
    temperatures : lowest and highest sensor temperature of the runs, °C; None where none was recorded.
    thermal : thermal terms of the model.
    """

    __test__ = False  # no test, whatever its name says to pytest

    temperatures: tuple[float, float] | None
    thermal: ThermalModel


def tested_unit(result: Result) -> TestedUnit:
    """Return what a specification is held against: quantities of the result, their combinations, and the standards'.

    Raises
    ------
    InputError
        where the fit did not converge.
    """
    quantities = with_combinations(posterior_quantities(result), result.summary.combinations)
    model = result.fit.model
    channels, gravity = model.campaign.channels, model.campaign.site.gravity
    changes = np.asarray(model.assembly.nodes.ambient.values.get("temperature_rate", 0.0))
    thermal = thermal_model(
        model.spec,
        {name: entry.unit for name, entry in quantities.entries.items()},
        float(np.nanmax(np.abs(changes), initial=0.0)),
        {channel.name: channel.scale_si for channel in channels},
    )
    unit = TestedUnit(
        quantities, channels, inputs_over_range(result.residuals.table), gravity, _temperatures(result), thermal
    )
    return replace(unit, quantities=with_standards(unit))


def with_standards(unit: UnitUnderTest) -> PosteriorQuantities:
    """Return the quantities of a result with those of the standards that are none of its parameters.

    A limit may name them: ``nonlinearity[gx]``, ``gyro_misalignment_total``.
    """
    known = unit.quantities
    entries, draws, effective = dict(known.entries), dict(known.draws), dict(known.effective)
    for quantity in STANDARD_QUANTITIES:
        for found in draws_of_standard(quantity, unit):
            if len(found.members) == 1 and np.array_equal(found.draws, known.draws[found.members[0]], equal_nan=True):
                continue
            name = f"{quantity.key}[{found.label}]"
            share = known.entries[found.members[0]].from_data if len(found.members) == 1 else None
            entries[name] = Quantity(name=name, unit=found.unit, from_data=share)
            draws[name] = found.draws
            effective[name] = min(known.effective[member] for member in found.members)
    return PosteriorQuantities(entries, draws, effective)


# A run was made over the range where it came this near to an end; of longer records so many rows stand for all.
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
    """Return the lowest and the highest sensor temperature of all rows, °C; None where none was recorded."""
    table = result.residuals.table
    if "temperature_degC" not in table.columns:
        return None
    values = table["temperature_degC"].cast(pl.Float64).drop_nulls().to_numpy()
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if len(values) else None

"""A result held against a specification: the outcome for each limit and for the unit.

Conformity is a statement about the unit only where the posterior is one: a unit cannot pass on a model that the
diagnosis found inadequate or has not seen, nor on intervals that the noise does not support.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import polars as pl

from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.qualification.conformity import (
    WORST_FIRST,
    ConformityOfQuantity,
    TestedUnit,
    conformity,
    overall_outcome,
    resolved_limits,
)
from imubayes.qualification.decision_rules import Outcome
from imubayes.qualification.posterior_quantities import (
    PosteriorQuantities,
    posterior_quantities,
    with_combinations,
)
from imubayes.qualification.specification import read_specification
from imubayes.qualification.standard_quantities import STANDARD_QUANTITIES, UnitUnderTest, draws_of_standard
from imubayes.qualification.temperature_range import thermal_model
from imubayes.results.result import Result
from imubayes.results.summary import Quantity

Obstacle = Literal["not_converged", "not_diagnosed", "inadequate_model", "invalid_intervals"]


@dataclass(frozen=True)
class Assessment:
    """What a specification says of a unit.

    Attributes
    ----------
    specification : its name.
    limits : outcome for each limit.
    obstacles : why the unit cannot pass, whatever the limits say; empty where nothing stands against it.
    """

    specification: str
    limits: tuple[ConformityOfQuantity, ...]
    obstacles: tuple[Obstacle, ...]

    @property
    def outcome(self) -> Outcome:
        """The worst outcome of all limits, and no better than `withheld` where there is an obstacle."""
        found = overall_outcome(self.limits)
        better = WORST_FIRST.index(found) > WORST_FIRST.index("withheld")
        return "withheld" if self.obstacles and better else found


def assess(
    result: Result, specification: str | Path, diagnosis: Diagnosis | None, unit: TestedUnit | None = None
) -> Assessment:
    """Return the conformity of a unit to a specification.

    Parameters
    ----------
    result : a fit of the unit, with its campaign in place.
    specification : the file.
    diagnosis : of the result; None where it was not diagnosed, which a unit cannot pass with.
    unit : the quantities of the result where they are known already.

    Raises
    ------
    InputError
        with everything in the specification that cannot be used with this result.
    """
    file, ledger = read_specification(specification)
    if not result.summary.converged:
        return Assessment(file.name, (), _obstacles(result, diagnosis))
    unit = unit or tested_unit(result)
    limits = tuple(conformity(limit, unit) for limit in resolved_limits(file, ledger, unit))
    return Assessment(file.name, limits, _obstacles(result, diagnosis))


def tested_unit(result: Result) -> TestedUnit:
    """Return what a specification is held against: quantities of the result, their combinations, and the standards'.

    Raises
    ------
    InputError
        where the fit did not converge.
    """
    quantities = with_combinations(posterior_quantities(result), result.summary.combinations)
    model = result.fit.model
    thermal = thermal_model(model.spec, {name: entry.unit for name, entry in quantities.entries.items()})
    gravity = model.campaign.site.gravity
    under_test = UnitUnderTest(quantities, model.campaign.channels, _inputs(result), gravity)
    return TestedUnit(with_standards(under_test), _temperatures(result), thermal, gravity)


def standards_input(result: Result, unit: TestedUnit) -> UnitUnderTest:
    """Return what the quantities of the standards are computed from."""
    campaign = result.fit.model.campaign
    return UnitUnderTest(unit.quantities, campaign.channels, _inputs(result), campaign.site.gravity)


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


def _inputs(result: Result) -> dict[str, tuple[float, float]]:
    """Return the lowest and the highest input of each channel over all runs, deg/s or g; injected currents are none."""
    table = result.residuals.table
    sensed = table.filter(
        (pl.col("procedure") != "current_injection") & pl.col("kind").is_in(["gyro", "accelerometer"])
    )
    ends = sensed.group_by("channel").agg(
        pl.col("input_observed").min().alias("low"), pl.col("input_observed").max().alias("high")
    )
    return {line["channel"]: (line["low"], line["high"]) for line in ends.iter_rows(named=True)}


def _temperatures(result: Result) -> tuple[float, float] | None:
    """Return the lowest and the highest sensor temperature of all rows, °C; None where none was recorded."""
    table = result.residuals.table
    if "temperature_degC" not in table.columns:
        return None
    values = table["temperature_degC"].cast(pl.Float64).drop_nulls().to_numpy()
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if len(values) else None


def _obstacles(result: Result, diagnosis: Diagnosis | None) -> tuple[Obstacle, ...]:
    if not result.summary.converged:
        return ("not_converged",)
    found: list[Obstacle] = []
    if diagnosis is None:
        found.append("not_diagnosed")
    elif diagnosis.verdict != "adequate":
        found.append("inadequate_model")
    if not result.summary.intervals_valid:
        found.append("invalid_intervals")
    return tuple(found)

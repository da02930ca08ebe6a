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
from imubayes.model.sensitive_axes import REFERENCE_TEMPERATURE
from imubayes.qualification.conformity import (
    WORST_FIRST,
    ConformityOfQuantity,
    TestedUnit,
    conformity,
    overall_outcome,
    resolved_limits,
)
from imubayes.qualification.decision_rules import Outcome
from imubayes.qualification.posterior_quantities import posterior_quantities
from imubayes.qualification.specification import read_specification
from imubayes.qualification.temperature_range import ThermalModel
from imubayes.results.result import Result

Obstacle = Literal["not_diagnosed", "inadequate_model", "invalid_intervals"]


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


def assess(result: Result, specification: str | Path, diagnosis: Diagnosis | None) -> Assessment:
    """Return the conformity of a unit to a specification.

    Parameters
    ----------
    result : a fit of the unit that converged, with its campaign in place.
    specification : the file.
    diagnosis : of the result; None where it was not diagnosed, which a unit cannot pass with.

    Raises
    ------
    InputError
        with everything in the specification that cannot be used with this result; where the fit did not converge.
    """
    file, ledger = read_specification(specification)
    unit = tested_unit(result)
    limits = tuple(conformity(limit, unit) for limit in resolved_limits(file, ledger, unit))
    return Assessment(file.name, limits, _obstacles(result, diagnosis))


def tested_unit(result: Result) -> TestedUnit:
    """Return what a specification is held against; raises InputError where the fit did not converge."""
    quantities = posterior_quantities(result)
    model = result.fit.model
    reference = {
        effect.name: effect.options["reference_degC"]
        for effect in model.spec.effects
        if "reference_degC" in effect.options
    }
    units = {name: entry.unit for name, entry in quantities.entries.items()}
    thermal = ThermalModel(reference, units, REFERENCE_TEMPERATURE)
    return TestedUnit(quantities, _temperatures(result), thermal, model.campaign.site.gravity)


def _temperatures(result: Result) -> tuple[float, float] | None:
    """Return the lowest and the highest sensor temperature of all rows, °C; None where none was recorded."""
    table = result.residuals.table
    if "temperature_degC" not in table.columns:
        return None
    values = table["temperature_degC"].cast(pl.Float64).drop_nulls().to_numpy()
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if len(values) else None


def _obstacles(result: Result, diagnosis: Diagnosis | None) -> tuple[Obstacle, ...]:
    found: list[Obstacle] = []
    if diagnosis is None:
        found.append("not_diagnosed")
    elif diagnosis.verdict != "adequate":
        found.append("inadequate_model")
    if not result.summary.intervals_valid:
        found.append("invalid_intervals")
    return tuple(found)

"""Units of a batch that need a person: without estimates, with noise that contradicts the model, unlike the others."""

from typing import Literal

import polars as pl

from imubayes.foundations.records import Record
from imubayes_archive.population.parameter_population import Populations

Doubt = Literal["no_estimates", "noise", "population"]
"""`no_estimates`: the unit has none; `noise`: its intervals must not be trusted; `population`: unlike the others."""


class UnitInDoubt(Record):
    """One reason to look at a unit.

    Attributes
    ----------
    unit, file : serial number, and the campaign that it was fitted from.
    doubt : kind of the reason.
    about : status of a unit without estimates, kinds of violations and noise scales, or the parameter.
    said : reason of the fit, empty for other kinds.
    distance : from the population in standard deviations; None for other kinds.
    """

    unit: str
    file: str
    doubt: Doubt
    about: tuple[str, ...]
    said: str = ""
    distance: float | None = None


def units_in_doubt(units: pl.DataFrame, found: Populations) -> tuple[UnitInDoubt, ...]:
    """Return the units that need a person, those without estimates first.

    Parameters
    ----------
    units : table of the units of a batch.
    found : their populations.
    """
    rows = list(units.iter_rows(named=True))
    failed = [
        UnitInDoubt(
            unit=row["unit"], file=row["file"], doubt="no_estimates", about=(row["status"],), said=row["reason"]
        )
        for row in rows
        if row["status"] != "fitted"
    ]
    noisy = [
        UnitInDoubt(unit=row["unit"], file=row["file"], doubt="noise", about=about)
        for row in rows
        if (about := (*(row["noise_violations"] or ()), *(row["noise_contradicted"] or ())))
        and row["status"] == "fitted"
    ]
    file_of = {row["unit"]: row["file"] for row in rows}
    unlike = [
        UnitInDoubt(
            unit=each.unit, file=file_of[each.unit], doubt="population", about=(parameter.parameter,),
            distance=each.distance,
        )
        for parameter in found.parameters
        if parameter.kind != "derived"
        for each in parameter.outlying
    ]  # fmt: skip
    return (*failed, *noisy, *sorted(unlike, key=lambda each: -abs(each.distance or 0.0)))

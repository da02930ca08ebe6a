"""Covariates of an archive: what the campaigns state that may explain how their units differ."""

import re

import numpy as np
import polars as pl

from imubayes.foundations.units import DAYS_PER_YEAR
from imubayes_archive.population.population_search import UnitCovariate

_NUMBER = re.compile(r"(\d+)\D*$")
_SERIALS = 100.0
# Sites closer than this are one: degrees of latitude.
_SAME_LATITUDE = 2


def serial_number(unit: str) -> float | None:
    """Return the last number in the name of a unit; None if it has none."""
    found = _NUMBER.search(unit)
    return float(found[1]) if found else None


def covariates_of(units: pl.DataFrame) -> list[UnitCovariate]:
    """Return the covariates of units: date, serial number, tables, mountings, site, procedures and stated labels.

    Parameters
    ----------
    units : rows of the table of units, one for each estimate, in their order.
    """
    found = [*_ordered(units)]
    for name in ("table", "mounting", "procedure"):
        found += [UnitCovariate(name, tuple(" + ".join(each) for each in units[f"{name}s"].to_list()))]
    sites = [f"latitude {latitude:.{_SAME_LATITUDE}f} deg" for latitude in units["latitude"].fill_null(0.0)]
    found.append(UnitCovariate("site", tuple(sites)))
    labels = [dict(each.split("=", 1) for each in stated or ()) for stated in units["labels"].to_list()]
    names = dict.fromkeys(name for each in labels for name in each)
    found.extend(UnitCovariate(name, tuple(each.get(name, "") for each in labels)) for name in names)
    return _distinct(found)


def _ordered(units: pl.DataFrame) -> list[UnitCovariate]:
    found, dates = [], units["date"]
    if dates.null_count() == 0:
        years = dates.cast(pl.Int32).cast(pl.Float64).to_numpy() / DAYS_PER_YEAR
        found.append(UnitCovariate("date", tuple(str(each) for each in dates), years, "year"))
    numbers = [serial_number(unit) for unit in units["unit"]]
    if None not in numbers:
        values = np.array(numbers, dtype=float) / _SERIALS
        found.append(UnitCovariate("serial number", tuple(units["unit"]), values, "100 serial numbers"))
    return found


def _distinct(covariates: list[UnitCovariate]) -> list[UnitCovariate]:
    """Return covariates without those that part the units as an earlier one does; that one has the names of both."""
    kept: dict[object, UnitCovariate] = {}
    for each in covariates:
        if each.ordered is not None:
            kept[each.name] = each
            continue
        first = {shown: place for place, shown in reversed(list(enumerate(each.shown)))}
        partition = tuple(first[shown] for shown in each.shown)
        same = kept.get(partition)
        if same is None:
            kept[partition] = each
        elif each.known:
            both = tuple(f"{one} / {other}" for one, other in zip(same.shown, each.shown, strict=True))
            kept[partition] = UnitCovariate(f"{same.name} / {each.name}", both)
    return list(kept.values())

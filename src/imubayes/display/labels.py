"""Units and covariates as they are shown: readable sizes, readable signs, one label per quantity.

Results carry the units of the interfaces (deg/s, g, ug, degC).  A residual of 0.00003 deg/s says little to anybody, so
pictures and run tables choose the size of the same unit that gives plain numbers: 0.11 deg/h.
"""

from collections.abc import Sequence

from imubayes.covariates import Covariate, shown

# unit → (largest typical size for which the finer unit is chosen, its factor, its name), the finest first
_FINER: dict[str, tuple[tuple[float, float, str], ...]] = {
    "deg/s": ((0.01, 3600.0, "deg/h"),),
    "g": ((1e-3, 1e6, "ug"), (1.0, 1e3, "mg")),
    "deg": ((0.05, 3600.0, "arcsec"), (1.0, 60.0, "arcmin")),
    "rad": ((1e-3, 1e6, "urad"), (1.0, 1e3, "mrad")),
    "m/s^2": ((0.1, 1e3, "mm/s^2"),),
}
_COARSER: dict[str, tuple[tuple[float, float, str], ...]] = {
    "s": ((7200.0, 1 / 3600, "h"), (600.0, 1 / 60, "min")),
    "ug": ((5e5, 1e-6, "g"), (1e4, 1e-3, "mg")),
}
_SIGNS = {"degC": "°C", "^2": "²", "^3": "³"}


def pretty(unit: str) -> str:
    """Return a unit with the signs of print: ug/g^2 → µg/g²."""
    for plain, sign in _SIGNS.items():
        unit = unit.replace(plain, sign)
    return "/".join("µ" + part[1:] if part in ("ug", "urad", "uA", "uA²") else part for part in unit.split("/"))


def readable(unit: str, typical: float) -> tuple[float, str]:
    """Return the factor and the unit in which numbers of a typical size read well."""
    for limit, factor, name in _FINER.get(unit, ()):
        if 0 < typical < limit:
            return factor, name
    for limit, factor, name in _COARSER.get(unit, ()):
        if typical >= limit:
            return factor, name
    return 1.0, unit


ROW = Covariate("row", "row", "", "", "row", origin="derived")
"""What residuals are drawn against where nothing better is recorded."""


def covariates() -> tuple[Covariate, ...]:
    """Return what residuals can be drawn against."""
    return (ROW, *shown())


def covariate(name: str) -> Covariate:
    """Return a covariate by its column (`table_rate_deg_s`) or its name (`table_rate`)."""
    for known in covariates():
        if name in (known.column, known.name):
            return known
    raise KeyError(f"'{name}' is not a covariate: {', '.join(known.name for known in covariates())}")


def shortened(name: str, most: int) -> str:
    """Return a name of at most `most` characters, its middle left out where it is longer."""
    if len(name) <= most:
        return name
    head = (most - 1 + 1) // 2
    return f"{name[:head]}…{name[len(name) - (most - 1 - head) :]}"


def listed(names: Sequence[str], most: int = 6) -> str:
    """Return names as a phrase: `a, b and 3 more`."""
    if len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[:most])} and {len(names) - most} more"

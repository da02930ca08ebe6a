"""Numbers with the digits that their uncertainty supports, units in readable sizes, and labels of covariates.

GUM 7.2.6: a standard uncertainty is stated to at most two significant digits, the estimate to the same decimal place.
Shares get the same care: 99.996 % is never printed as 100 %.

Results carry the units of the interfaces (deg/s, g, ug, degC).  A residual of 0.00003 deg/s says little to anybody, so
pictures and run tables choose the size of the same unit that gives plain numbers: 0.11 deg/h.  Units have readable
signs, and a quantity has one label.
"""

import math
import re
import shlex
from collections.abc import Sequence

from imubayes.foundations.covariates import Covariate, shown
from imubayes.foundations.number_text import NO_NUMBER as NO_NUMBER
from imubayes.foundations.number_text import concise as concise
from imubayes.foundations.number_text import is_exact as is_exact
from imubayes.foundations.number_text import pretty as pretty
from imubayes.foundations.number_text import rounded as rounded
from imubayes.foundations.number_text import significant as significant
from imubayes.foundations.number_text import value_and_sd as value_and_sd

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
"""Abscissa of residuals if nothing better is recorded."""


def covariates() -> tuple[Covariate, ...]:
    """Return what residuals can be drawn against."""
    return (ROW, *shown())


def covariate(name: str) -> Covariate:
    """Return a covariate by its column (`table_rate_deg_s`) or its name (`table_rate`)."""
    for known in covariates():
        if name in (known.column, known.name):
            return known
    raise KeyError(f"'{name}' is not a covariate: {', '.join(known.name for known in covariates())}")


def command_line(*words: str) -> str:
    """Return a command of `imubayes` as it is typed: a blank or another special character of a path is quoted."""
    return shlex.join(["imubayes", *words])


def shortened(name: str, most: int) -> str:
    """Return a name of at most `most` characters, its middle left out if it is longer."""
    if len(name) <= most:
        return name
    head = (most - 1 + 1) // 2
    return f"{name[:head]}…{name[len(name) - (most - 1 - head) :]}"


def listed(names: Sequence[str], most: int = 6) -> str:
    """Return names as a phrase: `a, b and 3 more`."""
    if len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[:most])} and {len(names) - most} more"


# A hyphen before a number, but within a name, a date, an exponent, or the prior of a model file.
_HYPHEN = re.compile(r"(?<![\w\-.,])(?<!\w[\[(])-(?=\.?\d)")
_CODE = re.compile(r"(`[^`]+`)")


def with_minus(text: str) -> str:
    """Return a text whose negative numbers have a minus sign (ISO 80000-1): −1.8e-06.

    Exponents, commands and names stay as they are.
    """
    parts = _CODE.split(text)
    return "".join(part if place % 2 else _HYPHEN.sub("−", part) for place, part in enumerate(parts))


def ratio_text(value: float | None) -> str:
    """Return a ratio near one, such as χ²/n, to two decimals; to three digits if it is large."""
    if value is None or not math.isfinite(value):
        return NO_NUMBER
    if value < 10:
        return f"{value:.2f}"
    return significant(value) if value < 1e4 else f"{value:.1e}"


def percent(share: float | None) -> str:
    """Return a share in per cent, finer toward certainty: 12 %, 97.3 %, 99.96 %, > 99.99 %."""
    if share is None or not math.isfinite(share):
        return NO_NUMBER
    share = 100 * min(max(share, 0.0), 1.0)
    if share > 99.99:
        return "> 99.99 %"
    decimals = 2 if share >= 99.9 else 1 if share >= 95 else 0
    # Rounded down if it is near certainty: 99.96 % is not 100 %.
    share = math.floor(share * 10**decimals) / 10**decimals if decimals else share
    return f"{share:.{decimals}f} %"


def chance_text(p: float | None) -> str:
    """Return a p-value: two digits, and a power of ten if it is small."""
    if p is None:
        return "–"
    return f"{p:.2g}" if p >= 1e-3 else ("< 1e-30" if p < 1e-30 else f"{p:.0e}")


def relation(p: float) -> str:
    """Return a p-value with its sign of equality, or below what is smallest."""
    text = chance_text(p)
    return text if text.startswith("<") else f"= {text}"

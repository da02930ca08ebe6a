"""Numbers with the digits that their uncertainty supports, and units with the signs of print.

GUM 7.2.6: a standard uncertainty is stated to at most two significant digits, the estimate to the same decimal place.
"""

import math
from collections.abc import Iterable
from functools import cache

from sciform import Formatter

from imubayes.foundations.numerics import leading_decade

_SIGNS = {"degC": "°C", "^2": "²", "^3": "³"}


def pretty(unit: str) -> str:
    """Return a unit with the signs of print: ug/g^2 → µg/g²."""
    for plain, sign in _SIGNS.items():
        unit = unit.replace(plain, sign)
    return "/".join("µ" + part[1:] if part in ("ug", "urad", "uA", "uA²") else part for part in unit.split("/"))


NO_NUMBER = "–"
# Outside of these sizes a power of ten is split off.
_SMALLEST, _LARGEST = 1e-5, 1e8
# Means and standard deviations over thousands of equal draws differ from them by some units in the last place.
_ROUNDING_ERROR = 1e-12


@cache
def _formatter(decimals: int, exponent: int) -> Formatter:
    if exponent:
        return Formatter(round_mode="dec_place", ndigits=decimals, exp_mode="scientific", exp_val=exponent)
    return Formatter(round_mode="dec_place", ndigits=decimals)


def rounded(values: Iterable[float | None], sd: float | None) -> tuple[str, ...]:
    """Return numbers to the second significant digit of their standard uncertainty, an en dash for none.

    Without a positive uncertainty the largest value gets five significant digits at least.
    """
    values = tuple(values)
    sizes = [abs(value) for value in values if value is not None and math.isfinite(value) and value]
    step = sd if sd is not None and math.isfinite(sd) and sd > 0 else max(sizes, default=1.0) * 1e-4
    largest = max([*sizes, step])
    exponent = 0 if _SMALLEST <= largest < _LARGEST else math.floor(math.log10(largest))
    formatter = _formatter(1 - leading_decade(step, 2) + exponent, exponent)
    return tuple(
        _unsigned_zero(formatter(value)) if value is not None and math.isfinite(value) else NO_NUMBER
        for value in values
    )


def _unsigned_zero(text: str) -> str:
    return text.removeprefix("-") if float(text) == 0 else text


def is_exact(value: float | None, sd: float | None) -> bool:
    """Return whether an uncertainty is only the rounding of the arithmetic: that of a number which nothing changes."""
    return value is not None and sd is not None and bool(0 <= sd <= _ROUNDING_ERROR * abs(value))


def value_and_sd(value: float | None, sd: float | None) -> tuple[str, str]:
    """Return estimate and standard uncertainty as text: (12.3456, 0.0213) → ("12.346", "0.021")."""
    if value is not None and is_exact(value, sd):
        return rounded((value,), None)[0], "0"
    estimate, uncertainty = rounded((value, sd), sd)
    return estimate, uncertainty


def concise(value: float, sd: float) -> str:
    """Return the estimate with its standard uncertainty in parentheses, GUM 7.2.2: 12.346(21), -0.00013(23)."""
    if not sd > 0:
        return rounded((value,), sd)[0]
    estimate, uncertainty = value_and_sd(value, sd)
    if "e" in uncertainty:
        return f"{estimate} ± {uncertainty}"
    digits = uncertainty.removeprefix("0.").lstrip("0") if uncertainty.startswith("0.") else uncertainty
    return estimate if uncertainty == "0" else f"{estimate}({digits})"


def significant(value: float | None, digits: int = 3) -> str:
    """Return a number of no stated uncertainty to some significant digits, without an exponent if possible."""
    if value is None or not math.isfinite(value):
        return NO_NUMBER
    if value == 0:
        return "0"
    if not _SMALLEST <= abs(value) < _LARGEST:
        return f"{value:.{digits - 1}e}"
    return _formatter(digits - 1 - leading_decade(value, digits), 0)(value)

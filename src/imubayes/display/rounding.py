"""Numbers as a metrologist writes them: no digit beyond what the uncertainty supports.

GUM 7.2.6: a standard uncertainty is stated to at most two significant digits, the estimate to the same decimal place.
Shares get the same care: 99.996 % is never printed as 100 %, since nothing is known that well.
"""

import math
from dataclasses import dataclass

# Outside of these the decimal point is moved by a power of ten.
_SMALLEST, _LARGEST = 1e-5, 1e8


@dataclass(frozen=True)
class Grid:
    """The decimal place that an uncertainty supports: `decimals` (negative left of the point) of x/10**exponent."""

    decimals: int
    exponent: int = 0

    def __call__(self, value: float | None) -> str:
        """Return the value as text on this grid, an en dash where there is none."""
        if value is None or not math.isfinite(value):
            return "–"
        scaled = round(value / 10.0**self.exponent, self.decimals)
        text = f"{scaled + 0.0:.{max(self.decimals, 0)}f}"
        if float(text) == 0:
            text = text.removeprefix("-")
        return text + (f"e{self.exponent:+03d}" if self.exponent else "")


def grid_of(sd: float | None, *values: float | None) -> Grid:
    """Return the decimal place for numbers whose standard uncertainty is `sd`.

    Parameters
    ----------
    sd : standard uncertainty; without a positive one the largest of the values is given six digits.
    values : what is to be written; decides whether a power of ten is split off.
    """
    sizes = [abs(v) for v in values if v is not None and math.isfinite(v) and v != 0]
    certain = sd is None or not math.isfinite(sd) or sd <= 0
    step = max(sizes, default=1.0) * 1e-4 if certain else float(sd or 0.0)
    largest = max([*sizes, step])
    exponent = 0
    if largest >= _LARGEST or largest < _SMALLEST:
        exponent = math.floor(math.log10(largest))
    # Two digits after rounding: 0.0996 is 0.10, not 0.100.
    place = int(f"{step / 10.0**exponent:.1e}".partition("e")[2])
    return Grid(1 - place, exponent)


def value_and_sd(value: float | None, sd: float | None) -> tuple[str, str]:
    """Return estimate and standard uncertainty as text: (12.3456, 0.0213) → ("12.346", "0.021")."""
    grid = grid_of(sd, value)
    return grid(value), grid(sd)


def concise(value: float, sd: float) -> str:
    """Return estimate with its standard uncertainty in its last two digits: 12.346(21)."""
    grid = grid_of(sd, value)
    if sd is None or not math.isfinite(sd) or sd <= 0:
        return grid(value)
    if grid.decimals <= 1 or grid.exponent:
        return f"{grid(value)} ± {grid(sd)}"
    return f"{grid(value)}({round(sd * 10**grid.decimals):02d})"


def significant(value: float | None, digits: int = 3) -> str:
    """Return a number of no stated uncertainty to some significant digits, without trailing exponent where it can."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if not _SMALLEST <= abs(value) < _LARGEST:
        return f"{value:.{digits - 1}e}"
    place = int(f"{value:.{digits - 1}e}".partition("e")[2])
    return f"{round(value, digits - 1 - place):.{max(digits - 1 - place, 0)}f}"


def ratio_text(value: float | None) -> str:
    """Return a ratio near one, such as χ²/n, to two decimals; three digits where it is large."""
    if value is None or not math.isfinite(value):
        return "–"
    if value < 10:
        return f"{value:.2f}"
    return significant(value) if value < 1e4 else f"{value:.1e}".replace("e+0", "e")


def percent(share: float | None) -> str:
    """Return a share as per cent, finer toward both ends: 12 %, 97.3 %, 99.96 %, > 99.99 %."""
    if share is None or not math.isfinite(share):
        return "–"
    share = 100 * min(max(share, 0.0), 1.0)
    if share > 99.99:
        return "> 99.99 %"
    if share >= 99.9:
        return f"{math.floor(share * 100) / 100:.2f} %"
    if share >= 95:
        return f"{math.floor(share * 10) / 10:.1f} %"
    return f"{share:.0f} %"

"""Hypotheses about what was recorded: in a run, or a row of it, a recorded quantity has another value.

The set-up check, the caution of a fit and the diagnosis weigh these hypotheses, each with its own likelihood: plausible
errors of a unit, the model of the user, and that model beside missing effects.  The rest is common to the three and
stands here: the record of a hypothesis, its words, the correction that it asks for, and the values that have a name,
such as another unit, with their prior odds.

A named value is a point on the open value.  It is reported if it is likelier than the open value (Savage and Dickey:
the ratio of posterior to prior density at the point is the Bayes factor).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imubayes.foundations.number_text import pretty, significant, value_and_sd
from imubayes.foundations.records import Record

Form = Literal["offset", "factor", "seat", "output_offset", "output_factor", "exchange", "unit", "prior", "samples"]
OPEN = 8.0
"""−2 times the logarithm of how usual an open value is, over the most usual mistakes.  Convention."""
OPEN_SCALE, NAMED_SCALE, SCALE_OF_KIND = 20.0, 30.0, 15.0
"""The same of a scale factor that only one run has: of any size, and as another unit of one channel and of all of a
kind, or with the opposite sign: outputs are read alike in all runs."""
WIDTHS = {"degC": 30.0, "deg": 57.3}
"""Standard deviations of open values by their unit; those of ratios are `RATIO`."""
RATIO = 0.3
_SAME_SD = 4.0
"""Standard deviations within which two estimates of a value are the same.  Convention."""

_DEGREE = math.pi / 180
GAINS = {
    "gyro": {
        "deg/s instead of rad/s": 1 / _DEGREE, "rad/s instead of deg/s": _DEGREE, "deg/h instead of deg/s": 3600.0,
        "deg/s instead of deg/h": 1 / 3600, "deg/h instead of rad/s": 3600.0 / _DEGREE,
        "rpm instead of deg/s": 1 / 6, "deg/s instead of rpm": 6.0, "mdeg/s instead of deg/s": 1000.0,
        "deg/s instead of mdeg/s": 1e-3, "a decimal place": 10.0, "one decimal place": 0.1,
    },
    "accelerometer": {
        "m/s² instead of g": 9.80665, "g instead of m/s²": 1 / 9.80665, "mg instead of g": 1000.0,
        "g instead of mg": 1e-3, "ft/s² instead of g": 32.174, "mg instead of m/s²": 1000 / 9.80665,
        "cm/s² instead of m/s²": 100.0, "a decimal place": 10.0, "one decimal place": 0.1,
    },
}  # fmt: skip
"""Mistaken units of an output, and the factor by which it is too large."""
RATE_UNITS = {
    "rpm": 6.0, "rev/s": 360.0, "rad/s": 1 / _DEGREE, "deg/min": 1 / 60, "deg/h": 1 / 3600, "mdeg/s": 1e-3,
    "rad/h": 1 / _DEGREE / 3600,
}  # fmt: skip
"""Units of rate in deg/s."""
ANGLE_UNITS = {
    "rad": 1 / _DEGREE, "gon": 0.9, "turns": 360.0, "arcmin": 1 / 60, "arcsec": 1 / 3600, "mrad": 1e-3 / _DEGREE,
}  # fmt: skip
"""Units of angle in degrees."""

OPPOSITE = "with the opposite sign"


def celsius[Number: (float, np.ndarray)](fahrenheit: Number) -> Number:
    """Return a temperature in °C from degrees Fahrenheit."""
    return (fahrenheit - 32) / 1.8


@dataclass(frozen=True)
class NamedValue:
    """A value of a record that has a name.

    Attributes
    ----------
    name : in words, after "as if".
    value : what agrees if the record is so.
    unlikelihood : −2 times the logarithm of how usual it is, over the most usual mistakes.
    correction : of a column, in words that take the column; empty if that of the open value serves.
    """

    name: str
    value: float
    unlikelihood: float = 0.0
    correction: str = ""


class WrongRecord(Record):
    """A recorded quantity of a run, or of one row of it, and what would make the run agree with the others.

    Attributes
    ----------
    run : its name; empty of a prior.
    row : counts from 1; None for the run as a whole.
    form : an ``offset`` or a ``factor`` of a column; the attitude of the ``seat``; an ``output_offset`` or an
        ``output_factor`` of all channels or of one; an ``exchange`` of a column with that of another run; another
        ``unit``; a ``prior`` that is too narrow; the count of ``samples`` of each row.
    quantity : the column; ``mounting``; ``outputs``, or the only channel; ``unit``; the parameter that is
        farthest off its prior as fitted, in standard deviations.
    unit : of the values; of a factor 1, of outputs the unit of the first channel.
    recorded : what the record says: the value of the row, the mean of the column, or 0 for the attitude and offsets and
        1 for a factor.
    agreeing : what would agree, for each component: value, factor, or rotation vector in body axes.
    sd : its standard uncertainty, with what is estimated beside it; empty of a value that has a name.
    probability : among all that was weighed with it.
    other : of an exchange, the name of the other run; empty otherwise.
    kind : of the channel concerned, if it is one.
    about : offset of the outputs that a factor leaves as it is, output units.
    """

    run: str = ""
    row: int | None = None
    form: Form
    quantity: str
    unit: str
    recorded: float | None
    agreeing: tuple[float, ...]
    sd: tuple[float, ...] = ()
    probability: float = 1.0
    other: str = ""
    kind: str = ""
    about: float = 0.0

    def agrees_with(self, other: "WrongRecord") -> bool:
        """Return whether another hypothesis is the same: what is wrong, and its value within the uncertainties."""
        places = [(each.run, each.row, each.form, each.quantity) for each in (self, other)]
        if self.form == other.form == "exchange":
            return self.quantity == other.quantity and {self.run, self.other} == {other.run, other.other}
        if places[0] != places[1]:
            return False
        if self.form in ("unit", "prior") or len(self.agreeing) != len(other.agreeing):
            return True
        none = (0.0,) * len(self.agreeing)
        pairs = zip(self.agreeing, other.agreeing, self.sd or none, other.sd or none, strict=True)
        apart = ((a, math.remainder(a - b, 360.0) if self.unit == "deg" else a - b, u, v) for a, b, u, v in pairs)
        return all(abs(off) <= _SAME_SD * math.hypot(u, v) + 1e-3 * abs(a) for a, off, u, v in apart)

    @property
    def named(self) -> NamedValue | None:
        """The named value that is likelier than the open one; None without one."""
        if len(self.agreeing) != 1:
            return None
        value, sd = self.agreeing[0], self.sd[0] if self.sd else 0.0
        if self.form in ("factor", "output_factor"):
            floor, width = 1e-3 * abs(value), RATIO * max(1.0, abs(value))
        else:
            floor, width = 1e-3, WIDTHS.get(self.unit, RATIO)
        sd = max(sd, floor)
        tried = [(((each.value - value) / sd) ** 2 + each.unlikelihood, k, each) for k, each in enumerate(_named(self))]
        score, _, best = min(tried, default=(math.inf, 0, None))
        unlikely = OPEN_SCALE if self.form == "output_factor" else OPEN
        return best if score < unlikely + 2 * math.log(max(width / sd, 1.0)) else None


def _named(each: WrongRecord) -> Iterator[NamedValue]:
    """Yield the values with a name of a record."""
    if each.form == "offset" and each.unit == "degC" and each.recorded is not None:
        replaced = "replace T by (T - 32) / 1.8 in {}"
        yield NamedValue("in degrees Fahrenheit", celsius(each.recorded), 0.0, replaced)
        yield NamedValue(OPPOSITE, -each.recorded, 0.0, "reverse the sign of {}")
    opposite = NamedValue(OPPOSITE, -1.0, SCALE_OF_KIND, "reverse the sign of {}")
    if each.form == "factor":
        yield opposite
        if "rate" in each.quantity:
            yield from (NamedValue(f"in {unit}", factor) for unit, factor in RATE_UNITS.items())
    if each.form == "output_factor":
        yield opposite
        of_kind = SCALE_OF_KIND if each.quantity == "outputs" else NAMED_SCALE
        gains = GAINS.get(each.kind, {}).items()
        yield from (NamedValue(f"with {unit}", 1 / gain, of_kind) for unit, gain in gains)


def agreement_text(each: WrongRecord) -> str:
    """Return what would make a run, or a row of it, agree."""
    named = each.named
    return _open_text(each) + (f", as if {named.name}" if named is not None else "")


def _open_text(each: WrongRecord) -> str:
    unit = f" {pretty(each.unit)}" if each.unit not in ("", "1") else ""
    sizes = ", ".join(_with_sd(each))
    recorded = significant(each.recorded, 5)
    match each.form:
        case "unit":
            return "errors of its own in all channels, which means that the run, or its file, is from another unit"
        case "exchange":
            return f"{each.quantity} exchanged with that of run '{each.other}'"
        case "seat":
            return f"the unit turned in its mounting by ({sizes}){unit} about its axes"
        case "output_offset":
            which = "outputs of every channel" if len(each.agreeing) > 1 else f"output of {each.quantity}"
            return f"its {which} changed by ({sizes}){unit}"
        case "factor":
            return f"{each.quantity} times {sizes}" + (", all rows alike" if each.row is None else "")
        case "output_factor":
            return f"its {'outputs' if each.quantity == 'outputs' else f'output of {each.quantity}'} times {sizes}"
        case "samples":
            return f"about {sizes} samples in each row (stated: {recorded})"
    if each.row is not None:
        return f"{each.quantity} = {sizes}{unit} (recorded: {recorded})"
    if each.unit == "deg":
        return f"{each.quantity} moved by {_moved(each)}{unit}, all rows alike"
    return f"{each.quantity} about {sizes}{unit} on average (recorded: {recorded})"


def _with_sd(each: WrongRecord) -> list[str]:
    if not each.sd:
        return [significant(value, 5) for value in each.agreeing]
    return [" ± ".join(value_and_sd(value, sd)) for value, sd in zip(each.agreeing, each.sd, strict=True)]


def _moved(each: WrongRecord, sd: bool = True) -> str:
    """Return what is to be added to a column, of an angle within half a turn."""
    size = each.agreeing[0] - (each.recorded or 0.0)
    size = math.remainder(size, 360.0) if each.unit == "deg" else size
    value, own = value_and_sd(size, each.sd[0]) if each.sd else (significant(size, 6), "")
    value = value if value.startswith("-") else f"+{value}"
    return f"{value} ± {own}" if sd and own else value


def correction(each: WrongRecord) -> str:
    """Return what to change in the record, as a clause; empty if the hypothesis names none."""
    if each.form == "prior" or not each.run:
        return ""
    run, named, where = f"run '{each.run}'", each.named, _cells(each)
    if each.about and each.form == "output_factor":
        if named is not None and named.name == OPPOSITE:
            return f"replace y by {2 * each.about:g} - y in {where}"
        return f"replace y by {each.about:g} + {_value(each)} (y - {each.about:g}) in {where}"
    if named is not None and named.correction:
        return named.correction.format(where)
    several = len(each.agreeing) > 1 or each.quantity == "outputs"
    if each.form in ("factor", "output_factor"):
        return f"multiply {f'the outputs of {run}' if several else where} by {_value(each)}"
    if each.form in ("offset", "output_offset") and not several:
        return f"add {_moved(each, sd=False)} to {where}" if _is_sum(each) else f"write {_value(each)} in {where}"
    return {
        "exchange": f"exchange {where} and of run '{each.other}'",
        "unit": f"name the file of this unit for {run}, or leave the run out",
        "seat": f"state a mounting of its own for {run}, turned by that much",
        "samples": f"multiply column 'samples' of {run} by {_share(each)}",
    }.get(each.form, f"add these values to the outputs of {run}")


def _is_sum(each: WrongRecord) -> bool:
    """Whether a value is corrected by what is added to it: of a row the column itself is written."""
    return each.row is None or each.form == "output_offset"


def _share(each: WrongRecord) -> str:
    """Return what agrees as a share of what was recorded; empty if nothing was."""
    return significant(each.agreeing[0] / each.recorded, 2) if each.agreeing and each.recorded else ""


def _cells(each: WrongRecord) -> str:
    """Return the column of a run, or the cell of a row."""
    names = each.quantity.split(" and ")
    column = ("column " if len(names) == 1 else "columns ") + " and ".join(f"'{name}'" for name in names)
    return f"{column} of run '{each.run}'" if each.row is None else f"{column}, row {each.row} of run '{each.run}'"


def _value(each: WrongRecord) -> str:
    """Return the value to write: that with a name exactly."""
    named = each.named
    if named is not None or not each.agreeing:
        return significant(named.value, 8) if named is not None else ""
    return value_and_sd(each.agreeing[0], each.sd[0])[0] if each.sd else significant(each.agreeing[0], 6)


def record_remedy(each: WrongRecord) -> str:
    """Return what to do as a sentence part: the correction, and what else serves."""
    found = correction(each)
    out = f"leave the {'run' if each.row is None else 'row'} out"
    if not found:
        return f"correct the record, or {out}"
    return found if found.endswith("out") else f"{found} if the record confirms it, or {out}"

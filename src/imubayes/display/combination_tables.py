"""What the data leave together: the weak directions, and the combinations that are determined nevertheless."""

from typing import Protocol, runtime_checkable

from imubayes.display.fit_cautions import alarm_of
from imubayes.display.fit_quality_tables import NOT_DETERMINED, more
from imubayes.display.labels import pretty
from imubayes.display.rounding import percent, rounded, value_and_sd
from imubayes.display.table_layout import Cell, Sheet
from imubayes.inference.identifiability import WeakDirection
from imubayes.results.output_units import in_output_units
from imubayes.results.summary import CombinationSummary, Summary

_NOTE = (
    "The data determine these sums much better than their leading members; each member counts in its own unit. Symbols "
    "are those of the standard of the test. "
)


@runtime_checkable
class Combined(Protocol):
    """A determined combination, as the summary and as the report have it."""

    @property
    def name(self) -> str:
        """Standard symbol, or the sum as it is written."""
        ...

    @property
    def standard(self) -> bool:
        """Whether it has a standard symbol."""
        ...

    @property
    def quantities(self) -> tuple[str, ...]:
        """Members."""
        ...

    @property
    def weights(self) -> tuple[float, ...] | None:
        """Weights of the members; None for k cos θ."""
        ...

    @property
    def constant(self) -> float:
        """What is added to the sum."""
        ...

    @property
    def middle_of(self) -> str:
        """Run in the middle of whose record it holds; empty where it does not change with time."""
        ...


def weak_sheet(summary: Summary) -> Sheet:
    """Return the combinations of parameters that the data did not determine."""
    rows = [
        (Cell(weak_text(found)), Cell(percent(found.from_data), "weak" if found.from_data < NOT_DETERMINED else ""))
        for found in summary.weak_directions
    ]
    note = "" if rows else "The data determine every combination of the parameters."
    return Sheet("Weakly determined combinations", ("combination", "from data"), rows, (0,), "", note)


def weak_text(found: WeakDirection) -> str:
    """Return a weak direction as a sum, or the two quantities of a confusion."""
    if found.kind == "confusion":
        return " against ".join(found.quantities)
    further = f" and {found.left_out} more" if found.left_out else ""
    return weighted_sum(found.quantities, found.weights) + further


def weighted_sum(quantities: tuple[str, ...], weights: tuple[float, ...]) -> str:
    """Return a sum as it is printed: `a + 0.56·b − c`."""
    text = ""
    for name, weight in zip(quantities, weights, strict=True):
        sign = "− " if weight < 0 else "+ "
        size = "" if abs(weight) == 1 else f"{abs(weight):.4g}·"
        text += f"{' ' if text else ''}{sign if text or weight < 0 else ''}{size}{name}"
    return text


def combination_sheet(summary: Summary, most: int = 24, standard: bool = False) -> Sheet:
    """Return the combinations that the data determine much better than each of their members.

    Parameters
    ----------
    most : number of rows.
    standard : only those that have a symbol in the standard of a test.
    """
    known = [found for found in in_output_units(summary).combinations if found.standard or not standard]
    shown = known[:most]
    rows = [_row(found) for found in shown]
    few = [
        (
            Cell(symbol_text(found) or members_text(found)),
            Cell(f"{' ± '.join(value_and_sd(found.mean, found.sd))} {pretty(found.unit)}"),
        )
        for found in shown
    ]
    title, note = "Determined combinations", (_NOTE + more(len(known) - len(shown))).strip()
    narrow = Sheet(title, ("combination", "estimate ± sd"), few, (0, 1), alarm_of(summary), note)
    head = ("symbol", "combination", "estimate", "sd", summary.interval, "unit")
    return Sheet(title, head, rows, (0, 1, 5), alarm_of(summary), note, narrow=narrow)


def _row(found: CombinationSummary) -> tuple[Cell, ...]:
    mean, sd, low, high = rounded((found.mean, found.sd, found.q025, found.q975), found.sd)
    return (
        Cell(symbol_text(found)), Cell(members_text(found)), Cell(mean), Cell(sd), Cell(f"{low} … {high}"),
        Cell(pretty(found.unit)),
    )  # fmt: skip


def symbol_text(found: Combined) -> str:
    """Return the standard symbol, with the instant at which it holds: `D[g] at mid-record of servo-day`."""
    if not found.standard:
        return ""
    return f"{found.name} at mid-record of {found.middle_of}" if found.middle_of else found.name


def members_text(found: Combined) -> str:
    """Return a combination as a sum of its members, or k cos θ."""
    if found.weights is None:
        scale, angle = found.quantities
        return f"{scale}·cos({angle})"
    constant = f"{found.constant:.6g} + " if found.constant else ""
    return constant + weighted_sum(found.quantities, found.weights)

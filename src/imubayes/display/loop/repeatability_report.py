"""Two calibrations of one unit in words and a table."""

from collections.abc import Iterator, Sequence

from imubayes.display.layout import Cell, Report, Sheet, cells
from imubayes.display.numbers_and_labels import listed, pretty, relation, rounded, significant, value_and_sd
from imubayes.qualification.next_due import MOST_INTERVALS, YEAR
from imubayes.qualification.repeatability import ComparedQuantity, Repeatability

_MOST_ROWS = 20
# Share of the variance in common that is worth a sentence.
_MUCH_IN_COMMON = 0.5


def repeatability_report(found: Repeatability, verbose: bool = False) -> Report:
    """Return the verdict, what moved, whether both may be pooled, and the table of differences."""
    return Report(list(_lines(found)), [difference_sheet(found, verbose)])


def _lines(found: Repeatability) -> Iterator[str]:
    unit = f" of unit {found.serial}" if found.serial else ""
    if not found.quantities:
        yield f"Nothing can be compared: there is no quantity that both calibrations{unit} determine."
    else:
        said = "agree" if found.verdict == "agree" else "DO NOT agree"
        yield (
            f"The two calibrations{unit} {said} within their uncertainties: χ² {significant(found.chi2)} for "
            f"{found.freedom} differences of parameters (p {relation(found.p)}); |E_n| ≤ 1 for "
            f"{sum(abs(each.e_n) <= 1 for each in found.quantities)} of {len(found.quantities)} quantities."
        )
    for each in [each for each in found.quantities if each.moved][:3]:
        yield _moved(each, found.days)
    if found.verdict == "differ" and not any(each.moved for each in found.quantities):
        yield "No quantity moved beyond chance by itself; together they did."
    yield from _common(found.quantities)
    yield _pooling(found)
    yield from _due(found)
    if found.other_priors:
        yield (
            f"Other priors in the two models: {listed(found.other_priors)}. They are compared as if they had nothing "
            "in common; a prior that was made of the first calibration makes the second agree."
        )
    if found.changed:
        yield f"Not the same equipment, although named alike: {listed(found.changed)}."
    if found.elsewhere:
        yield "The sites are two: gravity, level and heading have errors of their own."
    if found.not_determined:
        yield f"Not compared, as one of the two leaves it to its prior: {listed(found.not_determined)}."


def _moved(each: ComparedQuantity, days: float | None) -> str:
    apart, sd = value_and_sd(each.difference, each.difference_sd)
    text = f"{each.name} moved by {apart} ± {sd} {pretty(each.unit)} (E_n {significant(each.e_n, 2)})"
    if days:
        text += (
            f", {significant(each.difference * YEAR / abs(days), 2)} {pretty(each.unit)} per year if it drifts evenly"
        )
    return f"{text}."


def _common(quantities: Sequence[ComparedQuantity]) -> Iterator[str]:
    shared = [each for each in quantities if each.common > _MUCH_IN_COMMON]
    if shared:
        most = max(shared, key=lambda each: each.common)
        apart = (most.first_sd**2 + most.second_sd**2) ** 0.5
        _, alone = value_and_sd(apart, apart)
        _, sd = value_and_sd(most.difference, most.difference_sd)
        yield (
            f"Most of the uncertainty of {listed([each.name for each in shared], 3)} is common to both (equipment that "
            f"stayed, or a prior), and no difference shows it: {most.name} may differ by ±{sd}, not by ±{alone}, and "
            f"both may be wrong together by ±{value_and_sd(most.first, most.first_sd)[1]} {pretty(most.unit)}."
        )


def _due(found: Repeatability) -> Iterator[str]:
    """Yield when the next calibration is due, by the quantity that reaches its limit first."""
    if not found.due:
        return
    for each in found.due[:3]:
        rate, sd = value_and_sd(each.rate, each.rate_sd)
        drift = f"{each.name} drifts by {rate} ± {sd} {pretty(each.unit)} per year"
        if each.days is None:
            yield f"{drift} and stays within its limits for {MOST_INTERVALS:g} times the time between both."
        elif each.days == 0:
            yield f"{drift} and is not within its limits now, with k = 2: calibration is due."
        else:
            yield f"{drift} and may reach a limit (k = 2) {significant(each.days, 3)} days after the second one."
    yield (
        "Two calibrations cannot test whether a drift is even: the interval has no check of its model; `imubayes batch "
        "trends` has one of several."
    )


def _pooling(found: Repeatability) -> str:
    if found.pooled:
        return "They may be pooled: the last column is by both as one, priors and common equipment counted once."
    if found.verdict == "differ":
        return "They may not be pooled: fit the later one alone, or find what changed."
    return "They are not pooled: their priors differ." if found.other_priors else "They are not pooled."


def difference_sheet(found: Repeatability, verbose: bool = False) -> Sheet:
    """Return both estimates, their difference with U (k = 2), E_n and the pooled value, largest |E_n| first.

    The earlier of two dated calibrations is headed as left, the later as found.
    """
    rows = [_row(each, found.pooled) for each in found.quantities]
    head = ["quantity", *_heads(found), "difference", "U", "E_n", *(["pooled"] if found.pooled else []), "unit"]
    note = "U: expanded uncertainty of the difference, k = 2, without what is common to both; E_n: difference over U."
    sheet = Sheet("Differences of both calibrations", head, rows, (0, len(head) - 1), note=note)
    left = len(rows) - _MOST_ROWS
    few = (0, 3, 4, 5, len(head) - 1)
    return (sheet if verbose or left <= 0 else sheet.first(_MOST_ROWS, f"{left} more with --verbose. {note}")).with_few(
        *few
    )


def _heads(found: Repeatability) -> tuple[str, str]:
    if not found.days:
        return "first", "second"
    dates = [date[:10] for date in found.dates if date]
    words = ("as left", "as found") if found.days > 0 else ("as found", "as left")
    return f"{words[0]} {dates[0]}", f"{words[1]} {dates[1]}"


def _row(each: ComparedQuantity, pooled: bool) -> tuple[Cell, ...]:
    first, second = (" ± ".join(value_and_sd(*pair)) for pair in (
        (each.first, each.first_sd), (each.second, each.second_sd)
    ))  # fmt: skip
    apart, width = rounded((each.difference, 2 * each.difference_sd), each.difference_sd)
    e_n = Cell(f"{each.e_n:.2f}".replace("-", "−"), "bad" if each.moved else "weak" if abs(each.e_n) > 1 else "")
    both = [" ± ".join(value_and_sd(each.pooled, each.pooled_sd))] if pooled else []
    return cells(each.name, first, second, apart, width, e_n, *both, pretty(each.unit))

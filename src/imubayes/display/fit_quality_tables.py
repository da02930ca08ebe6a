"""Tables of the quality of a fit: goodness of fit, weak directions, contributions of procedures, candidate runs.

A fit that did not converge is reported first, in red.  Parameters that the data do not separate are shown as weak
directions, and as the combinations that are determined nevertheless.  A run that could be made is described in words.
"""

import math
from collections.abc import Iterable, Iterator, Sequence

from imubayes.display import numbers_and_labels as numbers
from imubayes.display.fit_cautions import SIGNIFICANT, alarm_of, chi2_text, share_of_freedom, tail
from imubayes.display.layout import Cell, Sheet, cells
from imubayes.foundations.covariates import COVARIATES
from imubayes.foundations.quantity_names import MOUNTING_ANGLE, family_of
from imubayes.inference.candidate_runs import RunDesign, TemperatureProfile
from imubayes.inference.identifiability import Contribution, WeakDirection
from imubayes.results import summary as records


def run_design_text(design: RunDesign) -> str:
    """Return procedure, table and mounting of a run, and what is varied in it."""
    place = design.procedure
    if design.table is not None:
        place += f" on another table than '{design.table}'" if design.another_table else f" on '{design.table}'"
    if design.mounting is not None:
        place += f" in mounting '{design.mounting}'"
    return ("one more " if design.repeated else "") + ", ".join([place, *_varied(design)])


def _varied(design: RunDesign) -> Iterator[str]:
    if design.max_rate_deg_s is not None:
        yield f"rates to ±{design.max_rate_deg_s:.0f} deg/s"
    if design.positions is not None:
        yield f"{design.positions} positions"
    if design.current_mA is not None:
        yield f"current {design.current_mA:.3g} mA ({design.specific_force_g:g} g)"
    if design.temperature is not None:
        yield _profile(design.temperature)


def _profile(profile: TemperatureProfile) -> str:
    name = COVARIATES[profile.covariate].phrase
    between = f"from {profile.low_degC:.3g} to {profile.high_degC:.3g} degC"
    if profile.form == "ramp":
        return f"{name} ramped {between}"
    return f"{name} cycled within {profile.hours:.2g} h {between}, held, and back three times slower"


NOT_DETERMINED = 0.1
_MOST_CONTRIBUTIONS = 6


def run_sheet(summary: records.Summary, most: int | None = None) -> Sheet:
    """Return n, χ²/n and rms residual of each run and channel, at most `most` lines."""
    share = share_of_freedom(summary)
    rows, dividers = [], set()
    shown = summary.runs[:most]
    for place, run in enumerate(shown):
        repeated = place > 0 and shown[place - 1].name == run.name
        if place and not repeated:
            dividers.add(place)
        rms, unit = _rms([run])
        name = Cell("" if repeated else run.name)
        rows.append(cells(name, run.channel, str(run.n), _fit_cell(run, share), rms, unit))
    note = f"{_fit_note(summary)} {more(len(summary.runs) - len(shown))}".strip()
    head = ("run", "channel", "n", "chi2/n", "rms residual", "unit")
    return Sheet(
        "Goodness of fit by run and channel", head, rows, (0, 1, 5), alarm_of(summary), note, frozenset(dividers)
    )


def fit_sheet(summary: records.Summary) -> Sheet:
    """Return χ²/n with a line per run and a column per channel, the rms residual of each channel below."""
    share = share_of_freedom(summary)
    entries = {(run.name, run.channel): run for run in summary.runs}
    names = dict.fromkeys(run.name for run in summary.runs)
    channels = dict.fromkeys(run.channel for run in summary.runs)
    rows = [cells(name, *(_fit_cell(entries.get((name, channel)), share) for channel in channels)) for name in names]
    sizes = [_rms([run for run in summary.runs if run.channel == channel]) for channel in channels]
    rows.append(cells("rms residual", *(size for size, _ in sizes)))
    rows.append(cells("unit", *(unit for _, unit in sizes)))
    head, note = ("chi2/n", *channels), _fit_note(summary)
    return Sheet("Goodness of fit", head, rows, (0,), alarm_of(summary), note, frozenset({len(names)}))


def _fit_cell(run: records.RunSummary | None, share: float) -> Cell:
    if run is None or not run.n or run.chi2 is None:
        return Cell("–", "dim")
    chance = tail(run.chi2, share * run.n)
    text = numbers.ratio_text(run.chi2 / run.n)
    if abs(chance) >= SIGNIFICANT or not math.isfinite(chance):
        return Cell(text)
    return Cell(text, "bad" if chance >= 0 else "weak")


def _rms(runs: Sequence[records.RunSummary]) -> tuple[str, str]:
    """Return the root mean square over runs of one channel, and its unit."""
    known = [(run.n, run.rms) for run in runs if run.n and run.rms is not None]
    if not known:
        return "–", numbers.pretty(runs[0].unit) if len(runs) == 1 else ""
    size = math.sqrt(sum(n * rms**2 for n, rms in known) / sum(n for n, _ in known))
    factor, unit = numbers.readable(runs[0].unit, size)
    return numbers.significant(size * factor), numbers.pretty(unit)


def _fit_note(summary: records.Summary) -> str:
    share = share_of_freedom(summary)
    runs = [run for run in summary.runs if run.n and run.chi2 is not None]
    excessive = sum(_fit_cell(run, share).mood == "bad" for run in runs)
    note = ""
    if summary.chi2 and summary.dof:
        note = f"Total: {chi2_text(summary)}. "
    if not excessive:
        return note + f"No χ² of a run and channel is too large (p < {SIGNIFICANT:g})."
    verb = "is" if excessive == 1 else "are"
    return note + f"{excessive} of {len(runs)} values of χ² {verb} too large (p < {SIGNIFICANT:g}, red)."


def contribution_sheet(summary: records.Summary) -> Sheet:
    """Return the standard uncertainty of angles, scale factors and standard sums from each procedure, and from all."""
    shown = _leading_contributions(records.in_output_units(summary))
    procedures = [share.procedure for share in shown[0].by] if shown else []
    wide, narrow = [], []
    for contribution in shown:
        factor, unit = numbers.readable(contribution.unit, contribution.sd)
        best = min(contribution.by, key=lambda share: share.alone)
        alone = [Cell(numbers.significant(share.alone * factor, 2)) for share in contribution.by]
        gain = Cell(f"{numbers.significant(best.alone / contribution.sd, 2)} ×")
        last = cells(numbers.significant(contribution.sd * factor, 2), gain, numbers.pretty(unit))
        wide.append(cells(contribution.quantity, *alone, *last))
        sd_of_best = Cell(numbers.significant(best.alone * factor, 2))
        narrow.append(cells(contribution.quantity, best.procedure, sd_of_best, *last))
    note = (
        "Standard uncertainty from the prior and the runs of one procedure, and from all runs; gain: ratio to the best "
        f"single procedure. {more(len(summary.contributions) - len(shown))}"
    ).strip()
    title, last = "Contribution of each procedure", ("all", "gain", "unit")
    sheet = Sheet(title, ("quantity", *procedures, *last), wide, (0, len(procedures) + 3), "", note)
    return sheet.with_narrow(("quantity", "best alone", "sd", *last), narrow, (0, 1, 5))


def _leading_contributions(summary: records.Summary) -> list[Contribution]:
    """Return the angles, inclined axes first, and the scale factors and standard sums that gain most from all runs."""
    mean = {derived.name: derived.mean for derived in summary.derived}

    def gain(contribution: Contribution) -> float:
        return contribution.sd / min(share.alone for share in contribution.by)

    def inclination(contribution: Contribution) -> float:
        # An angle matters little to the measurement if the axis is along or across the rotation axis.
        return -abs(round(math.sin(2 * math.radians(mean[contribution.quantity] or 0.0)), 1))

    found = sorted(summary.contributions, key=gain)
    angles = sorted((c for c in found if family_of(c.quantity) == MOUNTING_ANGLE), key=inclination)
    sums = {each.name for each in summary.combinations if not each.standard}
    others = [c for c in found if family_of(c.quantity) != MOUNTING_ANGLE and c.quantity not in sums]
    return [*angles[:_MOST_CONTRIBUTIONS], *others[:_MOST_CONTRIBUTIONS]]


def next_run_sheet(summary: records.Summary) -> Sheet:
    """Return the candidate runs, the most informative first; a run is named once for all its quantities."""
    designs = [run_design_text(run.run) for run in summary.next_runs]
    first = [not place or designs[place] != designs[place - 1] for place in range(len(designs))]
    rows = [
        cells(design if new else "", run.quantity, narrowing_text(run))
        for design, new, run in zip(designs, first, summary.next_runs, strict=True)
    ]
    dividers = frozenset(place for place, new in enumerate(first) if new and place)
    note, head = "" if rows else "No candidate run was ranked.", ("next run", "quantity", "sd now → after")
    return Sheet("Most informative next runs", head, rows, (0, 1, 2), "", note, dividers)


def narrowing_text(run: records.NextRun) -> str:
    """Return the standard deviation of the quantity of a candidate run before and after it."""
    factor, unit = numbers.readable(run.unit, abs(run.sd_before))
    sizes: Iterable[float] = (run.sd_before, run.sd_after)
    return f"{' → '.join(numbers.significant(sd * factor, 2) for sd in sizes)} {numbers.pretty(unit)}"


def more(count: int) -> str:
    """Return where the rows are that are not shown."""
    return f"{count} more {'row is' if count == 1 else 'rows are'} in summary.json." if count > 0 else ""


_NOTE = (
    "The data determine these sums much better than their leading members. Each member is in its own unit. Symbols "
    "are those of the standard of the test. "
)


def weak_sheet(summary: records.Summary) -> Sheet:
    """Return the combinations of parameters that the data did not determine."""
    rows = [
        cells(
            weak_text(found), Cell(numbers.percent(found.from_data), "weak" if found.from_data < NOT_DETERMINED else "")
        )
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


def combination_sheet(summary: records.Summary, most: int = 24, standard: bool = False) -> Sheet:
    """Return the combinations that the data determine much better than each of their members.

    Parameters
    ----------
    most : number of rows.
    standard : only those that have a symbol in the standard of a test.
    """
    known = [found for found in records.in_output_units(summary).combinations if found.standard or not standard]
    shown = known[:most]
    rows = [_row(found) for found in shown]
    few = [
        cells(
            symbol_text(found) or members_text(found),
            f"{' ± '.join(numbers.value_and_sd(found.mean, found.sd))} {numbers.pretty(found.unit)}",
        )
        for found in shown
    ]
    title, note = "Determined combinations", (_NOTE + more(len(known) - len(shown))).strip()
    head = ("symbol", "combination", "estimate", "sd", summary.interval, "unit")
    sheet = Sheet(title, head, rows, (0, 1, 5), alarm_of(summary), note)
    return sheet.with_narrow(("combination", "estimate ± sd"), few, (0, 1))


def _row(found: records.CombinationSummary) -> tuple[Cell, ...]:
    mean, sd, low, high = numbers.rounded((found.mean, found.sd, found.q025, found.q975), found.sd)
    return cells(symbol_text(found), members_text(found), mean, sd, f"{low} … {high}", numbers.pretty(found.unit))


def symbol_text(found: records.CombinedQuantities) -> str:
    """Return the standard symbol, with the instant at which it holds: `D[g] at mid-record of servo-day`."""
    if not found.standard:
        return ""
    return f"{found.name} at mid-record of {found.middle_of}" if found.middle_of else found.name


def members_text(found: records.CombinedQuantities) -> str:
    """Return a combination as a sum of its members, or k cos θ."""
    if found.weights is None:
        scale, angle = found.quantities
        return f"{scale}·cos({angle})"
    constant = f"{found.constant:.6g} + " if found.constant else ""
    return constant + weighted_sum(found.quantities, found.weights)

"""Tables of goodness of fit, contributions of procedures and candidate runs.

What did not converge is said first, in red.
"""

import math
from collections.abc import Iterable, Sequence

from imubayes.display.fit_cautions import alarm_of
from imubayes.display.goodness_of_fit import SIGNIFICANT, chi2_text, share_of_freedom, tail
from imubayes.display.labels import pretty, readable
from imubayes.display.rounding import ratio_text, significant
from imubayes.display.run_design_words import run_design_text
from imubayes.display.table_layout import Cell, Sheet
from imubayes.results.output_units import in_output_units
from imubayes.results.summary import Contribution, NextRun, RunSummary, Summary

NOT_DETERMINED = 0.1
_MOST_CONTRIBUTIONS = 6


def run_sheet(summary: Summary, most: int | None = None) -> Sheet:
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
        rows.append((name, Cell(run.channel), Cell(str(run.n)), _fit_cell(run, share), Cell(rms), Cell(unit)))
    note = f"{_fit_note(summary)} {more(len(summary.runs) - len(shown))}".strip()
    head = ("run", "channel", "n", "chi2/n", "rms residual", "unit")
    return Sheet(
        "Goodness of fit by run and channel", head, rows, (0, 1, 5), alarm_of(summary), note, frozenset(dividers)
    )


def fit_sheet(summary: Summary) -> Sheet:
    """Return χ²/n with a line per run and a column per channel, the rms residual of each channel below."""
    share = share_of_freedom(summary)
    entries = {(run.name, run.channel): run for run in summary.runs}
    names = dict.fromkeys(run.name for run in summary.runs)
    channels = dict.fromkeys(run.channel for run in summary.runs)
    rows = [(Cell(name), *(_fit_cell(entries.get((name, channel)), share) for channel in channels)) for name in names]
    sizes = [_rms([run for run in summary.runs if run.channel == channel]) for channel in channels]
    rows.append((Cell("rms residual"), *(Cell(size) for size, _ in sizes)))
    rows.append((Cell("unit"), *(Cell(unit) for _, unit in sizes)))
    head, note = ("chi2/n", *channels), _fit_note(summary)
    return Sheet("Goodness of fit", head, rows, (0,), alarm_of(summary), note, frozenset({len(names)}))


def _fit_cell(run: RunSummary | None, share: float) -> Cell:
    if run is None or not run.n or run.chi2 is None:
        return Cell("–", "dim")
    chance = tail(run.chi2, share * run.n)
    text = ratio_text(run.chi2 / run.n)
    if abs(chance) >= SIGNIFICANT or not math.isfinite(chance):
        return Cell(text)
    return Cell(text, "bad" if chance >= 0 else "weak")


def _rms(runs: Sequence[RunSummary]) -> tuple[str, str]:
    """Return the root mean square over runs of one channel, and its unit."""
    known = [(run.n, run.rms) for run in runs if run.n and run.rms is not None]
    if not known:
        return "–", pretty(runs[0].unit) if len(runs) == 1 else ""
    size = math.sqrt(sum(n * rms**2 for n, rms in known) / sum(n for n, _ in known))
    factor, unit = readable(runs[0].unit, size)
    return significant(size * factor), pretty(unit)


def _fit_note(summary: Summary) -> str:
    share = share_of_freedom(summary)
    runs = [run for run in summary.runs if run.n and run.chi2 is not None]
    excessive = sum(_fit_cell(run, share).mood == "bad" for run in runs)
    note = ""
    if summary.chi2 and summary.dof:
        note = f"Total: {chi2_text(summary)}. "
    if not excessive:
        return note + f"No chi2 is larger than noise explains (p < {SIGNIFICANT:g})."
    verb = "is" if excessive == 1 else "are"
    return note + f"{excessive} of {len(runs)} {verb} larger than noise explains (p < {SIGNIFICANT:g}, red)."


def contribution_sheet(summary: Summary) -> Sheet:
    """Return the standard uncertainty of angles, scale factors and standard sums from each procedure, and from all."""
    shown = _leading_contributions(in_output_units(summary))
    procedures = [share.procedure for share in shown[0].by] if shown else []
    wide, narrow = [], []
    for contribution in shown:
        factor, unit = readable(contribution.unit, contribution.sd)
        best = min(contribution.by, key=lambda share: share.alone)
        alone = [Cell(significant(share.alone * factor, 2)) for share in contribution.by]
        gain = Cell(f"{significant(best.alone / contribution.sd, 2)} ×")
        last = (Cell(significant(contribution.sd * factor, 2)), gain, Cell(pretty(unit)))
        wide.append((Cell(contribution.quantity), *alone, *last))
        sd_of_best = Cell(significant(best.alone * factor, 2))
        narrow.append((Cell(contribution.quantity), Cell(best.procedure), sd_of_best, *last))
    note = (
        "Standard uncertainty from the prior and the runs of one procedure, and from all runs; gain: ratio to the best "
        f"single procedure. {more(len(summary.contributions) - len(shown))}"
    ).strip()
    title, last = "Contribution of each procedure", ("all", "gain", "unit")
    few = Sheet(title, ("quantity", "best alone", "sd", *last), narrow, (0, 1, 5), "", note)
    return Sheet(title, ("quantity", *procedures, *last), wide, (0, len(procedures) + 3), "", note, narrow=few)


def _leading_contributions(summary: Summary) -> list[Contribution]:
    """Return the angles, inclined axes first, and the scale factors and standard sums that gain most from all runs."""
    mean = {derived.name: derived.mean for derived in summary.derived}

    def gain(contribution: Contribution) -> float:
        return contribution.sd / min(share.alone for share in contribution.by)

    def inclination(contribution: Contribution) -> float:
        # An angle matters little to the measurement where the axis is along or across the rotation axis.
        return -abs(round(math.sin(2 * math.radians(mean[contribution.quantity] or 0.0)), 1))

    found = sorted(summary.contributions, key=gain)
    angles = sorted((c for c in found if c.quantity.startswith("mounting_angle[")), key=inclination)
    sums = {each.name for each in summary.combinations if not each.standard}
    others = [c for c in found if not c.quantity.startswith("mounting_angle[") and c.quantity not in sums]
    return [*angles[:_MOST_CONTRIBUTIONS], *others[:_MOST_CONTRIBUTIONS]]


def next_run_sheet(summary: Summary) -> Sheet:
    """Return the candidate runs, the most informative first; a run is named once for all its quantities."""
    designs = [run_design_text(run.run) for run in summary.next_runs]
    first = [not place or designs[place] != designs[place - 1] for place in range(len(designs))]
    rows = [
        (Cell(design if new else ""), Cell(run.quantity), Cell(narrowing_text(run)))
        for design, new, run in zip(designs, first, summary.next_runs, strict=True)
    ]
    dividers = frozenset(place for place, new in enumerate(first) if new and place)
    note, head = "" if rows else "No candidate run was ranked.", ("next run", "quantity", "sd now → after")
    return Sheet("Most informative next runs", head, rows, (0, 1, 2), "", note, dividers)


def narrowing_text(run: NextRun) -> str:
    """Return the standard deviation of the quantity of a candidate run before and after it."""
    factor, unit = readable(run.unit, abs(run.sd_before))
    sizes: Iterable[float] = (run.sd_before, run.sd_after)
    return f"{' → '.join(significant(sd * factor, 2) for sd in sizes)} {pretty(unit)}"


def more(count: int) -> str:
    """Return where the rows are that are not shown."""
    return f"{count} more {'row is' if count == 1 else 'rows are'} in summary.json." if count > 0 else ""

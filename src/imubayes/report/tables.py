"""Tables of a result for the terminal and for a notebook.

Every number carries its unit and no digit that its uncertainty does not support (GUM 7.2.6); every interval says which it
is; what did not converge is said first, in red; and what the data did not determine is marked as such, since its
"estimate" is the prior's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rich.table import Table
from rich.text import Text

from imubayes.report.display import pretty, readable
from imubayes.report.rounding import grid_of, percent, ratio_text, significant
from imubayes.report.statistics import SIGNIFICANT, share_of_freedom, tail

NOT_DETERMINED = 0.1
R_HAT, EFFECTIVE_SIZE = 1.01, 400.0
INTERVAL = "95 % equal-tailed"

Summary = Mapping[str, Any]


@dataclass(frozen=True)
class Cell:
    """Text and what to make of it: plain, `bad`, `weak` or `dim`."""

    text: str
    mood: str = ""


@dataclass(frozen=True)
class Sheet:
    """A table free of its medium: title, what is said first in red, head, rows and a note below."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    left: Sequence[int] = (0,)
    alarm: str = ""
    note: str = ""
    dividers: frozenset[int] = field(default_factory=frozenset)


_STYLES = {"bad": "bold red", "weak": "yellow", "dim": "dim"}


def parameter_table(summary: Summary, most: int | None = None) -> Table:
    """Return the parameters: estimate, standard uncertainty, interval, share from the data.

    Parameters
    ----------
    summary : the content of `summary.json`.
    most : rows to show; those in need of attention are kept first.
    """
    return terminal(parameter_sheet(summary, most))


def derived_table(summary: Summary, most: int | None = None) -> Table:
    """Return the derived quantities, in the form of the parameters."""
    return terminal(derived_sheet(summary, most))


def run_table(summary: Summary, most: int | None = None) -> Table:
    """Return n, χ²/n and rms residual of every run and channel; the ones that do not fit are red."""
    return terminal(run_sheet(summary, most))


def weak_table(summary: Summary) -> Table:
    """Return the combinations of parameters that the runs left to the prior."""
    return terminal(weak_sheet(summary))


def next_run_table(summary: Summary) -> Table:
    """Return the runs that would determine a chosen quantity best."""
    return terminal(next_run_sheet(summary))


def alarm_of(summary: Summary) -> str:
    """Return what has to be said before anything else; empty where the result converged."""
    if summary.get("converged"):
        return ""
    message = str(summary.get("message") or "").strip()
    return f"NOT CONVERGED. {message or 'The numbers below must not be used.'}"


def parameter_sheet(summary: Summary, most: int | None = None) -> Sheet:
    """Return the content of the parameter table."""
    return _quantities(summary, summary["parameters"], "Parameters", most)


def derived_sheet(summary: Summary, most: int | None = None) -> Sheet:
    """Return the content of the table of derived quantities."""
    return _quantities(summary, summary["derived"], "Derived quantities", most)


def run_sheet(summary: Summary, most: int | None = None) -> Sheet:
    """Return the content of the table of runs."""
    share = share_of_freedom(summary)
    rows, dividers, suspects = [], set(), 0
    runs = list(summary["runs"])
    shown = runs[:most]
    for place, run in enumerate(shown):
        count = int(run["n"] or 0)
        chance = tail(float(run["chi2"] or 0.0), share * count)
        bad = 0 <= chance < SIGNIFICANT
        suspects += bad
        mood = "bad" if bad else ("weak" if -SIGNIFICANT < chance < 0 else "")
        same = place > 0 and shown[place - 1]["name"] == run["name"]
        if place and not same:
            dividers.add(place)
        factor, unit = readable(run["unit"], abs(run["rms"] or 0.0))
        ratio = ratio_text(run["chi2"] / count) if count and run["chi2"] is not None else "–"
        rms = significant(None if run["rms"] is None else run["rms"] * factor)
        rows.append(
            (
                Cell("" if same else run["name"]),
                Cell(run["channel"]),
                Cell(str(count)),
                Cell(ratio, mood),
                Cell(rms),
                Cell(pretty(unit)),
            )
        )
    total, freedom = summary.get("chi2"), summary.get("dof")
    note = f"Together: chi2 {significant(total, 4)} for {freedom} degrees of freedom. " if total and freedom else ""
    note += (
        f"{suspects} of {len(rows)} lie above what noise alone would give (chance < {SIGNIFICANT:g}, red). "
        if suspects
        else f"None lies above what noise alone would give (chance < {SIGNIFICANT:g}). "
    )
    note += _more(len(runs) - len(shown))
    head = ("run", "channel", "n", "chi2/n", "rms residual", "unit")
    return Sheet(
        "Model against measurement", head, rows, (0, 1, 5), alarm_of(summary), note.strip(), frozenset(dividers)
    )


def weak_sheet(summary: Summary) -> Sheet:
    """Return the content of the table of weak directions."""
    found = summary.get("weak_directions") or []
    rows = [
        (Cell(one["combination"]), Cell(percent(one["from_data"]), "weak" if one["from_data"] < NOT_DETERMINED else ""))
        for one in found
    ]
    note = "" if rows else "The runs determine every combination of the parameters."
    return Sheet(
        "What the runs left to the prior", ("combination", "from data"), rows, (0,), alarm_of(summary), note
    )


def next_run_sheet(summary: Summary) -> Sheet:
    """Return the content of the table of candidate runs."""
    rows = []
    for one in summary.get("next_runs") or []:
        before, after = one["sd_before"], one["sd_after"]
        factor, unit = readable(one["unit"], abs(before or 0.0))
        ratio = f"÷ {significant(before / after, 2)}" if before and after else "–"
        cells = (one["run"], one["quantity"], _scaled(before, factor), _scaled(after, factor), pretty(unit), ratio)
        rows.append(tuple(Cell(text) for text in cells))
    head = ("next run", "quantity", "sd now", "sd after", "unit", "")
    note = "" if rows else "No candidate run was ranked."
    return Sheet("Runs that would tell most", head, rows, (0, 1, 4), "", note)


def _scaled(value: float | None, factor: float) -> str:
    return significant(None if value is None else value * factor, 2)


def _quantities(summary: Summary, entries: Sequence[Summary], title: str, most: int | None) -> Sheet:
    sampled = any(entry.get("r_hat") is not None for entry in entries)
    chosen = _chosen(entries, most)
    rows, dividers = [], set()
    for place, entry in enumerate(chosen):
        if place and _family(entry) != _family(chosen[place - 1]):
            dividers.add(place)
        rows.append(_quantity(entry, sampled))
    head = ["name", "estimate", "sd", INTERVAL, "unit", "from data"] + (["R-hat", "ESS"] if sampled else []) + [""]
    undetermined = sum(1 for entry in entries if _undetermined(entry))
    note = f"sd: standard uncertainty. from data: 1 − (sd/prior sd)². Interval: {summary.get('interval') or INTERVAL}. "
    if undetermined:
        note += (
            f"{undetermined} of {len(entries)} not determined (less than {percent(NOT_DETERMINED)} from the data): "
            "their numbers are the prior's. "
        )
    note += _more(len(entries) - len(chosen))
    return Sheet(
        title, head, rows, (0, 4, len(head) - 1), alarm_of(summary), note.strip(), frozenset(dividers)
    )


def _quantity(entry: Summary, sampled: bool) -> tuple[Cell, ...]:
    mean, sd, low, high = (entry.get(key) for key in ("mean", "sd", "q025", "q975"))
    grid = grid_of(sd, mean, low, high)
    weak = _undetermined(entry)
    mood = "weak" if weak else ""
    cells = [
        Cell(entry["name"]),
        Cell(grid(mean), mood),
        Cell(grid(sd), mood),
        Cell(f"{grid(low)} … {grid(high)}", mood),
        Cell(pretty(entry["unit"])),
        Cell(percent(entry.get("from_data")), mood),
    ]
    if sampled:
        r_hat, sizes = entry.get("r_hat"), [entry[k] for k in ("ess_bulk", "ess_tail") if entry.get(k) is not None]
        least = min(sizes, default=None)
        cells += [
            Cell("–" if r_hat is None else f"{r_hat:.3f}", "bad" if r_hat is not None and not r_hat <= R_HAT else "dim"),
            Cell(
                "–" if least is None else f"{least:.0f}",
                "bad" if least is not None and not least >= EFFECTIVE_SIZE else "dim",
            ),
        ]
    return (*cells, Cell("not determined" if weak else "", mood))


def _undetermined(entry: Summary) -> bool:
    share = entry.get("from_data")
    return share is not None and share < NOT_DETERMINED


def _attention(entry: Summary) -> bool:
    r_hat, bulk, tail_size = (entry.get(key) for key in ("r_hat", "ess_bulk", "ess_tail"))
    poor = any(size is not None and not size >= EFFECTIVE_SIZE for size in (bulk, tail_size))
    return poor or (r_hat is not None and not r_hat <= R_HAT) or _undetermined(entry)


def _chosen(entries: Sequence[Summary], most: int | None) -> list[Summary]:
    if most is None or len(entries) <= most:
        return list(entries)
    ranked = sorted(range(len(entries)), key=lambda place: (not _attention(entries[place]), place))
    return [entries[place] for place in sorted(ranked[: max(most, 0)])]


def _family(entry: Summary) -> str:
    return str(entry["name"]).partition("[")[0].partition(".")[0]


def _more(count: int) -> str:
    return f"{count} more {'row is' if count == 1 else 'rows are'} in summary.json." if count > 0 else ""


def terminal(sheet: Sheet) -> Table:
    """Return a sheet as a table for the terminal."""
    title = Text()
    if sheet.alarm:
        title.append(sheet.alarm + "\n", style="bold red")
    title.append(sheet.title, style="bold")
    table = Table(title=title, title_justify="left", caption=sheet.note or None, caption_justify="left", box=None,
                  header_style="bold", pad_edge=False)  # fmt: skip
    for place, name in enumerate(sheet.head):
        left = place in sheet.left
        table.add_column(name, justify="left" if left else "right", overflow="fold" if place == 0 else "ellipsis")
    for place, row in enumerate(sheet.rows):
        if place in sheet.dividers:
            table.add_section()
        table.add_row(*(Text(cell.text, style=_STYLES.get(cell.mood, "")) for cell in row))
    return table


__all__ = [
    "derived_table", "next_run_table", "parameter_table", "run_table", "weak_table",
]  # fmt: skip

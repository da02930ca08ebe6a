"""What the tables of a result say, free of the medium they are shown in.

Every number carries its unit and no digit that its uncertainty does not support (GUM 7.2.6); every interval says which
it is; what did not converge is said first, in red; and what the data did not determine is marked as such, since its
"estimate" is the prior's.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from imubayes.display.goodness_of_fit import SIGNIFICANT, share_of_freedom, tail
from imubayes.display.labels import pretty, readable
from imubayes.display.rounding import percent, ratio_text, significant

NOT_DETERMINED = 0.1
_MOST_CONTRIBUTIONS = 6

Summary = Mapping[str, Any]


@dataclass(frozen=True)
class Cell:
    """Text and what to make of it: plain, `bad`, `weak` or `dim`."""

    text: str
    mood: str = ""


@dataclass(frozen=True)
class Sheet:
    """A table free of its medium.

    Attributes
    ----------
    title, head, rows : what it says.
    left : columns that are set flush left.
    alarm : what is said first, in red.
    note : what stands below.
    dividers : rows before which a group ends.
    narrow : the same in fewer columns, for where there is no room.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    left: Sequence[int] = (0,)
    alarm: str = ""
    note: str = ""
    dividers: frozenset[int] = field(default_factory=frozenset)
    narrow: "Sheet | None" = None


def alarm_of(summary: Summary) -> str:
    """Return what has to be said before anything else; empty where the result converged."""
    if summary.get("converged"):
        return ""
    message = str(summary.get("message") or "").strip()
    return f"NOT CONVERGED. {message or 'The numbers below must not be used.'}"


def run_sheet(summary: Summary, most: int | None = None) -> Sheet:
    """Return the content of the table of runs and channels."""
    share = share_of_freedom(summary)
    runs = list(summary["runs"])
    shown = runs[:most]
    rows, dividers = [], set()
    for place, run in enumerate(shown):
        same = place > 0 and shown[place - 1]["name"] == run["name"]
        if place and not same:
            dividers.add(place)
        factor, unit = readable(run["unit"], abs(run["rms"] or 0.0))
        rms = significant(None if run["rms"] is None else run["rms"] * factor)
        texts = (Cell("" if same else run["name"]), Cell(run["channel"]), Cell(str(run["n"] or 0)))
        rows.append((*texts, _fit_cell(run, share), Cell(rms), Cell(pretty(unit))))
    note = f"{_fit_note(summary)} {more(len(runs) - len(shown))}".strip()
    head = ("run", "channel", "n", "chi2/n", "rms residual", "unit")
    title = "Model against measurement, per run and channel"
    return Sheet(title, head, rows, (0, 1, 5), alarm_of(summary), note, frozenset(dividers))


def fit_sheet(summary: Summary) -> Sheet:
    """Return χ²/n with a line per run and a column per channel, the rms residual of each channel below."""
    share = share_of_freedom(summary)
    entries = {(run["name"], run["channel"]): run for run in summary["runs"]}
    names, channels = (list(dict.fromkeys(key[place] for key in entries)) for place in (0, 1))
    rows = [(Cell(name), *(_fit_cell(entries.get((name, one)), share) for one in channels)) for name in names]
    sizes = [_rms([run for run in summary["runs"] if run["channel"] == one]) for one in channels]
    rows.append((Cell("rms residual"), *(Cell(size) for size, _ in sizes)))
    rows.append((Cell("unit"), *(Cell(unit) for _, unit in sizes)))
    head = ("chi2/n", *channels)
    title = "Model against measurement"
    return Sheet(title, head, rows, (0,), alarm_of(summary), _fit_note(summary), frozenset({len(names)}))


def _fit_cell(run: Summary | None, share: float) -> Cell:
    count = int(run["n"] or 0) if run else 0
    if run is None or not count or run["chi2"] is None:
        return Cell("–", "dim")
    return Cell(ratio_text(run["chi2"] / count), _mood(tail(float(run["chi2"]), share * count)))


def _mood(chance: float) -> str:
    if 0 <= chance < SIGNIFICANT:
        return "bad"
    return "weak" if -SIGNIFICANT < chance < 0 else ""


def _rms(runs: Sequence[Summary]) -> tuple[str, str]:
    """Return the root mean square over runs of one channel, and its unit."""
    known = [run for run in runs if run["n"] and run["rms"] is not None]
    count = sum(run["n"] for run in known)
    if not count:
        return "–", ""
    size = math.sqrt(sum(run["n"] * run["rms"] ** 2 for run in known) / count)
    factor, unit = readable(known[0]["unit"], size)
    return significant(size * factor), pretty(unit)


def _fit_note(summary: Summary) -> str:
    share = share_of_freedom(summary)
    runs = [run for run in summary["runs"] if run["n"] and run["chi2"] is not None]
    suspects = sum(_fit_cell(run, share).mood == "bad" for run in runs)
    total, freedom = summary.get("chi2"), summary.get("dof")
    note = f"Together: chi2 {significant(total, 4)} for {freedom:.0f} degrees of freedom. " if total and freedom else ""
    if not suspects:
        return note + f"None lies above what noise alone would give (chance < {SIGNIFICANT:g})."
    verb = "lies" if suspects == 1 else "lie"
    return note + f"{suspects} of {len(runs)} {verb} above what noise alone would give (chance < {SIGNIFICANT:g}, red)."


def weak_sheet(summary: Summary) -> Sheet:
    """Return the content of the table of weak directions."""
    found = summary.get("weak_directions") or []
    rows = [
        (Cell(one["combination"]), Cell(percent(one["from_data"]), "weak" if one["from_data"] < NOT_DETERMINED else ""))
        for one in found
    ]
    note = "" if rows else "The runs determine every combination of the parameters."
    return Sheet("What the runs left to the prior", ("combination", "from data"), rows, (0,), "", note)


def contribution_sheet(summary: Summary) -> Sheet:
    """Return the content of the table of what each procedure tells of angles and scale factors."""
    found = list(summary.get("contributions") or [])
    names = [one["procedure"] for one in found[0]["by"]] if found else []
    found.sort(key=lambda one: one["sd"] / min(each["alone"] for each in one["by"]))
    mean = {one["name"]: one["mean"] for one in summary["derived"]}
    # Inclined axes first: along the table's axis and across it an angle hardly matters to what is measured.
    angles = [one for one in found if one["quantity"].startswith("mounting_angle[")]
    angles.sort(key=lambda one: -abs(round(math.sin(2 * math.radians(mean[one["quantity"]])), 1)))
    scales = [one for one in found if one not in angles]
    shown = [*angles[:_MOST_CONTRIBUTIONS], *scales[:_MOST_CONTRIBUTIONS]]
    wide, narrow = [], []
    for one in shown:
        factor, unit = readable(one["unit"], one["sd"])
        best = min(one["by"], key=lambda each: each["alone"])
        alone = [Cell(significant(each["alone"] * factor, 2)) for each in one["by"]]
        ratio = Cell(f"{significant(best['alone'] / one['sd'], 2)} ×")
        last = (Cell(significant(one["sd"] * factor, 2)), ratio, Cell(pretty(unit)))
        wide.append((Cell(one["quantity"]), *alone, *last))
        of_best = Cell(significant(best["alone"] * factor, 2))
        narrow.append((Cell(one["quantity"]), Cell(best["procedure"]), of_best, *last))
    note = (
        "Standard uncertainty from the prior and the runs of each procedure alone, and from all together; the gain is "
        f"over the best of them. {more(len(found) - len(shown))}"
    ).strip()
    title, last = "What each procedure tells", ("together", "gain", "unit")
    few = Sheet(title, ("quantity", "best alone", "sd", *last), narrow, (0, 1, 5), "", note)
    return Sheet(title, ("quantity", *names, *last), wide, (0, len(names) + 3), "", note, narrow=few)


def next_run_sheet(summary: Summary) -> Sheet:
    """Return the content of the table of candidate runs."""
    rows = []
    for one in summary.get("next_runs") or []:
        before, after = one["sd_before"], one["sd_after"]
        factor, unit = readable(one["unit"], abs(before or 0.0))
        sizes = " → ".join(significant(None if sd is None else sd * factor, 2) for sd in (before, after))
        rows.append((Cell(one["run"]), Cell(one["quantity"]), Cell(f"{sizes} {pretty(unit)}")))
    note = "" if rows else "No candidate run was ranked."
    return Sheet("Runs that would tell most", ("next run", "quantity", "sd now → after"), rows, (0, 1, 2), "", note)


def more(count: int) -> str:
    """Return where to find the rows that are not shown."""
    return f"{count} more {'row is' if count == 1 else 'rows are'} in summary.json." if count > 0 else ""

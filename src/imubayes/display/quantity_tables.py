"""Parameters and derived quantities as tables: estimate, standard uncertainty, interval, share from the data."""

from collections.abc import Sequence

from imubayes.display.fit_tables import NOT_DETERMINED, Cell, Sheet, Summary, alarm_of, more
from imubayes.display.labels import pretty
from imubayes.display.rounding import grid_of, percent, value_and_sd

R_HAT, EFFECTIVE_SIZE = 1.01, 400.0
INTERVAL = "95 % equal-tailed"


def parameter_sheet(summary: Summary, most: int | None = None) -> Sheet:
    """Return the content of the parameter table."""
    return _quantities(summary, summary["parameters"], "Parameters", most)


def derived_sheet(summary: Summary, most: int | None = None) -> Sheet:
    """Return the content of the table of derived quantities."""
    return _quantities(summary, summary["derived"], "Derived quantities", most)


def _quantities(summary: Summary, entries: Sequence[Summary], title: str, most: int | None) -> Sheet:
    everything = len(entries)
    entries = [entry for entry in entries if not entry.get("nuisance")]
    unsettled = any(_unsettled(entry) for entry in entries)
    chosen = _chosen(entries, most)
    families = [_family(entry) for entry in chosen]
    dividers = frozenset(place for place in range(1, len(chosen)) if families[place] != families[place - 1])
    interval = str(summary.get("interval") or INTERVAL)
    head = ("name", "estimate", "sd", interval, "unit", "from data", *(("R-hat", "ESS") if unsettled else ()))
    alarm = alarm_of(summary)
    note = _note(entries, everything - len(entries)) + more(len(entries) - len(chosen))
    rows = [_whole(entry, unsettled) for entry in chosen]
    short = [_short(entry) for entry in chosen]
    narrow = Sheet(title, ("name", "estimate ± sd", "from data"), short, (0, 1), alarm, note.strip(), dividers)
    return Sheet(title, head, rows, (0, 4), alarm, note.strip(), dividers, narrow)


def _note(entries: Sequence[Summary], left_out: int) -> str:
    note = (
        "sd: standard uncertainty. from data: 1 − (sd/prior sd)² on the scale on which the prior is normal. "
        + _sampling(entries)
    )
    undetermined = sum(_undetermined(entry) for entry in entries)
    if undetermined:
        note += (
            f"{undetermined} of {len(entries)} not determined (less than {percent(NOT_DETERMINED)} from the data): "
            "their numbers are the prior's. "
        )
    if left_out:
        note += f"{left_out} of no interest in themselves, such as attitudes of poses, are left out. "
    return note


def _short(entry: Summary) -> tuple[Cell, ...]:
    mean, sd = value_and_sd(entry.get("mean"), entry.get("sd"))
    mood = "weak" if _undetermined(entry) else ""
    return Cell(entry["name"]), Cell(f"{mean} ± {sd} {pretty(entry['unit'])}", mood), _from_data(entry)


def _from_data(entry: Summary) -> Cell:
    if entry.get("from_data") is None and entry.get("prior_sd") == 0:
        return Cell("fixed by the model", "dim")
    share = percent(entry.get("from_data"))
    return Cell(f"{share}, not determined", "weak") if _undetermined(entry) else Cell(share)


def _whole(entry: Summary, unsettled: bool) -> tuple[Cell, ...]:
    mean, sd, low, high = (entry.get(key) for key in ("mean", "sd", "q025", "q975"))
    grid = grid_of(sd, mean, low, high)
    mood = "weak" if _undetermined(entry) else ""
    cells = [
        Cell(entry["name"]),
        Cell(grid(mean), mood),
        Cell(grid(sd), mood),
        Cell(f"{grid(low)} … {grid(high)}", mood),
        Cell(pretty(entry["unit"])),
        _from_data(entry),
    ]
    if unsettled:
        r_hat, size = entry.get("r_hat"), _effective_size(entry)
        cells += [
            Cell("–" if r_hat is None else f"{r_hat:.3f}", "dim" if r_hat is None or r_hat <= R_HAT else "bad"),
            Cell("–" if size is None else f"{size:.0f}", "dim" if size is None or size >= EFFECTIVE_SIZE else "bad"),
        ]
    return tuple(cells)


def _undetermined(entry: Summary) -> bool:
    share = entry.get("from_data")
    return share is not None and share < NOT_DETERMINED


def _effective_size(entry: Summary) -> float | None:
    sizes = [entry[key] for key in ("ess_bulk", "ess_tail") if entry.get(key) is not None]
    return min(sizes, default=None)


def _unsettled(entry: Summary) -> bool:
    r_hat, size = entry.get("r_hat"), _effective_size(entry)
    return (r_hat is not None and not r_hat <= R_HAT) or (size is not None and not size >= EFFECTIVE_SIZE)


def _sampling(entries: Sequence[Summary]) -> str:
    """Return the worst R̂ and effective size, which stand for the columns that nobody needs where all is well."""
    r_hats = [entry["r_hat"] for entry in entries if entry.get("r_hat") is not None]
    sizes = [size for size in map(_effective_size, entries) if size is not None]
    if not r_hats or not sizes:
        return ""
    return f"Sampling: R-hat at most {max(r_hats):.3f}, effective sizes at least {min(sizes):.0f}. "


def _chosen(entries: Sequence[Summary], most: int | None) -> list[Summary]:
    if most is None or len(entries) <= most:
        return list(entries)
    ranked = sorted(
        range(len(entries)),
        key=lambda place: (not (_unsettled(entries[place]) or _undetermined(entries[place])), place),
    )
    return [entries[place] for place in sorted(ranked[: max(most, 0)])]


def _family(entry: Summary) -> str:
    return str(entry["name"]).partition("[")[0].partition(".")[0]

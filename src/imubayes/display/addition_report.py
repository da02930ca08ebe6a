"""What an addition brought: expected against found, unseen data, error before and after; as JSON and as text."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from imubayes.atomic_files import write_json
from imubayes.criticism.cross_validation import HeldOut
from imubayes.criticism.model_history import mean_square
from imubayes.criticism.warm_start import Extension
from imubayes.display.fit_tables import Cell, Sheet
from imubayes.display.labels import pretty, readable
from imubayes.display.rounding import significant, value_and_sd
from imubayes.records import finite
from imubayes.results.history_file import channel_errors
from imubayes.results.summary import Summary
from imubayes.units import to_si

ADDITION, ADDED_VARIABLE = "addition.json", "added_variable.parquet"
Facts = Mapping[str, Any]
_VERDICTS = {
    "helps": "the addition helps to predict {kind}s that were left out",
    "unclear": "whether the addition helps to predict {kind}s that were left out is not clear",
    "not": "THE ADDITION DOES NOT HELP to predict {kind}s that were left out",
    "": "no comparison by left-out data",
}


def expected_line(extension: Extension, screened: Facts | None) -> dict[str, Any]:
    """Return what was expected: of the linear model, of the screen where that cannot tell."""
    coefficients = [dict(vars(one)) for one in extension.coefficients]
    drop = extension.delta_chi2
    if drop is None and screened:
        drop, coefficients = screened.get("delta_chi2"), list(screened.get("coefficients") or [])
    return {"delta_chi2": drop, "coefficients": coefficients, "screened": (screened or {}).get("delta_chi2")}


def found_line(summary: Summary, names: Sequence[str], delta_chi2: float) -> dict[str, Any]:
    """Return what the refit found: drop of chi² and the new parameters."""
    coefficients = [
        {"name": parameter.name, "value": parameter.mean, "sd": parameter.sd, "unit": parameter.unit}
        for parameter in summary.parameters
        if parameter.name in names
    ]
    return {"delta_chi2": finite(delta_chi2), "coefficients": coefficients}


def held_out_line(found: HeldOut | None) -> dict[str, Any]:
    """Return what left-out data say; empty where there was no comparison."""
    if found is None or not len(found.gains):
        return {}
    degree = to_si("deg")
    return {
        "by": found.by,
        "delta": found.gain,
        "se": finite(found.se),
        "helped": found.helped,
        "of": len(found.gains),
        "verdict": found.verdict,
        "each": [{"name": name, "delta": float(gain)} for name, gain in zip(found.names, found.gains, strict=True)],
        "rates": [
            {"channel": name, "before": was / degree, "after": now / degree, "unit": "deg/s"}
            for name, was, now in found.rate_errors
        ],
    }


def errors_before_after(before: Summary, after: Summary) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the residual error before and after: per run and channel, and per channel, in input units."""
    was = {(run.name, run.channel): run.rms for run in before.runs}
    runs = [
        {"name": now.name, "channel": now.channel, "n": now.n, "unit": now.unit,
         "before": was.get((now.name, now.channel)), "after": now.rms}
        for now in after.runs
    ]  # fmt: skip
    old, new = channel_errors(before), channel_errors(after)
    channels = [
        {"channel": name, "before": old[name][0], "after": value, "unit": unit}
        for name, (value, unit) in new.items()
        if name in old
    ]
    return runs, channels


def added_variable(extension: Extension) -> pl.DataFrame:
    """Return the added-variable plot as a table: run, channel, added, residual; entries that the effect reaches."""
    model, entries = extension.model, extension.model.entries
    names = [*(channel.name for channel in model.campaign.channels), "closure_x", "closure_y", "closure_z"]
    runs = [run.name for run in model.campaign.runs]
    # Every entry moves a little through what the old model takes up; those are not shown.
    shown = np.abs(extension.added) > 1e-3 * np.max(np.abs(extension.added), initial=0.0)
    return pl.DataFrame(
        {
            "run": np.array(runs)[entries.run[shown]],
            "channel": np.array(names)[entries.channel[shown]],
            "added": extension.added[shown],
            "residual": extension.residual[shown],
        }
    )


def write_addition(folder: Path, facts: Facts, table: pl.DataFrame) -> None:
    """Write `addition.json` and `added_variable.parquet` of a result folder."""
    table.write_parquet(folder / ADDED_VARIABLE)
    write_json(folder / ADDITION, facts)


def read_addition(folder: Path) -> dict[str, Any]:
    """Return the facts of an addition, empty for a folder that was not made by one or whose facts are damaged."""
    try:
        found = json.loads((folder / ADDITION).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def addition_text(facts: Facts) -> list[str]:
    """Return the outcome in a few lines: what was added, expected and found, what unseen data say."""
    names = ", ".join(
        one["effect"] + (f" on {', '.join(one['channels'])}" if one["channels"] else "") for one in facts["added"]
    )
    expected, found = facts["predicted"]["delta_chi2"], facts["found"]["delta_chi2"]
    lines = [f"Added: {names}."]
    lines += [
        f"The data ask for more than is usual: prior of {name} widened to {prior}."
        for name, prior in (facts.get("widened") or {}).items()
    ]
    if facts["message"]:
        lines.append(str(facts["message"]))
    lines.append(
        f"chi2 at the noise of the model before: expected to fall by {significant(expected)}, "
        f"fell by {significant(found)}."
    )
    return [*lines, held_out_text(facts["held_out"]), *rates_text(facts["held_out"])]


def held_out_text(held_out: Facts) -> str:
    """Return what left-out data say, in a sentence."""
    words = _VERDICTS[held_out.get("verdict", "")].format(kind=held_out.get("by", "run"))
    if not held_out:
        return words[0].upper() + words[1:] + "."
    se = significant(held_out["se"], 2)
    return (
        f"Left out in turns: log predictive density {held_out['delta']:+.1f} ± {se}, better for "
        f"{held_out['helped']} of {held_out['of']} {held_out['by']}s: {words}."
    )


def rates_text(held_out: Facts) -> list[str]:
    """Return what gyros read at rest in poses that were left out, against the prediction; nothing without poses."""
    rates = held_out.get("rates") or []
    if not rates:
        return []
    each = [f"{one['channel']} {significant(one['before'])} -> {significant(one['after'])}" for one in rates]
    return [
        f"Rates at rest in poses that were left out, rms about the prediction, {rates[0]['unit']}: {', '.join(each)}."
    ]


def coefficient_sheet(facts: Facts) -> Sheet:
    """Return the table of coefficients, expected and found."""
    expected = {one["name"]: one for one in facts["predicted"]["coefficients"]}
    rows = []
    for one in facts["found"]["coefficients"]:
        before = expected.get(one["name"], {})
        value, sd = value_and_sd(one["value"], one["sd"])
        guess, width = value_and_sd(before.get("value"), before.get("sd"))
        rows.append((Cell(one["name"]), Cell(guess), Cell(width), Cell(value), Cell(sd), Cell(pretty(one["unit"]))))
    head = ("new parameter", "expected", "± ", "found", "±", "unit")
    return Sheet("Expected and found", head, rows, (0, 5))


def error_sheet(facts: Facts, by_run: bool = False) -> Sheet:
    """Return the table of the residual error before and after, per channel or per run and channel."""
    rows, dividers, last = [], set(), None
    for place, one in enumerate(facts["runs"] if by_run else facts["channels"]):
        sizes = [size for size in (one["before"], one["after"]) if size is not None]
        factor, unit = readable(one["unit"], max(sizes, default=0.0))
        texts = [significant(None if one[key] is None else one[key] * factor) for key in ("before", "after")]
        ratio = one["after"] / one["before"] if one["before"] and one["after"] is not None else None
        change = "–" if ratio is None else f"{100 * (ratio - 1):+.0f} %".replace("-", "−")
        mood = "bad" if ratio is not None and ratio > 1.05 else ""
        head = []
        if by_run:
            head = [Cell("" if one["name"] == last else one["name"])]
            dividers |= {place} if last is not None and one["name"] != last else set()
            last = one["name"]
        cells = (Cell(one["channel"]), *map(Cell, texts), Cell(pretty(unit)), Cell(change, mood))
        rows.append((*head, *cells))
    head = ("run",) if by_run else ()
    title = "Residual error before and after" + (", per run and channel" if by_run else ", per channel")
    shift = len(head)
    left = (*range(shift + 1), shift + 3)
    return Sheet(
        title, (*head, "channel", "before", "after", "unit", "change"), rows, left, dividers=frozenset(dividers)
    )


def overall(rows: Sequence[Facts], key: str) -> float:
    """Return the root mean square over rows of one unit."""
    return mean_square(one[key] for one in rows if one[key] is not None)

"""What a diagnosis says on a terminal: one sentence, one picture, one next command; then the evidence.

Works on the JSON of a diagnosis alone, which is also kept as `diagnosis.json` in the result folder.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from imubayes.atomic_files import write_json
from imubayes.display.fit_tables import Cell, Sheet
from imubayes.display.labels import listed, pretty
from imubayes.display.rounding import percent, significant, value_and_sd
from imubayes.errors import InputError, Issue

DIAGNOSIS = "diagnosis.json"
Facts = Mapping[str, Any]
_MOST_RANKED, _MOST_PATTERNS, _MOST_FAR_OFF = 10, 6, 8
# A shift below this share of a posterior standard deviation is not worth a word.
_SMALL_SHIFT = 0.1


def write_diagnosis(folder: Path, facts: Facts, channel: str = "", covariate: str = "") -> None:
    """Keep a diagnosis in its result folder, with the channel and covariate of its telling residual."""
    kept = {**facts, "telling": {"channel": channel, "covariate": covariate}}
    write_json(folder / DIAGNOSIS, kept)


def read_diagnosis(folder: Path) -> dict[str, Any]:
    """Return the diagnosis that a result folder holds, empty where there is none that can be read."""
    try:
        found = json.loads((folder / DIAGNOSIS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def screened_candidate(facts: Facts, effect: str) -> dict[str, Any]:
    """Return what the screen said of an effect: the candidate of a group, or the best of its lines; may be empty."""
    grouped = [one for group in facts.get("groups", ()) for one in group["candidates"]]
    for one in (*grouped, *facts.get("ranking", ()), *facts.get("noise", ())):
        if one.get("effect") == effect:
            return dict(one)
    return {}


def found_class(facts: Facts) -> str:
    """Return the effect class written for the strongest unexplained pattern.

    Raises
    ------
    InputError
        where the diagnosis found no pattern that a formula describes.
    """
    for one in facts.get("structure", ()):
        if one.get("python"):
            return str(one["python"])
    raise InputError(
        Issue(
            "there is no effect class to print",
            f"diagnosis: {facts['verdict']}",
            "unexplained_structure, with a formula",
            f"do what the diagnosis says next: {facts.get('next') or 'nothing'}",
        )
    )


def diagnosis_lines(facts: Facts, picture: Path | None = None) -> list[str]:
    """Return the answer: a sentence, what to expect of it, the picture and the next command.

    Parameters
    ----------
    facts : the diagnosis.
    picture : the file that shows it.
    """
    lines = [str(facts["sentence"])]
    if facts["groups"]:
        lines.append(_expected(facts))
        lines += [one for one in (_separating(facts["groups"]),) if one]
    elif facts["verdict"] == "not_converged":
        lines.append("Candidates are not ranked about a fit that did not converge.")
    if picture is not None:
        lines.append(f"picture: {picture}")
    if facts.get("next"):
        lines.append(f"next: {facts['next']}")
    return lines


def _expected(facts: Facts) -> str:
    best, looks = facts["groups"][0], facts.get("looks") or 0
    after = f" after {looks:.0f} looks" if looks else ""
    rms = best.get("residual")
    left = (
        f" and the residual of {rms['channel']} from {significant(rms['before'])} to {significant(rms['after'])} "
        f"{pretty(rms['unit'])} rms"
        if rms
        else ""
    )
    return (
        f"Expected of adding it: chi2 falls by {significant(best['delta_chi2'])}, counted in the noise that is then "
        f"left,{left}; chance {chance_text(best['p_global'])}{after}."
    )


def _separating(groups: Sequence[Facts]) -> str:
    best = groups[0]
    if len(best["effects"]) < 2:
        return ""
    how = f" To tell them apart: {best['separating_run']}." if best.get("separating_run") else ""
    return f"These fit alike: {', '.join(best['effects'])}.{how}"


def chance_text(p: float | None) -> str:
    """Return a chance: two digits, and a power of ten where it is small."""
    if p is None:
        return "–"
    return f"{p:.2g}" if p >= 1e-3 else ("< 1e-30" if p < 1e-30 else f"{p:.0e}".replace("e-0", "e-"))


def ranking_sheet(facts: Facts, effect: str = "") -> Sheet:
    """Return every candidate in order of evidence; those of one group carry its number."""
    ranking = [one for one in facts.get("ranking", ()) if not effect or one["effect"] == effect]
    whole = len(ranking)
    if not effect:
        # One line an effect: the channels on which it has most evidence.
        best: dict[str, Facts] = {}
        for one in ranking:
            best.setdefault(one["effect"], one)
        ranking = list(best.values())
    group = {
        (one["effect"], tuple(one["channels"])): place
        for place, each in reversed(list(enumerate(facts["groups"], 1)))
        for one in each["candidates"]
    }
    rows, slim = [], []
    for one in ranking[: None if effect else _MOST_RANKED]:
        strong = one["p_global"] is not None and one["p_global"] < facts["threshold"]
        number = group.get((one["effect"], tuple(one["channels"])))
        name, drop = Cell(one["effect"]), Cell(significant(one["delta_chi2"]))
        chance = Cell(chance_text(one["p_global"]), "bad" if strong else "dim")
        mark = Cell("" if number is None else str(number))
        rows.append(
            (name, Cell(listed(one["channels"], 3)), Cell(_coefficient(one)), drop, Cell(str(one["dof"])), chance, mark)
        )
        slim.append((name, Cell(_coefficient(one, short=True)), drop, chance, mark))
    left = whole - len(rows)
    note = f"{left} more in {DIAGNOSIS}. " if left > 0 else ""
    note += (
        "chi2 would fall by Δχ² if the effect were added; the chance is that of any candidate doing so well where "
        "nothing is missing. Candidates of one group cannot be told apart by these runs."
    )
    head = ("effect", "on", "coefficient", "Δχ²", "dof", "chance", "group")
    title = "Candidates in order of evidence"
    narrow = Sheet(title, ("effect", "coefficient", "Δχ²", "chance", "group"), slim, (0, 1), "", note)
    return Sheet(title, head, rows, (0, 1, 2), "", note, narrow=narrow)


def _coefficient(line: Facts, short: bool = False) -> str:
    """Return the coefficient that stands out most, in short, and the shape that was scanned."""
    known = [one for one in line["coefficients"] if one["value"] is not None]
    if not known:
        return "–"
    best = max(known, key=lambda one: abs(one["value"]) / (one["sd"] or float("inf")))
    value, sd = value_and_sd(best["value"], best["sd"])
    name = best["name"].partition(".")[2] or best["name"]
    text = f"{value} ± {sd} {pretty(best['unit'])}"
    if short:
        return text
    text = f"{name} {text}"
    shape = ", ".join(
        f"{key.rpartition('.')[2]} {significant(size)}" for key, size in (line.get("shape") or {}).items()
    )
    text += f" at {shape}" if shape else ""
    return text + (f", {len(known) - 1} more" if len(known) > 1 else "")


def undetectable_sheet(facts: Facts) -> Sheet:
    """Return what these runs cannot show, and what would hide it."""
    rows, without = [], []
    for one in facts.get("undetectable", ()):
        if one.get("needs"):
            without.append(f"{one['effect']} ({', '.join(one['needs'])})")
            continue
        hiding = [f"{percent(each['share'])} {each['parameter']}" for each in one["absorbed_by"][:2]]
        smallest, unit = one.get("smallest_detectable"), pretty(one.get("unit", ""))
        size = f"{significant(smallest)} {unit}" if smallest is not None else "–"
        rows.append(
            (
                Cell(one["effect"]),
                Cell(", ".join(hiding) or str(one.get("reason", "–"))),
                Cell(size),
                Cell(_shift(one.get("bias"))),
            )
        )
    note = "Not seen is not absent: these effects may be there, and no statement is made about them." if rows else ""
    note += f" No run supplies what these need: {', '.join(without)}." if without else ""
    if rows:
        note += " The last column is what the largest usual size of an effect, there and not seen, does to a parameter."
    head = ("effect", "would hide in", "smallest seen", "would shift")
    return Sheet("What these runs cannot show", head, rows, (0, 1, 3), "", note)


def _shift(bias: Facts | None) -> str:
    """Return the parameter that an effect shifts most while it goes unseen."""
    if not bias or abs(bias["in_sd"]) < _SMALL_SHIFT:
        return "–"
    size = f"{significant(abs(bias['value']))} {pretty(bias['unit'])}"
    return f"{bias['parameter']} by {size}, {significant(abs(bias['in_sd']))} sd"


def structure_sheet(facts: Facts) -> Sheet:
    """Return the patterns found in the residuals, whatever their cause."""
    patterns = facts.get("structure", ())
    rows = [
        (
            Cell(one["channel"]),
            Cell(one["covariate"]),
            Cell(one["test"]),
            Cell(chance_text(one["p"]), "bad"),
            Cell(" ".join(part for part in (str(one.get("shape") or ""), _size(one.get("coefficient"))) if part)),
        )
        for one in patterns[:_MOST_PATTERNS]
    ]
    head = ("channel", "depends on", "test", "chance", "shape")
    left = len(patterns) - len(rows)
    note = f"{left} more in {DIAGNOSIS}." if left > 0 else ""
    return Sheet("Patterns in the residuals, whatever their cause", head, rows, (0, 1, 2, 4), "", note)


def noise_sheet(facts: Facts) -> Sheet:
    """Return what was found of the noise."""
    rows = [
        (
            Cell(str(one.get("effect", ""))),
            Cell(listed(list(one.get("channels", ())), 4)),
            Cell(significant(one.get("drop", one.get("delta_chi2")))),
            Cell(chance_text(one.get("p_global", one.get("p")))),
        )
        for one in facts.get("noise", ())
        if one.get("adopted", True)
    ]
    return Sheet("Noise that the model lacks", ("noise", "on", "Δχ²", "chance"), rows, (0, 1))


def far_off_sheet(facts: Facts) -> Sheet:
    """Return the readings that are far off."""
    readings = facts.get("far_off", ())
    rows = [
        (Cell(one["run"]), Cell(one["channel"]), Cell(str(one["row"])), Cell(f"{one['distance']:+.1f}"))
        for one in readings[:_MOST_FAR_OFF]
    ]
    left = len(readings) - len(rows)
    note = f"{left} more in {DIAGNOSIS}. " if left > 0 else ""
    note += "In standard deviations of the other readings. The search went on without them."
    return Sheet("Readings that are far off", ("run", "channel", "row", "distance"), rows, (0, 1), "", note)


def _size(coefficient: Facts | None) -> str:
    return f"{significant(coefficient['value'])} {pretty(coefficient['unit'])}" if coefficient else ""


def asked_lines(facts: Facts, effect: str) -> list[str]:
    """Return the answer about one effect: found, absent down to a size, or not to be seen by these runs."""
    lines = [str(facts["sentence"])]
    hidden = [one for one in facts.get("undetectable", ()) if one["effect"] == effect]
    for one in hidden[:1]:
        if any(each["parameter"] in lines[0] for each in one["absorbed_by"]):
            continue
        hiding = [f"{percent(each['share'])} would hide in {each['parameter']}" for each in one["absorbed_by"]]
        lines.append(
            "; ".join(hiding) + "." if hiding else f"Reason: {one.get('reason', 'no run supplies what it needs')}."
        )
    return lines

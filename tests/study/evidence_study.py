"""A held-out study of `explain`: what does the evidence say of campaigns that nobody has looked at?

    python tests/study/evidence_study.py OUT.jsonl --minutes 50 --parts abcd     goes on where it stopped
    python tests/study/evidence_study.py OUT.jsonl --minutes 0                   the tables of what is there

Parts: a, one hidden effect at three sizes; b, pairs and triples; c, nothing missing, and other noise; d, causes
outside the catalogue.  Each procedure comes with and without scatter between runs in the model, whole and cut to 4 … 9
runs; what is compiled for one setting serves all its campaigns.  Judging is done afterwards, on the lines.
"""
# pyright: reportMissingImports=false

import argparse
import json
import pickle
import sys
import tempfile
import time
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from binomial_share import told
from blind import mode_of, start_worker
from evidence_cases import EQUAL, SEEN, Bench, Case, Setting, bench_of, cases, settings, write_case

from imubayes.foundations.errors import InputError

Line = dict[str, Any]
SURE, OPEN, SHARE = 0.9, 0.5, 0.05
"""Probability of a certain finding and of any finding, and the least share of a candidate that counts."""
BINS = ((0.0, 0.5), (0.5, 0.9), (0.9, 0.98), (0.98, 1.01))
GOOD = ("right", "equal", "open")
"""Verdicts of campaigns that need not be kept if a folder is given.  Of others: beside, an effect is named beside a
form outside the catalogue; equal, of the same shape as the cause; open, no name is reported as certain."""


# one campaign


def examine(bench: Bench, case: Case, place: Path, keep: Path | None = None) -> Line:
    """Fit a campaign and weigh the explanations of what is left."""
    from imubayes.criticism.evidence.relinearised_search import explain
    from imubayes.responses.candidate_effects import candidate_responses
    from imubayes.responses.residual_covariates import covariates

    started = time.perf_counter()
    try:
        fitted = mode_of(place, bench.model)
    except InputError as error:
        return {"status": f"refused: {error.issues[0].what[:40]}"}
    if not fitted.converged:
        return {"status": "not converged"}
    known = candidate_responses(fitted), covariates(fitted)
    before, searching = _resident("VmRSS"), time.perf_counter()
    Path("/proc/self/clear_refs").write_text("5")
    found = explain(fitted, *known).evidence
    line: Line = {"status": "done", "seconds": time.perf_counter() - searching, "fit": searching - started}
    line |= {"megabytes": _resident("VmHWM") - before, "hypotheses": found.hypotheses}
    line["kinds"] = {each.kind: each.probability for each in found.explanations}
    line["slots"] = [slot.model_dump(mode="json", include={"candidates", "channels", "gain"}) for slot in found.slots]
    line["form"] = found.form.model_dump(mode="json") if found.form else None
    line["noise"] = [each.model_dump(mode="json") for each in found.noise]
    line |= {"part": case.part, "label": case.label, "planted": list(case.planted), "cause": case.cause}
    line["joint"] = case.explained({each["effect"] for each, _ in named(line)})
    if keep is not None and verdict(line) not in GOOD:
        (keep / f"{place.name}.pkl").write_bytes(pickle.dumps((case.planted or case.cause, case.label, fitted, *known)))
    return line


def _resident(name: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(each for each in lines if each.startswith(name)).split()[1]) / 1024


# judging


def named(line: Line) -> list[tuple[dict[str, Any], float]]:
    """Return the leader of each slot with the probability of its name."""
    return [(each["candidates"][0], line["kinds"]["effects"] * each["candidates"][0]["probability"])
            for each in line["slots"] if each["candidates"]]  # fmt: skip


def is_it(candidate: dict[str, Any], one: dict[str, Any]) -> bool:
    """Return whether a candidate is a planted effect, on one of its channels at least."""
    here = not one["channels"] or not candidate["channels"] or set(one["channels"]) & set(candidate["channels"])
    return candidate["effect"] == one["effect"] and bool(here)


def planted(line: Line, candidate: dict[str, Any]) -> bool:
    """Return whether a candidate is there: planted, or of the same shape as what is."""
    return any(is_it(candidate, one) for one in line["planted"]) or candidate["effect"] in line["cause"].get(
        "equal", ()
    )


def in_slots(line: Line) -> bool:
    """Return whether every planted effect is the first candidate of a slot, or not excluded there."""
    listed = [
        each
        for slot in line["slots"]
        for place, each in enumerate(slot["candidates"])
        if place == 0 or each["probability"] >= SHARE
    ]
    return all(any(is_it(each, one) for each in listed) for one in line["planted"])


def leading(line: Line) -> str:
    """Return the most probable kind of explanation."""
    return max(line["kinds"], key=line["kinds"].get)


def _of_effects(line: Line) -> str:
    if any(p > SURE and not planted(line, each) for each, p in named(line)):
        return "wrong"
    if not in_slots(line):
        return "silent"
    return {"effects": "right", "outside": "beside", "input": "beside"}.get(leading(line), "silent")


def _of_nothing(line: Line) -> str:
    if any(p > OPEN for _, p in named(line)):
        return "wrong"
    if line["label"].startswith("null"):
        return "right" if line["kinds"]["nothing"] >= OPEN else "alarm"
    return "right" if leading(line) in ("nothing", "noise") else "form"


def _of_outside(line: Line) -> str:
    kind, cause, form = leading(line), line["cause"], line["form"]
    if kind == "effects":
        sure = [each for each, p in named(line) if p > SURE]
        if sure:
            same = line.get("joint", 0.0) >= EQUAL or all(planted(line, each) for each in sure)
            return "equal" if same else "wrong"
        return "open"
    if kind not in ("outside", "input") or form is None:
        return "silent"
    text = " ".join([form["name"], *form["covariates"]])
    right = any(word in text for word in cause["words"]) or (cause["run"] and form["run"] == cause["run"])
    return "right" if right else "other"


_JUDGES: dict[str, Callable[[Line], str]] = {"a": _of_effects, "b": _of_effects, "c": _of_nothing, "d": _of_outside}


def verdict(line: Line) -> str:
    """Return what is to be said of an answer: right, wrong, silent, …"""
    return _JUDGES[line["part"]](line)


def _table(title: str, lines: Iterable[Line], by: Callable[[Line], object], verdicts: Sequence[str]) -> list[str]:
    groups: dict[object, list[Line]] = defaultdict(list)
    for line in lines:
        groups[by(line)].append(line)
        groups["all"].append(line)
    rows = ["", f"| {title} | {' | '.join(verdicts)} |", "| --- " * (len(verdicts) + 1) + "|"]
    for group in sorted(groups, key=str):
        found = Counter(map(verdict, groups[group]))
        rows.append(f"| {group} | {' | '.join(told(found[each], len(groups[group])) for each in verdicts)} |")
    return rows


def _shown(line: Line, name: str) -> bool:
    return min(one.get(name, 0.0) for one in line["planted"]) >= SEEN


def _size(line: Line) -> object:
    return line["planted"][0]["size"]


def _setting(line: Line) -> object:
    return ("cut" if line["cut"] else "whole") + (", scatter" if line["scatter"] else "")


def statements(lines: Iterable[Line]) -> list[tuple[float, bool]]:
    """Return the probability of every name that is reported, and whether it is right."""
    return [(p, planted(line, each)) for line in lines for each, p in named(line)]


def _calibration(lines: Iterable[Line]) -> list[str]:
    found = statements(lines)
    rows = ["", "| e. probability of a name | right | mean probability |", "| --- | --- | --- |"]
    for low, high in BINS:
        inside = [(p, right) for p, right in found if low <= p < high]
        mean = float(np.mean([p for p, _ in inside])) if inside else 0.0
        rows.append(
            f"| {low:g} … {min(high, 1):g} | {told(sum(right for _, right in inside), len(inside))} | {mean:.3f} |"
        )
    return rows


def tables(every: Iterable[Line]) -> str:
    """Return the tables of a study."""
    every = list(every)
    lines, rows = [each for each in every if each["status"] == "done"], list[str]()
    part = {name: [each for each in lines if each["part"] == name] for name in "abcd"}
    effects = ("right", "beside", "silent", "wrong")
    rows += _table("a. not detectable", (each for each in part["a"] if not _shown(each, "s")), _size, effects)
    for title, name in (("a. detectable", "s"), ("a. detectable at noise of any size", "seen")):
        rows += _table(title, (each for each in part["a"] if _shown(each, name)), _size, effects)
    able = [each for each in part["a"] if _shown(each, "s")]
    rows += _table("a. setting", able, _setting, effects)
    rows += _table("a. procedure", able, lambda each: each["procedure"], effects)
    for title, name in (("b. effects", "s"), ("b. detectable at noise of any size", "seen")):
        rows += _table(title, (each for each in part["b"] if _shown(each, name)), lambda each: each["label"], effects)
    whole = [each for each in part["c"] if each["label"].startswith("null")]
    rows += _table("c. null", whole, _setting, ("right", "alarm", "wrong"))
    other = [each for each in part["c"] if each not in whole]
    rows += _table("c. noise", other, lambda each: each["label"], ("right", "form", "wrong"))
    outside = ("right", "other", "equal", "silent", "open", "wrong")
    rows += _table("d. cause", part["d"], lambda each: each["label"], outside)
    rows += _calibration(lines)
    for name in ("seconds", "megabytes", "hypotheses"):
        if values := [each[name] for each in lines]:
            rows += [
                "",
                f"{name}: median {np.median(values):.3g}, 90 % {np.quantile(values, 0.9):.3g}, most {max(values):.3g}",
            ]
    rows += ["", f"campaigns: {dict(Counter(each['status'] for each in every))}"]
    return "\n".join(rows)


# the study


def known(path: Path) -> dict[str, Line]:
    """Return the lines of what is done."""
    lines = map(json.loads, path.read_text().splitlines() if path.exists() else [])
    return {line["key"]: line for line in lines}


def study(path: Path, minutes: float, parts: str, some: list[Setting], keep: Path | None = None) -> list[Line]:
    """Run what is not done yet, and return all lines."""
    until, done = time.monotonic() + 60 * minutes, known(path)
    for setting in some:
        with tempfile.TemporaryDirectory() as temporary:
            if time.monotonic() > until or (bench := bench_of(setting, Path(temporary))) is None:
                continue
            for case in cases(bench, setting, parts):
                key = f"{case.part}-{setting.procedure}-{setting.seed}-{case.label}"
                if key in done or time.monotonic() > until:
                    continue
                place = Path(temporary) / key
                write_case(bench, case, place, zlib.crc32(key.encode()))
                line = examine(bench, case, place, keep)
                line |= {"key": key, "procedure": setting.procedure, "scatter": setting.scatter, "cut": setting.cut}
                done[key] = line | {"part": case.part, "label": case.label}
                with path.open("a") as file:
                    file.write(json.dumps(done[key]) + "\n")
    return list(done.values())


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("lines", type=Path, help="the file with one line per campaign")
    parser.add_argument("--minutes", type=float, default=50.0, help="no campaign is begun after so long")
    parser.add_argument("--parts", default="abcd")
    parser.add_argument("--some", type=int, help="of all settings every so manieth only")
    parser.add_argument("--keep", type=Path, help="a folder for the fits of what is not right")
    chosen = parser.parse_args()
    start_worker()
    print(tables(study(chosen.lines, chosen.minutes, chosen.parts, list(settings())[:: chosen.some], chosen.keep)))


if __name__ == "__main__":
    main()

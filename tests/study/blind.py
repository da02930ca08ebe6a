"""The blind study: is the missing effect found in campaigns whose making shares no line of code with its finding?

    python tests/study/blind.py --quick 12          a handful, to see that it runs
    python tests/study/blind.py                     the whole study, resumed where it stopped
    python tests/study/blind.py --look hidden 17    one campaign again, with its diagnosis in full

Campaigns are drawn by `data/generators/hidden.py`: plan, unit, noise, effect, channel, size and sign.  Each is fitted
with the model that lacks the effect, and diagnosed.  One line of JSON per campaign is kept in `.cache/blind/`, and
judged afterwards, so that rules of judgement may change without a refit.
"""

import argparse
import json
import math
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from scipy import stats

ROOT = Path(__file__).parents[2]
LINES = ROOT / ".cache" / "blind" / "campaigns.jsonl"
REPORT = ROOT / "benchmarks" / "results" / "blind_study.md"
COMMAND = "python tests/study/blind.py"
COUNTS = {
    "hidden": 300, "null-white": 100, "null-ar1": 100, "null-runs": 100, "outside": 60, "offsets": 24, "two": 40,
}  # fmt: skip
EXPLAINED = ("missing_effect", "equivalent_effects")
SHAPES = {
    "outside_resonance": ("rate",),
    "outside_root_rate": ("rate",),
    "outside_temperature_wave": ("temperature",),
    "outside_angle_harmonic": ("angle",),
    "outside_step": ("time", "power_on", "order", "row"),
    "outside_threshold": ("force", "acceleration", "angle", "input"),
}
"""Words in the name of a covariate that tell the cause of an effect outside the catalogue."""
UNDERSTATED = 1.5

Document = dict[str, Any]
Line = dict[str, Any]


# what a diagnosis says, judged against what was hidden


def names_it(one: dict[str, Any], group: dict[str, Any]) -> bool:
    """Tell whether a group names a planted effect, and at least one of its channels."""
    right_place = not one["channels"] or not group["channels"] or set(one["channels"]) & set(group["channels"])
    return one["effect"] in group["effects"] and bool(right_place)


def first_group(document: Document) -> dict[str, Any] | None:
    """Return the first group, if any."""
    return document["groups"][0] if document["groups"] else None


def alarms(document: Document) -> bool:
    """Tell whether an effect or a structure is claimed."""
    return document["verdict"] in (*EXPLAINED, "unexplained_structure")


def false_alarm(kind: str, document: Document) -> bool:
    """Tell whether a campaign without hidden effect is complained of; correlated noise that is there may be."""
    return alarms(document) or (document["verdict"] != "adequate" and kind != "null-ar1")


def alarms_at_one_look(document: Document) -> bool:
    """Planted fault: tell what would be claimed if only one candidate had been looked at."""
    return any(one["p"] < document["threshold"] for one in document["ranking"])


def alarms_if_understated(document: Document, factor: float = UNDERSTATED) -> bool:
    """Planted fault: tell what would be claimed if the noise were taken for smaller than it is."""
    looks = max(1.0, document.get("looks", 1.0))
    return any(
        looks * stats.chi2.sf(factor**2 * one["delta_chi2"], one["dof"]) < document["threshold"]
        for one in document["ranking"]
    )


def right_shape(effect: str, document: Document) -> bool:
    """Tell whether a structure is reported against the covariate that causes it."""
    return any(word in one["covariate"] for one in document["structure"] for word in SHAPES[effect])


def left_open(one: dict[str, Any], asked: Document) -> bool:
    """Tell whether the answer about one effect leaves room for its true size.

    It says that the effect is there, or cannot be seen; or its absence is stated down to a size (four standard
    deviations at least) that is above the true one.
    """
    if asked["verdict"] != "adequate":
        return True
    sd = {each["name"]: each["sd"] for row in asked["ranking"] for each in row["coefficients"] if each["sd"]}
    return all(name in sd and abs(value) < 4 * sd[name] for name, value in one["parameters"].items())


def judged(line: Line) -> str:
    """Return `ok`, or what is wrong with a campaign's diagnosis."""
    if not line["converged"]:
        return "not converged"
    kind, document, planted = line["kind"], line["document"], line["planted"]
    verdict, group = document["verdict"], first_group(document)
    said = verdict if group is None else f"{verdict} {'|'.join(group['effects'])} {','.join(group['channels'])}"
    if kind.startswith("null"):
        return "alarm: " + said if false_alarm(kind, document) else "ok"
    if kind == "hidden":
        return "ok" if group is not None and names_it(planted[0], group) else said
    if kind == "outside":
        # A group says that the catalogue has the cause, whatever structure stands beside it.
        if verdict == "unexplained_structure" or (group is None and right_shape(planted[0]["effect"], document)):
            return "ok"
        return "wrong name: " + said if verdict == "missing_effect" else said
    if kind == "offsets":
        effect = planted[0]["effect"]
        hidden = any(effect == one["effect"] for one in document["undetectable"])
        named = any(effect in one["effects"] for one in document["groups"])
        return "ok" if hidden or named or left_open(planted[0], line["asked"]) else "called absent: " + said
    second = line["second"]
    if second is None:
        return "first step: " + said
    left = next(one for one in planted if one["effect"] != line["added"])
    again = first_group(second) if second else None
    if again is not None and names_it(left, again):
        return "ok"
    return f"second step after {line['added']}: " + (second.get("verdict") or "refit not taken")


# one campaign


def draw_and_judge(kind: str, seed: int, folder: Path | None = None) -> Line:
    """Draw, fit and diagnose one campaign."""
    import hidden  # pyright: ignore[reportMissingImports]

    import imubayes.api

    with tempfile.TemporaryDirectory() as temporary:
        place = folder or Path(temporary) / "campaign"
        clock = [time.perf_counter()]
        drawn = hidden.random_campaign(place, seed, kind)
        clock.append(time.perf_counter())
        result = imubayes.api.fit(place, drawn.model, sample=False)
        clock.append(time.perf_counter())
        document = diagnosed(result)
        clock.append(time.perf_counter())
        planted = [
            {"effect": one.effect, "channels": list(one.channels), "s": one.s, "s_alone": one.s_alone,
             "seen": one.seen, "within": one.within, "shown": one.shown, "parameters": one.parameters}
            for one in drawn.planted
        ]  # fmt: skip
        line: Line = {
            "kind": kind,
            "seed": seed,
            "template": drawn.template,
            "readings": drawn.readings,
            "planted": planted,
            "passed_over": list(drawn.passed_over),
            "converged": bool(result.converged),
            "chi2": result.summary["chi2"],
            "dof": result.summary["dof"],
            "document": document,
        }
        if kind == "null-ar1":
            line["white"] = diagnosed_as_white(result)
        if kind == "offsets":
            line["asked"] = diagnosed(result, planted[0]["effect"])
        if kind == "two":
            line |= second_step(result, document, planted)
        clock.append(time.perf_counter())
    line["seconds"] = dict(zip(("draw", "fit", "diagnose", "more"), np.round(np.diff(clock), 3).tolist(), strict=True))
    return line


def diagnosed(result: Any, effect: str = "") -> Document:
    """Return what the diagnosis says, of all or of one effect, without the tail of the ranking."""
    import imubayes.api

    asked = {"effect": effect} if effect else {}
    document = json.loads(json.dumps(imubayes.api.diagnose(result, **asked).json))
    document["ranking"] = document.get("ranking", [])[: None if effect else 12]
    return document


def diagnosed_as_white(result: Any) -> Document | None:
    """Planted fault: return the diagnosis without a look at the noise; None where that cannot be asked."""
    try:
        with mock.patch("imubayes.criticism.search.screen_noise", return_value=[]):
            return diagnosed(result)
    except AttributeError:
        return None


def second_step(result: Any, document: Document, planted: list[dict[str, Any]]) -> Line:
    """Add what the first step found, and look again; `second` is None where the first step found neither."""
    import imubayes.api

    group = first_group(document)
    found = [] if group is None else [one for one in planted if names_it(one, group)]
    if not found or group is None:
        return {"added": None, "second": None}
    candidate = next(one for one in group["candidates"] if one["effect"] == found[0]["effect"])
    channels = candidate["channels"] if found[0]["channels"] else None
    addition: Any = imubayes.api.add(result, [found[0]["effect"]], channels=channels)
    refit = getattr(addition, "result", addition)
    taken = bool(getattr(addition, "taken", refit.converged))
    return {"added": found[0]["effect"], "second": diagnosed(refit) if taken else {}}


def start_worker() -> None:
    """Make a worker ready: one thread, double precision, everything compiled kept on disk."""
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    sys.path.insert(0, str(ROOT / "data" / "generators"))
    import jax

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", str(ROOT / ".cache" / "jax-study"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def attempt(kind: str, seed: int) -> Line:
    """Draw and judge one campaign; what breaks is a line too."""
    try:
        return draw_and_judge(kind, seed)
    except Exception as error:
        return {"kind": kind, "seed": seed, "error": f"{type(error).__name__}: {error}"[:500]}


# the study


def done(path: Path) -> dict[tuple[str, int], Line]:
    """Return the lines of campaigns that are done; a line cut short is done again."""
    lines = {}
    for text in path.read_text().splitlines() if path.exists() else []:
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue
        if "error" not in line:
            lines[line["kind"], line["seed"]] = line
    return lines


def study(counts: dict[str, int], path: Path = LINES, workers: int = 2, first_seed: int = 1) -> list[Line]:
    """Run what is not done yet, and return all lines, in order."""
    wanted = [(kind, first_seed + index) for kind, count in counts.items() for index in range(count)]
    known = done(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    left = [task for task in wanted if task not in known]
    if left:
        # After JAX has started a process must not fork.
        context = multiprocessing.get_context("spawn")
        with (
            ProcessPoolExecutor(workers, mp_context=context, initializer=start_worker) as pool,
            path.open("a") as file,
        ):
            for number, future in enumerate(as_completed([pool.submit(attempt, *task) for task in left]), 1):
                line = future.result()
                known[line["kind"], line["seed"]] = line
                file.write(json.dumps(line) + "\n")
                file.flush()
                if sys.stderr.isatty():
                    print(f"\r{number}/{len(left)}", end="", file=sys.stderr)
    return [known[task] for task in wanted]


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share after Wilson."""
    if count == 0:
        return 0.0, 1.0
    z, share = 1.959964, hits / count
    middle = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * math.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return middle - half, middle + half


class Tally:
    """Counts over some lines of the study."""

    def __init__(self, lines: Iterable[Line]):
        self.lines = [line for line in lines if "error" not in line]
        self.verdicts = [judged(line) for line in self.lines]

    def share(self, wanted: Sequence[bool]) -> tuple[int, int]:
        """Return how many of how many."""
        return sum(wanted), len(wanted)

    @property
    def ok(self) -> tuple[int, int]:
        """Campaigns that are judged right."""
        return self.share([verdict == "ok" for verdict in self.verdicts])

    @property
    def wrong_names(self) -> tuple[int, int]:
        """Campaigns with something outside the catalogue that got a single, wrong name."""
        return self.share([verdict.startswith("wrong name") for verdict in self.verdicts])

    @property
    def failures(self) -> list[tuple[Line, str]]:
        """Campaigns that are judged wrong, with what is wrong."""
        return [pair for pair in zip(self.lines, self.verdicts, strict=True) if pair[1] != "ok"]


def of_kind(lines: Iterable[Line], *kinds: str) -> Tally:
    """Return the tally over some kinds of campaign."""
    return Tally(line for line in lines if line["kind"] in kinds)


NULLS = ("null-white", "null-ar1", "null-runs")


def faults(lines: Sequence[Line]) -> dict[str, tuple[int, int]]:
    """Return the alarms in campaigns without hidden effect under the planted faults of the diagnosis."""
    null = [line for line in lines if line["kind"] in NULLS and "error" not in line]
    white = [line["white"] for line in null if line.get("white")]
    return {
        "look-elsewhere left out": (sum(alarms_at_one_look(line["document"]) for line in null), len(null)),
        f"noise understated {UNDERSTATED} times": (
            sum(alarms_if_understated(line["document"]) for line in null),
            len(null),
        ),
        "correlation ignored": (sum(alarms(document) for document in white), len(white)),
    }


def _cells(hits: int, count: int) -> str:
    low, high = wilson(hits, count)
    return f"{hits} of {count} | {100 * hits / max(count, 1):.1f} % | {100 * low:.1f} … {100 * high:.1f} %"


def report(lines: Sequence[Line], command: str = COMMAND) -> str:
    """Return the table of the study."""
    hidden, outside = of_kind(lines, "hidden"), of_kind(lines, "outside")
    alarmed = {kind: of_kind(lines, kind).ok for kind in NULLS}
    pooled = of_kind(lines, *NULLS).ok
    rows = [
        ("right group first, one hidden effect", "≥ 95 %", hidden.ok),
        *(
            (f"alarms without hidden effect, {kind.removeprefix('null-')}", "5 ± 2 %", (count - fine, count))
            for kind, (fine, count) in alarmed.items()
        ),
        ("alarms without hidden effect, together", "5 ± 2 %", (pooled[1] - pooled[0], pooled[1])),
        ("outside the catalogue: unexplained structure or right shape", "≥ 90 %", outside.ok),
        ("outside the catalogue: a single, wrong name", "≤ 5 %", outside.wrong_names),
        ("hidden in the run offsets: not called absent", "100 %", of_kind(lines, "offsets").ok),
        ("two hidden effects: both found in two steps", "≥ 90 %", of_kind(lines, "two").ok),
        *((f"planted fault, alarms: {name}", "> 7 %", share) for name, share in faults(lines).items()),
    ]
    whole = [line for line in lines if "error" not in line]
    sizes = [len(line["document"]["groups"][0]["effects"]) for line in hidden.lines if line["document"]["groups"]]
    seconds = {key: np.mean([line["seconds"][key] for line in whole]) for key in ("draw", "fit", "diagnose")}
    text = [
        "# Blind study of missing effects", "",
        f"Made by `{command}`. {len(whole)} campaigns of {min(line['readings'] for line in whole)} to "
        f"{max(line['readings'] for line in whole)} readings, drawn by `data/generators/hidden.py`, which shares no "
        "code with the package: plan, unit, noise, effect, channels, size and sign. The true size of each hidden "
        "effect is such that the readings show it with S = 36 … 2000 past everything that the model absorbs "
        "(80 … 2000 for each of two), and with at least 36 left where the spread of noise and run offsets is taken for "
        "larger than it is. Intervals are 95 % after Wilson.", "",
        "| question | wanted | found | share | interval |", "| --- | --- | --- | --- | --- |",
        *(f"| {name} | {wanted} | {_cells(*share)} |" for name, wanted, share in rows), "",
        f"A first group holds {np.mean(sizes) if sizes else 0:.2f} names on average, at most {max(sizes, default=0)}. "
        f"Seconds per campaign: drawing {seconds['draw']:.2f}, fit {seconds['fit']:.2f}, diagnosis "
        f"{seconds['diagnose']:.2f}.", "",
        "## By size", "", "| S | right group first | share | interval |", "| --- | --- | --- | --- |",
        *_by_size(hidden), "",
        "## By effect", "", "| effect | right group first | names in the group |", "| --- | --- | --- |",
        *_by_effect(hidden), "",
        "## Every failure", "", f"Look at one with `{COMMAND} --look KIND SEED`.", "",
        "| kind | seed | plan | hidden (S; within runs) | said |", "| --- | --- | --- | --- | --- |",
        *_failures(lines), "",
    ]  # fmt: skip
    return "\n".join(text)


def _by_size(hidden: Tally) -> list[str]:
    edges = (36, 60, 120, 300, 2100)
    lines = []
    for low, high in pairwise(edges):
        fine = [
            verdict == "ok"
            for line, verdict in zip(hidden.lines, hidden.verdicts, strict=True)
            if low * 0.98 <= line["planted"][0]["s"] < high
        ]
        lines.append(f"| {low} … {high} | {_cells(sum(fine), len(fine))} |")
    return lines


def _by_effect(hidden: Tally) -> list[str]:
    count, fine, names = Counter(), Counter(), Counter()
    for line, verdict in zip(hidden.lines, hidden.verdicts, strict=True):
        effect, group = line["planted"][0]["effect"], first_group(line["document"])
        count[effect] += 1
        fine[effect] += verdict == "ok"
        names[effect] += len(group["effects"]) if group else 0
    return [
        f"| {effect} | {fine[effect]} of {count[effect]} | {names[effect] / count[effect]:.1f} |"
        for effect in sorted(count)
    ]


def _failures(lines: Iterable[Line]) -> list[str]:
    rows = []
    for line in lines:
        if "error" in line:
            rows.append(f"| {line['kind']} | {line['seed']} | | | {line['error'].splitlines()[0]} |")
            continue
        verdict = judged(line)
        if verdict == "ok":
            continue
        hidden = "; ".join(
            f"{one['effect']} {','.join(one['channels'])} ({one['s']:.0f}; {one['within']:.0f})"
            for one in line["planted"]
        )
        rows.append(
            f"| {line['kind']} | {line['seed']} | {line['template']} | {hidden} | {verdict.replace('|', ', ')} |"
        )
    return rows


def quick(count: int) -> dict[str, int]:
    """Return the counts of a small study of about `count` campaigns with every kind in it."""
    total = sum(COUNTS.values())
    return {kind: max(1, round(count * number / total)) for kind, number in COUNTS.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", type=int, metavar="N", help="a study of about N campaigns, printed only")
    parser.add_argument("--look", nargs=2, metavar=("KIND", "SEED"), help="one campaign, with its diagnosis in full")
    parser.add_argument("--keep", type=Path, help="with --look: the folder to keep the campaign in")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--lines", type=Path, default=LINES, help="the file with one line per campaign")
    chosen = parser.parse_args()
    if chosen.look:
        start_worker()
        line = draw_and_judge(chosen.look[0], int(chosen.look[1]), chosen.keep)
        print(json.dumps(line, indent=1))
        print(judged(line))
        return
    counts = quick(chosen.quick) if chosen.quick else COUNTS
    lines = study(counts, chosen.lines, chosen.workers)
    text = report(lines)
    if chosen.quick:
        print(text)
        return
    REPORT.parent.mkdir(parents=True, exist_ok=True)
    REPORT.write_text(text)
    print(f"{REPORT.relative_to(ROOT)}: {len(lines)} campaigns")


if __name__ == "__main__":
    main()

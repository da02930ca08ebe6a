"""How the blind study judges a diagnosis, and the tables it makes of many."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import stats

COMMAND = "python tests/study/blind.py"
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
SEEDS = (
    "**Seeds.** Effects outside the catalogue (from 5001) and AR(1) noise (from 3001) are drawn from seeds that nobody "
    "had looked at before the rules that they judge were settled. Of the other kinds the failures of an earlier study "
    "had been read; no rule came from them since."
)

Document = dict[str, Any]
Line = dict[str, Any]


def names_it(one: dict[str, Any], group: dict[str, Any]) -> bool:
    """Tell whether a group names a planted effect, and at least one of its channels.

    The channels are those of the member itself: the first of a group may act on a table.
    """
    members = [each for each in group["candidates"] if each["effect"] == one["effect"]]
    channels = members[0]["channels"] if members else group["channels"]
    right_place = not one["channels"] or not channels or set(one["channels"]) & set(channels)
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


def contradicted(document: Document) -> bool:
    """Tell whether a diagnosis calls a model adequate beside a candidate or a structure that it holds significant."""
    known = [one["p_global"] for one in document["ranking"]] + [one["p"] for one in document["structure"]]
    return document["verdict"] == "adequate" and min(known, default=1.0) < document["threshold"]


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


def proposed_at_once(planted: Sequence[dict[str, Any]], document: Document) -> bool:
    """Tell whether all that was planted is to be added together, on the channels of each at least."""
    suggested = document.get("suggested") or {"effects": ()}
    if not {one["effect"] for one in planted} <= {*suggested["effects"]}:
        return False
    channels = suggested["channels"]
    return channels is None or all({*one["channels"]} <= {*channels} for one in planted)


def judged(line: Line) -> str:
    """Return `ok`, or what is wrong with a campaign's diagnosis."""
    if not line["converged"]:
        return "not converged"
    kind, document, planted = line["kind"], line["document"], line["planted"]
    verdict, group = document["verdict"], first_group(document)
    said = verdict if group is None else f"{verdict} {'|'.join(group['effects'])} {','.join(group['channels'])}"
    if kind.startswith("null"):
        return "alarm: " + said if false_alarm(kind, document) else "ok"
    if kind in ("hidden", "large"):
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
    if proposed_at_once(planted, document):
        return "ok"
    second = line["second"]
    if second is None:
        return "first step: " + said
    left = next(one for one in planted if one["effect"] != line["added"])
    again = first_group(second) if second else None
    if again is not None and names_it(left, again):
        return "ok"
    return f"second step after {line['added']}: " + (second.get("verdict") or "refit not taken")


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
    def wrong_single_names(self) -> tuple[int, int]:
        """Campaigns with an effect of the catalogue that got a single, wrong name, with nothing said to remain."""
        return self.share(
            [
                verdict != "ok"
                and line["document"]["verdict"] == "missing_effect"
                and not line["document"].get("more_remains", False)
                for line, verdict in zip(self.lines, self.verdicts, strict=True)
            ]
        )

    @property
    def false_adequate(self) -> tuple[int, int]:
        """Campaigns with something hidden that are called adequate."""
        return self.share([line["document"]["verdict"] == "adequate" for line in self.lines])

    @property
    def failures(self) -> list[tuple[Line, str]]:
        """Campaigns that are judged wrong, with what is wrong."""
        return [pair for pair in zip(self.lines, self.verdicts, strict=True) if pair[1] != "ok"]


def of_kind(lines: Iterable[Line], *kinds: str, procedure: str = "") -> Tally:
    """Return the tally over some kinds of campaign; of mixed plans, or of one procedure by itself."""
    return Tally(line for line in lines if line["kind"] in kinds and line.get("procedure", "") == procedure)


NULLS = ("null-white", "null-ar1", "null-runs")


def by_procedure(lines: Sequence[Line]) -> list[str]:
    """Return the table of campaigns with one procedure alone, and what failed in them."""
    alone = [line for line in lines if line.get("procedure")]
    rows = [
        "| procedure | right group first | false adequate | a single, wrong name | alarms without hidden effect |",
        "| --- | --- | --- | --- | --- |",
    ]
    for procedure in dict.fromkeys(line["procedure"] for line in alone):
        hidden = of_kind(lines, "hidden", procedure=procedure)
        fine, count = of_kind(lines, *NULLS, procedure=procedure).ok
        shares = (hidden.ok, hidden.false_adequate, hidden.wrong_single_names, (count - fine, count))
        rows.append(f"| {procedure} | " + " | ".join(f"{hits} of {of}" for hits, of in shares) + " |")
    failed = _failures(alone)
    head = ["", "| kind | seed | plan | hidden (S; within runs) | said |", "| --- | --- | --- | --- | --- |"]
    return rows + (head + failed if failed else [])


def faults(lines: Sequence[Line]) -> dict[str, tuple[int, int]]:
    """Return the alarms in campaigns without hidden effect under the planted faults of the diagnosis."""
    mixed = [line for line in lines if not line.get("procedure")]
    null = [line for line in mixed if line["kind"] in NULLS and "error" not in line]
    white = [line["white"] for line in null if line.get("white")]
    return {
        "look-elsewhere left out": (sum(alarms_at_one_look(line["document"]) for line in null), len(null)),
        f"noise understated {UNDERSTATED} times": (
            sum(alarms_if_understated(line["document"]) for line in null),
            len(null),
        ),
        "correlation ignored": (sum(alarms(document) for document in white), len(white)),
    }


def added(lines: Iterable[Line]) -> dict[str, tuple[str, int, int]]:
    """Return what additions brought: question → what is wanted, how many, of how many."""
    more = [line for line in lines if line.get("addition")]
    known = [line["addition"] for line in more]
    each = [one for facts in known for one in facts["coefficients"]]
    told = [facts for facts in known if facts["predicted"] and facts["found"]]
    return {
        "refit taken": ("all", sum(facts["taken"] for facts in known), len(known)),
        "coefficients within 3 sd of the truth": (
            "≥ 99 %",
            sum(abs(one["value"] - one["truth"]) < 3 * one["sd"] for one in each),
            len(each),
        ),
        "drop of chi² within 20 % of the predicted": (
            "all",
            sum(abs(facts["found"] / facts["predicted"] - 1) < 0.2 for facts in told),
            len(told),
        ),
        # What n readings scatter by is uncertain by 1/√(2 n) itself: 432 are off by more than 5 % one time in seven.
        "scatter within 5 % of the true noise, two standard deviations of its estimate allowed": (
            "all",
            sum(
                abs(line["addition"]["noise"] - 1) < 0.05 + 2 / np.sqrt(2 * line["readings"])
                for line in more
                if line["addition"]["noise"]
            ),
            len(known),
        ),
        "left-out runs do not speak against it": (
            "all",
            sum(facts["held_out"] != "not" for facts in known),
            len(known),
        ),
    }


def _cells(hits: int, count: int) -> str:
    low, high = wilson(hits, count)
    return f"{hits} of {count} | {100 * hits / max(count, 1):.1f} % | {100 * low:.1f} … {100 * high:.1f} %"


def report(lines: Sequence[Line], command: str = COMMAND) -> str:
    """Return the table of the study."""
    hidden, outside, large = (of_kind(lines, kind) for kind in ("hidden", "outside", "large"))
    alarmed = {kind: of_kind(lines, kind).ok for kind in NULLS}
    pooled = of_kind(lines, *NULLS).ok
    rows = [
        ("right group first, one hidden effect", "≥ 95 %", hidden.ok),
        ("right group first, one large effect", "≥ 95 %", large.ok),
        ("a single, wrong name for one large effect", "≤ 2 %", large.wrong_single_names),
        *(
            (f"alarms without hidden effect, {kind.removeprefix('null-')}", "5 ± 2 %", (count - fine, count))
            for kind, (fine, count) in alarmed.items()
        ),
        ("alarms without hidden effect, together", "5 ± 2 %", (pooled[1] - pooled[0], pooled[1])),
        ("outside the catalogue: unexplained structure or right shape", "≥ 90 %", outside.ok),
        ("outside the catalogue: a single, wrong name", "≤ 5 %", outside.wrong_names),
        ("hidden in the run offsets: not called absent", "100 %", of_kind(lines, "offsets").ok),
        ("two hidden effects: proposed together, or found in two steps", "≥ 90 %", of_kind(lines, "two").ok),
        *((f"after adding: {name}", wanted, (hits, of)) for name, (wanted, hits, of) in added(lines).items()),
        *((f"planted fault, alarms: {name}", "> 7 %", share) for name, share in faults(lines).items()),
    ]
    whole = [line for line in lines if "error" not in line]
    sizes = [len(line["document"]["groups"][0]["effects"]) for line in hidden.lines if line["document"]["groups"]]
    seconds = {key: np.mean([line["seconds"][key] for line in whole]) for key in ("draw", "fit", "diagnose")}
    text = [
        "# Blind study of missing effects", "", SEEDS, "",
        f"Made by `{command}`. {len(whole)} campaigns of {min(line['readings'] for line in whole)} to "
        f"{max(line['readings'] for line in whole)} readings, drawn by `data/generators/hidden.py`, which shares no "
        "code with the package: plan, unit, noise, effect, channels, size and sign. The true size of each hidden "
        "effect is such that the readings show it with S = 36 … 2000 past everything that the model absorbs "
        "(80 … 2000 for each of two, 2000 … 10⁶ for a large one), and with at least 36 left where the spread of noise "
        "and run offsets is taken for larger than it is. Intervals are 95 % after Wilson.", "",
        "| question | wanted | found | share | interval |", "| --- | --- | --- | --- | --- |",
        *(f"| {name} | {wanted} | {_cells(*share)} |" for name, wanted, share in rows), "",
        f"A first group holds {np.mean(sizes) if sizes else 0:.2f} names on average, at most {max(sizes, default=0)}. "
        f"Seconds per campaign: drawing {seconds['draw']:.2f}, fit {seconds['fit']:.2f}, diagnosis "
        f"{seconds['diagnose']:.2f}.", "",
        "## By size", "", "| S | right group first | share | interval |", "| --- | --- | --- | --- |",
        *_by_size(hidden), "",
        "## By effect", "", "| effect | right group first | names in the group |", "| --- | --- | --- |",
        *_by_effect(hidden), "",
        *(
            ["## Every procedure by itself", "", "Wanted: ≥ 95 %, none, ≤ 2 %, 5 ± 2 %.", "", *by_procedure(lines), ""]
            if any(line.get("procedure") for line in lines)
            else []
        ),
        "## Every failure", "", f"Look at one with `{COMMAND} --look KIND SEED`.", "",
        "| kind | seed | plan | hidden (S; within runs) | said |", "| --- | --- | --- | --- | --- |",
        *_failures([line for line in lines if not line.get("procedure")]), "",
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

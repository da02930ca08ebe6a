# pyright: reportMissingImports=false
"""Shares of seeded set-up mistakes that are named, and of valid campaigns that are doubted, collected seed by seed.

    python tests/study/setup_gate_shares.py mistakes FILE FIRST COUNT    append the mistakes of so many seeds
    python tests/study/setup_gate_shares.py valid FILE FIRST COUNT       append so many valid campaigns
    python tests/study/setup_gate_shares.py static FILE FIRST COUNT      append so many valid static records
    python tests/study/setup_gate_shares.py table FILE...                print the tables

A file holds one JSON object a line and can be continued with other seeds.  A mistake counts if the outputs show it
to a reader of the campaign files, and, in a table of its own, if they show it to one who knows the law that they
were drawn from (`tests/campaign/generating_law.py`).  It is named if the message holds its remedy; an angle has
to be right to within a tolerance, or to three times the uncertainty with which the outputs determine it.
"""

import json
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "campaign"), str(ROOT / "data" / "generators")]

from binomial_share import interval  # noqa: E402
from campaign_files import Files  # noqa: E402
from generating_law import DETECTABLE, STATED, chi_square  # noqa: E402
from hidden import random_campaign  # noqa: E402
from seeded_mistakes import MISTAKES, Planted, plant, says  # noqa: E402
from valid_campaigns import valid_campaign  # noqa: E402

from imubayes.campaign import inspect_campaign  # noqa: E402
from imubayes.campaign.setup_gate.judgement import SETUP_FINDINGS  # noqa: E402


@dataclass(frozen=True)
class Judged:
    """What the gate said of a campaign.

    Attributes
    ----------
    mistake : that was planted; empty in a valid campaign.
    detectable : whether the law that the outputs were drawn from determines the mistake.
    stated : whether what the campaign files state determines it.
    named : whether the message holds the remedy; of a valid campaign, whether a mistake was named.
    stopped : whether the campaign was refused.
    text : what was said in place of the remedy, or of a valid campaign.
    """

    seed: int
    campaign: str
    mistake: str
    detectable: bool
    named: bool
    stopped: bool
    stated: bool = True
    text: str = ""


def judge_valid(seed: int, folder: Path) -> Judged:
    """Return what the gate says of a valid campaign, which is written to a folder."""
    return judged_valid(seed, folder, valid_campaign(folder, seed))


def judged_valid(seed: int, folder: Path, campaign: str) -> Judged:
    """Return what the gate says of a valid campaign of a kind."""
    inspection = inspect_campaign(folder)
    doubted = {finding.name for finding in inspection.findings} & {*SETUP_FINDINGS, "setup_disagrees"}
    text = " ".join(map(str, inspection.findings)) if doubted else ""
    return Judged(seed, campaign, "", True, bool(doubted), bool(inspection.issues), text=text)


def judge_static(seed: int, folder: Path) -> Judged:
    """Return what the gate says of a valid static record, in three of four with an effect that no model expects."""
    random_campaign(folder, seed, "hidden" if seed % 4 else "null-white", "static_record")
    return judged_valid(seed, folder, "static_record")


def judge_mistakes(seed: int, folder: Path) -> Iterator[Judged]:
    """Yield what the gate says of each mistake that can be made in a campaign."""
    valid = folder / "valid"
    campaign = valid_campaign(valid, seed)
    least, least_stated = chi_square(valid) + DETECTABLE, chi_square(valid, STATED) + DETECTABLE
    for name in MISTAKES:
        wrong = folder / name
        shutil.copytree(valid, wrong)
        planted = plant(wrong, name, seed)
        detectable = stated = False
        if planted is not None:
            # An input that the law does not know, such as an angle beyond a turn, is no number.
            detectable, stated = not chi_square(wrong) < least, not chi_square(wrong, STATED) < least_stated
        if planted is not None and (detectable or stated):
            inspection = inspect_campaign(wrong)
            text = " ".join(map(str, (*inspection.issues, *inspection.findings)))
            named = says(planted, text) or says(planted, text, uncertainty(planted, valid, folder / "moved"))
            text = "" if named else f"{planted.named}: {text}"
            yield Judged(seed, campaign, name, detectable, named, bool(inspection.issues), stated, text)
        shutil.rmtree(wrong)


def uncertainty(planted: Planted, valid: Path, moved: Path) -> float:
    """Return the standard deviation, deg, of the angle of a mistake by the facts of the campaign; 0 of none.

    It follows from χ² with an angle one degree less and one degree more than the valid one.
    """
    if planted.more is None:
        return 0.0
    bend = -2 * chi_square(valid, STATED)
    for step in (-1.0, 1.0):
        shutil.copytree(valid, moved)
        planted.more(Files(moved), step)
        bend += chi_square(moved, STATED)
        shutil.rmtree(moved)
    return float(np.sqrt(2 / bend)) if bend > 0 else float("inf")


def tables(judged: Sequence[Judged]) -> str:
    """Return the tables of named mistakes, by both laws, and of valid campaigns, in Markdown."""
    valid = [each for each in judged if not each.mistake]
    stated = [each for each in judged if each.mistake and each.stated]
    drawn = [each for each in judged if each.mistake and (each.stated or each.detectable)]
    lines = [*_of_mistakes(stated), "", *_of_mistakes(drawn)]
    lines += ["", "| valid campaigns | of | share | 95 % |", "| --- | --- | --- | --- |"]
    for what, doubted in (
        ("stopped", [each.stopped for each in valid]), ("stopped or warned of", [each.named for each in valid]),
    ):  # fmt: skip
        share = f"{sum(doubted) / max(len(doubted), 1):.1%}"
        lines.append(f"| {what} | {_share(doubted)} | {share} | {_interval(doubted)} |")
    return "\n".join(lines)


def _of_mistakes(mistakes: Sequence[Judged]) -> list[str]:
    """Return the lines of a table of named mistakes, and the missed ones."""
    campaigns = list(dict.fromkeys(each.campaign for each in mistakes))
    lines = [f"| mistake | all | 95 % | {' | '.join(campaigns)} |", f"| --- | --- | --- |{' --- |' * len(campaigns)}"]
    for name in ("", *MISTAKES):
        own = [each for each in mistakes if name in ("", each.mistake)]
        cells = [_share([each.named for each in own if each.campaign == kind]) for kind in campaigns]
        named = [each.named for each in own]
        lines.append(f"| {name or 'all'} | {_share(named)} | {_interval(named)} | {' | '.join(cells)} |")
    missed = [f"{each.mistake} ({each.campaign}, {each.seed})" for each in mistakes if not each.named]
    return [*lines, "", f"Missed: {', '.join(missed) or 'none'}."]


def _share(outcomes: Sequence[bool]) -> str:
    return f"{sum(outcomes)}/{len(outcomes)}" if outcomes else ""


def _interval(outcomes: Sequence[bool]) -> str:
    """Return the Clopper–Pearson interval of a share."""
    if not outcomes:
        return ""
    low, high = interval(sum(outcomes), len(outcomes))
    return f"{low:.1%} … {high:.1%}"


def main(what: str, *arguments: str) -> None:
    """Append judgements to a file, or print the tables of files."""
    if what == "table":
        lines = [line for file in arguments for line in Path(file).read_text(encoding="utf-8").splitlines()]
        print(tables([Judged(**json.loads(line)) for line in lines]))
        return
    file, first, count = arguments
    with Path(file).open("a", encoding="utf-8") as out:
        for seed in range(int(first), int(first) + int(count)):
            with tempfile.TemporaryDirectory() as folder:
                place = Path(folder)
                if what == "mistakes":
                    judged = judge_mistakes(seed, place)
                else:
                    judged = [(judge_static if what == "static" else judge_valid)(seed, place / "valid")]
                for each in judged:
                    print(json.dumps(asdict(each)), file=out, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

# pyright: reportMissingImports=false
"""Shares of fresh set-up mistakes that `check` names, or passes in silence, and of alarms in campaigns without one.

    python tests/study/fresh_setup_shares.py FILE FIRST COUNT [KIND...]    append so many seeds of each kind of mistake
    python tests/study/fresh_setup_shares.py FILE FIRST COUNT null         append so many campaigns without a mistake
    python tests/study/fresh_setup_shares.py table FILE...                 print the table

A mistake is named if an error or a warning names the run (or table, mounting, channel) and the quantity; it is
silent if nothing is said at all.
"""

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "campaign"), str(ROOT / "data" / "generators")]

from campaign_files import Files  # noqa: E402
from fresh_setups import BENCHES, KINDS, write_campaign  # noqa: E402
from seeded_mistakes import says  # noqa: E402

from imubayes.campaign import inspect_campaign  # noqa: E402
from imubayes.foundations.errors import InputError  # noqa: E402
from imubayes.model.bind import bind  # noqa: E402
from imubayes.model.model_file import read_model  # noqa: E402


@dataclass(frozen=True)
class Said:
    """What `check` said of a campaign: whether it named the mistake, stopped, or said nothing."""

    kind: str
    seed: int
    bench: str
    named: bool
    stopped: bool
    silent: bool
    text: str


def judge(kind: str, seed: int, folder: Path) -> Said | None:
    """Return what `check` says of a campaign with a mistake of a kind; None if it cannot be made there."""
    bench = BENCHES[seed % len(BENCHES)]
    write_campaign(folder, bench, seed)
    planted = KINDS[kind](Files(folder), np.random.default_rng([seed, 7])) if kind != "null" else None
    if planted is None and kind != "null":
        return None
    stopped, text = checked(folder)
    named = planted is not None and says(planted, text)
    return Said(kind, seed, bench, named, stopped, not text, f"{planted and planted.named}: {text}"[:1500])


def checked(folder: Path) -> tuple[bool, str]:
    """Return whether `check --model` refuses a campaign, and all it says."""
    found = inspect_campaign(folder)
    text = " ".join(map(str, (*found.issues, *found.findings)))
    if found.campaign is None:
        return True, text
    try:
        bind(read_model(folder / "model.toml"), found.campaign)
    except InputError as error:
        return True, f"{text} {error}"
    return False, text


def table(said: Sequence[Said]) -> str:
    """Return the shares by kind, in Markdown."""
    lines = ["| mistake | named | said otherwise | silent |", "| --- | --- | --- | --- |"]
    for kind in (*KINDS, "null"):
        own = [each for each in said if each.kind == kind]
        named, silent = sum(each.named for each in own), sum(each.silent for each in own)
        lines += [f"| {kind} | {named}/{len(own)} | {len(own) - named - silent} | {silent} |"] * bool(own)
    return "\n".join(lines)


def main(file: str, *arguments: str) -> None:
    """Append judgements to a file, or print the table of files."""
    if file == "table":
        lines = [line for each in arguments for line in Path(each).read_text(encoding="utf-8").splitlines()]
        print(table([Said(**json.loads(line)) for line in lines]))
        return
    first, count, *kinds = arguments
    with Path(file).open("a", encoding="utf-8") as out:
        for kind in kinds or KINDS:
            for seed in range(int(first), int(first) + int(count)):
                with tempfile.TemporaryDirectory() as folder:
                    said = judge(kind, seed, Path(folder) / "campaign")
                if said is not None:
                    print(json.dumps(asdict(said)), file=out, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

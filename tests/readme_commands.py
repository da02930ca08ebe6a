"""The commands that a document of the repository shows, and their output."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def _parts(document: str) -> dict[str, str]:
    """Return the text under each heading of a document."""
    text = (ROOT / document).read_text(encoding="utf-8")
    return {part.partition("\n")[0]: part for part in text.split("\n## ")[1:]}


def sections(document: str) -> dict[str, list[str]]:
    """Return the commands under each heading that has some."""
    found = {}
    for heading, part in _parts(document).items():
        block = "".join(re.findall(r"```sh\n(.*?)```", part, re.DOTALL))
        found[heading] = [line.split("#")[0].strip() for line in block.splitlines() if line.startswith("imubayes ")]
    return {heading: commands for heading, commands in found.items() if commands}


def outputs(document: str, heading: str) -> dict[str, list[str]]:
    """Return the lines of output that stand under a heading, by the command that prints them."""
    shown = re.findall(r"<!-- output of (.*?) -->\n```text\n(.*?)```", _parts(document)[heading], re.DOTALL)
    return {verb: text.splitlines() for verb, text in shown}

"""The commands that a document of the repository shows."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def sections(document: str) -> dict[str, list[str]]:
    """Return the commands under each heading of a document."""
    text = (ROOT / document).read_text(encoding="utf-8")
    blocks = {
        part.splitlines()[0]: "".join(re.findall(r"```sh\n(.*?)```", part, re.DOTALL))
        for part in text.split("\n## ")[1:]
    }
    found = {
        heading: [line.split("#")[0].strip() for line in block.splitlines() if line.startswith("imubayes ")]
        for heading, block in blocks.items()
    }
    return {heading: commands for heading, commands in found.items() if commands}

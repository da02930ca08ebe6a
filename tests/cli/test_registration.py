"""Every command that the README names is a command of `imubayes`."""

import re
from pathlib import Path

from imubayes.cli.main import app

README = Path(__file__).parents[2] / "README.md"


def commands_of(text: str) -> set[str]:
    """Return the words after `imubayes` at the start of a line of code or of a quotation."""
    return set(re.findall(r"(?:^|`)imubayes ([a-z]+)\b", text, re.MULTILINE))


def test_every_command_of_the_readme_is_there() -> None:
    named = commands_of(README.read_text(encoding="utf-8"))
    assert {"fit", "diagnose", "batch", "export"} <= named
    assert named <= set(app)


def test_a_missing_command_is_seen() -> None:
    assert not commands_of("`imubayes sew RESULT`") <= set(app)

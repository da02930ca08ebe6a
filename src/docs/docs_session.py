"""Start of every executed page: commands run in its process, and one that fails stops the build."""

import contextlib
import io
import os
import shlex
import sys
import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any

import rich.console
from myst_nb import glue  # pyright: ignore[reportMissingImports]  (installed for `make docs` alone)

from imubayes.cli.main import run
from imubayes.display import progress

os.chdir(os.environ["IMUBAYES_DOCS"])
os.environ["COLUMNS"] = "100"
rich.console._is_jupyter = lambda: False  # commands print text, as in a terminal
progress._display = lambda: None  # what is cleared in the end would leave an empty box


def say(name: str, text: str) -> None:
    """Keep a text for a sentence of the page."""
    glue(name, text, display=False)


def truth_of(campaign: str) -> dict[str, Any]:
    """Return the true values of a shipped campaign."""
    return tomllib.loads(Path("data", campaign, "truth.toml").read_text(encoding="utf-8"))


def _command(line: str) -> None:
    """Run a line that begins with `!`; `> FILE` writes a file, a comment `# exit status 1` states that."""
    words, _, file = (shlex.split(part, comments=True) for part in line.partition(" > "))
    errors, output = io.StringIO(), io.StringIO()
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(output if file else sys.stdout):
        status = run(words[1:])
    if file:
        Path(file[0]).write_text(output.getvalue(), encoding="utf-8")
    if status != (1 if "exit status 1" in line else 0):
        raise RuntimeError(f"{line}: exit status {status}\n{errors.getvalue()}")


vars(import_module("IPython").get_ipython())["system"] = _command

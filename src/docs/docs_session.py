"""Start of every executed page: commands run in its process, and one that fails stops the build."""

import contextlib
import io
import os
import shlex
from importlib import import_module

import rich.console

from imubayes.cli.main import run

os.chdir(os.environ["IMUBAYES_DOCS"])
os.environ["COLUMNS"] = "110"
rich.console._is_jupyter = lambda: False  # commands print text, as in a terminal


def _command(line: str) -> None:
    """Run a line that begins with `!`; a comment `# exit status 1` says that this is what is expected."""
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors):
        status = run(shlex.split(line, comments=True)[1:])
    if status != (1 if "exit status 1" in line else 0):
        raise RuntimeError(f"{line}: exit status {status}\n{errors.getvalue()}")


vars(import_module("IPython").get_ipython())["system"] = _command

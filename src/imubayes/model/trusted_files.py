"""Which effect files may run.

Effect files are code.  A model file that the user names runs with its effect files.  An effect file that comes with a
result folder or a test plan runs only if the user trusts it.  Its SHA-256 is remembered then, so that a changed file is
another one.  A file that has run in this process may run in it again.
"""

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

from pydantic import ValidationError

from imubayes.foundations.errors import Issue, refuse
from imubayes.foundations.files import only_writer, write_text
from imubayes.foundations.records import Record

_FILE = "trusted.json"
_ran: set[str] = set()


class TrustedFiles(Record):
    """The contents of `trusted.json` in the user's configuration: SHA-256 of the files that he trusts."""

    sha256: tuple[str, ...] = ()


def note_run(file: Path) -> None:
    """Note that a file is run in this process."""
    _ran.add(_digest(file))


def trust_files(files: Iterable[str | Path]) -> None:
    """Remember files as trusted."""
    place, new = _place(), [_digest(Path(file)) for file in files]
    if new:
        with only_writer(place):
            known = dict.fromkeys((*_trusted(), *new))
            write_text(place, TrustedFiles(sha256=tuple(known)).json_text())


def refuse_untrusted(files: Iterable[str | Path]) -> None:
    """Raise InputError for effect files that came along and are not trusted."""
    known = {*_ran, *_trusted()}
    refuse(
        Issue(
            f"'{Path(file).name}' is Python code that came with the input, and it is not trusted",
            str(file),
            "effect files of a model that is named on the command line, and those whose present text you have trusted",
            "read the file; if you trust it, add --trust, or in Python call imubayes.trust, which remembers it",
        )
        for file in files
        if Path(file).is_file() and _digest(Path(file)) not in known
    )


def _place() -> Path:
    home = os.environ.get("XDG_CONFIG_HOME")
    return (Path(home) if home else Path.home() / ".config") / "imubayes" / _FILE


def _trusted() -> tuple[str, ...]:
    try:
        return TrustedFiles.model_validate_json(_place().read_bytes()).sha256
    except (OSError, ValidationError):
        return ()


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()

"""Input errors in four parts: what is wrong, where, what is allowed, what to do.

Issues are collected and raised together as one `InputError`, so that all mistakes of a campaign can be corrected at
once.  Numerical failure is not an exception but a value with a message (see `imubayes.inference`).
"""

import difflib
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Issue:
    """One fault of an input.

    Attributes
    ----------
    what : the fault, in one sentence.
    where : file with line, key or column.
    allowed : accepted values, closest match first; empty if they cannot be listed.
    remedy : what to do.
    """

    what: str
    where: str
    allowed: str
    remedy: str

    def __str__(self) -> str:
        lines = [f"error: {self.what}", f"  where:   {self.where}"]
        if self.allowed:
            lines.append(f"  allowed: {self.allowed}")
        lines.append(f"  do:      {self.remedy}")
        return "\n".join(lines)


class InputError(Exception):
    """An input that cannot be used; `issues` holds every fault found in it, `written` the folder with it to correct.

    Examples
    --------
    >>> import imubayes
    >>> try:
    ...     imubayes.load_model("hidden-efects")
    ... except imubayes.InputError as error:
    ...     print(error.issues[0].what)
    there is no model 'hidden-efects': neither a file nor a shipped model has this name
    """

    def __init__(self, issues: Issue | Iterable[Issue], written: str = ""):
        self.issues, self.written = (issues,) if isinstance(issues, Issue) else tuple(issues), written
        super().__init__("\n".join(str(issue) for issue in self.issues))

    def __reduce__(self):
        return type(self), (self.issues, self.written)  # pickled between processes with its issues, not with their text


def input_error(what: str, where: str, allowed: str, remedy: str) -> InputError:
    """Return the error of a single issue; see `Issue` for the four parts."""
    return InputError(Issue(what, where, allowed, remedy))


def refuse(issues: Iterable[Issue]) -> None:
    """Raise InputError with issues; nothing if there are none."""
    if found := tuple(issues):
        raise InputError(found)


class NotKept(UserWarning):
    """Warning: a finding is returned, but could not be written to the result folder `folder`.

    Examples
    --------
    >>> import warnings
    >>> import imubayes
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", imubayes.NotKept)  # an error in a script that must keep what it finds
    ...     found = imubayes.diagnose("results/accel-channel")
    """

    def __init__(self, folder: Path, reason: str):
        self.folder = folder
        remedy = (
            "to keep it, run the command in a place with free space and write permission, such as a copy of the folder"
        )
        super().__init__(f"nothing of this is kept in {folder} ({reason}); {remedy}")


@contextmanager
def kept_if_possible(folder: Path) -> Iterator[None]:
    """Warn, and go on after the block, if it cannot write to a folder: what was to be kept there is not lost."""
    try:
        yield
    except (OSError, InputError) as error:
        reason = error.issues[0].what if isinstance(error, InputError) else error.strerror or str(error)
        warnings.warn(NotKept(folder, reason), stacklevel=3)


def closest_first(word: str, options: Iterable[str], most: int = 8) -> str:
    """Return the allowed words as a list in text, close matches to `word` first, at most `most` of them."""
    options = list(dict.fromkeys(options))
    near = difflib.get_close_matches(word, options, n=3, cutoff=0.5)
    listed = near + [option for option in options if option not in near]
    return ", ".join(listed[:most]) + (", …" if len(listed) > most else "")

"""Named errors whose text an engineer can act on.

Every complaint about an input is a `Issue` in four parts: what is wrong, where, what is allowed
(closest first) and what to do.  Problems are collected and raised together as one `InputError`, so
that a campaign with five mistakes is mended in one go.  Numerical failure is not an exception but a
value with a sentence (see `imubayes.inference`).
"""

import difflib
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Issue:
    """One thing that is wrong with an input.

    Attributes
    ----------
    what : the fault, in one sentence.
    where : file with line, key or column.
    allowed : what would be accepted, closest first; empty where nothing can be listed.
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
    """An input that cannot be used; carries every problem found in it."""

    def __init__(self, issues: Issue | Iterable[Issue]):
        self.issues = (issues,) if isinstance(issues, Issue) else tuple(issues)
        super().__init__("\n".join(str(problem) for problem in self.issues))


def closest_first(word: str, options: Iterable[str], most: int = 8) -> str:
    """List the allowed words, the ones nearest to `word` in front."""
    options = list(dict.fromkeys(options))
    near = difflib.get_close_matches(word, options, n=3, cutoff=0.5)
    listed = near + [option for option in options if option not in near]
    return ", ".join(listed[:most]) + (", …" if len(listed) > most else "")

"""Commands of `imubayes`: the kernel lists its own, packages beside it register theirs by entry points."""

from dataclasses import dataclass
from typing import Literal

import cyclopts

Group = Literal["The loop", "Data", "Results", "Many units"]
GROUPS: tuple[Group, ...] = ("The loop", "Data", "Results", "Many units")
"""In the order of work: what `imubayes --help` shows together."""


@dataclass(frozen=True)
class Command:
    """A command of the command line.

    Attributes
    ----------
    call : `module:function`, or `module:app` of a group of commands; imported only for a command that runs, or if
        `imubayes --help` shows it without a `help` of its own.
    group : the commands that `imubayes --help` shows it with.
    place : where among them.
    name : of the command, if it is not that of the function.
    help : of the command, if its function takes long to import.
    interrupted : what is kept of its work after Ctrl-C, and how it is continued; empty if nothing is.
    """

    call: str
    group: Group
    place: float
    name: str = ""
    help: str = ""
    interrupted: str = ""

    @property
    def word(self) -> str:
        """The word by which it is called."""
        return self.name or self.call.rpartition(":")[2]

    def add_to(self, app: cyclopts.App, group: cyclopts.Group) -> None:
        """Add the command to the command line, shown in a group."""
        app.command(self.call, name=self.word, group=group, sort_key=self.place, help=self.help or None)

"""Commands of `imubayes`: the kernel lists its own, packages beside it register theirs by entry points."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import cyclopts

Group = Literal["The loop", "Data", "Results", "Many units"]
GROUPS: tuple[Group, ...] = ("The loop", "Data", "Results", "Many units")
"""In the order of work: what `imubayes --help` shows together."""


@dataclass(frozen=True)
class Command:
    """A command of the command line.

    Attributes
    ----------
    call : the function, a group of commands, or `module:function`, which is imported only when the command runs.
    group : the commands that `imubayes --help` shows it with.
    place : where among them.
    name : of the command, if it is not that of the function.
    help : of the command, if its function is not imported for `imubayes --help`.
    interrupted : what is kept of its work after Ctrl-C, and how it is continued; empty if nothing is.
    """

    call: Callable[..., Any] | cyclopts.App | str
    group: Group
    place: float
    name: str = ""
    help: str = ""
    interrupted: str = ""

    @property
    def word(self) -> str:
        """The word by which it is called."""
        own = self.call.name[0] if isinstance(self.call, cyclopts.App) else getattr(self.call, "__name__", "")
        return self.name or own

    def add_to(self, app: cyclopts.App, group: cyclopts.Group) -> None:
        """Add the command to the command line, shown in a group."""
        if isinstance(self.call, cyclopts.App):
            self.call.group, self.call.sort_key = group, self.place
            app.command(self.call)
        elif isinstance(self.call, str):
            app.command(self.call, name=self.name, group=group, sort_key=self.place, help=self.help)
        else:
            app.command(self.call, name=self.name or None, group=group, sort_key=self.place)

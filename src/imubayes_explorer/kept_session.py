"""Kept by a session beside its first result: the commands of every click, names and notes, locks of effects."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from imubayes.foundations.files import write_text
from imubayes.foundations.records import Record
from imubayes.results.folder_files import read_record

Lock = Literal["in", "out"]


class ModelNote(Record):
    """A name and a note of a model, in the user's words."""

    name: str = Field(default="", max_length=120)
    note: str = Field(default="", max_length=4000)


class KeptSession(Record):
    """The contents of `RESULT.explore.json`.

    Attributes
    ----------
    commands : that do what was clicked, in order.
    notes : by the name of the result folder.
    locks : effect → whether it is always added, or never proposed.
    """

    format: Literal[1] = 1
    commands: tuple[str, ...] = ()
    notes: dict[str, ModelNote] = {}
    locks: dict[str, Lock] = {}

    def with_command(self, command: str, *, again: bool = False) -> "KeptSession":
        """Return the same with a command after the others.

        An action that creates something is not repeated; an action that may be done `again`, such as a selection, only
        not at once.
        """
        if command in (self.commands[-1:] if again else self.commands):
            return self
        return self.model_copy(update={"commands": (*self.commands, command)})

    def with_note(self, folder: str, note: ModelNote) -> "KeptSession":
        """Return the same with another note of a model."""
        return self.model_copy(update={"notes": self.notes | {folder: note}})

    def with_lock(self, effect: str, lock: Lock | Literal[""]) -> "KeptSession":
        """Return the same with an effect locked in or out, or free."""
        others = {name: kept for name, kept in self.locks.items() if name != effect}
        return self.model_copy(update={"locks": others | {effect: lock} if lock else others})

    def script(self) -> str:
        """Return a shell script of the commands."""
        return "\n".join(["#!/bin/sh", "set -eu", *self.commands, ""])

    @classmethod
    def read(cls, root: Path) -> "KeptSession":
        """Return what the session of a first result has kept; a new one if there is none.

        Raises
        ------
        InputError
            if the file cannot be read.
        """
        return read_record(_file(root), cls) if _file(root).is_file() else cls()

    def write(self, root: Path) -> None:
        """Keep a session beside its first result."""
        write_text(_file(root), self.json_text())


def _file(root: Path) -> Path:
    return root.with_name(f"{root.name}.explore.json")

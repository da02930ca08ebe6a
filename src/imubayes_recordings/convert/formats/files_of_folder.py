"""A folder with a file for each sensor, as phones export a recording: one recording, a topic for each file.

Such exports hold further files, of other sensors or without numbers (`Metadata.csv`): they are topics without channels,
or are left out with a note.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imubayes.foundations.errors import InputError, input_error
from imubayes_recordings.convert.gravity_file import with_gravity
from imubayes_recordings.convert.recording import SourceRecording, Topic

_MOST_FILES = 50  # of one folder: more are a collection of recordings, not one


class FilesOfFolder(SourceRecording):
    """The files of a folder as one recording."""

    def __init__(self, folder: Path, opened: Callable[[Path], SourceRecording]) -> None:
        """Open the files of a folder.

        Parameters
        ----------
        opened : opens a file.

        Raises
        ------
        InputError
            if no file of the folder is a recording.
        """
        self.file, self._left = folder, []
        files = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
        parts = [part for path in files[:_MOST_FILES] if (part := self._part(path, opened)) is not None]
        if not parts or len(files) > _MOST_FILES:
            inside = ", ".join(sorted(path.name for path in folder.iterdir())[:12])
            what = f"'{folder}' is a folder" + (f" of {len(files)} files" if files else "")
            allowed = f"a ROS 2 bag, an EuRoC folder, a folder with a file for each sensor, or a file: {inside}"
            raise input_error(what, str(folder), allowed, "name the file, or each folder of files")
        self._parts = with_gravity(parts)
        self._topics: dict[str, tuple[SourceRecording, Topic]] = {}
        for part in self._parts:
            for topic in part.topics():
                name = f"{part.file.name}: {topic.name}" if topic.name else part.file.name
                self._topics[name] = (part, topic)

    def _part(self, path: Path, opened: Callable[[Path], SourceRecording]) -> SourceRecording | None:
        try:
            part = opened(path)
            part.topics()
        except InputError:
            self._left.append(path.name)
            return None
        return part

    def topics(self) -> tuple[Topic, ...]:
        """Return the tables of all files, by the names of the files."""
        return tuple(replace(topic, name=name) for name, (_, topic) in self._topics.items())

    def blocks(self, topic: Topic, positions: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield rows of the file that the topic is named after."""
        part, own = self._topics[topic.name]
        yield from part.blocks(own, positions)

    def notes(self) -> tuple[str, ...]:
        """Return which files hold no table, and what was left out of the others."""
        left = (f"{self.file.name}: no table in {', '.join(self._left)}",) if self._left else ()
        return (*left, *(note for part in self._parts for note in part.notes()))

"""A recording taken step by step until its poses determine what was asked for."""

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imubayes.foundations.errors import input_error
from imubayes.foundations.files import refuse_existing, refuse_occupied
from imubayes.foundations.records import several
from imubayes_recordings.convert import read_recordings
from imubayes_recordings.guided_capture import UNTIL, Guidance, GuidedCapture, Wanted

STANDARD_INPUT = "-"


@dataclass(frozen=True)
class Captured:
    """A campaign that was captured.

    Attributes
    ----------
    folder : of the campaign.
    last : last guidance: done, or the quantities that were still open.
    wanted : requested uncertainties of the quantities that the channels can determine.

    Examples
    --------
    >>> import imubayes
    >>> from imubayes_recordings.guided_capture import Guidance
    >>> imubayes.Captured("desk", Guidance("done", poses=14), ()).last.poses
    14
    """

    folder: str | Path
    last: Guidance
    wanted: tuple[Wanted, ...]


def capture(
    folder: str | Path,
    source: str | Path,
    until: str | Sequence[str] = UNTIL,
    *,
    patience: float = 60.0,
    show: Callable[[Guidance, Sequence[Wanted]], None] = lambda step, wanted: None,
    **options: Any,
) -> Captured:
    """Guide through the rests and turns of a unit in hand, and write the campaign.

    An interrupt writes what there is.

    Parameters
    ----------
    folder : of the campaign; must not exist, or be empty.
    source : a text file that grows, or ``-`` for the lines of standard input, which are kept in FOLDER.log.
    until : largest standard uncertainties of the effects, such as ``accel_bias=0.2mg``.
    patience : seconds without a line after which a file has ended.
    show : called with every step, and the requested uncertainties.
    options : as of `imubayes convert`.

    Raises
    ------
    InputError
        with everything that prevents it; the lines that were received stay in their file.

    Examples
    --------
    >>> import imubayes
    >>> try:
    ...     imubayes.capture("captured", "no-port.log")
    ... except imubayes.InputError as error:
    ...     print(error.issues[0].what)
    there is no file 'no-port.log'
    """
    folder = Path(folder)
    refuse_occupied(folder)
    with _file_of(source, folder) as (file, ended):
        guide, last = GuidedCapture(file, several(until), options), None
        try:
            for last in guide.follow(ended, patience):
                show(last, guide.wanted)
        except KeyboardInterrupt:  # what was shown as enough is in the file
            pass
        if last is None:
            what = "the source ended before its columns were named"
            raise input_error(what, str(file), "some seconds of a recording", "start the recording first")
        read_recordings([file], folder.name, **({"procedure": "free_tumble"} | options)).write(folder)
    return Captured(folder, last, guide.wanted)


@contextmanager
def _file_of(source: str | Path, folder: Path) -> Iterator[tuple[Path, Callable[[], bool]]]:
    """Yield the file that grows, and whether its writer has ended; a copy of standard input is gone in the end."""
    if str(source) != STANDARD_INPUT:
        if not Path(source).is_file():
            raise input_error(f"there is no file '{source}'", str(source), "a text file, or -", "give its path")
        yield Path(source), lambda: False
        return
    copy = folder.with_name(f"{folder.name}.log")
    refuse_existing(copy)
    copy.parent.mkdir(parents=True, exist_ok=True)
    copy.touch()
    # The buffer of a port is small: it is emptied while the poses are judged.
    writer = threading.Thread(target=_copy, args=(sys.stdin.buffer.readline, copy), daemon=True)
    writer.start()
    yield copy, lambda: not writer.is_alive()
    copy.unlink()


def _copy(line_of: Callable[[], bytes], target: Path) -> None:
    with target.open("wb", buffering=0) as stream:
        while line := line_of():
            stream.write(line)

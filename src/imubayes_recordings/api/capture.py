"""A recording taken step by step until its poses determine what was asked for."""

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imubayes.foundations.errors import closest_first, input_error
from imubayes.foundations.files import refuse_existing, refuse_occupied
from imubayes.foundations.records import several
from imubayes.procedures.carried import LEAST_SECONDS
from imubayes_recordings.guided_capture import UNTIL, Guidance, GuidedCapture, Motion, Wanted

STANDARD_INPUT = "-"
_LONGEST = 600.0  # s of one motion


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
    until: str | Sequence[str] | None = None,
    *,
    motion: Motion = "poses",
    seconds: float | None = None,
    patience: float = 60.0,
    show: Callable[[Guidance, Sequence[Wanted]], None] = lambda step, wanted: None,
    **options: Any,
) -> Captured:
    """Guide through rests and turns of a unit in hand, or through motions, and write the campaign.

    An interrupt writes what there is.

    Parameters
    ----------
    folder : of the campaign; must not exist, or be empty.
    source : a text file that grows, or ``-`` for the lines of standard input, which are kept in FOLDER.log.
    until : largest standard uncertainties of the effects, such as ``accel_bias=0.2mg``; those of `UNTIL` by default.
    motion : ``poses``, at rest; ``drill``, turns about one axis after the other; or ``wave``, slowly by hand.
    seconds : of each motion; 20 s of a turn and 60 s of waving by default.
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
        words = several(until) if until else _default_until(motion)
        guide, last = GuidedCapture(file, words, options, motion, _stated_seconds(motion, seconds)), None
        try:
            for last in guide.follow(ended, patience):
                show(last, guide.wanted)
        except KeyboardInterrupt:  # what was shown as enough is in the file
            pass
        if last is None:
            what = "the source ended before its columns were named"
            raise input_error(what, str(file), "some seconds of a recording", "start the recording first")
        guide.write(folder)
    return Captured(folder, last, guide.wanted)


def _default_until(motion: str) -> tuple[str, ...]:
    if motion not in UNTIL:
        what = f"'{motion}' is no motion of a capture"
        raise input_error(what, "option motion", closest_first(motion, UNTIL), "choose one of them")
    return UNTIL[motion]


def _stated_seconds(motion: str, seconds: float | None) -> float | None:
    if motion == "poses" and seconds is not None:
        what = "poses are held until they are known well enough: --seconds is of a motion"
        raise input_error(what, "option seconds", "--motion drill or --motion wave", "leave it out, or choose a motion")
    if seconds is not None and not LEAST_SECONDS < seconds <= _LONGEST:
        what, allowed = f"{seconds:g} s are no duration of a motion", f"{LEAST_SECONDS:g} s to {_LONGEST:g} s"
        raise input_error(what, "option seconds", allowed, "20 s of a turn and 60 s of waving are usual")
    return seconds


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

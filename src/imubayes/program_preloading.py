"""Programs that the last process of the same purpose used, loaded in a thread while this one imports and reads.

Loading takes half a second of a repeated command, in code that leaves the interpreter's lock alone.  Which programs a
command needs is known once its problem is built, so a list of the last time stands in for that; what is not needed
this time costs a moment of another core.
"""

import atexit
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from imubayes.atomic_files import replacing
from imubayes.program_files import StoredProgram, read_program


class Preloading:
    """Loads the programs of a list, in the order in which they were used; at the exit the list is brought up to date.

    Parameters
    ----------
    folder : of the programs.
    purpose : names the list, as the command that is running.
    """

    def __init__(self, folder: Path, purpose: str):
        self._list = folder / f"{purpose}.used"
        self._used: dict[str, None] = {}
        try:
            self._known = self._list.read_text().split()
        except (OSError, UnicodeDecodeError):
            self._known = []
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="preloading")
        self._pending: dict[str, Future[StoredProgram | None]] = {
            name: self._pool.submit(read_program, folder / name) for name in self._known
        }
        atexit.register(self.remember)

    def read(self, file: Path) -> StoredProgram | None:
        """Return the program in a file, as `read_program` does: loaded ahead, or now."""
        self._used[file.name] = None
        ahead = self._pending.pop(file.name, None)
        return read_program(file) if ahead is None or ahead.cancel() else ahead.result()

    def remember(self) -> None:
        """Write the list of the programs used; nothing where it has not changed, or the folder cannot be written."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        if self._used and list(self._used) != self._known:
            with suppress(OSError), replacing(self._list) as scratch:
                scratch.write_text("\n".join(self._used) + "\n")

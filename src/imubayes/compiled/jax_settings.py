"""JAX as this package needs it: double precision, compiled code kept between processes, and a limit on its memory maps.

JAX is set where a model is bound, which everything that computes goes through, and not on import: a process that only
reads results keeps its own settings.

Every compiled function occupies several memory maps.  Linux allows 65 530 per process by default; beyond that the
compiler aborts.  A process that fits many units with different test plans reaches the limit after some hundreds of
fits, so the cache of compiled functions is cleared before.
"""

import os
import time
import warnings
from contextlib import suppress
from pathlib import Path

import jax
from jax._src.xla_bridge import backends_are_initialized

from imubayes.compiled.kept_programs import forget_programs, keep_programs
from imubayes.foundations.errors import input_error

# An empty entry younger than this may be in the hands of another process.
_BEING_WRITTEN_S = 60.0


def prepare_jax(command: str = "") -> None:
    """Switch double precision and the persistent compilation cache on, unless the process has chosen a cache itself.

    Parameters
    ----------
    command : that is running: the programs that it used the last time are loaded ahead.

    Raises
    ------
    InputError
        if JAX has computed in single precision already: arrays made then would stay so.
    """
    if not jax.config.jax_enable_x64:
        if backends_are_initialized():
            raise input_error(
                "JAX has been started in single precision",
                "this Python process",
                "float64: a part in a million of a scale factor is lost in float32",
                'call jax.config.update("jax_enable_x64", True), and make arrays of your own again',
            )
        jax.config.update("jax_enable_x64", True)
    if jax.config.jax_compilation_cache_dir is None:
        _keep_compiled()
    keep_programs(_own_folder("programs") if jax.config.jax_enable_compilation_cache else None, command)


def _own_folder(name: str) -> Path | None:
    """Return a folder for compiled code that belongs to the user alone (mode 0700); None if it cannot be made."""
    home = os.environ.get("XDG_CACHE_HOME")
    folder = (Path(home) if home else Path.home() / ".cache") / "imubayes" / name
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        folder.chmod(0o700)
    except OSError:
        return None  # no writable home: compile every time
    return folder


def _keep_compiled() -> None:
    """Keep compiled code, found by the lowered program."""
    folder = _own_folder("compiled")
    if folder is None:
        return
    _without_empty(folder)
    warnings.filterwarnings("ignore", "Error writing persistent compilation cache")  # the disk is full
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _without_empty(folder: Path) -> None:
    """Remove empty entries, which a process that was killed leaves: JAX warns of them and never writes them again."""
    with os.scandir(folder) as entries:
        for entry in entries:
            with suppress(OSError):
                if entry.stat().st_size == 0 and time.time() - entry.stat().st_mtime > _BEING_WRITTEN_S:
                    Path(entry.path).unlink()


_MOST, _HELD = Path("/proc/sys/vm/max_map_count"), Path("/proc/self/maps")
# One fit with its diagnosis holds 1 to 2 % of the maps.
_FULL = 0.5


def clear_if_crowded() -> bool:
    """Clear the caches of compiled functions if half of the memory maps are in use; return whether it was done."""
    try:
        most = int(_MOST.read_text())
        with _HELD.open("rb") as file:
            held = sum(1 for _ in file)
    except OSError:
        return False  # not Linux: no such limit
    if held < _FULL * most:
        return False
    forget_programs()
    jax.clear_caches()
    return True

"""Room for compiled code.

Linux maps every compiled function in several pieces of memory, 65 530 in all for a process unless it is set otherwise;
beyond that the compiler ends the process.  Whoever fits an archive of units with plans unlike each other in one process
gets there after some hundreds of fits, so what was compiled for earlier ones is given up in time.
"""

from pathlib import Path

import jax

_MOST, _HELD = Path("/proc/sys/vm/max_map_count"), Path("/proc/self/maps")
# One fit with its diagnosis holds a hundredth or two.
_FULL = 0.5


def clear_if_crowded() -> bool:
    """Give up all compiled code where half of the memory maps of the process are in use; return whether it was."""
    try:
        most = int(_MOST.read_text())
        with _HELD.open("rb") as file:
            held = sum(1 for _ in file)
    except OSError:
        return False  # another system, which counts otherwise
    if held < _FULL * most:
        return False
    jax.clear_caches()
    return True

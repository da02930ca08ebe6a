"""Limit on the memory maps held by compiled code.

Every compiled function occupies several memory maps.  Linux allows 65 530 per process by default; beyond that the
compiler aborts.  A process that fits many units with different test plans reaches the limit after some hundreds of
fits, so the cache of compiled functions is cleared before.
"""

from pathlib import Path

import jax

from imubayes.kept_programs import forget_programs

_MOST, _HELD = Path("/proc/sys/vm/max_map_count"), Path("/proc/self/maps")
# One fit with its diagnosis holds 1 to 2 % of the maps.
_FULL = 0.5


def clear_if_crowded() -> bool:
    """Clear the caches of compiled functions where half of the memory maps are in use; return whether it was done."""
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

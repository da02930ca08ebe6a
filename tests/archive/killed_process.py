"""A batch in a process of its own that is killed with its children, as by a power cut."""

import os
import signal
import subprocess
import time


def kill_after(process: subprocess.Popen, chunks: int, seconds: float) -> None:
    """Kill a process group after it has printed so many lines, one a chunk, and so many seconds more."""
    assert process.stdout is not None
    for _ in range(chunks):
        process.stdout.readline()
    time.sleep(seconds)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()

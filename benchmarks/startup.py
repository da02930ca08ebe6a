"""How long a command takes to start, and a fit with an empty and with a filled cache of compiled code."""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from common import ROOT, Report

HELP_BAR, COLD_BAR, WARM_BAR = 0.4, 30.0, 12.0
# Wall time asked for with an empty and with a filled cache of compiled code.
_ASKED = {
    "check": (1.5, 1.5), "fit": (15, 4), "diagnose": (15, 4),
    "add": (None, 6), "compare": (5, 5), "history": (1.5, 1.5),
}  # fmt: skip
_COMMAND = [sys.executable, "-m", "imubayes.cli.main"]


def measure(quick: bool = False) -> Report:
    report = Report("startup", "Starting, and the first fit")
    times = 3 if quick else 10
    shown = timed([*_COMMAND, "--help"], times)
    imported = timed([sys.executable, "-c", "import imubayes"], times)
    whole = timed([sys.executable, "-c", "import imubayes.api"], min(times, 3))
    bare = timed([sys.executable, "-c", "pass"], times)
    report.table(
        ["what", "wall time (median)"],
        [
            ["Python alone", f"{bare:.2f} s"],
            ["import imubayes", f"{imported:.2f} s"],
            ["imubayes --help", f"{shown:.2f} s"],
            ["import imubayes.api (all of it, with JAX)", f"{whole:.2f} s"],
        ],
    )
    rows, taken = [], {}
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"XDG_CACHE_HOME": str(Path(folder) / "cache")}
        for sampled, flags in (("fit alone", ["--no-sample"]), ("fit and sampling", [])):
            for cache in ("empty", "filled"):
                if cache == "empty":
                    environment["XDG_CACHE_HOME"] = str(Path(folder) / f"cache{len(rows)}")
                out = Path(folder) / f"result{len(rows)}"
                command = [*_COMMAND, "fit", str(ROOT / "data/trihedral-imu"), "--model"]
                command += [str(ROOT / "models/trihedral-imu.toml"), "--out", str(out), *flags]
                taken[sampled, cache] = timed(command, 1, environment)
                rows.append([f"imubayes fit, {sampled}", f"{cache} cache", f"{taken[sampled, cache]:.1f} s"])
            if quick:
                break
    report.say("`imubayes fit data/trihedral-imu`, the whole command with imports, reading and writing:\n")
    report.table(["command", "compiled code", "wall time"], rows)
    if not quick:
        commands(report)
    report.judge("imubayes --help, s", shown, HELP_BAR, least=False)
    if not quick:
        report.judge("fit and sampling, empty cache, s", taken["fit and sampling", "empty"], COLD_BAR, least=False)
        report.judge("fit and sampling, filled cache, s", taken["fit and sampling", "filled"], WARM_BAR, least=False)
    return report


def commands(report: Report) -> None:
    """Measure every command of the loop on `data/trihedral-imu`, twice with one cache of compiled code.

    CPU seconds of the command and the processes it starts: unlike wall time they mean the same on a busy machine,
    within some tens of per cent.
    """
    data, model = str(ROOT / "data/trihedral-imu"), str(ROOT / "models/trihedral-imu.toml")
    report.say("\nThe loop on `data/trihedral-imu`, the whole command with imports, reading and writing:\n")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"XDG_CACHE_HOME": str(Path(folder) / "cache")}
        for turn, cache in enumerate(("empty", "filled")):
            out = str(Path(folder) / f"result{turn}")
            for words in (
                ["check", data],
                ["fit", data, "--model", model, "--no-sample", "--out", out],
                ["diagnose", out],
                ["add", "gyro_scale_cubic", "--to", out, "--out", f"{out}-added"],
                ["compare", out],
                ["history", out],
            ):
                clock, spent = time.perf_counter(), cpu_seconds()
                timed([*_COMMAND, *words], 1, environment)
                wall, spent = time.perf_counter() - clock, cpu_seconds() - spent
                rows.append([words[0], cache, f"{spent:.1f} s", f"{wall:.1f} s", bar(words[0], cache)])
    report.table(["command", "compiled code", "CPU", "wall", "asked, wall on 2 quiet cores"], rows)


def bar(command: str, cache: str) -> str:
    """Return the wall time that is asked for."""
    asked = _ASKED[command][cache == "filled"]
    return "–" if asked is None else f"{asked:g} s"


def cpu_seconds() -> float:
    """Return user and system time of all processes started and ended so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def timed(command: Sequence[str], times: int, environment: Mapping[str, str] | None = None) -> float:
    """Return the median wall time of a command; stops with its own words if it fails."""
    taken = []
    for _ in range(times):
        clock = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
        taken.append(time.perf_counter() - clock)
        if done.returncode not in (0, 1):
            sys.exit(f"`imubayes {' '.join(command[3:])}` failed:\n{done.stderr}")
    return statistics.median(taken)

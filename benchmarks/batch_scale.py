"""Resources of a batch of any size: memory for 1000 and 5000 units, and compiling for five structures.

Units are campaigns on disk, copies of shipped ones with other readings, fitted by `run_batch` in a process of its own.
If anything grows with the number of units it is the driver: for the large numbers only the first chunk is
fitted, and the others get copies of its posteriors.
"""

import csv
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from common import ROOT, Report

FEW, MANY, FITTED, ALIKE, COMPILING_BAR = 1000, 5000, (100, 500), 0.2, 60.0
MEMORY_MODEL = "polar-tumble"
# One model and plan, whose runs have missing readings at other places: five structures.
COMPILED_MODEL, STRUCTURES = "trihedral-imu", 5

_RUN = """
import json, resource, sys, time
from jax import monitoring
seconds = {}
monitoring.register_event_duration_secs_listener(
    lambda event, taken, **_: seconds.__setitem__(event, seconds.get(event, 0.0) + taken))
from dataclasses import replace
from imubayes_archive.unit_fits.fit_chunk import fit_chunk, in_process
from imubayes_archive.unit_fits.run_batch import run_batch
from imubayes_archive.unit_fits.batch_folder import unread
def copied(tasks):
    known = None
    for task in tasks:
        known = known or fit_chunk(task)
        yield tuple(replace(unit, identity=unread(source)) for unit, source in zip(known, task.sources))
peaks = []
def report(state):
    peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
state = run_batch(*sys.argv[1:4], copied if sys.argv[4] == "copied" else in_process, progress=report)
print(json.dumps({
    "units": state.done, "failed": state.failed, "peak": peaks[-1], "cpu": time.process_time(), "first": peaks[0],
    "compiling": sum(taken for event, taken in seconds.items() if event.startswith("/jax/core/compile/")),
}))
"""


def make_unit(source: Path, folder: Path, random: np.random.Generator, serial: str, missing: int = 0) -> None:
    """Write a copy of a campaign with other readings, some of them missing."""
    shutil.copytree(source, folder)
    (folder / "truth.toml").unlink(missing_ok=True)
    campaign = folder / "campaign.toml"
    campaign.write_text(campaign.read_text().replace('serial = "', f'serial = "{serial}-'))
    for file in sorted((folder / "runs").glob("*.csv")):
        with file.open() as stream:
            head, *rows = csv.reader(stream)
        chosen = [place for place, name in enumerate(head) if name in _CHANNELS]
        for row in rows:
            for place in chosen:
                if row[place]:
                    row[place] = repr(float(row[place]) * (1 + random.normal(0, 1e-6)))
        first = head[chosen[0]]
        for row in rows[:missing]:
            for name in {first, f"{first}_sd"} & set(head):
                row[head.index(name)] = ""
        missing = 0
        with file.open("w", newline="") as stream:
            csv.writer(stream).writerows([head, *rows])


_CHANNELS = ("g", "a", "gx", "gy", "gz", "ax", "ay", "az")


def fitted(units: Path, model: str, how: str = "fitted", cache: Path | None = None) -> dict[str, float]:
    """Run a batch in a process of its own, its units `fitted`, or `copied` from the first chunk; return its figures."""
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    if cache is not None:
        environment["XDG_CACHE_HOME"] = str(cache)
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-c", _RUN, str(units), str(ROOT / "models" / f"{model}.toml"), out, how]
        return json.loads(subprocess.run(command, capture_output=True, check=True, env=environment, text=True).stdout)


def memory(report: Report, counts: dict[str, tuple[int, int]]) -> None:
    """Say the peak memory of small and of large batches, fitted and copied."""
    random, rows, changes = np.random.default_rng(0), [], {}
    with tempfile.TemporaryDirectory() as folder:
        for how, pair in counts.items():
            peaks = []
            for count in pair:
                made = len(list(Path(folder).iterdir()))
                for place in range(made, count):
                    unit = Path(folder) / f"unit-{place:05d}"
                    make_unit(ROOT / "data" / MEMORY_MODEL, unit, random, f"U{place:05d}")
                found = fitted(Path(folder), MEMORY_MODEL, how)
                assert (found["units"], found["failed"]) == (count, 0), found
                peaks.append(found["peak"])
                rows.append([count, how, f"{found['first']:.0f} MB", f"{found['peak']:.0f} MB",
                             f"{1e3 * found['cpu'] / count:.0f} ms"])  # fmt: skip
            changes[f"change of peak memory from {pair[0]} to {pair[1]} units, {how}"] = abs(peaks[1] / peaks[0] - 1)
    head = [f"units (`{MEMORY_MODEL}`)", "posteriors", "peak after the first chunk", "peak", "CPU time a unit, all"]
    report.table(head, rows)
    for what, change in changes.items():
        report.judge(what, change, ALIKE, least=False)
    report.say()


def compiling(report: Report) -> None:
    """Say the time that compiling takes for five structures of one model, cache empty."""
    random, rows = np.random.default_rng(0), []
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as cache:
        for place in range(STRUCTURES):
            unit = Path(folder) / f"unit-{place}"
            make_unit(ROOT / "data" / COMPILED_MODEL, unit, random, f"S{place}", missing=place)
        clock = time.perf_counter()
        found = fitted(Path(folder), COMPILED_MODEL, cache=Path(cache))
        wall = time.perf_counter() - clock
        assert found["failed"] == 0, found
        rows.append([f"five structures of `{COMPILED_MODEL}`", f"{found['compiling']:.0f} s", f"{found['cpu']:.0f} s",
                     f"{wall:.0f} s"])  # fmt: skip
    report.say(f"Mean load of the machine in the last 15 minutes: {os.getloadavg()[2]:.0f}.\n")
    report.table(
        ["archive, compile cache empty", "tracing and compiling, wall time", "CPU time in all", "wall time in all"],
        rows,
    )
    report.judge("CPU time of five structures, fits included, s", found["cpu"], COMPILING_BAR, least=False)
    report.say()


def measure(quick: bool = False) -> Report:
    """Measure both."""
    report = Report("batch_scale", "A batch whatever its size: memory and compiling")
    compiling(report)
    memory(report, {"fitted": (40, 80), "copied": (40, 80)} if quick else {"fitted": FITTED, "copied": (FEW, MANY)})
    return report


if __name__ == "__main__":
    measure("--quick" in sys.argv).write()

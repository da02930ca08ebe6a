"""How memory and time of `fit --no-sample` and `diagnose` grow: with the readings, and with the parameters.

The plan of `data/trihedral-imu` with its runs repeated, each time with noise of its own, simulated by the generator of
the shipped campaign.  Every command runs twice, each time as a process of its own; the second finds its compiled code.
How a batch grows with its units is the subject of `batch_scale`.
"""

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

from common import ROOT, Report

REPEATED, DAYS_APART = (1, 4, 16), 4
FIT_BAR, DIAGNOSE_BAR, SHIPPED_DIAGNOSE_BAR, FILE_BAR, LINEAR_BAR = 1000.0, 1500.0, 450.0, 20.0, 1.2
MODELS = ("start", "trihedral-imu")


@dataclass(frozen=True)
class Cost:
    """Peak memory, MB, and CPU time, s, of a command."""

    memory: float
    cpu: float


def make_campaign(folder: Path, times: int) -> int:
    """Write the campaign with its runs repeated; return the number of its readings."""
    sys.path.insert(0, str(ROOT / "data/generators"))
    import trihedral_imu
    from simulate import write_simulated

    plan = trihedral_imu.plan(trihedral_imu.SEED)
    runs = []
    for again in range(times):
        later = timedelta(days=DAYS_APART * again)
        for run in plan.runs:
            start = (datetime.fromisoformat(run.start) + later).isoformat()
            runs.append(replace(run, name=f"{run.name}-{again}" if again else run.name, start=start))
    write_simulated(folder, replace(plan, runs=tuple(runs)), trihedral_imu.SEED)
    return sum(len(run.rows) for run in runs) * len(plan.channels)


def cost(*words: str | Path) -> Cost:
    """Run a command; return what it needs, its children included in the time."""
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src"), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "imubayes.cli.main", *map(str, words)]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(command)} failed")
    return Cost(used.ru_maxrss / 1024, used.ru_utime + used.ru_stime)


def loop_cost(campaign: Path, model: str, out: Path) -> tuple[Cost, Cost]:
    """Return what a fit and a diagnosis need, compiled code at hand."""
    fit = ("fit", campaign, "--model", ROOT / f"models/{model}.toml", "--out", out, "--no-sample", "--replace")
    for _ in range(2):
        costs = cost(*fit), cost("diagnose", out)
    return costs


def measure(quick: bool = False) -> Report:
    report = Report("growth", "Memory and time against the size of the campaign")
    with tempfile.TemporaryDirectory() as scratch:
        _readings(report, Path(scratch), REPEATED[:2] if quick else REPEATED)
        _parameters(report, Path(scratch))
    return report


def _readings(report: Report, scratch: Path, repeated: tuple[int, ...]) -> None:
    rows, sizes, found, files = [], [], [], []
    for times in repeated:
        campaign, out = scratch / f"c{times}", scratch / f"r{times}"
        sizes.append(make_campaign(campaign, times))
        found.append(loop_cost(campaign, "trihedral-imu", out))
        files.append((out / "posterior.nc").stat().st_size / 1e6)
        numbers = [f"{x:.0f} MB, {y:.1f} s" for x, y in ((each.memory, each.cpu) for each in found[-1])]
        rows.append([times, sizes[-1], *numbers, f"{files[-1]:.0f} MB"])
    report.table(["times", "readings", "`fit --no-sample`", "`diagnose`", "`posterior.nc`"], rows)
    fits, diagnoses = zip(*found, strict=True)
    report.judge("peak memory of `fit`, MB", fits[-1].memory, FIT_BAR, least=False)
    report.judge("peak memory of `diagnose`, MB", diagnoses[-1].memory, DIAGNOSE_BAR, least=False)
    report.judge("the same at the shipped size, MB", diagnoses[0].memory, SHIPPED_DIAGNOSE_BAR, least=False)
    report.judge("`posterior.nc`, MB", files[-1], FILE_BAR, least=False)
    for name, costs in (("fit", fits), ("diagnose", diagnoses)):
        slopes = [(b.cpu - a.cpu) / (n - m) for a, b, m, n in zip(costs, costs[1:], sizes, sizes[1:], strict=False)]
        report.say(f"- `{name}`: {', '.join(f'{1e3 * slope:.2f}' for slope in slopes)} ms a further reading")
        report.judge(f"time of `{name}`, last slope over the first", slopes[-1] / slopes[0], LINEAR_BAR, least=False)
    report.say()


def _parameters(report: Report, scratch: Path) -> None:
    rows = []
    for model in MODELS:
        fit, diagnosis = loop_cost(ROOT / "data/trihedral-imu", model, scratch / model)
        rows.append([f"`{model}`", *(f"{each.memory:.0f} MB, {each.cpu:.1f} s" for each in (fit, diagnosis))])
    report.table(["model of `data/trihedral-imu`", "`fit --no-sample`", "`diagnose`"], rows)

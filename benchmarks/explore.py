"""The page of the loop: first points, previews and brushes, in Chromium, at three sizes of a campaign.

The server is `imubayes explore` in a process of its own on results that are fitted but not diagnosed, with compiled
code at hand; CPU times are those of the server and of the main thread of the page.  A brush is a click on a cell of the
map, up to the frame in which its causes are drawn; a preview is a request, answered for every cause once.  Browser and
server share the cores.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import ROOT, Report
from growth import make_campaign

sys.path.insert(0, str(ROOT / "tests/explorer"))
from explore_client import Client
from explore_page import LACKING, Page

POINTS_BAR, LATENCY_BAR, OPENED_BAR, LARGE_BRUSH_BAR = 2.0, 0.1, 5.0, 0.3
_COMMAND = [sys.executable, "-m", "imubayes.cli.main"]
_ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT / "src"), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
_REPEATED, _BRUSHES, _MOST_PREVIEWS = 5, 24, 40
_BRUSHED = """
const cells = document.querySelectorAll('.cell'), done = arguments[1], from = performance.now();
const before = document.querySelector('#selection-sentence')?.textContent;
cells[arguments[0] % cells.length].click();
const drawn = () => {
  const said = document.querySelector('#selection-sentence')?.textContent;
  if (said && said !== before) requestAnimationFrame(() => setTimeout(() => done(performance.now() - from)));
  else if (performance.now() - from < 5000) setTimeout(drawn, 2);
  else done(NaN);
};
drawn();
"""


class Server:
    """`imubayes explore` on a result, and when it printed its address."""

    def __init__(self, result: Path):
        command = [*_COMMAND, "explore", str(result), "--no-browser"]
        began = time.monotonic()
        self.process = subprocess.Popen(
            command, env=_ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert self.process.stdout is not None
        self.address = next(found[0] for line in self.process.stdout if (found := re.search(r"http://\S+", line)))
        self.started = time.monotonic() - began

    @property
    def cpu(self) -> float:
        """CPU time since the start, s."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def end(self) -> None:
        self.process.terminate()
        self.process.wait()


def p95(times: list[float]) -> float:
    return sorted(times)[round(0.95 * (len(times) - 1))]


def fitted(folder: Path, campaign: Path, model: str) -> Path:
    command = [*_COMMAND, "fit", str(campaign), "--model", str(ROOT / f"models/{model}.toml"), "--out", str(folder)]
    subprocess.run([*command, "--no-sample"], env=_ENVIRONMENT, check=True, capture_output=True)
    return folder


def page_cpu(page: Page) -> float:
    """Return the CPU time of the main thread of the page, s."""
    found = page.driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return next(each["value"] for each in found if each["name"] == "TaskDuration")


def brushes(page: Page) -> list[float]:
    """Return the times of clicks on cells all over the map, s."""
    found = []
    for place in range(_BRUSHES):
        found.append(page.driver.execute_async_script(_BRUSHED, 7 + 29 * place) / 1000)
        time.sleep(0.1)
    return found


def previews(address: str) -> list[float]:
    """Return the time of the first preview of each cause, s."""
    client = Client(address)
    model = client.json("state")["tree"][0]["id"]
    found = []
    for cause in client.json("model", {"model": model})["causes"][:_MOST_PREVIEWS]:
        began = time.monotonic()
        client.json("preview", {"model": model, "effects": [cause["effect"]]})
        found.append(time.monotonic() - began)
    return found


def walked(result: Path) -> dict[str, float]:
    """Open a result in a browser; return wall and CPU times, s, and latencies."""
    server = Server(result)
    try:
        found = {"address": server.started, "address, CPU": server.cpu}
        page = Page("about:blank", wait=False)
        try:
            page.driver.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
            before, began = server.cpu, time.monotonic()
            page.open(server.address)
            found |= {"points": time.monotonic() - began, "points, CPU": server.cpu}
            found["points, waited CPU"] = server.cpu - before
            found["brush, weighing"] = p95(brushes(page))
            page.wait("document.querySelector('.tick:not(:disabled)')")
            found |= {"ready": time.monotonic() - began, "ready, CPU": server.cpu}
            before, drawing = server.cpu, page_cpu(page)
            taken = brushes(page)
            found |= {"brush": p95(taken), "brush, CPU": (server.cpu - before) / len(taken)}
            found["brush, page"] = (page_cpu(page) - drawing) / len(taken)
            before, taken = server.cpu, previews(server.address)
            found |= {"preview": p95(taken), "preview, CPU": (server.cpu - before) / len(taken)}
        finally:
            page.close()
    finally:
        server.end()
    return found


def measure(quick: bool = False) -> Report:
    report = Report("explore", "The page of the loop in Chromium")
    if LACKING:
        report.say("Chromium and chromedriver are not here: nothing was measured.")
        return report
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        cases = [("hidden-gyro", ROOT / "data/hidden-gyro", "hidden-effects")]
        if not quick:
            readings = make_campaign(place / "large", _REPEATED)
            cases += [
                ("trihedral-imu", ROOT / "data/trihedral-imu", "start"),
                (f"trihedral-imu × {_REPEATED}, {readings} readings", place / "large", "trihedral-imu"),
            ]
        found = {}
        for number, (name, campaign, model) in enumerate(cases):
            found[name] = walked(fitted(place / f"result{number}", campaign, model))
            print(json.dumps({name: found[name]}), flush=True)
    _say(report, found)
    return report


def _say(report: Report, found: dict[str, dict[str, float]]) -> None:
    lines = {
        "command to address, s": ("address", "address, CPU"),
        "page opened to first points, s": ("points", "points, waited CPU"),
        "page opened to previews, s": ("ready", "ready, CPU"),
        "brush while causes are weighed, p95, s": ("brush, weighing", ""),
        "brush, p95, s": ("brush", "brush, CPU"),
        "brush, CPU of the page, s": ("brush, page", ""),
        "preview, p95, s": ("preview", "preview, CPU"),
    }
    rows = [
        [words, *(f"{each[wall]:.3g}" + (f" ({each[cpu]:.2g} CPU)" if cpu else "") for each in found.values())]
        for words, (wall, cpu) in lines.items()
    ]
    report.say(f"Wall time, in parentheses CPU time of the server; load average {os.getloadavg()[0]:.1f}.\n")
    report.table(["", *found], rows)
    *small, large = found.items()
    for name, each in small or [large]:
        report.judge(f"{name}: first points, s", each["points"], POINTS_BAR, least=False)
        report.judge(f"{name}: brush, s", each["brush"], LATENCY_BAR, least=False)
        report.judge(f"{name}: preview, s", each["preview"], LATENCY_BAR, least=False)
    if small:
        name, each = large
        report.judge(f"{name}: command to points, s", each["address"] + each["points"], OPENED_BAR, least=False)
        report.judge(f"{name}: brush, s", each["brush"], LARGE_BRUSH_BAR, least=False)

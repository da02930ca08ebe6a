"""Reducing a raw log to means: time and peak memory of a run of a million and of ten million rows.

Each log is read in a process of its own, whose peak of resident memory is compared with that of a process which reads
a short log.
"""

import multiprocessing
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
from common import Report

MEMORY_BAR = 300.0
_RATE_HZ, _HOLD_ROWS = 1000.0, 60_000
_RATES = (0.0, 100.0, -100.0, 50.0, -50.0, 10.0, -10.0, 0.0)
_BLOCK = 500_000

CAMPAIGN = """\
format = 1
name = "long"
[site]
latitude_deg = 34.25
[[channel]]
name = "gx"
kind = "gyro"
input_axis = [1, 0, 0]
output_unit = "pulse/s"
scale = 1000.0
per = "deg/s"
[[channel]]
name = "ax"
kind = "accelerometer"
input_axis = [1, 0, 0]
output_unit = "pulse/s"
scale = 20000.0
per = "g"
[[table]]
name = "rate"
elevation_deg = 90.0
[[mounting]]
name = "x-up"
body_to_table = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
[[run]]
name = "long"
procedure = "rate_table"
file = "long.{form}"
table = "rate"
mounting = "x-up"
temperature_degC = 25.0
"""


def measure(quick: bool = False) -> Report:
    report = Report("reduction", "Reducing raw logs to segment means")
    sizes = [("csv", 10**5), ("csv", 10**6), ("parquet", 10**6)] + ([] if quick else [("parquet", 10**7)])
    rows, least, most = [], None, 0.0
    with tempfile.TemporaryDirectory() as folder:
        for form, count in sizes:
            campaign = Path(folder) / f"{form}-{count}"
            write_log(campaign, form, count)
            taken, peak, means = in_own_process(campaign)
            least = peak if least is None else least
            most = max(most, peak - least)
            megabytes = (campaign / f"long.{form}").stat().st_size / 1e6
            rows.append(
                [f"{count:.0e}", form, f"{megabytes:.0f} MB", means, f"{taken:.1f} s", f"{peak - least:+.0f} MB"]
            )
    report.table(["raw rows", "table", "file", "means", "time", "peak memory against the shortest"], rows)
    report.judge("memory beyond that of a short log, MB", most, MEMORY_BAR, least=False)
    return report


def write_log(folder: Path, form: str, count: int) -> None:
    """Write a log of constant rates with short ramps between them, block by block."""
    folder.mkdir()
    (folder / "campaign.toml").write_text(CAMPAIGN.format(form=form))
    random = np.random.default_rng(1)
    file, writer, angle = folder / f"long.{form}", None, 0.0
    for first in range(0, count, _BLOCK):
        index = np.arange(first, min(count, first + _BLOCK))
        rate = commanded(index)
        turned = angle + np.cumsum(rate) / _RATE_HZ
        angle = float(turned[-1])
        table = pa.table(
            {
                "time_s": index / _RATE_HZ,
                "table_rate_deg_s": rate,
                "table_angle_deg": np.mod(turned, 360.0),
                "gx": 1000.0 * (rate + 15.041067 / 3600 * np.sin(np.radians(34.25))) + random.normal(0, 8, len(index)),
                "ax": 20000.0 + random.normal(0, 2, len(index)),
            }
        )
        if writer is None:
            writer = pq.ParquetWriter(file, table.schema) if form == "parquet" else pa.csv.CSVWriter(file, table.schema)
        writer.write_table(table)
    if writer is not None:
        writer.close()


def commanded(index: np.ndarray) -> np.ndarray:
    """Return the table's rate at rows: held for a minute, then changed within two seconds."""
    hold, place = np.divmod(index, _HOLD_ROWS)
    rates = np.array(_RATES)
    now, ahead = rates[hold % len(rates)], rates[(hold + 1) % len(rates)]
    ramp = np.clip((place - (_HOLD_ROWS - 2000)) / 2000, 0, 1)
    return now + ramp * (ahead - now)


def in_own_process(campaign: Path) -> tuple[float, float, int]:
    """Return time, peak memory in MB and the number of means."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(read, (campaign,))


def read(campaign: Path) -> tuple[float, float, int]:
    from imubayes.campaign import load_campaign

    clock = time.perf_counter()
    loaded = load_campaign(campaign)
    taken = time.perf_counter() - clock
    return taken, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, loaded.runs[0].rows

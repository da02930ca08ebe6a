"""An archive of accelerometers on a dividing head, simulated from its own equations and written as campaign folders.

Each unit has two runs of 24 positions, eight at each of 10, 30 and 50 degrees Celsius.  Bias, scale factor error and
bias slope are drawn from populations; a lot of units may share another slope.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path

import numpy as np

SCALE, ANGLES = 20000.0, np.tile(np.arange(0.0, 360.0, 45.0), 3)
TEMPERATURES = np.repeat([10.0, 30.0, 50.0], 8)
RUNS = 2
NOISE, SAMPLES = 2.0, 100
MODEL = """format = 1
name = "head"
[[effect]]
name = "accel_bias"
prior = { bias = "normal(0, 2000 ug)" }
[[effect]]
name = "accel_scale_factor"
prior = { scale = "normal(0, 1000 ppm)" }
[[effect]]
name = "accel_bias_temperature"
prior = { slope = "normal(0, 100 ug/degC)" }
[[effect]]
name = "white_noise"
prior = { sigma = "lognormal(1 noise, 0.3)" }
[[effect]]
name = "run_scatter"
prior = { tau = "halfnormal(0.5 noise)" }
"""


@dataclass(frozen=True)
class Archive:
    """What the units of an archive have.

    Attributes
    ----------
    units : number.
    lot : number of units, the first ones in random order, whose slope differs by `shift`, in ug/degC.
    spread : of the slope within a lot, in ug/degC.
    run_scatter : standard deviation of the offset of a run, in output units.
    stated_lots : whether the campaigns state the lot.
    """

    units: int = 12
    lot: int = 0
    shift: float = 40.0
    spread: float = 3.0
    run_scatter: float = 0.05
    stated_lots: bool = False


def write_archive(folder: Path, archive: Archive, seed: int) -> dict[str, Mapping[str, float]]:
    """Write campaigns and `model.toml` below a folder; return the true values of each unit."""
    random = np.random.default_rng(seed)
    order, truth = random.permutation(archive.units), {}
    (folder / "units").mkdir(parents=True)
    (folder / "model.toml").write_text(MODEL)
    for place in range(archive.units):
        apart = order[place] < archive.lot
        own = {
            "bias": random.normal(500.0, 150.0), "scale": random.normal(-200.0, 80.0),
            "slope": random.normal(20.0, archive.spread) + apart * archive.shift, "lot": float(apart),
        }  # fmt: skip
        name = f"U{place + 1:03d}"
        label = f'labels = {{ lot = "{"B" if apart else "A"}" }}' if archive.stated_lots else ""
        _write_unit(
            folder / "units" / name, name, label, date(2024, 1, 8) + timedelta(days=3 * place), own, archive, random
        )
        truth[name] = own
    return truth


def _write_unit(
    folder: Path,
    name: str,
    label: str,
    day: date,
    own: Mapping[str, float],
    archive: Archive,
    random: np.random.Generator,
) -> None:
    (folder / "runs").mkdir(parents=True)
    runs = ""
    for place in range(RUNS):
        warm = TEMPERATURES + random.normal(0.0, 0.3, len(ANGLES))
        force = -np.sin(np.radians(ANGLES))
        error = 1e-6 * (own["bias"] + own["slope"] * (warm - 25.0))
        output = SCALE * ((1 + 1e-6 * own["scale"]) * force + error) + random.normal(0.0, archive.run_scatter)
        output = output + random.normal(0.0, NOISE / np.sqrt(SAMPLES), len(ANGLES))
        rows = [
            f"{30 + 40 * row},{angle:g},{warm[row]:.4f},{SAMPLES},{output[row]:.6f},{NOISE:.4f}"
            for row, angle in enumerate(ANGLES)
        ]
        file = f"runs/run-{place}.csv"
        (folder / file).write_text(
            "time_s,table_angle_deg,temperature_degC,samples,ax,ax_sd\n" + "\n".join(rows) + "\n"
        )
        runs += (
            f'[[run]]\nname = "run-{place}"\nprocedure = "dividing_head"\nfile = "{file}"\ntable = "head"\n'
            f'mounting = "flat"\nstart = {day.isoformat()}T0{8 + place}:00:00Z\n'
        )
    (folder / "campaign.toml").write_text(_HEAD.format(name=name, label=label) + runs)


_HEAD = """format = 1
name = "{name}"
[site]
latitude_deg = 34.25
height_m = 400.0
[unit]
serial = "{name}"
{label}
[[channel]]
name = "ax"
kind = "accelerometer"
input_axis = [1.0, 0.0, 0.0]
output_unit = "pulse/s"
scale = 20000.0
per = "g"
noise = 2.0
[[table]]
name = "head"
azimuth_deg = 0.0
elevation_deg = 0.0
[[mounting]]
name = "flat"
body_to_table = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
uncertainty_arcmin = 0.0
"""

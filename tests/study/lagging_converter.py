"""Campaigns of one accelerometer whose converter offset lags the converter's temperature on up-and-down ramps.

Plain NumPy, no code shared with the package.  The offset follows o·(T_lag − 25 °C), τ dT_lag/dt = T − T_lag: on a ramp
it lags by the rate times τ, and a run up and down again leaves the same course in every run of the same profile.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

SCALE, NOISE, SAMPLES, ROW_SECONDS = 20000.0, 8.0, 12, 120.0
COLDEST, WARMEST = 15.0, 45.0
INPUTS = {"up": 1.0, "pyramid": 3**-0.5}
HEADER = """format = 1
name = "lagging-converter"

[site]
latitude_deg = 34.25
height_m = 400.0

[unit]
serial = "LC{seed}"

[[channel]]
name = "ax"
kind = "accelerometer"
input_axis = [1, 0, 0]
output_axis = [0, 1, 0]
output_unit = "pulse/s"
scale = 20000.0
per = "g"
noise = 8.0
current_mA_per_g = 1.2

[[table]]
name = "plate"
azimuth_deg = 0.0
elevation_deg = 90.0

[[mounting]]
name = "up"
body_to_table = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
uncertainty_arcmin = 5.0

[[mounting]]
name = "pyramid"
preset = "trihedral"
uncertainty_arcmin = 5.0
"""


@dataclass(frozen=True)
class LaggingOffset:
    """What a campaign hides.

    Attributes
    ----------
    slope : offset per degree, output units.
    tau_min : time constant.
    runs : number of runs, in turn in both mountings.
    degc_per_hour : rate of the ramps.
    cycles : times up and down again in a run.
    with_sd : whether rows carry the standard deviation of their samples.
    """

    slope: float
    tau_min: float = 20.0
    runs: int = 3
    degc_per_hour: float = 30.0
    cycles: int = 1
    with_sd: bool = True


def drawn(seed: int) -> LaggingOffset:
    """Draw size, sign, runs and ramps."""
    random = np.random.default_rng([seed, 31])
    return LaggingOffset(
        slope=float(random.choice([-1.0, 1.0]) * np.exp(random.uniform(np.log(0.2), np.log(1.0)))),
        runs=int(random.integers(2, 5)),
        degc_per_hour=float(random.choice([20.0, 30.0, 40.0])),
        cycles=int(random.integers(1, 3)),
        with_sd=bool(random.random() < 0.7),
    )


def lagged(time_min: np.ndarray, temperature: np.ndarray, tau_min: float) -> np.ndarray:
    """Integrate the first-order lag exactly for a temperature that is linear between instants."""
    result = np.empty_like(temperature)
    result[0] = temperature[0]
    for k, step in enumerate(np.diff(time_min), 1):
        rate, fade = (temperature[k] - temperature[k - 1]) / step, np.exp(-step / tau_min)
        behind = (result[k - 1] - temperature[k - 1] + rate * tau_min) * fade - rate * tau_min
        result[k] = temperature[k] + behind
    return result


def write(folder: Path, seed: int, hidden: LaggingOffset) -> Path:
    """Write the campaign; return its folder."""
    random = np.random.default_rng(seed)
    (folder / "runs").mkdir(parents=True)
    parts = [HEADER.format(seed=seed)]
    half = round((WARMEST - COLDEST) / (hidden.degc_per_hour * ROW_SECONDS / 3600))
    minutes = (np.arange(2 * half * hidden.cycles * 6 + 1)) * ROW_SECONDS / 60 / 6
    phase = minutes / (half * ROW_SECONDS / 60) % 2
    temperature = COLDEST + (WARMEST - COLDEST) * np.where(phase < 1, phase, 2 - phase)
    bias, gain, seat = random.normal(0, 400), random.normal(0, 100), random.normal(0, 5 / 3437.7, (2, 3))
    for run in range(hidden.runs):
        mounting = tuple(INPUTS)[run % 2]
        # A seat tilts by some arcminutes: second order for the axis that is up, first order in the pyramid.
        force = INPUTS[mounting] + (seat[1, 0] * 0.8165 if mounting == "pyramid" else -(seat[0, 0] ** 2) / 2)
        gravity = 9.7966 / 9.7966
        output = SCALE * (1 + gain * 1e-6) * (gravity * force + bias * 1e-6)
        output = output * (1 + 1.5e-6 * (temperature - 25)) + hidden.slope * (
            lagged(minutes, temperature, hidden.tau_min) - 25
        )
        rows = output[:-1].reshape(-1, 6).mean(axis=1) / 2 + output[1:].reshape(-1, 6).mean(axis=1) / 2
        mean_temperature = temperature[:-1].reshape(-1, 6).mean(axis=1) / 2
        mean_temperature += temperature[1:].reshape(-1, 6).mean(axis=1) / 2
        rows = rows + random.normal(0, 0.5) + random.normal(0, NOISE / np.sqrt(SAMPLES), len(rows))
        sd = NOISE * np.sqrt(random.chisquare(SAMPLES - 1, len(rows)) / (SAMPLES - 1))
        time = (np.arange(len(rows)) + 0.5) * ROW_SECONDS
        lines = ["time_s,temperature_degC,converter_temperature_degC,samples,ax" + ",ax_sd" * hidden.with_sd]
        for k in range(len(rows)):
            own = f",{sd[k]:.4f}" if hidden.with_sd else ""
            lines.append(f"{time[k]:.1f},25.0,{mean_temperature[k]:.4f},{SAMPLES},{rows[k]:.4f}{own}")
        name = f"cycle-{run + 1}"
        (folder / "runs" / f"{name}.csv").write_text("\n".join(lines) + "\n")
        parts.append(
            f'\n[[run]]\nname = "{name}"\nprocedure = "thermal_ramp"\nfile = "runs/{name}.csv"\ntable = "plate"\n'
            f'mounting = "{mounting}"\nstart = 2026-03-10T{6 + 5 * run % 18:02d}:00:00Z\n'
        )
    (folder / "campaign.toml").write_text("".join(parts))
    return folder

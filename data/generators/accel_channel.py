"""One accelerometer with current output and a converter (I/F, V/F or ADC) whose gain and zero drift with temperature.

Gain drift grows with the input, offset drift does not.  With inputs of 1 g and 1/√3 g the slopes of output
against converter temperature are nearly alike and their noise hides the gain; a current that stands for 12 g
shows it.
"""

from math import sqrt
from pathlib import Path

import truth
from kinematics import X_UP, Mounting, Site, Table, trihedral
from plan import Plan, Row, Run
from sensor import Channel, Values
from simulate import write_simulated

SEED = 20260346
CURRENT_PER_G = 1.2
INJECTED_G = 12.0
ROW_SECONDS = 120.0
RAW_RATE = 0.1
SENSOR_TEMPERATURE = 25.0
COLDEST, WARMEST = 15.0, 45.0


def _behind(unit: str, scale: float, noise_ug: float) -> Channel:
    noise = round(noise_ug * 1e-6 * scale, 9)
    axes = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    return Channel("ax", "accelerometer", axes[0], unit, scale, "g", noise, axes[1], current_mA_per_g=CURRENT_PER_G)


CONVERTERS = {
    "I/F": _behind("pulse/s", 20000.0, 400.0),
    "V/F": _behind("Hz", 6000.0, 400.0),
    "ADC": _behind("V", 0.4, 250.0),
}
"""The same sensor behind each kind of converter; the shipped campaign has the first."""
INPUT_G = {"ramp-1g": 1.0, "ramp-trihedral": 1 / sqrt(3), "inject-12g": INJECTED_G}
"""Nominal input of each run, in g."""


def ramp(seed: int, name: str, degC_per_hour: float, current: float | None = None) -> list[Row]:
    """Rows of two minutes while the converter warms steadily and the sensor is held."""
    rise = degC_per_hour * ROW_SECONDS / 3600
    count = round((WARMEST - COLDEST) / rise)
    held = SENSOR_TEMPERATURE + truth.stream(seed, name).normal(0.0, 0.01, count)
    return [
        Row(
            time=(k + 0.5) * ROW_SECONDS,
            samples=round(ROW_SECONDS * RAW_RATE),
            temperature=round(float(held[k]), 3),
            converter_temperature=COLDEST + (k + 0.5) * rise,
            converter_rise=rise,
            current=current,
        )
        for k in range(count)
    ]


def plan(seed: int, converter: str = "I/F") -> Plan:
    def run(name, procedure, degC_per_hour, hour, mounting=None, current=None) -> Run:
        rows = ramp(seed, name, degC_per_hour, current)
        start = f"2026-03-10T{hour:02d}:00:00+00:00"
        return Run(name, procedure, rows, "plate" if mounting else None, mounting, start)

    return Plan(
        name="accel-channel",
        purpose="One accelerometer channel: converter ramps at 1 g, at 1/sqrt(3) g and with 12 g injected.",
        serial="QA117",
        site=Site(34.25, 400.0),
        channels=(CONVERTERS[converter],),
        tables=(Table("plate", 0.0, 90.0),),
        mountings=(Mounting("up", X_UP, 5.0), Mounting("pyramid", trihedral(), 5.0, preset="trihedral")),
        runs=(
            run("ramp-1g", "thermal_ramp", 30.0, 8, "up"),
            run("ramp-trihedral", "thermal_ramp", 20.0, 11, "pyramid"),
            run("inject-12g", "current_injection", 30.0, 14, current=INJECTED_G * CURRENT_PER_G),
        ),
    )


def slope_differences(values: Values, scale: float) -> dict[str, float]:
    """Relative difference in % of each run's slope, per unit of input, from the slope of the 1 g run."""
    gain = 1e-6 * scale * values["converter_gain_drift.slope[ax]"]
    offset = values["converter_offset_drift.slope[ax]"]
    slope = {name: gain + offset / nominal for name, nominal in INPUT_G.items()}
    reference = slope.pop("ramp-1g")
    return {f"delta_k[ax,{name}]": 100 * abs(other - reference) / abs(reference) for name, other in slope.items()}


def generate(folder: Path, seed: int, converter: str = "I/F") -> dict[str, float]:
    """Write the campaign into `folder`; return the true parameters and derived quantities."""
    scale = CONVERTERS[converter].scale
    return write_simulated(Path(folder), plan(seed, converter), seed, lambda values: slope_differences(values, scale))


if __name__ == "__main__":
    generate(Path(__file__).resolve().parents[1] / "accel-channel", SEED)

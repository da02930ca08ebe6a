"""Where the true values come from: drawn from the priors that the matching model file states.

Reading the priors from the model file itself makes the coverage of a Bayesian fit exact by construction.  Each
value has its own random stream, seeded by the seed and its name, so that it does not depend on what else is
drawn.  Seats and table axes take their spread from the equipment that the campaign names.
"""

import re
import tomllib
import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from scipy import stats

from kinematics import Mounting, Table, rotation
from sensor import ARCSEC, Channel, Values, sensitive_axis

MODELS = Path(__file__).resolve().parents[2] / "models"

UNITS = {
    "mounting_error.x": "arcsec", "mounting_error.y": "arcsec", "mounting_error.z": "arcsec",
    "table_axis_tilt.x": "arcsec", "table_axis_tilt.y": "arcsec", "table_rate_error.rate_error": "ppm",
    "lever_arm.x": "mm", "lever_arm.y": "mm", "lever_arm.z": "mm",
    "gyro_bias.bias": "deg/h", "gyro_bias_temperature.slope": "deg/h/degC",
    "gyro_scale_factor.scale": "ppm", "gyro_scale_temperature.slope": "ppm/degC",
    "gyro_misalignment.toward_o": "arcsec", "gyro_misalignment.toward_s": "arcsec",
    "gyro_g_sensitivity.d_i": "deg/h/g", "gyro_g_sensitivity.d_o": "deg/h/g",
    "gyro_g_sensitivity.d_s": "deg/h/g",
    "gyro_magnetic_sensitivity.m_i": "deg/h/gauss", "gyro_magnetic_sensitivity.m_o": "deg/h/gauss",
    "gyro_magnetic_sensitivity.m_s": "deg/h/gauss",
    "accel_bias.bias": "ug", "accel_bias_temperature.slope": "ug/degC",
    "accel_scale_factor.scale": "ppm", "accel_scale_temperature.slope": "ppm/degC",
    "accel_misalignment.toward_o": "arcsec", "accel_misalignment.toward_p": "arcsec",
    "accel_quadratic.quadratic": "ug/g^2",
    "converter_gain_drift.slope": "ppm/degC", "converter_offset_drift.slope": "output/degC",
    "injection_error.gain": "ppm", "injection_error.offset": "ug",
    "white_noise.sigma": "output", "run_scatter.tau": "output",
    "gyro_scale_asymmetry.asymmetry": "ppm", "gyro_scale_quadratic.quadratic": "ppm/(deg/s)",
    "gyro_scale_cubic.cubic": "ppm/(deg/s)^2", "gyro_scale_g_dependence.dependence": "ppm/g",
    "gyro_g2_sensitivity.d_ii": "deg/h/g^2", "gyro_g2_sensitivity.d_oo": "deg/h/g^2",
    "gyro_g2_sensitivity.d_ss": "deg/h/g^2", "gyro_g2_sensitivity.d_io": "deg/h/g^2",
    "gyro_g2_sensitivity.d_os": "deg/h/g^2", "gyro_g2_sensitivity.d_si": "deg/h/g^2",
    "gyro_bias_temperature_quadratic.curvature": "deg/h/degC^2",
    "gyro_bias_temperature_cubic.coefficient": "deg/h/degC^3",
    "gyro_bias_temperature_rate.slope": "deg/h/(degC/min)",
    "gyro_thermal_lag.coefficient": "deg/h/degC", "gyro_thermal_lag.tau": "min",
    "gyro_warm_up.amplitude": "deg/h", "gyro_warm_up.tau": "min", "gyro_bias_drift.slope": "deg/h/h",
    "gyro_scale_temperature_quadratic.curvature": "ppm/degC^2", "gyro_dead_zone.half_width": "deg/h",
    "accel_cubic.cubic": "ug/g^3", "accel_odd_quadratic.odd_quadratic": "ug/g^2",
    "accel_cross_coupling.k_ip": "ug/g^2", "accel_cross_coupling.k_io": "ug/g^2",
    "accel_cross_axis_quadratic.k_oo": "ug/g^2", "accel_cross_axis_quadratic.k_pp": "ug/g^2",
    "accel_scale_asymmetry.asymmetry": "ppm", "accel_bias_temperature_quadratic.curvature": "ug/degC^2",
    "accel_bias_temperature_cubic.coefficient": "ug/degC^3",
    "accel_bias_temperature_rate.slope": "ug/(degC/min)",
    "accel_thermal_lag.coefficient": "ug/degC", "accel_thermal_lag.tau": "min",
    "accel_warm_up.amplitude": "ug", "accel_warm_up.tau": "min", "accel_bias_drift.slope": "ug/h",
    "accel_scale_temperature_quadratic.curvature": "ppm/degC^2", "accel_dead_zone.half_width": "ug",
    "converter_gain_drift_quadratic.curvature": "ppm/degC^2",
    "converter_offset_drift_quadratic.curvature": "output/degC^2",
    "converter_nonlinearity.quadratic": "ppm/output", "converter_nonlinearity.cubic": "ppm/output^2",
    "converter_leakage.leakage": "output", "converter_leakage.doubling": "degC",
    "converter_warm_up.amplitude": "output", "converter_warm_up.tau": "min",
    "converter_dead_zone.half_width": "output",
    "converter_gain_temperature_rate.slope": "ppm/(degC/min)",
    "converter_gain_lag.coefficient": "ppm/degC", "converter_gain_lag.tau": "min",
    "converter_gain_hysteresis.half_width": "ppm", "converter_gain_hysteresis.play": "degC",
    "converter_offset_temperature_rate.slope": "output/(degC/min)",
    "converter_offset_lag.coefficient": "output/degC", "converter_offset_lag.tau": "min",
    "converter_offset_hysteresis.half_width": "output", "converter_offset_hysteresis.play": "degC",
    "gyro_thermal_hysteresis.half_width": "deg/h", "gyro_thermal_hysteresis.play": "degC",
    "accel_thermal_hysteresis.half_width": "ug", "accel_thermal_hysteresis.play": "degC",
    **{f"encoder_harmonic.{part}_{order}": "arcsec" for order in (1, 2) for part in ("sin", "cos")},
    **{
        f"table_wobble.{axis}_{part}_{order}": "arcsec"
        for order in (1, 2) for axis in "xy" for part in ("cos", "sin")
    },
    "station_heading.heading": "arcsec", "station_level.east": "arcsec", "station_level.north": "arcsec",
    **{f"{axis}_axis_zero.zero": "arcsec" for axis in ("outer", "middle", "inner")},
    **{f"{axis}_axis_squareness.angle": "arcsec" for axis in ("outer", "middle")},
    "outer_axis_intersection.distance": "um", "middle_axis_intersection.distance": "um",
    "middle_axis_intersection.along": "um", "platform_tilt.x": "arcsec", "platform_tilt.y": "arcsec",
    "arm_error.radius": "um", "arm_error.stretch": "um/g",
    **{f"reference_alignment.{axis}": "arcsec" for axis in "xyz"},
    **{f"reference_scale_factor.{axis}": "ppm" for axis in "xyz"},
    **{f"reference_bias.{axis}": "deg/h" for axis in "xyz"},
    "reference_noise.sigma": "deg/s", "time_skew.skew": "ms",
    "rate_proportional_noise.k": "ppm", "correlated_noise.sigma": "output", "correlated_noise.correlation": "1",
    "outside_resonance.amplitude": "deg/h", "outside_resonance.centre": "deg/s", "outside_resonance.width": "deg/s",
    "outside_root_rate.amplitude": "deg/h/(deg/s)^(1/2)",
    "outside_temperature_wave.amplitude": "deg/h (gyro), ug (accelerometer)",
    "outside_temperature_wave.period": "degC", "outside_temperature_wave.phase": "deg",
    "outside_angle_harmonic.amplitude": "deg/h (gyro), ug (accelerometer)",
    "outside_angle_harmonic.order": "1", "outside_angle_harmonic.phase": "deg",
    "outside_step.amplitude": "deg/h (gyro), ug (accelerometer)", "outside_step.run": "index of the run, from 0",
    "outside_step.progress": "share of the run's rows",
    "outside_threshold.amplitude": "ug", "outside_threshold.width": "g",
}  # fmt: skip
"""The datasheet unit in which each true value is stated."""

_IN_BASE_UNIT = {
    "arcsec": 1.0, "arcmin": 60.0, "deg": 3600.0, "ppm": 1.0, "%": 1e4, "deg/h": 1.0, "deg/s": 3600.0,
    "ug": 1.0, "mg": 1e3, "mm": 1.0, "cm": 10.0, "ppm/degC": 1.0, "deg/h/degC": 1.0, "ug/degC": 1.0,
    "ms": 1.0, "deg/h/h": 1.0, "deg/h/g": 1.0, "deg/h/g^2": 1.0, "ug/g^2": 1.0, "ug/g^3": 1.0, "output": 1.0,
    "output/degC": 1.0,
}  # fmt: skip
_PRIOR = re.compile(r"(\w+)\(\s*(.+?)\s*\)")
_NUMBER_AND_UNIT = re.compile(r"([-+.\deE]+)\s*(\S*)")


def stream(seed: int, name: str) -> np.random.Generator:
    """The random stream that belongs to `name`."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def draw(prior: str, unit: str, generator: np.random.Generator) -> float:
    """One value of a prior such as ``normal(0, 500 ppm)``, in `unit`."""
    family, numbers, given = _stated(prior)
    factor = _IN_BASE_UNIT[given] / _IN_BASE_UNIT[unit] if given else 1.0
    match family:
        case "normal":
            return factor * generator.normal(*numbers)
        case "halfnormal":
            return factor * abs(generator.normal(0.0, numbers[0]))
        case "lognormal":
            return factor * numbers[0] * float(np.exp(generator.normal(0.0, numbers[1])))
        case "uniform":
            return factor * generator.uniform(*numbers)
    raise ValueError(f"unknown prior family '{family}'")


def _stated(prior: str) -> tuple[str, list[float], str]:
    """Family, numbers and unit of a prior; the unit is empty where none is given."""
    family, inside = _PRIOR.fullmatch(prior.strip()).groups()
    parts = [_NUMBER_AND_UNIT.fullmatch(part.strip()).groups() for part in inside.split(",")]
    return family, [float(number) for number, _ in parts], next((unit for _, unit in reversed(parts) if unit), "")


def _applies(effect: dict, channel: Channel) -> bool:
    if "channels" in effect:
        return channel.name in effect["channels"]
    if effect["name"].startswith("gyro_"):
        return channel.kind == "gyro"
    if effect["name"].startswith(("accel_", "lever_arm")):
        return channel.kind == "accelerometer"
    return not effect["name"].startswith(("reference_", "time_", "station_", "arm_"))


def effects_of(model: str | Path) -> list[dict]:
    """The effects that a model file lists; a bare name stands for a file in `models/`."""
    path = model if isinstance(model, Path) else MODELS / f"{model}.toml"
    return tomllib.loads(path.read_text(encoding="utf-8"))["effect"]


def in_output(prior: str, channel: Channel) -> str:
    """Replace the units `noise` and `scale` by what they are for a channel, in output units."""
    own = {"noise": channel.noise, "scale": channel.scale}

    def stated(found: re.Match) -> str:
        return f"{float(found.group(1)) * own[found.group(2)]:.12g} output"

    return re.sub(r"([-+.\deE]+)\s*(noise|scale)", stated, prior)


def priors(effects: Iterable[dict], channels: Iterable[Channel]) -> dict[str, str]:
    """The stated prior of every parameter that belongs to a channel."""
    return {
        f"{effect['name']}.{parameter}[{channel.name}]": in_output(prior, channel)
        for effect in effects
        for channel in channels
        if _applies(effect, channel)
        for parameter, prior in effect.get("prior", {}).items()
    }


def from_model(effects: Iterable[dict], channels: Iterable[Channel], seed: int) -> dict[str, float]:
    """Draw a value for every parameter that belongs to a channel."""
    stated = priors(effects, tuple(channels))
    return {name: draw(prior, UNITS[name.split("[")[0]], stream(seed, name)) for name, prior in stated.items()}


def equipment_spreads(
    mountings: Iterable[Mounting], tables: Iterable[Table], turning: Iterable[str]
) -> dict[str, float]:
    """One sigma of the errors of seats and table axes, and of the rates of the tables in `turning`."""
    spreads: dict[str, float] = {}
    for mounting in mountings:
        for axis in "xyz":
            spreads[f"mounting_error.{axis}[{mounting.name}]"] = 60 * mounting.uncertainty_arcmin
    for table in tables:
        for axis in "xy" if table.axis_uncertainty_arcsec else "":
            spreads[f"table_axis_tilt.{axis}[{table.name}]"] = table.axis_uncertainty_arcsec
        if table.name in turning:
            spreads[f"table_rate_error.rate_error[{table.name}]"] = table.rate_uncertainty_ppm
    return spreads


def of_reference(effects: Iterable[dict], tables: Iterable[str], seed: int) -> dict[str, float]:
    """Draw a value for every parameter of a reference gyro and its clock, and of the station: of no channel."""
    labels = {"reference": ("all",), "station": ("all",), "time": tuple(tables)}
    names = {
        f"{effect['name']}.{parameter}": (labels[effect["name"].split("_")[0]], prior)
        for effect in effects
        if effect["name"].split("_")[0] in labels
        for parameter, prior in effect.get("prior", {}).items()
    }
    return {
        f"{name}[{label}]": draw(prior, UNITS[name], stream(seed, f"{name}[{label}]"))
        for name, (owners, prior) in names.items()
        for label in owners
    }


def widths_of_station(effects: Iterable[dict], tables: Iterable[str]) -> dict[str, float]:
    """One sigma of the errors of the station and of the clock beside a reference gyro, which move the outputs."""
    labels = {"station": ("all",), "time": tuple(tables)}
    return {
        f"{effect['name']}.{parameter}[{label}]": width(prior, UNITS[f"{effect['name']}.{parameter}"])
        for effect in effects
        for label in labels.get(effect["name"].split("_")[0], ())
        for parameter, prior in effect.get("prior", {}).items()
    }


def from_spreads(spreads: dict[str, float], seed: int) -> dict[str, float]:
    """Draw normal errors of the given one sigma."""
    return {name: stream(seed, name).normal(0.0, spread) for name, spread in spreads.items()}


def width(prior: str, unit: str) -> float:
    """One sigma of a normal prior, in `unit`."""
    family, numbers, given = _stated(prior)
    if family != "normal":
        raise ValueError(f"the width of a {family} prior is not asked for")
    return numbers[1] * (_IN_BASE_UNIT[given] / _IN_BASE_UNIT[unit] if given else 1.0)


def at_score(prior: str, score: float) -> float:
    """The value of a noise scale whose quantile under its prior is that of a standard normal `score`."""
    family, numbers = _of_a_scale(prior)
    if family == "lognormal":
        return numbers[0] * float(np.exp(numbers[1] * score))
    return numbers[0] * float(stats.norm.isf(stats.norm.sf(score) / 2))


def normal_score(prior: str, value: float) -> float:
    """The standard normal score whose quantile is that of a noise scale under its prior."""
    family, numbers = _of_a_scale(prior)
    if family == "lognormal":
        return float(np.log(value / numbers[0]) / numbers[1])
    return float(stats.norm.isf(2 * stats.norm.sf(value / numbers[0])))


def _of_a_scale(prior: str) -> tuple[str, list[float]]:
    """Family and numbers of a prior in output units."""
    family, numbers, _ = _stated(prior)
    if family not in ("lognormal", "halfnormal"):
        raise ValueError(f"no noise scale has a {family} prior")
    return family, numbers


def true_seat(mounting: Mounting, values: Values) -> np.ndarray:
    """Body to table with the error of the seat in it."""
    error = [values.get(f"mounting_error.{axis}[{mounting.name}]", 0.0) * ARCSEC for axis in "xyz"]
    return mounting.body_to_table @ rotation(error)


def mounting_angles(channels: Iterable[Channel], mountings: Iterable[Mounting], values: Values) -> dict[str, float]:
    """True angle in deg between each sensitive axis and the rotation axis."""
    angles = {}
    channels = tuple(channels)
    for mounting in mountings:
        for channel in channels:
            axis = true_seat(mounting, values) @ sensitive_axis(channel, values)
            angles[f"mounting_angle[{channel.name},{mounting.name}]"] = float(
                np.degrees(np.arctan2(np.hypot(axis[0], axis[1]), axis[2]))
            )
    return angles


def scale_factors(channels: Iterable[Channel], values: Values) -> dict[str, float]:
    """True scale factor at the reference temperature, output units per input unit."""
    factors = {}
    for channel in channels:
        effect = "gyro_scale_factor" if channel.kind == "gyro" else "accel_scale_factor"
        error = 1e-6 * values.get(f"{effect}.scale[{channel.name}]", 0.0)
        factors[f"scale_factor[{channel.name}]"] = channel.scale * (1 + error)
    return factors

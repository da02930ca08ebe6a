"""How one channel turns what it experiences into its output: the sensor's errors, then the converter's.

Errors are looked up by name in a flat dictionary, `effect.parameter[label]` in datasheet units; what is absent
is zero.  The order is fixed: the axis leans, terms in specific force and its square, the bias, the scale, and
behind the sensor the gain and the offset of the converter.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import pi, radians

import numpy as np

from kinematics import ARCSEC, Site

REFERENCE_TEMPERATURE = 25.0
DEG_PER_HOUR = pi / 180 / 3600
PPM = 1e-6
Values = Mapping[str, float]


@dataclass(frozen=True)
class Channel:
    """One sensitive axis as the campaign file describes it (`scale` in output units per `per`)."""

    name: str
    kind: str
    input_axis: tuple[float, float, float]
    output_unit: str
    scale: float
    per: str
    noise: float
    output_axis: tuple[float, float, float] | None = None
    offset: float = 0.0
    current_mA_per_g: float | None = None

    @property
    def axes(self) -> np.ndarray:
        """Rows are the input, output and spin (pendulous) axes, right-handed, in body axes."""
        along = np.asarray(self.input_axis, dtype=float)
        along /= np.linalg.norm(along)
        # where no output axis is named: the body axis least aligned with the input axis, x before y before z
        least = np.eye(3)[np.argmin(np.round(np.abs(along), 9))]
        output = least if self.output_axis is None else np.asarray(self.output_axis, dtype=float)
        output = output - (output @ along) * along
        output /= np.linalg.norm(output)
        return np.array([along, output, np.cross(along, output)])

    def scale_si(self, site: Site) -> float:
        """Nominal output units per rad/s or m/s²."""
        per = {"deg/s": radians(1), "deg/h": DEG_PER_HOUR, "rad/s": 1.0, "g": site.gravity, "m/s^2": 1.0}
        return self.scale / per[self.per]


def errors_of(values: Values, label: str) -> Callable[[str], float]:
    return lambda parameter: values.get(f"{parameter}[{label}]", 0.0)


def sensitive_axis(channel: Channel, values: Values) -> np.ndarray:
    """Unit vector of the true sensitive axis in body axes."""
    error = errors_of(values, channel.name)
    effect, third = ("gyro_misalignment", "toward_s") if channel.kind == "gyro" else ("accel_misalignment", "toward_p")
    lean = np.array([1.0, error(f"{effect}.toward_o") * ARCSEC, error(f"{effect}.{third}") * ARCSEC])
    return lean @ channel.axes / np.linalg.norm(lean)


def gyro_signal(channel: Channel, values: Values, site: Site, rate, force, temperature) -> np.ndarray:
    """Input-referred signal in rad/s, for body rates and specific forces (K, 3)."""
    error = errors_of(values, channel.name)
    warmer = temperature - REFERENCE_TEMPERATURE
    sensitivity = [error(f"gyro_g_sensitivity.{name}") for name in ("d_i", "d_o", "d_s")]
    signal = rate @ sensitive_axis(channel, values)
    signal = signal + DEG_PER_HOUR * (force / site.gravity @ channel.axes.T) @ np.array(sensitivity)
    signal = signal + DEG_PER_HOUR * (error("gyro_bias.bias") + error("gyro_bias_temperature.slope") * warmer)
    return signal * (1 + PPM * (error("gyro_scale_factor.scale") + error("gyro_scale_temperature.slope") * warmer))


def accelerometer_signal(channel: Channel, values: Values, site: Site, force, temperature) -> np.ndarray:
    """Input-referred signal in m/s², for specific forces (K, 3) at the sensor."""
    error = errors_of(values, channel.name)
    warmer = temperature - REFERENCE_TEMPERATURE
    micro_g = 1e-6 * site.gravity
    signal = force @ sensitive_axis(channel, values)
    along_g = force @ channel.axes[0] / site.gravity
    signal = signal + error("accel_quadratic.quadratic") * micro_g * along_g**2
    signal = signal + micro_g * (error("accel_bias.bias") + error("accel_bias_temperature.slope") * warmer)
    return signal * (1 + PPM * (error("accel_scale_factor.scale") + error("accel_scale_temperature.slope") * warmer))


def injected_signal(channel: Channel, values: Values, site: Site, current_mA: float) -> float:
    """The acceleration in m/s² that a current fed into the converter stands for, with the source's errors."""
    error = errors_of(values, channel.name)
    equivalent_g = current_mA / channel.current_mA_per_g
    return site.gravity * (
        equivalent_g * (1 + PPM * error("injection_error.gain")) + 1e-6 * error("injection_error.offset")
    )


def lever_arm_force(channel: Channel, values: Values, table_rate: np.ndarray) -> np.ndarray:
    """Centripetal specific force, body axes, of a sensor off the rotation axis at a steady rate."""
    error = errors_of(values, channel.name)
    arm = 1e-3 * np.array([error(f"lever_arm.{axis}") for axis in "xyz"])
    return np.cross(table_rate, np.cross(table_rate, arm))


def converted(channel: Channel, values: Values, site: Site, signal, converter_temperature) -> np.ndarray:
    """Output of the converter in output units."""
    error = errors_of(values, channel.name)
    warmer = converter_temperature - REFERENCE_TEMPERATURE
    gained = channel.scale_si(site) * signal * (1 + PPM * error("converter_gain_drift.slope") * warmer)
    return gained + error("converter_offset_drift.slope") * warmer + channel.offset

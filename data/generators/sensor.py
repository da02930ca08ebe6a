"""How one channel turns what it experiences into its output: the sensor's errors, then the converter's.

Errors are looked up by name in a flat dictionary, `effect.parameter[label]` in datasheet units; what is absent
is zero.  The order is fixed: the axis leans, terms in rate or specific force and their powers, the bias and what it
does over temperature and time, the scale, the dead zone, and behind the sensor the gain, the offset and the dead
zone of the converter.

Effects called `outside_…` are in no catalogue: shapes that a user's instrument may have and no list foresees.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import pi, radians

import numpy as np

from kinematics import ARCSEC, Site

REFERENCE_TEMPERATURE = 25.0
NORTHWARD_GAUSS, UPWARD_GAUSS = 0.25, -0.4
DEG_PER_HOUR = pi / 180 / 3600
DEG_PER_SECOND = pi / 180
PPM = 1e-6
Values = Mapping[str, float]


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
AXES = (("x", X, Y), ("y", Y, Z), ("z", Z, X))
"""Three perpendicular sensors: letter, input axis and output axis of each."""


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


Memory = Callable[[float], float | np.ndarray]


def steady(size: float) -> float:
    """The memory of a temperature that does not change."""
    return 0.0


@dataclass(frozen=True)
class Surroundings:
    """Circumstances of the instants at which a channel is read: numbers, or arrays with one number per instant.

    Attributes
    ----------
    temperature, temperature_rate : of the sensor, °C and °C/min.
    lag : time constant in min → lagged minus true temperature, °C.
    loop : play in °C → place in the loop of a hysteresis, −1 … 1.
    hours : since the campaign began.
    power_on_min : since power-on; infinite where nobody knows.
    rate, angle : of the table, commanded, rad/s and rad.
    converter : temperature of the converter; the reference temperature where nobody measures it.
    converter_rate, converter_lag, converter_loop : as above, of the converter.
    run, progress : index of the run, and how much of it is over (0 … 1).
    """

    temperature: float | np.ndarray = REFERENCE_TEMPERATURE
    temperature_rate: float | np.ndarray = 0.0
    lag: Memory = field(default=steady)
    loop: Memory = field(default=steady)
    hours: float | np.ndarray = 0.0
    power_on_min: float | np.ndarray = np.inf
    rate: float | np.ndarray = 0.0
    angle: float | np.ndarray = 0.0
    converter: float | np.ndarray = REFERENCE_TEMPERATURE
    converter_rate: float | np.ndarray = 0.0
    converter_lag: Memory = field(default=steady)
    converter_loop: Memory = field(default=steady)
    run: int | np.ndarray = 0
    progress: float | np.ndarray = 0.0


def errors_of(values: Values, label: str) -> Callable[[str], float]:
    return lambda parameter: values.get(f"{parameter}[{label}]", 0.0)


def sensitive_axis(channel: Channel, values: Values) -> np.ndarray:
    """Unit vector of the true sensitive axis in body axes."""
    error = errors_of(values, channel.name)
    effect, third = ("gyro_misalignment", "toward_s") if channel.kind == "gyro" else ("accel_misalignment", "toward_p")
    lean = np.array([1.0, error(f"{effect}.toward_o") * ARCSEC, error(f"{effect}.{third}") * ARCSEC])
    return lean @ channel.axes / np.linalg.norm(lean)


def stuck(signal, half_width: float):
    """What a dead zone takes away: the play has to be taken up first, in either direction."""
    return np.clip(signal, -half_width, half_width)


def bias_over_temperature_and_time(kind: str, error: Callable[[str], float], around: Surroundings):
    """Bias and what moves it, in deg/h or µg; `kind` is `gyro` or `accel`."""
    warmer = around.temperature - REFERENCE_TEMPERATURE
    bias = error(f"{kind}_bias.bias") + error(f"{kind}_bias_temperature.slope") * warmer
    if curvature := error(f"{kind}_bias_temperature_quadratic.curvature"):
        bias = bias + curvature * warmer**2
    if coefficient := error(f"{kind}_bias_temperature_cubic.coefficient"):
        bias = bias + coefficient * warmer**3
    if slope := error(f"{kind}_bias_temperature_rate.slope"):
        bias = bias + slope * around.temperature_rate
    if coefficient := error(f"{kind}_thermal_lag.coefficient"):
        bias = bias + coefficient * around.lag(error(f"{kind}_thermal_lag.tau"))
    if half_width := error(f"{kind}_thermal_hysteresis.half_width"):
        bias = bias + half_width * around.loop(error(f"{kind}_thermal_hysteresis.play"))
    if amplitude := error(f"{kind}_warm_up.amplitude"):
        bias = bias + amplitude * np.exp(-around.power_on_min / error(f"{kind}_warm_up.tau"))
    if slope := error(f"{kind}_bias_drift.slope"):
        bias = bias + slope * around.hours
    if amplitude := error("outside_temperature_wave.amplitude"):
        period, phase = error("outside_temperature_wave.period"), error("outside_temperature_wave.phase")
        bias = bias + amplitude * np.sin(2 * pi * warmer / period + radians(phase))
    if amplitude := error("outside_angle_harmonic.amplitude"):
        order, phase = error("outside_angle_harmonic.order"), error("outside_angle_harmonic.phase")
        bias = bias + amplitude * np.sin(order * around.angle + radians(phase))
    if amplitude := error("outside_step.amplitude"):
        in_run = np.asarray(around.run) == error("outside_step.run")
        bias = bias + amplitude * (in_run & (np.asarray(around.progress) > error("outside_step.progress")))
    return bias


def scale_over_temperature(kind: str, error: Callable[[str], float], around: Surroundings):
    """True over nominal scale factor: its error at the reference temperature times what the temperature does to it."""
    warmer = around.temperature - REFERENCE_TEMPERATURE
    change = error(f"{kind}_scale_temperature.slope") * warmer
    if curvature := error(f"{kind}_scale_temperature_quadratic.curvature"):
        change = change + curvature * warmer**2
    return (1 + PPM * error(f"{kind}_scale_factor.scale")) * (1 + PPM * change)


def magnetic_field(site: Site, earth: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Field in gauss, body axes (K, 3), of a unit at one place, from Earth rate and force there."""
    latitude = radians(site.latitude_deg)
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    north = (earth / np.linalg.norm(site.earth_rate) - np.sin(latitude) * up) / np.cos(latitude)
    return NORTHWARD_GAUSS * north + UPWARD_GAUSS * up


def gyro_signal(
    channel: Channel, values: Values, site: Site, rate, force, around: Surroundings, earth: np.ndarray | None = None
) -> np.ndarray:
    """Input-referred signal in rad/s, for body rates and specific forces (K, 3); `earth` is Earth rate in body axes."""
    error = errors_of(values, channel.name)
    signal = rate @ sensitive_axis(channel, values)
    in_g = force / site.gravity @ channel.axes.T
    linear = np.array([error(f"gyro_g_sensitivity.{name}") for name in ("d_i", "d_o", "d_s")])
    signal = signal + DEG_PER_HOUR * in_g @ linear
    for name, (first, second) in {
        "d_ii": (0, 0), "d_oo": (1, 1), "d_ss": (2, 2), "d_io": (0, 1), "d_os": (1, 2), "d_si": (2, 0),
    }.items():  # fmt: skip
        if drift := error(f"gyro_g2_sensitivity.{name}"):
            signal = signal + DEG_PER_HOUR * drift * in_g[:, first] * in_g[:, second]
    magnetic = np.array([error(f"gyro_magnetic_sensitivity.{name}") for name in ("m_i", "m_o", "m_s")])
    if np.any(magnetic):
        signal = signal + DEG_PER_HOUR * magnetic_field(site, earth, force) @ channel.axes.T @ magnetic
    along = rate @ channel.axes[0]
    if asymmetry := error("gyro_scale_asymmetry.asymmetry"):
        signal = signal + PPM * asymmetry * np.abs(along)
    if quadratic := error("gyro_scale_quadratic.quadratic"):
        signal = signal + PPM * quadratic * along**2 / DEG_PER_SECOND
    if cubic := error("gyro_scale_cubic.cubic"):
        signal = signal + PPM * cubic * along**3 / DEG_PER_SECOND**2
    if dependence := error("gyro_scale_g_dependence.dependence"):
        signal = signal + PPM * dependence * in_g[:, 0] * along
    if amplitude := error("outside_resonance.amplitude"):
        centre, width = error("outside_resonance.centre"), error("outside_resonance.width")
        off = (np.abs(along) / DEG_PER_SECOND - centre) / width
        signal = signal + DEG_PER_HOUR * amplitude / (1 + off**2)
    if amplitude := error("outside_root_rate.amplitude"):
        signal = signal + DEG_PER_HOUR * amplitude * np.sqrt(np.abs(along) / DEG_PER_SECOND)
    signal = signal + DEG_PER_HOUR * bias_over_temperature_and_time("gyro", error, around)
    signal = signal * scale_over_temperature("gyro", error, around)
    if half_width := error("gyro_dead_zone.half_width"):
        signal = signal - stuck(signal, DEG_PER_HOUR * half_width)
    return signal


def accelerometer_signal(channel: Channel, values: Values, site: Site, force, around: Surroundings) -> np.ndarray:
    """Input-referred signal in m/s², for specific forces (K, 3) at the sensor."""
    error = errors_of(values, channel.name)
    micro_g = 1e-6 * site.gravity
    signal = force @ sensitive_axis(channel, values)
    along, across, pendulous = (force / site.gravity @ channel.axes.T).T
    for name, shape in {
        "accel_quadratic.quadratic": lambda: along**2,
        "accel_cubic.cubic": lambda: along**3,
        "accel_odd_quadratic.odd_quadratic": lambda: along * np.abs(along),
        "accel_scale_asymmetry.asymmetry": lambda: np.abs(along),
        "accel_cross_coupling.k_ip": lambda: along * pendulous,
        "accel_cross_coupling.k_io": lambda: along * across,
        "accel_cross_axis_quadratic.k_oo": lambda: across**2,
        "accel_cross_axis_quadratic.k_pp": lambda: pendulous**2,
        "outside_threshold.amplitude": lambda: np.tanh(along / error("outside_threshold.width")),
    }.items():
        if coefficient := error(name):
            signal = signal + micro_g * coefficient * shape()
    signal = signal + micro_g * bias_over_temperature_and_time("accel", error, around)
    signal = signal * scale_over_temperature("accel", error, around)
    if half_width := error("accel_dead_zone.half_width"):
        signal = signal - stuck(signal, micro_g * half_width)
    return signal


def injected_signal(channel: Channel, values: Values, site: Site, current_mA):
    """The acceleration in m/s² that a current fed into the converter stands for, with the source's errors."""
    error = errors_of(values, channel.name)
    equivalent_g = current_mA / channel.current_mA_per_g
    return site.gravity * (
        equivalent_g * (1 + PPM * error("injection_error.gain")) + 1e-6 * error("injection_error.offset")
    )


def lever_arm_force(channel: Channel, values: Values, table_rate: np.ndarray, rising: np.ndarray) -> np.ndarray:
    """Specific force, body axes, of a sensor off the rotation axis at a rate that rises by `rising` per second."""
    error = errors_of(values, channel.name)
    arm = 1e-3 * np.array([error(f"lever_arm.{axis}") for axis in "xyz"])
    if not np.any(arm):
        return np.zeros_like(table_rate)
    return np.cross(table_rate, np.cross(table_rate, arm)) + np.cross(rising, arm)


def memories_of_the_converter(part: str, error: Callable[[str], float], around: Surroundings):
    """What the way to the converter's present temperature adds to its gain (ppm) or offset (output units)."""
    change = error(f"converter_{part}_temperature_rate.slope") * around.converter_rate
    if coefficient := error(f"converter_{part}_lag.coefficient"):
        change = change + coefficient * around.converter_lag(error(f"converter_{part}_lag.tau"))
    if half_width := error(f"converter_{part}_hysteresis.half_width"):
        change = change + half_width * around.converter_loop(error(f"converter_{part}_hysteresis.play"))
    return change


def converted(channel: Channel, values: Values, site: Site, signal, around: Surroundings) -> np.ndarray:
    """Output of the converter in output units."""
    error = errors_of(values, channel.name)
    warmer = around.converter - REFERENCE_TEMPERATURE
    ideal = channel.scale_si(site) * signal
    gain = PPM * error("converter_gain_drift.slope") * warmer
    if curvature := error("converter_gain_drift_quadratic.curvature"):
        gain = gain + PPM * curvature * warmer**2
    gain = gain + PPM * memories_of_the_converter("gain", error, around)
    if quadratic := error("converter_nonlinearity.quadratic"):
        gain = gain + PPM * quadratic * ideal
    if cubic := error("converter_nonlinearity.cubic"):
        gain = gain + PPM * cubic * ideal**2
    output = ideal * (1 + gain) + error("converter_offset_drift.slope") * warmer
    if curvature := error("converter_offset_drift_quadratic.curvature"):
        output = output + curvature * warmer**2
    output = output + memories_of_the_converter("offset", error, around)
    if leakage := error("converter_leakage.leakage"):
        output = output + leakage * (2 ** (warmer / error("converter_leakage.doubling")) - 1)
    if amplitude := error("converter_warm_up.amplitude"):
        output = output + amplitude * np.exp(-around.power_on_min / error("converter_warm_up.tau"))
    if half_width := error("converter_dead_zone.half_width"):
        output = output - stuck(output, half_width)
    return output + channel.offset

"""Effects of a gyro: bias, scale factor and its nonlinearity, input axis, dead zone, and sensitivities of its drift.

Bias and scale factor depend on temperature and time; the drift is sensitive to specific force, angular acceleration and
the magnetic field.
"""

from typing import Any

import jax.numpy as jnp

from imubayes.effects import shared_formulas as formulas
from imubayes.effects.base import Order, SignalEffect
from imubayes.effects.shared_formulas import Gyro
from imubayes.foundations.arrays import Scalar, cross
from imubayes.foundations.signal_path_state import Sample
from imubayes.parameters.declarations import option, parameter, thermal_play, time_constant


class GyroBias(Gyro, formulas.ConstantBias):
    name = "gyro_bias"
    confused_with = "run offsets if every run has its own"
    reference = "IEEE Std 952, bias (D_F)"
    bias: Scalar = parameter(
        "deg/h", "normal(0, 3600 deg/h)", (0.01, 1800), "the constant rate offset", coarse=(3600, 36000)
    )


class GyroBiasTemperature(Gyro, formulas.LinearThermalBias):
    name = "gyro_bias_temperature"
    reference = "IEEE Std 952, bias temperature sensitivity"
    slope: Scalar = parameter(
        "deg/h/degC", "normal(0, 20 deg/h/degC)", (0.001, 60), "the bias per degree", coarse=(60, 300)
    )


class GyroBiasTemperatureQuadratic(Gyro, formulas.QuadraticThermalBias):
    name = "gyro_bias_temperature_quadratic"
    reference = "IEEE Std 952, bias temperature sensitivity"
    curvature: Scalar = parameter(
        "deg/h/degC^2", "normal(0, 0.5 deg/h/degC^2)", (0.0001, 2), "the bias per degree squared", coarse=(2, 10)
    )


class GyroBiasTemperatureCubic(Gyro, formulas.CubicThermalBias):
    name = "gyro_bias_temperature_cubic"
    reference = "IEEE Std 952, bias temperature sensitivity; the third order of an autopilot's calibration"
    coefficient: Scalar = parameter(
        "deg/h/degC^3", "normal(0, 0.01 deg/h/degC^3)", (1e-6, 0.04), "the bias per degree cubed", coarse=(0.05, 0.2)
    )


class GyroBiasTemperatureRate(Gyro, formulas.ThermalRateBias):
    """Bias linear in the rate of sensor temperature: signal + c·dT/dt, the Shupe term of a fibre-optic gyro."""

    name = "gyro_bias_temperature_rate"
    reference = "Shupe, Applied Optics 1980; IEEE Std 952, bias temperature gradient; 10 deg/h at 1 degC/min"
    slope: Scalar = parameter(
        "deg/h/(degC/min)",
        "normal(0, 20 deg/h/(degC/min))",
        (0.1, 60),
        "the bias per temperature rate",
        coarse=(60, 300),
    )


class GyroThermalLag(Gyro, formulas.ThermalLag):
    name = "gyro_thermal_lag"
    reference = "first-order lag, IEEE Std 952 thermal model; time constants of minutes"
    coefficient: Scalar = parameter(
        "deg/h/degC", "normal(0, 20 deg/h/degC)", (0.001, 60), "the bias per degree of lag", coarse=(60, 300)
    )
    tau: Scalar = time_constant("the time constant of the lag")


class GyroThermalHysteresis(Gyro, formulas.ThermalHysteresis):
    name = "gyro_thermal_hysteresis"
    confused_with = "gyro_thermal_lag, at one ramp rate; gyro_bias_temperature if all ramps are monotonic"
    reference = "play operator, Visintin, Differential Models of Hysteresis, ch. III; IEEE Std 952, thermal hysteresis"
    half_width: Scalar = parameter(
        "deg/h", "normal(0, 10 deg/h)", (0.01, 50), "half the height of the loop", coarse=(100, 500)
    )
    play: Scalar = thermal_play()


class GyroWarmUp(Gyro, formulas.WarmUp):
    name = "gyro_warm_up"
    reference = "IEEE Std 952, turn-on transient and warm-up"
    amplitude: Scalar = parameter(
        "deg/h", "normal(0, 20 deg/h)", (0.01, 100), "the excess bias at power-on", coarse=(200, 1000)
    )
    tau: Scalar = time_constant("the time constant")


class GyroBiasDrift(Gyro, formulas.BiasDrift):
    name = "gyro_bias_drift"
    reference = "IEEE Std 952, bias trend"
    slope: Scalar = parameter(
        "deg/h/h", "normal(0, 1 deg/h/h)", (0.0001, 10), "the change of bias per hour", coarse=(20, 100)
    )


class GyroRunBias(Gyro, formulas.RunBias):
    name = "gyro_run_bias"
    reference = "IEEE Std 952, bias run-to-run repeatability"
    offset: Scalar = parameter("deg/h", "normal(0, 10 deg/h)", (0.01, 100), "the run's own offset", spread="spread")
    spread: Scalar = parameter(
        "deg/h",
        "lognormal(10 deg/h, 1.0)",
        (0.01, 100),
        "the standard deviation over runs",
        per=("channel",),
        coarse=(60, 300),
    )


class GyroScaleFactor(Gyro, formulas.ScaleFactor):
    name = "gyro_scale_factor"
    confused_with = "mounting angle and table rate error, in one mounting"
    reference = "IEEE Std 952, scale factor S"
    scale: Scalar = parameter(
        "ppm", "normal(0, 2000 ppm)", (10, 500), "the relative scale factor error", coarse=(5000, 20000)
    )


class GyroScaleTemperature(Gyro, formulas.LinearThermalScale):
    name = "gyro_scale_temperature"
    reference = "IEEE Std 952, scale factor temperature sensitivity"
    slope: Scalar = parameter(
        "ppm/degC", "normal(0, 100 ppm/degC)", (10, 100), "the scale change per degree", coarse=(100, 300)
    )


class GyroScaleTemperatureQuadratic(Gyro, formulas.QuadraticThermalScale):
    name = "gyro_scale_temperature_quadratic"
    reference = "IEEE Std 952, scale factor temperature sensitivity"
    curvature: Scalar = parameter(
        "ppm/degC^2", "normal(0, 1 ppm/degC^2)", (0.01, 2), "the scale change per degree squared", coarse=(3, 10)
    )


class GyroDeadZone(Gyro, formulas.DeadZone):
    name = "gyro_dead_zone"
    confused_with = "gyro_scale_asymmetry and the bias if all runs rotate in one direction"
    reference = "IEEE Std 952, dead zone"
    half_width: Scalar = parameter(
        "deg/h", "halfnormal(5 deg/h)", (0.01, 50), "half the width of the zone", coarse=(50, 300)
    )


_TESLA_PER_UT = 1e-6


def _drift_per_g(meaning: str) -> Any:
    return parameter("deg/h/g", "normal(0, 100 deg/h/g)", (1, 576), meaning, coarse=(200, 500))


def _drift_per_g2(meaning: str) -> Any:
    return parameter("deg/h/g^2", "normal(0, 10 deg/h/g^2)", (0.01, 20), meaning, coarse=(30, 100))


def _drift_per_gauss(meaning: str) -> Any:
    return parameter("deg/h/gauss", "normal(0, 20 deg/h/gauss)", (0.1, 50), meaning, coarse=(200, 1000))


class GyroMisalignment(Gyro, formulas.Misalignment):
    """The true input axis is the unit vector along I + a·O + b·S, S = I × O: a is the angle toward O, b toward S."""

    name = "gyro_misalignment"
    reference = "IEEE Std 952, input axis misalignment"
    toward_s: Scalar = formulas.input_axis_angle("S")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return self.misaligned(signal, sample, self.toward_s)


class GyroGSensitivity(Gyro, SignalEffect):
    """Drift proportional to specific force: signal + D_I f_I + D_O f_O + D_S f_S."""

    name = "gyro_g_sensitivity"
    order = Order.SENSITIVITY
    confused_with = "levelling error and Earth rate components"
    reference = "IEEE Std 517, D_I, D_O, D_S"
    d_i: Scalar = _drift_per_g("the drift per g along the input axis")
    d_o: Scalar = _drift_per_g("the drift per g along the output axis")
    d_s: Scalar = _drift_per_g("the drift per g along the spin axis")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        force = sample.force
        return signal + self.d_i * force[0] + self.d_o * force[1] + self.d_s * force[2]


class GyroG2Sensitivity(Gyro, SignalEffect):
    """signal + D_II f_I² + D_OO f_O² + D_SS f_S² + D_IO f_I f_O + D_OS f_O f_S + D_SI f_S f_I.

    In a 1 g field f_I² + f_O² + f_S² = g², so that the common part of the three squares is a bias.
    """

    name = "gyro_g2_sensitivity"
    order = Order.SENSITIVITY
    confused_with = "the bias: D_II, D_OO and D_SS together, in a 1 g field; table_axis_tilt"
    reference = "IEEE Std 517, D_II … D_SI; 0.01 … 20 deg/h/g²"
    d_ii: Scalar = _drift_per_g2("the drift per g² along I")
    d_oo: Scalar = _drift_per_g2("the drift per g² along O")
    d_ss: Scalar = _drift_per_g2("the drift per g² along S")
    d_io: Scalar = _drift_per_g2("the drift per g² along I and O")
    d_os: Scalar = _drift_per_g2("the drift per g² along O and S")
    d_si: Scalar = _drift_per_g2("the drift per g² along S and I")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        f_i, f_o, f_s = sample.force[0], sample.force[1], sample.force[2]
        squares = self.d_ii * f_i**2 + self.d_oo * f_o**2 + self.d_ss * f_s**2
        return signal + squares + self.d_io * f_i * f_o + self.d_os * f_o * f_s + self.d_si * f_s * f_i


class GyroScaleAsymmetry(Gyro, formulas.ScaleAsymmetry):
    name = "gyro_scale_asymmetry"
    confused_with = "gyro_scale_quadratic if few rates are tested; a bias, at one rate"
    reference = "IEEE Std 952, asymmetry error; 10 … 300 ppm, of consumer gyros to 3000 ppm"
    asymmetry: Scalar = parameter(
        "ppm", "normal(0, 100 ppm)", (10, 3000), "half the scale factor difference", coarse=(1000, 3000)
    )


class GyroScaleQuadratic(Gyro, formulas.SecondOrderNonlinearity):
    """Second-order nonlinearity: signal + K2·Ω².

    Even in rate: the error has the same sign in both directions; 25 … 50 ppm at 200 … 400 °/s is 0.1 ppm/(°/s).
    """

    name = "gyro_scale_quadratic"
    confused_with = "gyro_scale_asymmetry if few rates are tested; g-sensitivity to centripetal acceleration"
    reference = "IEEE Std 952, scale factor nonlinearity; 25 … 50 ppm at 200 … 400 °/s"
    quadratic: Scalar = parameter(
        "ppm/(deg/s)", "normal(0, 1 ppm/(deg/s))", (0.01, 1), "the coefficient K2", coarse=(5, 20)
    )


class GyroScaleCubic(Gyro, formulas.ThirdOrderNonlinearity):
    """Third-order nonlinearity: signal + K3·Ω³.

    50 ppm at 400 °/s is 3·10⁻⁴ ppm/(°/s)².
    """

    name = "gyro_scale_cubic"
    confused_with = "the scale factor, over a narrow range of rates; saturation near full scale"
    reference = "IEEE Std 952, scale factor nonlinearity; 25 … 50 ppm at 200 … 400 °/s"
    cubic: Scalar = parameter(
        "ppm/(deg/s)^2", "normal(0, 0.005 ppm/(deg/s)^2)", (1e-5, 1e-2), "the coefficient K3", coarse=(0.05, 1)
    )


class GyroScaleGDependence(Gyro, SignalEffect):
    """Scale factor linear in specific force: signal + S_g·f_I·Ω."""

    name = "gyro_scale_g_dependence"
    order = Order.SENSITIVITY
    confused_with = "the scale factor if the angle between input axis and gravity is constant"
    reference = "IEEE Std 952, scale factor acceleration sensitivity; 1 … 100 ppm/g"
    dependence: Scalar = parameter(
        "ppm/g", "normal(0, 50 ppm/g)", (1, 100), "the relative change of scale per g", coarse=(200, 1000)
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.dependence * sample.force[0] * sample.rate[0]


class GyroMagneticSensitivity(Gyro, SignalEffect):
    """Drift linear in the magnetic field: signal + M_I B_I + M_O B_O + M_S B_S.

    The field is constant in the local level frame and is rotated into the unit's axes; set it to the field measured at
    the test place.  In a free tumble it acts as far as the heading is determined.
    """

    name = "gyro_magnetic_sensitivity"
    order = Order.SENSITIVITY
    confused_with = "g-sensitivity and misalignment: field, gravity and Earth rate are nearly coplanar"
    reference = "IEEE Std 952, magnetic sensitivity; 1 … 50 deg/h/gauss without a shield"
    m_i: Scalar = _drift_per_gauss("the drift per gauss along I")
    m_o: Scalar = _drift_per_gauss("the drift per gauss along O")
    m_s: Scalar = _drift_per_gauss("the drift per gauss along S")
    north_uT: float = option(25.0, "the field towards true North, µT")
    east_uT: float = option(0.0, "the field towards East, µT")
    up_uT: float = option(-40.0, "the field upwards, µT; negative in the northern hemisphere")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        east = cross(sample.north, sample.up)
        level = self.east_uT * east + self.north_uT * sample.north + self.up_uT * sample.up
        field = level * _TESLA_PER_UT
        return signal + self.m_i * field[0] + self.m_o * field[1] + self.m_s * field[2]


class GyroBandwidth(Gyro, SignalEffect):
    """First-order bandwidth f = 1/(2πτ): τ·dy/dt + y = x, y the output and x the input, with bias and scale factor.

    A row of constant acceleration has the mean input less τ times its mean slope; one that follows the angle of the
    table has the higher derivatives too, up to the sixth.  At a constant rate there is no lag.
    """

    name = "gyro_bandwidth"
    order = Order.LAG
    confused_with = "time_skew if all channels lag alike; beside it, a lag of the other sign: state a positive prior"
    reference = "IEEE Std 952, frequency response: a first-order lag, 0.1 … 20 ms for 1.6 kHz … 8 Hz"
    tau: Scalar = parameter("ms", "normal(0, 5 ms)", (0.01, 50), "the time constant of the lag")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        followed = formulas.lagged(signal, sample, self.tau)
        return jnp.where(sample.ambient.row_seconds > 0, followed, signal - self.tau * sample.acceleration[0])


class GyroOutputAxisAcceleration(Gyro, SignalEffect):
    """Drift linear in angular acceleration: signal + k·dω_O/dt.

    For a single-degree-of-freedom gyro k is the float's moment of inertia over the wheel's angular momentum.
    """

    name = "gyro_output_axis_acceleration"
    order = Order.SENSITIVITY
    confused_with = "time_skew, between table and unit"
    reference = "IEEE Std 517, output-axis angular acceleration; 0.1 … 10 ms"
    coefficient: Scalar = parameter("ms", "normal(0, 5 ms)", (0.01, 50), "the rate per angular acceleration")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.coefficient * sample.acceleration[1]

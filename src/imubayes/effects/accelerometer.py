"""Effects of an accelerometer: input axis, nonlinearity, bias and scale factor over temperature and time, dead zone."""

import jax.numpy as jnp

from imubayes.effects import shared_formulas as formulas
from imubayes.effects.base import Order, SignalEffect
from imubayes.effects.shared_formulas import Accelerometer
from imubayes.foundations.arrays import Scalar
from imubayes.foundations.signal_path_state import Sample
from imubayes.parameters.declarations import parameter, thermal_play, time_constant


class AccelMisalignment(Accelerometer, formulas.Misalignment):
    """The true input axis is the unit vector along I + a·O + b·P, P = I × O: a is the angle toward O, b toward P."""

    name = "accel_misalignment"
    reference = "IEEE Std 1293; its δ_o, about O, is toward_p, and its δ_p is −toward_o"
    toward_p: Scalar = formulas.input_axis_angle("P")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return self.misaligned(signal, sample, self.toward_p)


class AccelQuadratic(Accelerometer, formulas.SecondOrderNonlinearity):
    name = "accel_quadratic"
    confused_with = "K_oo and K_pp, and a second harmonic of the dividing head"
    reference = "IEEE Std 1293, K2"
    quadratic: Scalar = parameter("ug/g^2", "normal(0, 50 ug/g^2)", (1, 50), "the coefficient K2", coarse=(500, 3000))


class AccelCubic(Accelerometer, formulas.ThirdOrderNonlinearity):
    name = "accel_cubic"
    confused_with = "K1, in a 1 g field of few positions; a third harmonic of the dividing head"
    reference = "IEEE Std 1293, K3"
    cubic: Scalar = parameter("ug/g^3", "normal(0, 20 ug/g^3)", (0.1, 20), "the coefficient K3", coarse=(200, 1000))


class AccelOddQuadratic(Accelerometer, SignalEffect):
    """Output quadratic with the sign of the input: signal + K_oq a_i|a_i|."""

    name = "accel_odd_quadratic"
    order = Order.INPUT
    confused_with = "K1 and K3, in a 1 g field"
    reference = "IEEE Std 1293, K_oq"
    odd_quadratic: Scalar = parameter(
        "ug/g^2", "normal(0, 50 ug/g^2)", (1, 50), "the odd quadratic coefficient K_oq", coarse=(500, 3000)
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.odd_quadratic * sample.force[0] * jnp.abs(sample.force[0])


class AccelCrossCoupling(Accelerometer, SignalEffect):
    """Output proportional to products with the cross-axis inputs: signal + K_ip a_i a_p + K_io a_i a_o."""

    name = "accel_cross_coupling"
    order = Order.SENSITIVITY
    confused_with = "a second harmonic of the dividing head; mounting error, to second order"
    reference = "IEEE Std 1293, K_ip and K_io"
    k_ip: Scalar = parameter("ug/g^2", "normal(0, 50 ug/g^2)", (1, 50), "the coefficient K_ip", coarse=(500, 3000))
    k_io: Scalar = parameter("ug/g^2", "normal(0, 50 ug/g^2)", (1, 50), "the coefficient K_io", coarse=(500, 3000))

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        a_i, a_o, a_p = sample.force[0], sample.force[1], sample.force[2]
        return signal + self.k_ip * a_i * a_p + self.k_io * a_i * a_o


class AccelCrossAxisQuadratic(Accelerometer, SignalEffect):
    """Output quadratic in the cross axes: signal + K_oo a_o² + K_pp a_p².

    In a 1 g field a_i² + a_o² + a_p² = g²: the three squares are a bias and two independent terms.
    """

    name = "accel_cross_axis_quadratic"
    order = Order.SENSITIVITY
    confused_with = "bias and K2, in a 1 g field; a second harmonic of the dividing head"
    reference = "IEEE Std 1293, K_oo and K_pp"
    k_oo: Scalar = parameter("ug/g^2", "normal(0, 50 ug/g^2)", (1, 50), "the coefficient K_oo", coarse=(500, 3000))
    k_pp: Scalar = parameter("ug/g^2", "normal(0, 50 ug/g^2)", (1, 50), "the coefficient K_pp", coarse=(500, 3000))

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.k_oo * sample.force[1] ** 2 + self.k_pp * sample.force[2] ** 2


class AccelScaleAsymmetry(Accelerometer, formulas.ScaleAsymmetry):
    name = "accel_scale_asymmetry"
    confused_with = "bias and K2, in a 1 g field of few positions"
    reference = "IEEE Std 1293, scale factor asymmetry K1'"
    asymmetry: Scalar = parameter(
        "ppm", "normal(0, 100 ppm)", (1, 300), "half the scale factor difference", coarse=(1000, 3000)
    )


class AccelBandwidth(Accelerometer, SignalEffect):
    """First-order bandwidth f = 1/(2πτ): τ·dy/dt + y = x, y the output and x the input, with bias and scale factor.

    The input changes as gravity turns in the axes of the sensor, and with the tangential acceleration at its place.
    Rows that follow the angle of a table show it, to the sixth derivative of the input.
    """

    name = "accel_bandwidth"
    order = Order.LAG
    needs = ("row_seconds",)
    confused_with = "time_skew if all channels lag alike; lever_arm, in motion at one frequency about a vertical axis"
    reference = "IEEE Std 1293, frequency response: a first-order lag, 0.1 … 20 ms for 1.6 kHz … 8 Hz"
    tau: Scalar = parameter("ms", "normal(0, 5 ms)", (0.01, 50), "the time constant of the lag")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return jnp.where(sample.ambient.row_seconds > 0, formulas.lagged(signal, sample, self.tau), signal)


class AccelBias(Accelerometer, formulas.ConstantBias):
    name = "accel_bias"
    confused_with = "K2 and K_oo, K_pp in a 1 g tumble"
    reference = "IEEE Std 1293, K0"
    bias: Scalar = parameter("ug", "normal(0, 20 mg)", (50, 2000), "the constant offset K0", coarse=(20000, 60000))


class AccelBiasTemperature(Accelerometer, formulas.LinearThermalBias):
    name = "accel_bias_temperature"
    reference = "IEEE Std 1293, bias temperature sensitivity"
    slope: Scalar = parameter("ug/degC", "normal(0, 100 ug/degC)", (1, 100), "the bias per degree", coarse=(300, 1000))


class AccelBiasTemperatureQuadratic(Accelerometer, formulas.QuadraticThermalBias):
    name = "accel_bias_temperature_quadratic"
    reference = "IEEE Std 1293, bias temperature sensitivity"
    curvature: Scalar = parameter(
        "ug/degC^2", "normal(0, 5 ug/degC^2)", (0.01, 20), "the bias per degree squared", coarse=(10, 30)
    )


class AccelBiasTemperatureCubic(Accelerometer, formulas.CubicThermalBias):
    name = "accel_bias_temperature_cubic"
    reference = "IEEE Std 1293, bias temperature sensitivity; the third order of an autopilot's calibration"
    coefficient: Scalar = parameter(
        "ug/degC^3", "normal(0, 0.1 ug/degC^3)", (1e-4, 0.4), "the bias per degree cubed", coarse=(0.3, 1)
    )


class AccelBiasTemperatureRate(Accelerometer, formulas.ThermalRateBias):
    name = "accel_bias_temperature_rate"
    reference = "IEEE Std 1293, bias thermal-transient sensitivity"
    slope: Scalar = parameter(
        "ug/(degC/min)", "normal(0, 100 ug/(degC/min))", (1, 500), "the bias per temperature rate", coarse=(300, 1000)
    )


class AccelThermalLag(Accelerometer, formulas.ThermalLag):
    name = "accel_thermal_lag"
    reference = "first-order lag, IEEE Std 1293 thermal model; time constants of minutes"
    coefficient: Scalar = parameter(
        "ug/degC", "normal(0, 50 ug/degC)", (1, 300), "the bias per degree of lag", coarse=(300, 1000)
    )
    tau: Scalar = time_constant("the time constant of the lag")


class AccelThermalHysteresis(Accelerometer, formulas.ThermalHysteresis):
    name = "accel_thermal_hysteresis"
    confused_with = "accel_thermal_lag, at one ramp rate; accel_bias_temperature if all ramps are monotonic"
    reference = "play operator, Visintin, Differential Models of Hysteresis, ch. III; IEEE Std 1293, thermal hysteresis"
    half_width: Scalar = parameter(
        "ug", "normal(0, 500 ug)", (1, 5000), "half the height of the loop", coarse=(2000, 5000)
    )
    play: Scalar = thermal_play()


class AccelWarmUp(Accelerometer, formulas.WarmUp):
    name = "accel_warm_up"
    reference = "IEEE Std 1293, turn-on transient and warm-up"
    amplitude: Scalar = parameter(
        "ug", "normal(0, 500 ug)", (5, 2000), "the excess bias at power-on", coarse=(2000, 5000)
    )
    tau: Scalar = time_constant("the time constant")


class AccelBiasDrift(Accelerometer, formulas.BiasDrift):
    name = "accel_bias_drift"
    reference = "IEEE Std 1293, bias trend"
    slope: Scalar = parameter("ug/h", "normal(0, 10 ug/h)", (0.01, 50), "the change of bias per hour", coarse=(50, 300))


class AccelVibrationRectification(Accelerometer, SignalEffect):
    """Vibration rectification: signal + K_v·a_rms², a_rms the rms of vibration (column `vibration_g_rms`)."""

    name = "accel_vibration_rectification"
    order = Order.BIAS
    needs = ("vibration",)
    confused_with = "the bias if vibration is the same in all runs"
    reference = "IEEE Std 1293, vibration rectification coefficient; 1 … 100 µg/g²"
    rectification: Scalar = parameter(
        "ug/g^2", "normal(0, 50 ug/g^2)", (1, 500), "the bias per mean-square vibration", coarse=(200, 500)
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.rectification * sample.ambient.vibration**2


class AccelRunBias(Accelerometer, formulas.RunBias):
    name = "accel_run_bias"
    reference = "IEEE Std 1293, bias repeatability"
    offset: Scalar = parameter("ug", "normal(0, 50 ug)", (1, 200), "the run's own offset", spread="spread")
    spread: Scalar = parameter(
        "ug",
        "lognormal(50 ug, 1.0)",
        (1, 200),
        "the run-to-run standard deviation",
        per=("channel",),
        coarse=(300, 1000),
    )


class AccelScaleFactor(Accelerometer, formulas.ScaleFactor):
    name = "accel_scale_factor"
    confused_with = "K3 in a 1 g field"
    reference = "IEEE Std 1293, K1"
    scale: Scalar = parameter(
        "ppm", "normal(0, 2000 ppm)", (10, 300), "the relative scale factor error", coarse=(5000, 20000)
    )


class AccelScaleTemperature(Accelerometer, formulas.LinearThermalScale):
    name = "accel_scale_temperature"
    reference = "IEEE Std 1293, scale factor temperature sensitivity"
    slope: Scalar = parameter(
        "ppm/degC", "normal(0, 100 ppm/degC)", (10, 100), "the scale change per degree", coarse=(100, 300)
    )


class AccelScaleTemperatureQuadratic(Accelerometer, formulas.QuadraticThermalScale):
    name = "accel_scale_temperature_quadratic"
    reference = "IEEE Std 1293, scale factor temperature sensitivity"
    curvature: Scalar = parameter(
        "ppm/degC^2", "normal(0, 1 ppm/degC^2)", (0.01, 2), "the scale change per degree squared", coarse=(3, 10)
    )


class AccelDeadZone(Accelerometer, formulas.DeadZone):
    name = "accel_dead_zone"
    confused_with = "the bias if the input axis points up in all runs"
    reference = "IEEE Std 1293, dead band and threshold"
    half_width: Scalar = parameter(
        "ug", "halfnormal(20 ug)", (0.1, 100), "half the width of the zone", coarse=(200, 1000)
    )

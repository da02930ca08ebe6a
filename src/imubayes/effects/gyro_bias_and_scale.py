"""Bias and scale factor of a gyro, over temperature and time, and its dead zone."""

from imubayes.array_shapes import Scalar
from imubayes.effects.shared_formulas import (
    BiasDrift,
    ConstantBias,
    DeadZone,
    Gyro,
    LinearThermalBias,
    LinearThermalScale,
    QuadraticThermalBias,
    QuadraticThermalScale,
    RunBias,
    ScaleFactor,
    ThermalHysteresis,
    ThermalLag,
    ThermalRateBias,
    WarmUp,
)
from imubayes.parameters.parameter_declarations import parameter, thermal_play, time_constant


class GyroBias(Gyro, ConstantBias):
    name = "gyro_bias"
    confused_with = "run offsets, where every run has its own"
    reference = "IEEE Std 952, bias (D_F)"
    bias: Scalar = parameter(
        "deg/h", "normal(0, 3600 deg/h)", (0.01, 1800), "the constant rate offset", coarse=(3600, 36000)
    )


class GyroBiasTemperature(Gyro, LinearThermalBias):
    name = "gyro_bias_temperature"
    reference = "IEEE Std 952, bias temperature sensitivity"
    slope: Scalar = parameter(
        "deg/h/degC", "normal(0, 20 deg/h/degC)", (0.001, 60), "the bias per degree", coarse=(60, 300)
    )


class GyroBiasTemperatureQuadratic(Gyro, QuadraticThermalBias):
    name = "gyro_bias_temperature_quadratic"
    reference = "IEEE Std 952, bias temperature sensitivity"
    curvature: Scalar = parameter(
        "deg/h/degC^2", "normal(0, 0.5 deg/h/degC^2)", (0.0001, 2), "the bias per degree squared", coarse=(2, 10)
    )


class GyroBiasTemperatureRate(Gyro, ThermalRateBias):
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


class GyroThermalLag(Gyro, ThermalLag):
    name = "gyro_thermal_lag"
    reference = "first-order lag, IEEE Std 952 thermal model; time constants of minutes"
    coefficient: Scalar = parameter(
        "deg/h/degC", "normal(0, 20 deg/h/degC)", (0.001, 60), "the bias per degree of lag", coarse=(60, 300)
    )
    tau: Scalar = time_constant("the time constant of the lag")


class GyroThermalHysteresis(Gyro, ThermalHysteresis):
    name = "gyro_thermal_hysteresis"
    confused_with = "gyro_thermal_lag, at one ramp rate; gyro_bias_temperature, where all ramps are monotonic"
    reference = "play operator, Visintin, Differential Models of Hysteresis, ch. III; IEEE Std 952, thermal hysteresis"
    half_width: Scalar = parameter(
        "deg/h", "normal(0, 10 deg/h)", (0.01, 50), "half the height of the loop", coarse=(100, 500)
    )
    play: Scalar = thermal_play()


class GyroWarmUp(Gyro, WarmUp):
    name = "gyro_warm_up"
    reference = "IEEE Std 952, turn-on transient and warm-up"
    amplitude: Scalar = parameter(
        "deg/h", "normal(0, 20 deg/h)", (0.01, 100), "the excess bias at power-on", coarse=(200, 1000)
    )
    tau: Scalar = time_constant("the time constant")


class GyroBiasDrift(Gyro, BiasDrift):
    name = "gyro_bias_drift"
    reference = "IEEE Std 952, bias trend"
    slope: Scalar = parameter(
        "deg/h/h", "normal(0, 1 deg/h/h)", (0.0001, 10), "the change of bias per hour", coarse=(20, 100)
    )


class GyroRunBias(Gyro, RunBias):
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


class GyroScaleFactor(Gyro, ScaleFactor):
    name = "gyro_scale_factor"
    confused_with = "mounting angle and table rate error, in one mounting"
    reference = "IEEE Std 952, scale factor S"
    scale: Scalar = parameter(
        "ppm", "normal(0, 2000 ppm)", (10, 500), "the relative scale factor error", coarse=(5000, 20000)
    )


class GyroScaleTemperature(Gyro, LinearThermalScale):
    name = "gyro_scale_temperature"
    reference = "IEEE Std 952, scale factor temperature sensitivity"
    slope: Scalar = parameter(
        "ppm/degC", "normal(0, 100 ppm/degC)", (10, 100), "the scale change per degree", coarse=(100, 300)
    )


class GyroScaleTemperatureQuadratic(Gyro, QuadraticThermalScale):
    name = "gyro_scale_temperature_quadratic"
    reference = "IEEE Std 952, scale factor temperature sensitivity"
    curvature: Scalar = parameter(
        "ppm/degC^2", "normal(0, 1 ppm/degC^2)", (0.01, 2), "the scale change per degree squared", coarse=(3, 10)
    )


class GyroDeadZone(Gyro, DeadZone):
    name = "gyro_dead_zone"
    confused_with = "gyro_scale_asymmetry and the bias, where all runs rotate in one direction"
    reference = "IEEE Std 952, dead zone"
    half_width: Scalar = parameter(
        "deg/h", "halfnormal(5 deg/h)", (0.01, 50), "half the width of the zone", coarse=(50, 300)
    )

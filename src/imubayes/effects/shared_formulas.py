"""Formulas that several effects share, one class each, and the devices that they act on.

An effect combines the two: `class GyroBias(Gyro, ConstantBias)` gives a formula its name, units, priors and source.
"""

from abc import abstractmethod
from dataclasses import replace
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from imubayes.effects.base import Decay, Effect, MotionEffect, Order, Play, RecordEffect, SignalEffect, Stage
from imubayes.foundations.arrays import Scalar, Vector3, compose, exponential, vector3
from imubayes.foundations.covariates import ROW_SLOPES
from imubayes.foundations.signal_path_state import Ambient, Motion, Sample
from imubayes.parameters.declarations import parameter, reference_temperature

Parameter = eqx.AbstractVar[Scalar]
_SLOPES = tuple(f"row_slope_{order}" for order in ROW_SLOPES)


class Device(Effect):
    """The device in the signal chain that an effect belongs to.

    A formula needs and takes the temperature of the device, whichever that is.

    Attributes
    ----------
    owner : what the covariates of the device's temperature begin with.
    """

    owner: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "name" in vars(cls):  # of a formula alone the device is not known, and a device alone needs nothing
            cls.needs = tuple(cls.owner + need if need.startswith("temperature") else need for need in cls.needs)

    @classmethod
    def temperature(cls, ambient: Ambient) -> Scalar:
        """Return the device's temperature, °C."""
        return getattr(ambient, f"{cls.owner}temperature")

    @classmethod
    def temperature_rate(cls, ambient: Ambient) -> Scalar:
        """Return the rate of the device's temperature, °C/s."""
        return getattr(ambient, f"{cls.owner}temperature_rate")


class Sensor(Device):
    """A sensor: its effects are referred to the input."""

    stage = Stage.SENSOR

    @staticmethod
    @abstractmethod
    def measurand(sample: Sample) -> Vector3:
        """Return the measurand along the sensor's nominal input axis and the two axes across it, SI."""


class Gyro(Sensor):
    """A gyro: angular rate along its axes I, O, S."""

    kinds = ("gyro",)

    @staticmethod
    def measurand(sample: Sample) -> Vector3:
        return sample.rate


class Accelerometer(Sensor):
    """An accelerometer: specific force along its axes I, O, P."""

    kinds = ("accelerometer",)

    @staticmethod
    def measurand(sample: Sample) -> Vector3:
        return sample.force


class Converter(Device):
    """The readout of a channel of either kind: its effects are in output units."""

    stage = Stage.CONVERTER
    owner = "converter_"


def input_axis_angle(axis: str) -> Any:
    """Declare a field as the angle of the true input axis toward one of the axes across the nominal one."""
    meaning = f"the misalignment toward {axis}"
    return parameter("arcsec", "normal(0, 200 arcsec)", (10, 200), meaning, coarse=(700, 4000))


class Misalignment(Sensor, SignalEffect):
    """Base of input-axis misalignments, which differ in the name of the third axis."""

    order = Order.AXIS
    confused_with = "mounting error common to all axes"
    toward_o: Scalar = input_axis_angle("O")

    def misaligned(self, signal: Scalar, sample: Sample, toward_third: Scalar) -> Scalar:
        """Return the signal along the unit vector in the direction of (1, toward_o, toward_third)."""
        norm = jnp.sqrt(1 + self.toward_o**2 + toward_third**2)
        measurand = self.measurand(sample)
        along = measurand[0]
        projected = (along + self.toward_o * measurand[1] + toward_third * measurand[2]) / norm
        # Only the projection changes: what earlier effects added stays.
        return signal + (projected - along)


class ConstantBias(SignalEffect):
    """Constant bias, referred to the input: signal + b."""

    order = Order.BIAS
    bias: Parameter

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.bias


def lagged(signal: Scalar, sample: Sample, tau: Scalar) -> Scalar:
    """Return what a signal contributes to the mean over its row behind a first-order lag, τ·dy/dt + y = x.

    y = x − τ·dx/dt + τ²·d²x/dt² − …, without the transient of what was before.  The mean of a derivative over a row is
    a sum over its instants (`row_slope_n`), so each instant has another weight.  The seventh power of τ is neglected:
    6e-5 of the input at 8 Hz and 5 ms.  Rows of a constant stimulus have no slope.
    """
    slopes = [getattr(sample.ambient, name) for name in _SLOPES]
    factor = jnp.zeros_like(signal)
    for slope in reversed(slopes):
        factor = -tau * (slope + factor)
    return signal * (1 + factor)


class BiasDrift(SignalEffect):
    """Bias linear in time: signal + c·t.

    If the runs have a `start`, t counts from the start of the campaign's first run, so that one drift spans all runs;
    otherwise it counts from the start of each run.
    """

    order = Order.BIAS
    needs = ("campaign_time",)
    confused_with = "run offsets; bias_temperature_rate and thermal_lag, in a single monotonic ramp"
    slope: Parameter

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.slope * sample.ambient.campaign_time


class RunBias(SignalEffect):
    """Offset of each run: signal + b_r with b_r ~ normal(0, spread); all runs together determine the spread.

    `run_scatter` is the same model with the offsets integrated out: use it if the offsets themselves are of no
    interest.
    """

    order = Order.BIAS
    per = ("channel", "run")
    excludes = ("run_scatter",)
    confused_with = "temperature terms, when each run has one temperature"
    offset: Parameter
    spread: Parameter

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.offset


class WarmUp(SignalEffect):
    """Bias transient after power-on: signal + A·e^(−t_on/τ)."""

    order = Order.BIAS
    needs = ("power_on",)
    confused_with = "bias_temperature, with self-heating of the unit; run offsets if runs are short against τ"
    amplitude: Parameter
    tau: Parameter

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.amplitude * jnp.exp(-sample.ambient.power_on / self.tau)


class LinearThermalBias(Device, SignalEffect):
    """Bias linear in sensor temperature: signal + c·(T − T_ref)."""

    order = Order.BIAS
    needs = ("temperature",)
    confused_with = "run offsets, when each run has one temperature"
    slope: Parameter
    reference_degC: float = reference_temperature()

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.slope * (self.temperature(sample.ambient) - self.reference_degC)


class QuadraticThermalBias(Device, SignalEffect):
    """Bias quadratic in sensor temperature: signal + c·(T − T_ref)²."""

    order = Order.BIAS
    needs = ("temperature",)
    confused_with = "run offsets, when each run has one temperature; the linear coefficient, on one side of T_ref"
    curvature: Parameter
    reference_degC: float = reference_temperature()

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.curvature * (self.temperature(sample.ambient) - self.reference_degC) ** 2


class CubicThermalBias(Device, SignalEffect):
    """Bias cubic in sensor temperature: signal + c·(T − T_ref)³."""

    order = Order.BIAS
    needs = ("temperature",)
    confused_with = "the linear and quadratic coefficients, over a narrow range; thermal_lag, in a single slow ramp"
    coefficient: Parameter
    reference_degC: float = reference_temperature()

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.coefficient * (self.temperature(sample.ambient) - self.reference_degC) ** 3


class ThermalRateBias(Device, SignalEffect):
    """Bias linear in the rate of sensor temperature: signal + c·dT/dt, a measure of gradients inside the sensor."""

    order = Order.BIAS
    needs = ("temperature_rate",)
    confused_with = "thermal_lag and bias_drift, in a single monotonic ramp: two ramp rates or a cycle separate them"
    slope: Parameter

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.slope * self.temperature_rate(sample.ambient)


class TemperatureLag(Device, RecordEffect):
    """Base of effects of the thermal lag T − T_τ, which is their memory: dT_τ/dt = (T − T_τ)/τ, T_τ = T at the start.

    T is linear between two instants, for which the lag is exact.
    """

    needs = ("temperature", "temperature_rate")
    coefficient: Parameter
    tau: Parameter

    def carry(self, before: Ambient, now: Ambient, seconds: Scalar) -> Decay:
        return Decay.lag(self.temperature(now) - self.temperature(before), seconds / self.tau)


class ThermalLag(TemperatureLag):
    """Bias linear in the thermal lag: signal + c·(T_τ − T) with dT_τ/dt = (T − T_τ)/τ, T_τ = T at the start of a run.

    If the bias of a sensor follows only its internal temperature, c equals its linear temperature coefficient of bias.
    T is taken as linear between two instants; the lag is then exact.
    """

    order = Order.BIAS
    confused_with = "bias_temperature_rate if changes are slow against τ; bias_drift, in a single monotonic ramp"

    def apply(self, signal: Scalar, sample: Sample, memory: Scalar) -> Scalar:
        return signal - self.coefficient * memory


class TemperaturePlay(Device, RecordEffect):
    """Base of effects of thermal hysteresis; their memory m follows T with play ±w: m ← clip(m + ΔT, −w, w).

    Each run begins in the middle of the loop.
    """

    needs = ("temperature", "temperature_rate")
    half_width: Parameter
    play: Parameter

    def carry(self, before: Ambient, now: Ambient, seconds: Scalar) -> Play:
        return Play(self.temperature(now) - self.temperature(before), -self.play, self.play)


class ThermalHysteresis(TemperaturePlay):
    """Thermal hysteresis of bias: signal + h·m/w, where m follows T with play ±w: m ← clip(m + ΔT, −w, w).

    After warming by more than 2w the bias is h above the middle of the loop, after cooling by as much h below it, at
    any ramp rate. Each run begins in the middle.
    """

    order = Order.BIAS

    def apply(self, signal: Scalar, sample: Sample, memory: Scalar) -> Scalar:
        return signal + self.half_width * memory / self.play


class ScaleFactor(SignalEffect):
    """Relative deviation of the scale factor from nominal: signal · (1 + s)."""

    order = Order.SCALE
    scale: Parameter

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.scale)


class LinearThermalScale(Device, SignalEffect):
    """Scale factor linear in sensor temperature: signal · (1 + c·(T − T_ref))."""

    order = Order.SCALE
    needs = ("temperature",)
    confused_with = "the converter's gain drift, without injected current"
    slope: Parameter
    reference_degC: float = reference_temperature()

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.slope * (self.temperature(sample.ambient) - self.reference_degC))


class QuadraticThermalScale(Device, SignalEffect):
    """Scale factor quadratic in sensor temperature: signal · (1 + c·(T − T_ref)²)."""

    order = Order.SCALE
    needs = ("temperature",)
    confused_with = "the converter's quadratic gain drift, without injected current"
    curvature: Parameter
    reference_degC: float = reference_temperature()

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.curvature * (self.temperature(sample.ambient) - self.reference_degC) ** 2)


class ThermalRateScale(Device, SignalEffect):
    """Scale factor linear in the rate of temperature: signal · (1 + c·dT/dt), a measure of gradients in the device."""

    order = Order.SCALE
    needs = ("temperature_rate",)
    slope: Parameter

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.slope * self.temperature_rate(sample.ambient))


class ThermalLagScale(TemperatureLag):
    """Scale factor linear in the thermal lag: signal · (1 + c·(T_τ − T)) with dT_τ/dt = (T − T_τ)/τ.

    T_τ = T at the start of a run. If the scale factor of a device follows only its internal temperature, c equals its
    linear temperature coefficient.
    """

    order = Order.SCALE

    def apply(self, signal: Scalar, sample: Sample, memory: Scalar) -> Scalar:
        return signal * (1 - self.coefficient * memory)


class ThermalHysteresisScale(TemperaturePlay):
    """Thermal hysteresis of scale factor: signal · (1 + h·m/w), m following T with play ±w: m ← clip(m + ΔT, −w, w).

    Each run begins in the middle of the loop.
    """

    order = Order.SCALE

    def apply(self, signal: Scalar, sample: Sample, memory: Scalar) -> Scalar:
        return signal * (1 + self.half_width * memory / self.play)


class ScaleAsymmetry(Sensor, SignalEffect):
    """Scale factor asymmetry: signal + S_a·|x|, S_a half the difference of the scale factors for either sign of x.

    x is the input along the true axis. Along a nominal axis at right angles to the input x would be 0, where |x| has no
    derivative.
    """

    order = Order.INPUT
    asymmetry: Parameter

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.asymmetry * jnp.abs(signal)


class SecondOrderNonlinearity(Sensor, SignalEffect):
    """Second-order nonlinearity: signal + K2·x², x the input."""

    order = Order.INPUT
    quadratic: Parameter

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.quadratic * self.measurand(sample)[0] ** 2


class ThirdOrderNonlinearity(Sensor, SignalEffect):
    """Third-order nonlinearity: signal + K3·x³, x the input."""

    order = Order.INPUT
    cubic: Parameter

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.cubic * self.measurand(sample)[0] ** 3


class DeadZone(SignalEffect):
    """Dead zone of half width b: signal − clip(signal, −b, b).

    Inputs inside the zone give no output; outside, the output is reduced by b, as by backlash.  Lock-in of a ring-laser
    gyro is different: its error decreases above the threshold.
    """

    order = Order.LIMIT
    half_width: Parameter

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        clipped = jnp.where(jnp.abs(signal) < self.half_width, signal, jnp.sign(signal) * self.half_width)
        return signal - clipped


class BodyRotation(MotionEffect):
    """Small rotation of the body at rest, C_tb = C_tb,nominal · exp([δ]×), δ = (x, y, z) in body axes."""

    stage = Stage.STAND
    x: Parameter
    y: Parameter
    z: Parameter

    def apply(self, motion: Motion, ambient: Ambient) -> Motion:
        rotation = exponential(vector3(self.x, self.y, self.z))
        return replace(motion, mounting=compose(motion.mounting, rotation))

"""Effects of the readout: ADC, current-to-frequency or voltage-to-frequency converter, and the injected current."""

import jax.numpy as jnp

from imubayes.effects import shared_formulas as formulas
from imubayes.effects.base import Order, SignalEffect
from imubayes.effects.shared_formulas import Converter
from imubayes.foundations.arrays import Scalar
from imubayes.foundations.signal_path_state import Sample
from imubayes.parameters.declarations import parameter, reference_temperature, thermal_play, time_constant


class Gain(Converter):
    """The gain of a converter."""

    order = Order.GAIN


class Offset(Converter):
    """The offset of a converter, after its gain."""

    order = Order.OFFSET


class InjectionError(Converter, SignalEffect):
    """Gain and offset error of the current source against the sensor's own current: c · (1 + g) + scale · o."""

    name = "injection_error"
    order = 0
    kinds = ("accelerometer",)
    needs = ("injection",)
    reference = "definition: relative to the nominal current_mA_per_g"
    gain: Scalar = parameter("ppm", "normal(0, 1000 ppm)", (10, 1000), "the relative error of the injected current")
    offset: Scalar = parameter("ug", "normal(0, 1 mg)", (1, 1000), "the offset of the injected current")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.gain) + self.offset * sample.output_scale


class ConverterGainDrift(Gain, formulas.LinearThermalScale):
    """Gain linear in converter temperature: signal · (1 + γ1·(T_c − T_ref))."""

    name = "converter_gain_drift"
    confused_with = "converter offset drift, with one input; the sensor's scale temperature coefficient"
    reference = "first-order thermal gain model of ADC, I/F and V/F converters"
    slope: Scalar = parameter("ppm/degC", "normal(0, 100 ppm/degC)", (1, 100), "the gain change per degree")


class ConverterGainDriftQuadratic(Gain, formulas.QuadraticThermalScale):
    """Gain quadratic in converter temperature: signal · (1 + γ2·(T_c − T_ref)²)."""

    name = "converter_gain_drift_quadratic"
    confused_with = "converter offset drift, with one input; the sensor's quadratic scale temperature coefficient"
    reference = "second-order thermal gain model of ADC, I/F and V/F converters"
    curvature: Scalar = parameter(
        "ppm/degC^2", "normal(0, 2 ppm/degC^2)", (0.01, 5), "the gain change per degree squared"
    )


class ConverterGainTemperatureRate(Gain, formulas.ThermalRateScale):
    """Gain linear in the rate of converter temperature: signal · (1 + γ·dT_c/dt)."""

    name = "converter_gain_temperature_rate"
    confused_with = "converter_gain_lag if changes are slow against τ; converter_offset_temperature_rate, one input"
    reference = "first-order lag of slow changes, gain drift times time constant: 100 ppm/degC and 10 min"
    slope: Scalar = parameter(
        "ppm/(degC/min)", "normal(0, 1000 ppm/(degC/min))", (1, 3000), "the gain change per temperature rate"
    )


class ConverterGainLag(Gain, formulas.ThermalLagScale):
    """Gain linear in the thermal lag: signal · (1 + γ·(T_τ − T_c)) with dT_τ/dt = (T_c − T_τ)/τ.

    T_τ = T_c at the start of a run. If the gain of a converter follows only its internal temperature, γ is equal to its
    gain drift.
    """

    name = "converter_gain_lag"
    confused_with = "converter_gain_temperature_rate if changes are slow against τ; converter_offset_lag, one input"
    reference = "first-order thermal network between temperature sensor and converter; size of the gain drift"
    coefficient: Scalar = parameter(
        "ppm/degC", "normal(0, 100 ppm/degC)", (1, 100), "the gain change per degree of lag"
    )
    tau: Scalar = time_constant("the time constant of the lag")


class ConverterGainHysteresis(Gain, formulas.ThermalHysteresisScale):
    """Thermal hysteresis of gain: signal · (1 + h·m/w), m following T_c with play ±w: m ← clip(m + ΔT_c, −w, w).

    Each run begins in the middle of the loop.
    """

    name = "converter_gain_hysteresis"
    confused_with = "converter_gain_lag, at one ramp rate; converter_gain_drift if all ramps are monotonic"
    reference = (
        "thermal hysteresis of voltage references, 10 to 200 ppm in data sheets; play operator, Visintin, ch. III"
    )
    half_width: Scalar = parameter("ppm", "normal(0, 100 ppm)", (1, 200), "half the height of the loop")
    play: Scalar = thermal_play()


class ConverterNonlinearity(Gain, SignalEffect):
    """Gain error that depends on the input: signal · (1 + q·signal + c·signal²), signal in output units.

    The priors are in `scale`, the nominal output for 1 deg/s or 1 g: 10 ppm/scale is 120 ppm at 12 g.  A converter
    bends by a share of its range: on a gyro, whose 400 deg/s take the place of 12 g, the change per unit is smaller.
    """

    name = "converter_nonlinearity"
    confused_with = "the sensor's own K2 and K3 or the gyro's nonlinearity (exactly, without injected current)"
    reference = "transfer curve of ADC, I/F and V/F converters; IEEE Std 1241, integral nonlinearity"
    quadratic: Scalar = parameter(
        "ppm/output", "normal(0, 10 ppm/scale)", (0.1, 100), "the gain change per output",
        of_gyro=("normal(0, 0.3 ppm/scale)", (0.003, 3)),
    )  # fmt: skip
    cubic: Scalar = parameter(
        "ppm/output^2", "normal(0, 1 ppm/scale^2)", (0.01, 10), "the gain change per output squared",
        of_gyro=("normal(0, 0.001 ppm/scale^2)", (1e-5, 1e-2)),
    )  # fmt: skip

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.quadratic * signal + self.cubic * signal**2)


class ConverterOffsetDrift(Offset, formulas.LinearThermalBias):
    """Offset linear in converter temperature: signal + o1·(T_c − T_ref)."""

    name = "converter_offset_drift"
    confused_with = "converter gain drift, with one input; the sensor's bias temperature coefficient"
    reference = "first-order thermal offset model of ADC, I/F and V/F converters"
    slope: Scalar = parameter("output/degC", "normal(0, 1e-4 scale/degC)", (1e-6, 1e-3), "the offset per degree")


class ConverterOffsetDriftQuadratic(Offset, formulas.QuadraticThermalBias):
    """Offset quadratic in converter temperature: signal + o2·(T_c − T_ref)²."""

    name = "converter_offset_drift_quadratic"
    confused_with = "converter_leakage; converter gain drift, with one input"
    reference = "second-order thermal offset model of ADC, I/F and V/F converters"
    curvature: Scalar = parameter(
        "output/degC^2", "normal(0, 1e-5 scale/degC^2)", (1e-8, 1e-4), "the offset per degree squared"
    )


class ConverterOffsetTemperatureRate(Offset, formulas.ThermalRateBias):
    """Offset linear in the rate of converter temperature: signal + o·dT_c/dt."""

    name = "converter_offset_temperature_rate"
    confused_with = "converter_offset_lag if changes are slow against τ; bias_drift, in a single monotonic ramp"
    reference = "thermoelectric voltages across gradients; offset drift times time constant: 1e-4 scale/degC and 10 min"
    slope: Scalar = parameter(
        "output/(degC/min)", "normal(0, 1e-3 scale/(degC/min))", (1e-5, 1e-2), "the offset per temperature rate"
    )


class ConverterOffsetLag(Offset, formulas.ThermalLag):
    """Offset linear in the thermal lag: signal + o·(T_τ − T_c) with dT_τ/dt = (T_c − T_τ)/τ.

    T_τ = T_c at the start of a run. If the offset of a converter follows only its internal temperature, o is equal to
    its offset drift.
    """

    name = "converter_offset_lag"
    confused_with = "converter_offset_temperature_rate if changes are slow against τ; converter_gain_lag, one input"
    reference = "first-order thermal network between temperature sensor and converter; size of the offset drift"
    coefficient: Scalar = parameter(
        "output/degC", "normal(0, 1e-4 scale/degC)", (1e-6, 1e-3), "the offset per degree of lag"
    )
    tau: Scalar = time_constant("the time constant of the lag")


class ConverterOffsetHysteresis(Offset, formulas.ThermalHysteresis):
    """Thermal hysteresis of offset: signal + h·m/w, m following T_c with play ±w: m ← clip(m + ΔT_c, −w, w).

    Each run begins in the middle of the loop.
    """

    name = "converter_offset_hysteresis"
    confused_with = "converter_offset_lag, at one ramp rate; converter_offset_drift if all ramps are monotonic"
    reference = "play operator, Visintin, Differential Models of Hysteresis, ch. III; offset drift over a few degrees"
    half_width: Scalar = parameter("output", "normal(0, 1e-3 scale)", (1e-6, 1e-2), "half the height of the loop")
    play: Scalar = thermal_play()


class ConverterLeakage(Offset, SignalEffect):
    """Offset exponential in converter temperature: signal + L·(2^((T_c − T_ref)/D) − 1).

    A junction in silicon has D of about 10 °C; the leakage at T_ref itself is bias.
    """

    name = "converter_leakage"
    needs = ("converter_temperature",)
    confused_with = "converter_offset_drift and its quadratic, over a narrow range of temperature"
    reference = "reverse current of a p–n junction, doubling every 10 °C"
    leakage: Scalar = parameter("output", "normal(0, 1e-4 scale)", (1e-6, 1e-3), "the leakage at T_ref")
    doubling: Scalar = parameter(
        "degC",
        "lognormal(10 degC, 0.3)",
        (5, 20),
        "the temperature rise that doubles the leakage",
        null=10.0,
        shape=(6.0, 8.0, 10.0, 14.0),
    )
    reference_degC: float = reference_temperature()

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        warmer = (sample.ambient.converter_temperature - self.reference_degC) / self.doubling
        return signal + self.leakage * jnp.expm1(jnp.log(2.0) * warmer)


class ConverterWarmUp(Offset, formulas.WarmUp):
    """Offset transient after power-on: signal + A·e^(−t_on/τ)."""

    name = "converter_warm_up"
    confused_with = "the sensor's warm-up, without injected current; converter_offset_drift, with self-heating"
    reference = "turn-on transient of ADC, I/F and V/F converters"
    amplitude: Scalar = parameter("output", "normal(0, 1e-3 scale)", (1e-6, 1e-2), "the excess offset at power-on")
    tau: Scalar = time_constant("the time constant")


class ConverterDeadZone(Converter, formulas.DeadZone):
    name = "converter_dead_zone"
    confused_with = "the sensor's own dead zone, without injected current"
    reference = "dead zone of bipolar I/F and V/F converters about zero"
    half_width: Scalar = parameter("output", "halfnormal(1e-4 scale)", (1e-6, 1e-3), "half the width of the zone")


class ConverterSaturation(Converter, SignalEffect):
    """Compression beyond a limit: signal − k·sign(signal)·max(|signal| − limit, 0); k = 1 is a hard stop.

    The limit is in `scale`, the nominal output for 1 deg/s or 1 g.
    """

    name = "converter_saturation"
    order = Order.LIMIT
    confused_with = "cubic nonlinearity of sensor or converter"
    reference = "full-scale range of ADC, I/F and V/F converters; IEEE Std 1241, clipping"
    compression: Scalar = parameter("%", "halfnormal(50 %)", (0.01, 100), "the fraction lost beyond the limit")
    limit: Scalar = parameter(
        "scale",
        "lognormal(30 scale, 1.5)",
        (1, 1000),
        "the output at which compression begins",
        null=1.0,
        shape=(1.0, 3.0, 10.0, 30.0, 100.0, 300.0),
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        excess = jnp.maximum(jnp.abs(signal) - self.limit, 0.0)
        return signal - self.compression * jnp.sign(signal) * excess

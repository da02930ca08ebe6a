"""The effects: one physical cause each.  A new one is a class in a file of its own and one line here."""

from imubayes.effects.accel_bias import AccelBias
from imubayes.effects.accel_bias_drift import AccelBiasDrift
from imubayes.effects.accel_bias_temperature import AccelBiasTemperature
from imubayes.effects.accel_bias_temperature_quadratic import AccelBiasTemperatureQuadratic
from imubayes.effects.accel_bias_temperature_rate import AccelBiasTemperatureRate
from imubayes.effects.accel_cross_axis_quadratic import AccelCrossAxisQuadratic
from imubayes.effects.accel_cross_coupling import AccelCrossCoupling
from imubayes.effects.accel_cubic import AccelCubic
from imubayes.effects.accel_dead_zone import AccelDeadZone
from imubayes.effects.accel_misalignment import AccelMisalignment
from imubayes.effects.accel_odd_quadratic import AccelOddQuadratic
from imubayes.effects.accel_quadratic import AccelQuadratic
from imubayes.effects.accel_run_bias import AccelRunBias
from imubayes.effects.accel_scale_asymmetry import AccelScaleAsymmetry
from imubayes.effects.accel_scale_factor import AccelScaleFactor
from imubayes.effects.accel_scale_temperature import AccelScaleTemperature
from imubayes.effects.accel_scale_temperature_quadratic import AccelScaleTemperatureQuadratic
from imubayes.effects.accel_thermal_lag import AccelThermalLag
from imubayes.effects.accel_vibration_rectification import AccelVibrationRectification
from imubayes.effects.accel_warm_up import AccelWarmUp
from imubayes.effects.base import Effect, MotionEffect, Order, PlaceEffect, RecordEffect, SignalEffect, Stage
from imubayes.effects.converter_dead_zone import ConverterDeadZone
from imubayes.effects.converter_gain_drift import ConverterGainDrift
from imubayes.effects.converter_gain_drift_quadratic import ConverterGainDriftQuadratic
from imubayes.effects.converter_leakage import ConverterLeakage
from imubayes.effects.converter_nonlinearity import ConverterNonlinearity
from imubayes.effects.converter_offset_drift import ConverterOffsetDrift
from imubayes.effects.converter_offset_drift_quadratic import ConverterOffsetDriftQuadratic
from imubayes.effects.converter_saturation import ConverterSaturation
from imubayes.effects.converter_warm_up import ConverterWarmUp
from imubayes.effects.encoder_harmonic import EncoderHarmonic
from imubayes.effects.gravity_anomaly import GravityAnomaly
from imubayes.effects.gyro_bias import GyroBias
from imubayes.effects.gyro_bias_drift import GyroBiasDrift
from imubayes.effects.gyro_bias_temperature import GyroBiasTemperature
from imubayes.effects.gyro_bias_temperature_quadratic import GyroBiasTemperatureQuadratic
from imubayes.effects.gyro_bias_temperature_rate import GyroBiasTemperatureRate
from imubayes.effects.gyro_dead_zone import GyroDeadZone
from imubayes.effects.gyro_g2_sensitivity import GyroG2Sensitivity
from imubayes.effects.gyro_g_sensitivity import GyroGSensitivity
from imubayes.effects.gyro_magnetic_sensitivity import GyroMagneticSensitivity
from imubayes.effects.gyro_misalignment import GyroMisalignment
from imubayes.effects.gyro_output_axis_acceleration import GyroOutputAxisAcceleration
from imubayes.effects.gyro_run_bias import GyroRunBias
from imubayes.effects.gyro_scale_asymmetry import GyroScaleAsymmetry
from imubayes.effects.gyro_scale_cubic import GyroScaleCubic
from imubayes.effects.gyro_scale_factor import GyroScaleFactor
from imubayes.effects.gyro_scale_g_dependence import GyroScaleGDependence
from imubayes.effects.gyro_scale_quadratic import GyroScaleQuadratic
from imubayes.effects.gyro_scale_temperature import GyroScaleTemperature
from imubayes.effects.gyro_scale_temperature_quadratic import GyroScaleTemperatureQuadratic
from imubayes.effects.gyro_thermal_hysteresis import GyroThermalHysteresis
from imubayes.effects.gyro_thermal_lag import GyroThermalLag
from imubayes.effects.gyro_warm_up import GyroWarmUp
from imubayes.effects.injection_error import InjectionError
from imubayes.effects.lever_arm import LeverArm
from imubayes.effects.mounting_error import MountingError
from imubayes.effects.pose_attitude import PoseAttitude
from imubayes.effects.reference_alignment import ReferenceAlignment
from imubayes.effects.reference_bias import ReferenceBias
from imubayes.effects.reference_scale_factor import ReferenceScaleFactor
from imubayes.effects.servo_start import ServoStart
from imubayes.effects.table_axis_tilt import TableAxisTilt
from imubayes.effects.table_rate_error import TableRateError
from imubayes.effects.table_wobble import TableWobble
from imubayes.effects.time_skew import TimeSkew
from imubayes.effects.tumble_heading import TumbleHeading

EFFECTS: tuple[type[Effect], ...] = (
    TableAxisTilt,
    GravityAnomaly,
    TimeSkew,
    EncoderHarmonic,
    TableRateError,
    TableWobble,
    ReferenceBias,
    ReferenceScaleFactor,
    ReferenceAlignment,
    TumbleHeading,
    MountingError,
    PoseAttitude,
    ServoStart,
    LeverArm,
    GyroMisalignment,
    GyroGSensitivity,
    GyroG2Sensitivity,
    GyroScaleAsymmetry,
    GyroScaleQuadratic,
    GyroScaleCubic,
    GyroScaleGDependence,
    GyroMagneticSensitivity,
    GyroOutputAxisAcceleration,
    GyroBias,
    GyroBiasTemperature,
    GyroBiasTemperatureQuadratic,
    GyroBiasTemperatureRate,
    GyroThermalLag,
    GyroThermalHysteresis,
    GyroWarmUp,
    GyroBiasDrift,
    GyroRunBias,
    GyroScaleFactor,
    GyroScaleTemperature,
    GyroScaleTemperatureQuadratic,
    GyroDeadZone,
    AccelMisalignment,
    AccelQuadratic,
    AccelCubic,
    AccelOddQuadratic,
    AccelCrossCoupling,
    AccelCrossAxisQuadratic,
    AccelScaleAsymmetry,
    AccelBias,
    AccelBiasTemperature,
    AccelBiasTemperatureQuadratic,
    AccelBiasTemperatureRate,
    AccelThermalLag,
    AccelWarmUp,
    AccelBiasDrift,
    AccelVibrationRectification,
    AccelRunBias,
    AccelScaleFactor,
    AccelScaleTemperature,
    AccelScaleTemperatureQuadratic,
    AccelDeadZone,
    InjectionError,
    ConverterGainDrift,
    ConverterGainDriftQuadratic,
    ConverterNonlinearity,
    ConverterOffsetDrift,
    ConverterOffsetDriftQuadratic,
    ConverterLeakage,
    ConverterWarmUp,
    ConverterDeadZone,
    ConverterSaturation,
)

__all__ = ["EFFECTS", "Effect", "MotionEffect", "Order", "PlaceEffect", "RecordEffect", "SignalEffect", "Stage"]

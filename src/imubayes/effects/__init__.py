"""The effects: one physical cause each.  A new one is a class in a file of its own and one line here."""

from imubayes.effects.accel_bias import AccelBias
from imubayes.effects.accel_bias_temperature import AccelBiasTemperature
from imubayes.effects.accel_misalignment import AccelMisalignment
from imubayes.effects.accel_quadratic import AccelQuadratic
from imubayes.effects.accel_run_bias import AccelRunBias
from imubayes.effects.accel_scale_factor import AccelScaleFactor
from imubayes.effects.accel_scale_temperature import AccelScaleTemperature
from imubayes.effects.base import Effect, MotionEffect, Order, PlaceEffect, RecordEffect, SignalEffect, Stage
from imubayes.effects.converter_gain_drift import ConverterGainDrift
from imubayes.effects.converter_offset_drift import ConverterOffsetDrift
from imubayes.effects.gyro_bias import GyroBias
from imubayes.effects.gyro_bias_temperature import GyroBiasTemperature
from imubayes.effects.gyro_g_sensitivity import GyroGSensitivity
from imubayes.effects.gyro_misalignment import GyroMisalignment
from imubayes.effects.gyro_run_bias import GyroRunBias
from imubayes.effects.gyro_scale_factor import GyroScaleFactor
from imubayes.effects.gyro_scale_temperature import GyroScaleTemperature
from imubayes.effects.injection_error import InjectionError
from imubayes.effects.lever_arm import LeverArm
from imubayes.effects.mounting_error import MountingError
from imubayes.effects.pose_attitude import PoseAttitude
from imubayes.effects.table_axis_tilt import TableAxisTilt
from imubayes.effects.table_rate_error import TableRateError
from imubayes.effects.tumble_heading import TumbleHeading

EFFECTS: tuple[type[Effect], ...] = (
    TableAxisTilt,
    TableRateError,
    TumbleHeading,
    MountingError,
    PoseAttitude,
    LeverArm,
    GyroMisalignment,
    GyroGSensitivity,
    GyroBias,
    GyroBiasTemperature,
    GyroRunBias,
    GyroScaleFactor,
    GyroScaleTemperature,
    AccelMisalignment,
    AccelQuadratic,
    AccelBias,
    AccelBiasTemperature,
    AccelRunBias,
    AccelScaleFactor,
    AccelScaleTemperature,
    InjectionError,
    ConverterGainDrift,
    ConverterOffsetDrift,
)

__all__ = ["EFFECTS", "Effect", "MotionEffect", "Order", "PlaceEffect", "RecordEffect", "SignalEffect", "Stage"]

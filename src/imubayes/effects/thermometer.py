"""Errors of the temperatures that a campaign states or records: of a thermometer, or of a run without one."""

from typing import ClassVar

from imubayes.effects.base import AmbientEffect, Order, Stage
from imubayes.foundations.arrays import Scalar
from imubayes.foundations.covariates import COVARIATES
from imubayes.foundations.signal_path_state import Ambient
from imubayes.parameters.declarations import parameter


class UncertainTemperature(AmbientEffect):
    """An error of a temperature that runs state or record.

    Thermal memories follow changes of the recorded temperature and stay as they are.

    Attributes
    ----------
    covariate : the temperature that is in error, as `imubayes.foundations.covariates.COVARIATES` names it.
    """

    stage, order = Stage.TABLE, Order.CIRCUMSTANCES
    nuisance = True
    covariate: ClassVar[str]


class TemperatureOffset(UncertainTemperature):
    """True temperature = stated or recorded one + δ, the same δ in all rows of a run.

    Rates of temperature follow changes of temperature and stay as they are.
    """

    per = ("run",)
    reference = "JCGM 100 (GUM) § 4.3 and F.2.4.5, uncorrected temperature of the test; 0.1 … 20 °C"
    offset: Scalar

    def true_ambient(self, ambient: Ambient) -> Ambient:
        return ambient.updated(**{self.covariate: getattr(ambient, self.covariate) + self.offset})


class ThermometerError(TemperatureOffset):
    """True temperature T + δ: T as stated or recorded, and the same δ in all rows of a run.

    The prior of δ is normal, with the `temperature_uncertainty_degC` that the run states; without one, δ = 0. If a run
    states an uncertainty, every model with effects of temperature includes this effect, listed or not.
    """

    name = "thermometer_error"
    needs = ("temperature",)
    covariate = "temperature"
    confused_with = "gyro_run_bias and accel_run_bias if one coefficient alone depends on temperature"
    offset: Scalar = parameter(
        "degC", "normal(0, 1 degC)", (0.1, 20), "the true minus the stated temperature", "temperature"
    )


class ConverterThermometerError(TemperatureOffset):
    """True temperature T_c + δ of the converter: T_c as stated or recorded, and the same δ in a whole run.

    The prior of δ is normal, with the `converter_temperature_uncertainty_degC` of the run; see `thermometer_error`.
    """

    name = "converter_thermometer_error"
    needs = ("converter_temperature",)
    covariate = "converter_temperature"
    confused_with = "thermometer_error if only one gain or offset, of one channel, depends on temperature"
    offset: Scalar = parameter(
        "degC", "normal(0, 1 degC)", (0.1, 20), "the true minus the stated temperature of the converter",
        "converter_temperature",
    )  # fmt: skip


class SharedThermometer(UncertainTemperature):
    """True temperature = reading T + δ + γ·(T − 25 °C), the same δ and γ in all runs read by one thermometer.

    The rate of change of the temperature is larger by γ, too.
    """

    reference = "JCGM 100 (GUM) § 4.3 and F.1.2.3, one instrument for several readings; IEC 60751, tolerance classes"
    offset: Scalar
    gain: Scalar

    def true_ambient(self, ambient: Ambient) -> Ambient:
        reading, rate = getattr(ambient, self.covariate), f"{self.covariate}_rate"
        changed = {self.covariate: reading + self.offset + self.gain * (reading - COVARIATES[self.covariate].centre)}
        if rate in ambient.values:
            changed[rate] = getattr(ambient, rate) * (1 + self.gain)
        return ambient.updated(**changed)


class ThermometerCalibration(SharedThermometer):
    """True temperature T + δ + γ·(T − 25 °C) at the reading T, with one δ and γ for all runs of a thermometer.

    The priors are normal, with the uncertainties that the `[[thermometer]]` of these runs states; an error without a
    stated uncertainty is 0. If a thermometer states one, every model with effects of temperature includes this effect,
    listed or not. The error of a single run is `thermometer_error`, in addition.
    """

    name = "thermometer_calibration"
    needs = ("temperature",)
    per = ("thermometer",)
    covariate = "temperature"
    confused_with = (
        "gyro_bias and accel_bias: an offset changes them by the offset times their temperature coefficients"
    )
    offset: Scalar = parameter(
        "degC", "normal(0, 1 degC)", (0.01, 5), "the true minus the indicated temperature at 25 °C",
        "thermometer offset",
    )  # fmt: skip
    gain: Scalar = parameter(
        "%",
        "normal(0, 0.3 %)",
        (0.01, 2),
        "the true minus the indicated change of temperature, relative",
        "thermometer gain",
    )


class ConverterThermometerCalibration(SharedThermometer):
    """True temperature T_c + δ + γ·(T_c − 25 °C) of the converter, one δ and γ for all runs of a thermometer.

    The priors are those of the `[[thermometer]]` that runs name as `converter_thermometer`; see
    `thermometer_calibration`.
    """

    name = "converter_thermometer_calibration"
    needs = ("converter_temperature",)
    per = ("converter_thermometer",)
    covariate = "converter_temperature"
    confused_with = "thermometer_calibration if only one gain or offset, of one channel, depends on temperature"
    offset: Scalar = parameter(
        "degC", "normal(0, 1 degC)", (0.01, 5), "the true minus the indicated temperature of the converter at 25 °C",
        "converter_thermometer offset",
    )  # fmt: skip
    gain: Scalar = parameter(
        "%", "normal(0, 0.3 %)", (0.01, 2),
        "the true minus the indicated change of temperature of the converter, relative",
        "converter_thermometer gain",
    )  # fmt: skip

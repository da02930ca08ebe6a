"""Errors of the temperatures that a campaign states or records: of a thermometer, or of a run without one."""

from typing import ClassVar

from imubayes.effects.base import AmbientEffect, Order, Stage
from imubayes.foundations.arrays import Scalar
from imubayes.foundations.signal_path_state import Ambient
from imubayes.parameters.declarations import parameter


class TemperatureOffset(AmbientEffect):
    """True temperature = stated or recorded one + δ, the same δ in all rows of a run.

    Rates of temperature and thermal memories follow changes of temperature and stay as they are.

    Attributes
    ----------
    covariate : the temperature that is in error, as `imubayes.foundations.covariates.COVARIATES` names it.
    """

    stage, order = Stage.TABLE, Order.CIRCUMSTANCES
    per = ("run",)
    nuisance = True
    reference = "JCGM 100 (GUM) § 4.3 and F.2.4.5, uncorrected temperature of the test; 0.1 … 20 °C"
    covariate: ClassVar[str]
    offset: Scalar

    def true_ambient(self, ambient: Ambient) -> Ambient:
        return ambient.updated(**{self.covariate: getattr(ambient, self.covariate) + self.offset})


class ThermometerError(TemperatureOffset):
    """True temperature T + δ, where T was stated or recorded, with the same δ in all rows of a run.

    The prior of δ is normal, with the `temperature_uncertainty_degC` that the run states; without one, δ = 0.  A model
    with effects of temperature has it wherever a run states an uncertainty, listed or not.
    """

    name = "thermometer_error"
    needs = ("temperature",)
    covariate = "temperature"
    confused_with = "gyro_run_bias and accel_run_bias if one coefficient alone depends on temperature"
    offset: Scalar = parameter(
        "degC", "normal(0, 1 degC)", (0.1, 20), "the excess of true over stated temperature", "temperature"
    )


class ConverterThermometerError(TemperatureOffset):
    """True temperature T_c + δ of the converter, where T_c was stated or recorded, with the same δ in a whole run.

    The prior of δ is normal, with the `converter_temperature_uncertainty_degC` of the run; see `thermometer_error`.
    """

    name = "converter_thermometer_error"
    needs = ("converter_temperature",)
    covariate = "converter_temperature"
    confused_with = "thermometer_error if gain or offset of one channel alone depends on temperature"
    offset: Scalar = parameter(
        "degC", "normal(0, 1 degC)", (0.1, 20), "the excess of true over stated temperature of the converter",
        "converter_temperature",
    )  # fmt: skip

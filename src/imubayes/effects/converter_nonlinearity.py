"""Converter nonlinearity, quadratic and cubic in its input."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class ConverterNonlinearity(SignalEffect):
    """Relative error of gain that grows with the input: signal · (1 + q·signal + c·signal²), signal in output units.

    The priors are in `scale`, the nominal output for 1 deg/s or 1 g: 10 ppm/scale is 120 ppm at 12 g.
    """

    name = "converter_nonlinearity"
    stage, order = Stage.CONVERTER, Order.GAIN
    kinds = ("gyro", "accelerometer")
    confused_with = "the sensor's own K2 and K3 or the gyro's nonlinearity: exactly, without injected current"
    reference = "transfer curve of ADC, I/F and V/F converters; IEEE Std 1241, integral nonlinearity"

    quadratic: Scalar = parameter(
        "ppm/output", "normal(0, 10 ppm/scale)", (1e-06, 1000.0), "the relative change of gain per output"
    )
    cubic: Scalar = parameter(
        "ppm/output^2", "normal(0, 1 ppm/scale^2)", (1e-09, 1000.0), "the relative change of gain per output squared"
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.quadratic * signal + self.cubic * signal**2)

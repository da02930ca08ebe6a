"""Injection error: what the injected current truly stands for."""

from imubayes.effects.base import SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class InjectionError(SignalEffect):
    """Gain and offset error of the current source against the sensor's own current: c · (1 + g) + scale · o."""

    name = "injection_error"
    stage, order = Stage.CONVERTER, 0
    kinds = ("accelerometer",)
    needs = ("injection",)
    reference = "definition: relative to the nominal current_mA_per_g"

    gain: Scalar = parameter("ppm", "normal(0, 1000 ppm)", (10, 1000), "the relative error of the injected current")
    offset: Scalar = parameter("ug", "normal(0, 1 mg)", (1, 1000), "the offset of the injected current")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal * (1 + self.gain) + self.offset * sample.output_scale

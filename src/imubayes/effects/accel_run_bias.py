"""Run-to-run bias of the accelerometer, each run with its own offset."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class AccelRunBias(SignalEffect):
    """Offset of each run, signal + b_r with b_r ~ normal(0, spread): the spread is learnt from all runs together.

    `run_scatter` says the same with the offsets integrated out: choose it where the offsets themselves are of no
    interest.
    """

    name = "accel_run_bias"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("accelerometer",)
    per = ("channel", "run")
    excludes = ("run_scatter",)
    confused_with = "temperature terms, when each run has one temperature"
    reference = "IEEE Std 1293, bias repeatability"

    offset: Scalar = parameter("ug", "normal(0, 50 ug)", (1, 200), "the run's own offset", spread="spread")
    spread: Scalar = parameter(
        "ug", "lognormal(50 ug, 1.0)", (1, 200), "the run-to-run standard deviation", per=("channel",)
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.offset

"""Run-to-run bias of the gyro, each run with its own offset."""

from imubayes.effects.base import Order, SignalEffect, Stage
from imubayes.parameters.parameter import parameter
from imubayes.stimulus import Sample
from imubayes.types import Scalar


class GyroRunBias(SignalEffect):
    """Offset of each run, signal + b_r with b_r ~ normal(0, spread): the spread is learnt from all runs together.

    `run_scatter` says the same with the offsets integrated out: choose it where the offsets themselves are of no
    interest.
    """

    name = "gyro_run_bias"
    stage, order = Stage.SENSOR, Order.BIAS
    kinds = ("gyro",)
    per = ("channel", "run")
    excludes = ("run_scatter",)
    confused_with = "temperature terms, when each run has one temperature"
    reference = "IEEE Std 952, bias run-to-run repeatability"

    offset: Scalar = parameter("deg/h", "normal(0, 10 deg/h)", (0.01, 100), "the run's own offset", spread="spread")
    spread: Scalar = parameter(
        "deg/h",
        "lognormal(10 deg/h, 1.0)",
        (0.01, 100),
        "the run-to-run standard deviation",
        per=("channel",),
    )

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.offset

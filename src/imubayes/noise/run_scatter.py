"""Run scatter: an offset that every run draws anew, integrated out."""

from imubayes.noise.base import SharedNoise
from imubayes.parameters.parameter import parameter
from imubayes.types import Scalar


class RunScatter(SharedNoise):
    """One offset per run and channel, b ~ normal(0, τ), integrated out: every two entries of it share variance τ²."""

    name = "run_scatter"
    kinds = ("gyro", "accelerometer")
    excludes = ("gyro_run_bias", "accel_run_bias")
    confused_with = "temperature terms, when each run has one temperature"
    reference = "IEEE Std 952 and 1293, run-to-run repeatability; random effect of a one-way layout"

    tau: Scalar = parameter(
        "output", "lognormal(0.1 noise, 1.0)", (1e-6, 1e3), "the standard deviation of the offset of a run"
    )

    def shared_variance(self) -> Scalar:
        return self.tau**2

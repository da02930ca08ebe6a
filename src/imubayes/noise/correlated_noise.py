"""Correlated noise: what scatters remembers the row before."""

from imubayes.noise.base import SeriesNoise
from imubayes.parameters.parameter import parameter
from imubayes.types import Scalar


class CorrelatedNoise(SeriesNoise):
    """Correlation φ^k between rows k apart in one run and channel: r_k = φ·r_(k−1) + √(1 − φ²)·ε_k, AR(1).

    It leaves each row's variance to the other members and says how they hang together: the scatter of white_noise,
    quantisation and rate_proportional_noise is correlated as a whole.  Rows count in the order of time; a row without a
    value leaves a gap that counts as well.
    """

    name = "correlated_noise"
    confused_with = "run_scatter, where runs are short; a drift or a lag that the model lacks"
    reference = "IEEE Std 952, exponentially correlated (Markov) noise; Box and Jenkins, AR(1)"

    correlation: Scalar = parameter("1", "uniform(0, 0.99)", (0.05, 0.95), "the correlation of neighbouring rows")

    def of_neighbours(self) -> Scalar:
        return self.correlation

"""Quantisation: the step in which a row's value can move."""

from imubayes.noise.base import Entry, EntryNoise
from imubayes.parameters.parameter import parameter
from imubayes.types import Scalar


class Quantisation(EntryNoise):
    """Variance q²/12 of a row, whatever the number of its samples: rounding is uniform over a step q.

    q is the step of the row's value: a count of pulses over a row is off by less than one pulse, and its mean rate by
    less than one pulse over the row's length.  Rounding of single samples that is averaged, where noise is wider than
    the step, is white noise and belongs there.
    """

    name = "quantisation"
    confused_with = "white_noise, where all rows have equally many samples"
    reference = "IEEE Std 952, quantization noise; GUM § F.2.2.1"

    q: Scalar = parameter("output", "lognormal(0.3 noise, 1.0)", (1e-6, 1e3), "the step of a row's value")

    def variance(self, entry: Entry) -> Scalar:
        return self.q**2 / 12

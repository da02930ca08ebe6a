"""The noise: the covariance and the distribution of what the model does not predict.

A new component is one class with a `name` in `imubayes.noise.components`, or beside it.
"""

from imubayes.noise import components, hand_components
from imubayes.noise.components import EntryNoise, Noise, SeriesNoise, SharedNoise, SlowNoise, TailNoise
from imubayes.parameters.declarations import named_in

NOISES: tuple[type[Noise], ...] = (*named_in(components, Noise), *named_in(hand_components, Noise))

__all__ = ["NOISES", "EntryNoise", "Noise", "SeriesNoise", "SharedNoise", "SlowNoise", "TailNoise"]

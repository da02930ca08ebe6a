"""The noise: the covariance and the distribution of what the model does not predict.

A new component is one class with a `name` in `imubayes.noise.components` or `imubayes.noise.slow_components`.
"""

from imubayes.noise import components, slow_components
from imubayes.noise.base import EntryNoise, Noise, SeriesNoise, SharedNoise, SlowNoise, TailNoise
from imubayes.parameters.parameter_declarations import named_in

NOISES: tuple[type[Noise], ...] = (*named_in(components, Noise), *named_in(slow_components, Noise))

__all__ = ["NOISES", "EntryNoise", "Noise", "SeriesNoise", "SharedNoise", "SlowNoise", "TailNoise"]

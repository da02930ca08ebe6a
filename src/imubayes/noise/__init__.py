"""The noise: what scatters without a cause that the model names."""

from imubayes.noise.base import EntryNoise, Noise, SeriesNoise, SharedNoise, TailNoise
from imubayes.noise.correlated_noise import CorrelatedNoise
from imubayes.noise.outliers import Outliers
from imubayes.noise.quantisation import Quantisation
from imubayes.noise.rate_proportional_noise import RateProportionalNoise
from imubayes.noise.reference_noise import ReferenceNoise
from imubayes.noise.rotation_closure import RotationClosure
from imubayes.noise.run_scatter import RunScatter
from imubayes.noise.white_noise import WhiteNoise

NOISES: tuple[type[Noise], ...] = (
    WhiteNoise,
    RateProportionalNoise,
    ReferenceNoise,
    Quantisation,
    CorrelatedNoise,
    Outliers,
    RunScatter,
    RotationClosure,
)

__all__ = ["NOISES", "EntryNoise", "Noise", "SeriesNoise", "SharedNoise", "TailNoise"]

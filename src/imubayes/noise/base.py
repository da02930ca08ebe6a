"""What a noise member is: a variance, of one entry alone or of a whole run and channel; a correlation; a heavy tail.

The covariance of the data is Σ = D^½ R D^½ + Σ_g T_g 1 1ᵀ: D is diagonal, the sum of the members' variances, R is the
correlation along the rows of each run and channel g (I where no member correlates), and T_g is the variance of what all
entries of g have in common.  Under a heavy tail what an entry has alone follows Student's t of the scale D^½ instead of
a normal law.  The parameters of noise are hyperparameters: they change the width of the posterior, not the predicted
output.
"""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx

from imubayes.types import Scalar, Scalars


class Entry(eqx.Module):
    """What is known of one measured value besides the value.

    Attributes
    ----------
    samples : number of raw samples in the mean.
    rate : size of the nominal table rate along a gyro's input axis in output units, 0 for all else.
    reference : size of a gyro's nominal scale in a run beside a reference gyro, output units per rad/s, 0 for all else.
    """

    samples: Scalars
    rate: Scalars
    reference: Scalars


class Noise(eqx.Module):
    """Base of all noise members; `kinds` says what it applies to (gyro, accelerometer, angle, closure)."""

    name: ClassVar[str]
    per: ClassVar[tuple[str, ...]] = ("channel",)
    kinds: ClassVar[tuple[str, ...]] = ("gyro", "accelerometer", "angle")
    needs: ClassVar[tuple[str, ...]] = ()
    excludes: ClassVar[tuple[str, ...]] = ()
    confused_with: ClassVar[str] = ""
    reference: ClassVar[str] = ""
    nuisance: ClassVar[bool] = False


class EntryNoise(Noise):
    """Independent from entry to entry."""

    @abstractmethod
    def variance(self, entry: Entry) -> Scalar:
        """Return the variance of one entry, output units squared."""


class SharedNoise(Noise):
    """Common to all entries of one run and channel."""

    @abstractmethod
    def shared_variance(self) -> Scalar:
        """Return the variance of what the entries have in common, output units squared."""


class SeriesNoise(Noise):
    """Correlated from row to row within one run and channel: what is independent otherwise becomes AR(1)."""

    @abstractmethod
    def of_neighbours(self) -> Scalar:
        """Return the correlation of an entry with that of the row before, in (−1, 1)."""


class TailNoise(Noise):
    """Heavy tails: what each reading of a run and channel has alone follows Student's t instead of a normal law.

    The variances of the other members are then the square of its scale.
    """

    @abstractmethod
    def degrees(self) -> Scalar:
        """Return the degrees of freedom, above 0; a normal law has infinitely many."""

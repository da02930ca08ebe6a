"""What a component of the noise is: a variance, per entry or per run and channel, a correlation or a heavy tail.

The covariance of the data is Σ = D^½ R D^½ + S + Σ_g T_g 1 1ᵀ: D is diagonal, the sum of the components' variances, R
is the correlation along the rows of each run and channel g (I without autocorrelation), S is the covariance of slow
noise, and T_g is the variance that all entries of g share.  With heavy tails the independent part of an entry follows
Student's t of scale D^½ instead of a normal law.  The parameters of noise are hyperparameters: they change the width
of the posterior, not the predicted output.
"""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx

from imubayes.array_shapes import Array, Float, Scalar, Scalars


class Entry(eqx.Module):
    """Facts about one measured value that its variance depends on.

    Attributes
    ----------
    samples : number of raw samples in the mean.
    rate : magnitude of the nominal table rate along a gyro's input axis in output units, 0 for all else.
    reference : magnitude of a gyro's nominal scale in a run beside a reference gyro, output units per rad/s, 0 for all
        else.
    """

    samples: Scalars
    rate: Scalars
    reference: Scalars


class Noise(eqx.Module):
    """Base of all noise components; `kinds` says what it applies to (gyro, accelerometer, angle, closure)."""

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
        """Return the variance of the common offset, output units squared."""


class SeriesNoise(Noise):
    """Autocorrelated within one run and channel: the independent noise becomes AR(1)."""

    @abstractmethod
    def lag_one_correlation(self) -> Scalar:
        """Return the correlation of an entry with that of the row before, in (−1, 1)."""


class RowSpan(eqx.Module):
    """The time that a row averages over.

    Attributes
    ----------
    start : of the row, since the start of its run, s.
    length : of the row, s.
    gap : between the end of the row before in the same run and channel and the start, s; ∞ for the first row.
    times : shape (J,), equally spaced logarithms from half the shortest row to the longest run, s; the same for all.
    """

    start: Scalars
    length: Scalars
    gap: Scalars
    times: Float[Array, " J"]


class StateCovariance(eqx.Module):
    """Covariance of a row, or of many, with the rows of its run and channel, through J independently decaying states.

    With m the mean of a row, c its covariance with the states at its end, and a, k the decay of the states over the
    gap before a row and over the row, rows i < j have the covariance Σ c_i a_(i+1) k_(i+1) a_(i+2) … a_j m_j.

    Attributes
    ----------
    variance : of the mean over the row, output units squared.
    mean : shape (…, J), mean over the row per unit of the states at its start.
    end : shape (…, J), covariance of the mean over the row with the states at its end, output units squared.
    over_gap, over_row : shape (…, J), decay of the states over the gap before the row, and over the row.
    """

    variance: Scalars
    mean: Float[Array, "*rows J"]
    end: Float[Array, "*rows J"]
    over_gap: Float[Array, "*rows J"]
    over_row: Float[Array, "*rows J"]


class SlowNoise(Noise):
    """Noise in continuous time, correlated between the rows of one run and channel; runs are independent."""

    @abstractmethod
    def states(self, row: RowSpan) -> StateCovariance:
        """Return the covariance of one row with those of its run and channel."""


class TailNoise(Noise):
    """Heavy tails: the independent noise of a run and channel follows Student's t instead of a normal law.

    The variances of the other components are then the square of its scale.
    """

    @abstractmethod
    def degrees(self) -> Scalar:
        """Return the degrees of freedom, above 0; a normal law has infinitely many."""

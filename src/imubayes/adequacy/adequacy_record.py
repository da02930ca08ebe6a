"""Records of the adequacy of a fit: noise against what is known, runs that others do not predict, χ²."""

import math
from dataclasses import dataclass
from typing import Literal

from imubayes.foundations.records import Record
from imubayes.foundations.wrong_records import WrongRecord

_NOISE_CONTRADICTED_P = 0.005
"""A scale that exceeds what is known with less than this p-value, all comparisons together (Holm), contradicts it, and
no model is adequate.  Convention: half of the budget for noise, because an excess that matters is far beyond; larger
gives false alarms."""
NOISE_AGREES = 1.05
"""A ratio of fitted to recorded noise up to this is agreement, whatever its uncertainty.  Convention: the standard
deviation of samples is rounded, and the stimulus varies a little within a row.  Larger hides weak structure."""
_NOISE_TOLD, NOISE_TOLD_SD = 1.3, 3.0
"""A ratio beyond this, or below its inverse, is reported if it exceeds so many standard uncertainties.  Convention."""

NoiseKind = Literal[
    "autocorrelation", "low_frequency", "scatter_between_runs", "grows_with_input", "heavy_tails", "quantisation"
]
# `channel`: as stated by the channel, in diagnoses of earlier versions.
NoiseSource = Literal["samples", "prior", "sisters", "channel"]


class NoiseViolation(Record):
    """A way in which the noise differs from that of the model.

    Attributes
    ----------
    kind : kind of the violation.
    channels : names.
    p : p-value under the noise of the model; None for quantisation, which is not random.
    step : quantisation step over the noise standard deviation; None for other kinds.
    """

    kind: NoiseKind
    channels: tuple[str, ...]
    p: float | None = None
    step: float | None = None


@dataclass(frozen=True)
class NoiseComparison:
    """A noise scale as fitted and as known beforehand.

    Attributes
    ----------
    channel : channel of the noise; the label of the parameter if it has no channel.
    fitted : fitted scale; for white noise the standard deviation of one raw sample, from the scatter of the rows.
    recorded : the same, known beforehand from the raw samples, the prior, or the sister channels.
    source : source of the known noise.
    ratio, ratio_sd : fitted over known with its standard uncertainty; of sisters the ratio of the scatter of the means
        of runs, the noise of the rows included.
    p : p-value of the ratio, over all comparisons (Holm).
    correlated : whether the model has autocorrelated noise on this channel, which scatters rows but not samples.
    unit : of the scale.
    freedom : degrees of freedom of the fitted noise; 0 if they are not estimated.
    parameter : its name; empty in diagnoses of earlier versions.
    sisters : channels of the comparison.
    between_runs : whether it is a scatter between runs.
    """

    channel: str
    fitted: float
    recorded: float
    source: NoiseSource
    ratio: float
    ratio_sd: float
    p: float
    correlated: bool
    unit: str
    freedom: float = 0.0
    parameter: str = ""
    sisters: tuple[str, ...] = ()
    between_runs: bool = False

    @property
    def excessive(self) -> bool:
        """Whether it exceeds what is known, beyond chance, with nothing in the model that would explain it."""
        return not self.correlated and self.p < _NOISE_CONTRADICTED_P

    @property
    def of_rows(self) -> bool:
        """Whether it is the white noise of rows, against what is known of that channel itself."""
        return self.freedom > 0 and not self.between_runs and self.source != "sisters"

    @property
    def agrees(self) -> bool:
        """Whether fitted and known noise agree, but for chance or for less than is worth a word."""
        chance = NOISE_TOLD_SD * self.ratio_sd / self.ratio
        return not self.excessive and abs(math.log(self.ratio)) < max(math.log(_NOISE_TOLD), chance)


class Disagreement(Record):
    """A run, or one row of it, whose record is wrong in the most probable explanation.

    Attributes
    ----------
    run : its name; empty of a prior.
    row : counts from 1; None for the run as a whole.
    log_odds : natural logarithm of the odds against the most probable explanation with the record as it is.
    causes : corrections with which it would agree, the most probable first; the runs do not distinguish them.
    instead : other runs and rows that may be wrong in place of this one.
    """

    run: str
    row: int | None
    log_odds: float
    causes: tuple[WrongRecord, ...]
    instead: tuple[str, ...] = ()


class DoubtedRun(Record):
    """A run that the others do not predict.

    Attributes
    ----------
    p : p-value of the χ² that it adds to the others, for all runs together.
    causes : corrections of its record with which it would agree, the most probable first; empty if there is none.
    """

    run: str
    p: float
    causes: tuple[WrongRecord, ...] = ()


class ChannelRms(Record):
    """The residual rms of one channel.

    Attributes
    ----------
    within : about the mean of each run; None if it is unknown.
    noise : standard deviation of the residual known beforehand, offsets of runs included; None if unknown.
    """

    channel: str
    rms: float
    unit: str
    within: float | None = None
    noise: float | None = None


class RunChi2(Record):
    """χ² of the `n` readings of one channel in one run."""

    run: str
    channel: str
    n: int
    chi2: float


class KnownNoiseFit(Record):
    """Goodness of fit at the noise known beforehand.

    Attributes
    ----------
    chi2 : least sum of squares of outputs and priors.
    dof : number of outputs.
    channels : residual rms of each channel, offsets of runs included, with the noise that was known.
    runs : χ² of each channel in each run; empty in results of earlier versions.
    """

    chi2: float
    dof: float
    channels: tuple[ChannelRms, ...]
    runs: tuple[RunChi2, ...] = ()

    @property
    def chi2_per_dof(self) -> float:
        """χ² per degree of freedom."""
        return self.chi2 / self.dof

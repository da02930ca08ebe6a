"""What a model file says, free of the file: a list of effects with their settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from imubayes.json_record import Record


@dataclass(frozen=True)
class EffectSpec:
    """One effect of a model.

    Attributes
    ----------
    name : of the effect or noise member.
    channels : the channels it acts on; None for all that it can act on.
    per : sharing of values (channel, all, run, mounting); None for the default of the effect.
    prior : parameter → prior as written.
    options : fixed settings of the effect.
    optional : drop it where no run can show it or the unit lacks the channel, instead of refusing the model.
    where : file and key, for errors.
    """

    name: str
    channels: tuple[str, ...] | None = None
    per: str | None = None
    prior: Mapping[str, str] = field(default_factory=dict)
    options: Mapping[str, float] = field(default_factory=dict)
    optional: bool = False
    where: str = "model"


class SingleRunEffect(Record):
    """An effect that is what differs from run to run, on channels of one run each: it is not in the bound model."""

    effect: str
    channels: tuple[str, ...]


@dataclass(frozen=True)
class PriorCorrelation:
    """Correlation of the priors of noise parameters, of their logarithms where these are lognormal.

    Attributes
    ----------
    parameters : names of K noise parameters, `effect.parameter[label]`.
    matrix : K rows of K correlations.
    optional : leave out the parameters that the model does not have, instead of refusing it.
    where : file and key, for errors.
    """

    parameters: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]
    optional: bool = False
    where: str = "model"


@dataclass(frozen=True)
class ModelSpec:
    """A model: a name and its effects; `files` are sources of the user's own effects, as given.

    `delta_k_threshold` is the Δk up to which the 1 g line of a converter applies to all inputs, as a ratio; None for
    that of the campaign.  `correlations` are those of the priors of noise parameters.  `noise_priors` is the noise
    of the unit from its static records, which takes the place of the model's own once bound to a campaign.
    """

    name: str
    effects: tuple[EffectSpec, ...]
    files: tuple[str, ...] = ()
    where: str = "model"
    delta_k_threshold: float | None = None
    correlations: tuple[PriorCorrelation, ...] = ()
    noise_priors: "ModelSpec | None" = None

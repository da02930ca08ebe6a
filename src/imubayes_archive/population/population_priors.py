"""Priors from a population: the model of the next unit, and that of a unit which is fitted with the others as prior.

The predictive distribution of the next unit replaces the prior of each parameter whose population is known; the others
keep theirs.  Parameters of mountings and tables keep theirs too: they belong to the equipment of a campaign, not to a
kind of unit.  A parameter that cannot be negative and whose prior reaches down to zero keeps it there: a half-normal
prior with the second moment of the population.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from imubayes import Registry
from imubayes.foundations.errors import input_error
from imubayes.foundations.quantity_names import QuantityName
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.parameters.declarations import declared_parameters
from imubayes_archive.population.parameter_population import Populations
from imubayes_archive.population.unit_populations import Scale

_DIGITS = 4
# Families of priors with their mode at zero.
_FROM_ZERO = ("halfnormal", "halfcauchy")


@dataclass(frozen=True)
class KnownPrior:
    """What is known of a parameter beforehand: mean and standard deviation, of the logarithm on the scale ``log``."""

    scale: Scale
    mean: float
    sd: float
    unit_of_measure: str

    def text(self, before: str, digits: int = _DIGITS) -> str:
        """Return it as a prior of a model file; `before` is the one that it replaces."""
        unit = f" {self.unit_of_measure}" if self.unit_of_measure not in ("", "1") else ""
        if self.scale == "log":
            return f"lognormal({math.exp(self.mean):.{digits}g}{unit}, {self.sd:.{digits}g})"
        if before.partition("(")[0] in _FROM_ZERO:
            return f"halfnormal({math.hypot(self.mean, self.sd):.{digits}g}{unit})"
        return f"normal({self.mean:.{digits}g}{unit}, {self.sd:.{digits}g}{unit})"


@dataclass(frozen=True)
class ReplacedPrior:
    """A prior of the new model, and the one that it replaces; empty if that was the default of the effect."""

    parameter: str
    prior: str
    before: str


def next_unit_model(spec: ModelSpec, found: Populations, name: str = "") -> tuple[ModelSpec, list[ReplacedPrior]]:
    """Return the model of the next unit, with what was replaced.

    Parameters
    ----------
    spec : the model of the batch.
    found : its populations.
    name : of the new model; that of the old one with ``-population`` if empty.

    Raises
    ------
    InputError
        if no parameter has a population.
    """
    changed, replaced = with_priors(spec, known_priors(found), [each.parameter for each in found.parameters])
    source = f"the population of {found.units} units (model {found.model})"
    if not replaced:
        raise input_error(
            "no parameter has a population",
            f"results of model {found.model}",
            "parameters that five units or more carry information on",
            "fit more units, or see the reasons with `imubayes batch population`",
        )
    return replace(changed, name=name or f"{spec.name}-population", priors_from=source), replaced


def known_priors(found: Populations) -> dict[str, KnownPrior]:
    """Return what the populations say of the parameters of the next unit."""
    return {
        each.parameter: KnownPrior(each.scale, each.next_mean, each.predictive_sd, each.unit_of_measure)
        for each in found.parameters
        if each.kind != "derived" and each.next_mean is not None and each.predictive_sd is not None
    }


def with_priors(
    spec: ModelSpec, known: Mapping[str, KnownPrior], names: Iterable[str], digits: int = _DIGITS
) -> tuple[ModelSpec, list[ReplacedPrior]]:
    """Return a model with other priors of parameters of channels, and what was replaced.

    An effect whose channels have priors of their own is written once for each channel.

    Parameters
    ----------
    known : by the name of the parameter; those of mountings and tables are passed over.
    names : of all parameters that the model has: channels whose priors are not known keep theirs.
    digits : significant digits of the numbers of a prior.
    """
    registry, every = Registry().with_files(spec.files), tuple(names)
    effects: list[EffectSpec] = []
    replaced: list[ReplacedPrior] = []
    for effect in spec.effects:
        kind = registry.find(effect.name, effect.where)
        of_channel = (effect.per or ",".join(kind.per)) == "channel"
        own = {key: each for key, each in known.items() if QuantityName.of(key).effect == effect.name}
        channels = _channels(effect, (*every, *own)) if of_channel and _channels(effect, own) else []
        defaults = {field: each.prior for field, each in declared_parameters(kind).items()}
        parts = [_on_channel(effect, defaults, channel, own, digits, replaced) for channel in channels]
        effects.extend(parts or [effect])
    return replace(spec, effects=tuple(effects)), replaced


def _channels(effect: EffectSpec, names: Iterable[str]) -> list[str]:
    """Return the channels that an effect has parameters on."""
    labels = (name.labels for name in map(QuantityName.of, names) if name.effect == effect.name)
    found = dict.fromkeys(each[0] for each in labels if len(each) == 1)
    return [label for label in found if effect.channels is None or label in effect.channels]


def _on_channel(
    effect: EffectSpec,
    defaults: Mapping[str, str],
    channel: str,
    known: Mapping[str, KnownPrior],
    digits: int,
    replaced: list[ReplacedPrior],
) -> EffectSpec:
    """Return an effect on one channel with the priors that are known; `defaults` are those declared."""
    priors = dict(effect.prior)
    for key, each in known.items():
        name = QuantityName.of(key)
        if name.labels == (channel,):
            before = priors.get(name.parameter, "")
            priors[name.parameter] = each.text(before or defaults[name.parameter], digits)
            replaced.append(ReplacedPrior(key, priors[name.parameter], before))
    # The next unit may lack a channel that others had.
    return replace(effect, channels=(channel,), prior=priors, optional=True)

"""The prior of the next unit, from the population of those before it.

The predictive distribution of the next unit, N(μ, τ²) with mean and spread uncertain, replaces the prior of each
parameter whose population is known; the others keep theirs.  Parameters of mountings and tables keep theirs too: they
belong to the equipment of a campaign, not to a kind of unit.  A parameter that cannot be negative and whose prior
reaches down to zero keeps it there: a half-normal prior with the second moment of the population.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from imubayes.batch.parameter_population import ParameterPopulation, Populations
from imubayes.foundations.errors import input_error
from imubayes.model.effect_registry import Registry
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.parameters.declarations import declared_parameters

_DIGITS = 4


@dataclass(frozen=True)
class ReplacedPrior:
    """A prior of the new model, and the one that it replaces; empty where that was the default of the effect."""

    parameter: str
    prior: str
    before: str


# Families of priors with their mode at zero.
_FROM_ZERO = ("halfnormal", "halfcauchy")


def prior_text(found: ParameterPopulation, before: str) -> str:
    """Return the predictive distribution of the next unit as a prior of a model file; `before` is that of the batch."""
    assert found.mean is not None, found.reason
    assert found.predictive_sd is not None, found.reason
    unit = f" {found.unit_of_measure}" if found.unit_of_measure not in ("", "1") else ""
    if found.scale == "log":
        return f"lognormal({math.exp(found.mean):.{_DIGITS}g}{unit}, {found.predictive_sd:.{_DIGITS}g})"
    if before.partition("(")[0] in _FROM_ZERO:
        return f"halfnormal({math.hypot(found.mean, found.predictive_sd):.{_DIGITS}g}{unit})"
    return f"normal({found.mean:.{_DIGITS}g}{unit}, {found.predictive_sd:.{_DIGITS}g}{unit})"


def next_unit_model(spec: ModelSpec, found: Populations, name: str = "") -> tuple[ModelSpec, list[ReplacedPrior]]:
    """Return the model of the next unit, with what was replaced.

    An effect whose channels have priors of their own is written once for each channel.

    Parameters
    ----------
    spec : the model of the batch.
    found : its populations.
    name : of the new model; that of the old one with ``-population`` where empty.

    Raises
    ------
    InputError
        where no parameter has a population.
    """
    registry = Registry().with_files(spec.files)
    known = {each.parameter: each for each in found.parameters if each.kind != "derived"}
    effects: list[EffectSpec] = []
    replaced: list[ReplacedPrior] = []
    for effect in spec.effects:
        kind = registry.find(effect.name, effect.where)
        of_channel = (effect.per or ",".join(kind.per)) == "channel"
        channels = _channels(effect, known) if of_channel else []
        before = len(replaced)
        defaults = {field: each.prior for field, each in declared_parameters(kind).items()}
        parts = [_with_priors(effect, defaults, channel, known, replaced) for channel in channels]
        effects.extend(parts if len(replaced) > before else [effect])
    if not replaced:
        raise input_error(
            "no parameter has a population",
            f"results of model {found.model}",
            "parameters that five units or more carry information on",
            "fit more units, or see the reasons with `imubayes batch population`",
        )
    return replace(spec, name=name or f"{spec.name}-population", effects=tuple(effects)), replaced


def _channels(effect: EffectSpec, known: Mapping[str, ParameterPopulation]) -> list[str]:
    """Return the channels that an effect has parameters on in the batch."""
    labels = (key.removeprefix(f"{effect.name}.").partition("[")[2][:-1] for key in _own(effect.name, known))
    found = dict.fromkeys(label for label in labels if label and "," not in label)
    return [label for label in found if effect.channels is None or label in effect.channels]


def _own(name: str, known: Mapping[str, ParameterPopulation]) -> Sequence[str]:
    return [key for key in known if key.startswith(f"{name}.")]


def _with_priors(
    effect: EffectSpec,
    defaults: Mapping[str, str],
    channel: str,
    known: Mapping[str, ParameterPopulation],
    replaced: list[ReplacedPrior],
) -> EffectSpec:
    """Return an effect on one channel with the priors that the population gives it; `defaults` are those declared."""
    priors = dict(effect.prior)
    for field, each in _fields(effect.name, channel, known):
        if each.mean is not None:
            before = priors.get(field, "")
            text = prior_text(each, before or defaults[field])
            replaced.append(ReplacedPrior(each.parameter, text, before))
            priors[field] = text
    # The next unit may lack a channel that others had.
    return replace(effect, channels=(channel,), prior=priors, optional=True)


def _fields(
    name: str, channel: str, known: Mapping[str, ParameterPopulation]
) -> Iterator[tuple[str, ParameterPopulation]]:
    for key in _own(name, known):
        if key.endswith(f"[{channel}]"):
            yield key.removeprefix(f"{name}.").partition("[")[0], known[key]

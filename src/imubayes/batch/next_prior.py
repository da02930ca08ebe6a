"""The prior of the next unit, from the population of those before it.

The predictive distribution of the next unit, N(μ, τ²) with mean and spread uncertain, replaces the prior of each
parameter whose population is known; the others keep theirs.  Parameters of mountings and tables keep theirs too: they
belong to the equipment of a campaign, not to a kind of unit.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from imubayes.batch.parameter_population import ParameterPopulation, Populations
from imubayes.errors import input_error
from imubayes.model.effect_registry import Registry
from imubayes.model.model_spec import EffectSpec, ModelSpec

_DIGITS = 4


@dataclass(frozen=True)
class ReplacedPrior:
    """A prior of the new model, and the one that it replaces; empty where that was the default of the effect."""

    parameter: str
    prior: str
    before: str


def prior_text(found: ParameterPopulation) -> str:
    """Return the predictive distribution of the next unit as a prior of a model file."""
    assert found.mean is not None, found.reason
    assert found.predictive_sd is not None, found.reason
    unit = f" {found.unit_of_measure}" if found.unit_of_measure not in ("", "1") else ""
    if found.scale == "log":
        return f"lognormal({math.exp(found.mean):.{_DIGITS}g}{unit}, {found.predictive_sd:.{_DIGITS}g})"
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
        of_channel = (effect.per or ",".join(registry.find(effect.name, effect.where).per)) == "channel"
        channels = _channels(effect, known) if of_channel else []
        before = len(replaced)
        parts = [_with_priors(effect, channel, known, replaced) for channel in channels]
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
    effect: EffectSpec, channel: str, known: Mapping[str, ParameterPopulation], replaced: list[ReplacedPrior]
) -> EffectSpec:
    """Return an effect on one channel with the priors that the population gives it."""
    priors = dict(effect.prior)
    for field, each in _fields(effect.name, channel, known):
        if each.mean is not None:
            text = prior_text(each)
            replaced.append(ReplacedPrior(each.parameter, text, priors.get(field, "")))
            priors[field] = text
    # The next unit may lack a channel that others had.
    return replace(effect, channels=(channel,), prior=priors, optional=True)


def _fields(
    name: str, channel: str, known: Mapping[str, ParameterPopulation]
) -> Iterator[tuple[str, ParameterPopulation]]:
    for key in _own(name, known):
        if key.endswith(f"[{channel}]"):
            yield key.removeprefix(f"{name}.").partition("[")[0], known[key]

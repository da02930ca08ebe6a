"""The noise of a unit from its static records in the models of its other campaigns.

`imubayes noise` writes what it finds as a model of noise alone.  In another model it takes the place of the effects of
the same names, on the channels that it has and the campaign has.
"""

from collections.abc import Sequence
from dataclasses import replace

from imubayes.campaign_data import Campaign
from imubayes.model.effect_registry import Registry
from imubayes.model.model_spec import EffectSpec, ModelSpec


def with_noise_priors(spec: ModelSpec, campaign: Campaign, registry: Registry) -> ModelSpec:
    """Return the model with the noise from static records in it; the model itself where it names none."""
    if spec.noise_priors is None:
        return spec
    names = tuple(channel.name for channel in campaign.channels)
    given = [entry for each in spec.noise_priors.effects if (entry := _among(each, names)) is not None]
    own = []
    for each in spec.effects:
        kinds = registry.find(each.name, each.where).kinds
        suitable = [channel.name for channel in campaign.channels if channel.kind in kinds]
        entry = _beside(each, given, suitable)
        own += [] if entry is None else [entry]
    blocks = (
        block
        for block in spec.noise_priors.correlations
        if all(name.rsplit("[", 1)[-1].rstrip("]") in names for name in block.parameters)
    )
    correlations = (*spec.correlations, *blocks)
    return replace(spec, effects=(*own, *given), correlations=correlations, noise_priors=None)


def _among(entry: EffectSpec, names: Sequence[str]) -> EffectSpec | None:
    """Return an entry for the channels that the campaign has; None where it has none of them."""
    if entry.channels is None:
        return entry
    shared = tuple(name for name in entry.channels if name in names)
    return replace(entry, channels=shared) if shared else None


def _beside(entry: EffectSpec, given: Sequence[EffectSpec], suitable: Sequence[str]) -> EffectSpec | None:
    """Return an entry of the model for the channels that no given entry of its name has; None where none is left."""
    same = [each for each in given if each.name == entry.name]
    if not same:
        return entry
    if any(each.channels is None for each in same):
        return None
    taken = {name for each in same for name in each.channels or ()}
    left = tuple(name for name in entry.channels or suitable if name not in taken)
    return replace(entry, channels=left) if left else None

"""Which effects a campaign could show, and what is missing for the others."""

from dataclasses import dataclass

from imubayes.campaign_data import Campaign
from imubayes.effects.base import AmbientEffect
from imubayes.model.bound_effects import BoundEffect, NoChannelError, NotObservableError, bind_effect
from imubayes.model.effect_registry import EffectClass, Registry
from imubayes.model.grouping import Grouping
from imubayes.model.model_spec import EffectSpec
from imubayes.model.nodes_and_entries import join_entries, join_nodes


@dataclass(frozen=True)
class Observability:
    """What a campaign has for one effect or noise member.

    Attributes
    ----------
    effect_class : the class.
    runs : names of the runs that respond to it.
    channels : names of the channels it can act on; none for effects on the motion.
    missing : covariates that no run recorded, or that a run which it changes lacks, or the stimulus that no run has;
        empty where the campaign could show it.
    """

    effect_class: EffectClass
    runs: tuple[str, ...]
    channels: tuple[str, ...]
    missing: tuple[str, ...]


def observability(campaign: Campaign, registry: Registry | None = None) -> tuple[Observability, ...]:
    """Return for every effect and noise member what the campaign has for it; nothing is fitted."""
    registry = registry or Registry()
    grouping = Grouping(campaign, join_nodes(campaign), join_entries(campaign))
    return tuple(_of_class(known, grouping, registry) for known in registry.effects.values())


def _of_class(effect_class: EffectClass, grouping: Grouping, registry: Registry) -> Observability:
    if _of_tumbles(effect_class) and not any(run.tumble for run in grouping.campaign.runs):
        return Observability(effect_class, (), (), ("free tumble",))
    try:
        bound = bind_effect(EffectSpec(effect_class.name), grouping, registry)
    except NoChannelError:
        return Observability(effect_class, (), (), tuple(effect_class.kinds))
    except NotObservableError as error:
        return Observability(effect_class, (), (), error.missing or ("response",))
    return Observability(effect_class, _shown_in(bound, grouping.campaign), bound.channels, ())


def _of_tumbles(effect_class: EffectClass) -> bool:
    """Whether an effect is an unknown of free tumbles themselves."""
    of_others = issubclass(effect_class, AmbientEffect) or "driven" in effect_class.needs
    return effect_class.nuisance and not of_others


def _shown_in(bound: BoundEffect, campaign: Campaign) -> tuple[str, ...]:
    """Return the names of the runs that respond; of an error in what they state, of those that state one."""
    names = [campaign.runs[run].name for run in sorted(bound.shown_in)]
    if issubclass(bound.effect_class, AmbientEffect):
        names = [name for name in names if any(parameter.label == (name,) for parameter in bound.parameters)]
    return tuple(names)

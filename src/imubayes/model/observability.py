"""Which effects a campaign could show, and what is missing for the others."""

from dataclasses import dataclass

from imubayes.campaign_data import Campaign
from imubayes.effects.base import AmbientEffect
from imubayes.model.bound_effects import ExactEquipmentError, NoChannelError, NotObservableError, bind_effect
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
    runs, of_ambient = grouping.campaign.runs, issubclass(effect_class, AmbientEffect)
    of_tumble = effect_class.nuisance and not of_ambient and "driven" not in effect_class.needs
    if of_tumble and not any(run.tumble for run in runs):
        return Observability(effect_class, (), (), ("free tumble",))
    try:
        bound = bind_effect(EffectSpec(effect_class.name), grouping, registry)
    except NoChannelError:
        return Observability(effect_class, (), (), tuple(effect_class.kinds))
    except ExactEquipmentError:
        needed = f"{effect_class.needs[0]} uncertainty" if of_ambient else "response"
        return Observability(effect_class, (), (), (needed,))
    except NotObservableError as error:
        return Observability(effect_class, (), (), error.missing or ("response",))
    shown = [runs[run].name for run in sorted(bound.shown_in)]
    if of_ambient:  # exact in the others
        shown = [name for name in shown if any(parameter.label == (name,) for parameter in bound.parameters)]
    return Observability(effect_class, tuple(shown), bound.channels, ())

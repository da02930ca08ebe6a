"""Which effects a campaign could show, and what is missing for the others."""

from dataclasses import dataclass

from imubayes.campaign_data import Campaign, Run
from imubayes.effects.base import Effect, Stage
from imubayes.model.effect_registry import EffectClass, Registry, acts_on_channels
from imubayes.model.nodes_and_entries import join_nodes


@dataclass(frozen=True)
class Observability:
    """What a campaign has for one effect or noise member.

    Attributes
    ----------
    effect_class : the class.
    runs : names of the runs that supply all it needs.
    channels : names of the channels it can act on; none for effects on the motion.
    missing : what no run supplies, or what no run has together; empty where the campaign could show it.
    """

    effect_class: EffectClass
    runs: tuple[str, ...]
    channels: tuple[str, ...]
    missing: tuple[str, ...]


def observability(campaign: Campaign, registry: Registry | None = None) -> tuple[Observability, ...]:
    """Return for every effect and noise member what the campaign has for it; nothing is fitted."""
    supplies = {
        run.name: frozenset({*supplied, *_group_axes(run)})
        for run, supplied in zip(campaign.runs, join_nodes(campaign).supplies, strict=True)
    }
    return tuple(_of_class(known, campaign, supplies) for known in (registry or Registry()).effects.values())


def _group_axes(run: Run) -> set[str]:
    """Return the axes by which values of a run can be labelled."""
    tumble = {"pose", "free tumble"} if run.tumble is not None else set()
    return {"run", *({"table"} if run.table else ()), *({"mounting"} if run.mounting else ()), *tumble}


def _of_class(effect_class: EffectClass, campaign: Campaign, supplies: dict[str, frozenset[str]]) -> Observability:
    by_channel = acts_on_channels(effect_class)
    channels = [channel.name for channel in campaign.channels if by_channel and channel.kind in effect_class.kinds]
    if by_channel and not channels:
        return Observability(effect_class, (), (), tuple(effect_class.kinds))
    needs = {*effect_class.needs, *effect_class.per, *(("free tumble",) if effect_class.nuisance else ())} - {"channel"}
    hidden_by = _hidden_by(effect_class) - needs
    runs = tuple(name for name, supplied in supplies.items() if needs <= supplied and not hidden_by & supplied)
    nowhere = sorted(need for need in needs if not any(need in supplied for supplied in supplies.values()))
    missing = () if runs else tuple(nowhere or sorted(needs))
    return Observability(effect_class, runs, tuple(channels), missing)


def _hidden_by(effect_class: EffectClass) -> set[str]:
    """Return what hides the effect: an injected current replaces the sensor, and all that precedes the converter."""
    return {"injection"} if issubclass(effect_class, Effect) and effect_class.stage < Stage.CONVERTER else set()

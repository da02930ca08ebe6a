"""Which effects a campaign could show, and what is missing for the others."""

from dataclasses import dataclass

from imubayes.effects.base import Effect, MotionEffect, Stage
from imubayes.model.effect_registry import EffectClass, Registry
from imubayes.model.nodes import join_nodes
from imubayes.run import Campaign, Run


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
    supplies = [
        frozenset({*supplied, *_belongings(run)})
        for run, supplied in zip(campaign.runs, join_nodes(campaign).supplies, strict=True)
    ]
    return tuple(_judged(member, campaign, supplies) for member in (registry or Registry()).effects.values())


def _belongings(run: Run) -> set[str]:
    """Return what a run has that values can belong to."""
    tumble = {"pose", "free tumble"} if run.tumble is not None else set()
    return {"run", *({"table"} if run.table else ()), *({"mounting"} if run.mounting else ()), *tumble}


def _judged(member: EffectClass, campaign: Campaign, supplies: list[frozenset[str]]) -> Observability:
    needs = {*member.needs, *member.per, *(("free tumble",) if member.nuisance else ())} - {"channel"}
    # A current stands for the sensor: of what comes before the converter nothing is seen then.
    blind = {"injection"} - needs if issubclass(member, Effect) and member.stage < Stage.CONVERTER else set()
    runs = tuple(
        run.name
        for run, supplied in zip(campaign.runs, supplies, strict=True)
        if needs <= supplied and not blind & supplied
    )
    by_channel = not issubclass(member, MotionEffect) and "closure" not in member.kinds
    channels = tuple(one.name for one in campaign.channels if by_channel and one.kind in member.kinds)
    if by_channel and not channels:
        return Observability(member, (), (), tuple(member.kinds))
    if runs:
        return Observability(member, runs, channels, ())
    nowhere = sorted(need for need in needs if not any(need in supplied for supplied in supplies))
    return Observability(member, (), channels, tuple(nowhere or sorted(needs)))

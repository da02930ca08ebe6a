"""Effects and campaign put together: the pieces from which the problem and the derived quantities are built."""

from dataclasses import dataclass, replace

import numpy as np

from imubayes.earth import earth_rate
from imubayes.effects.base import Effect, MotionEffect, RecordEffect, Stage
from imubayes.model.bound_effects import BoundEffect
from imubayes.model.grouping import Grouping
from imubayes.model.nodes import KINDS, NodeTable, records_of
from imubayes.model.signal_path import Channels, EffectLayer
from imubayes.parameters.vector import Layout
from imubayes.run import Campaign
from imubayes.stimulus import Ambient, Motion, Nodes
from imubayes.types import Array


@dataclass(frozen=True)
class Assembly:
    """What a model consists of on a campaign, before it becomes arrays.

    Attributes
    ----------
    effects : the effects and noise members.
    grouping : what nodes and entries belong to.
    layout, hyper_layout : the scalars.
    nulls : values at which effects do nothing, behind the parameters in the vector of values.
    channels : constants of the channels, per kind.
    nodes : all nodes.
    """

    effects: tuple[BoundEffect, ...]
    grouping: Grouping
    layout: Layout
    hyper_layout: Layout
    nulls: np.ndarray
    channels: dict[str, Channels]
    nodes: Nodes

    def effect_layers(self, one: BoundEffect, chosen: np.ndarray | None) -> list[EffectLayer]:
        """Return the layers of an effect at chosen nodes; None stands for one node that belongs to no run.

        What acts on stands is laid out over all stands, what has a memory over all nodes, whatever the nodes.
        """
        member = one.effect_class
        assert issubclass(member, Effect)
        if member.stage == Stage.STAND:
            chosen = self.grouping.nodes.stand_node
        if issubclass(member, RecordEffect):
            chosen = np.arange(len(self.grouping.nodes.run))
        nodes = _nowhere(self.grouping.nodes) if chosen is None else _at(self.grouping.nodes, chosen)
        grouping = replace(self.grouping, nodes=nodes)
        places = {p.name: place for place, p in enumerate(self.layout.parameters)}
        kinds = ("",) if issubclass(member, MotionEffect) else tuple(kind for kind in KINDS if kind in one.kinds)
        layers = []
        for kind in kinds:
            names = [channel.name for channel in grouping.campaign.channels if channel.kind == kind]
            by_field: dict[str, Array] = {
                field: self._places(one, field, grouping, names, places) for field in one.declared
            }
            layers.append(EffectLayer(member, tuple(sorted(one.spec.options.items())), by_field, kind))
        return layers

    def _places(
        self, one: BoundEffect, field: str, grouping: Grouping, names: list[str], places: dict[str, int]
    ) -> np.ndarray:
        """Return the places of one field's values: (1 or N, 1 or C), or (1 or N,) for effects on the motion."""
        null = len(self.layout) + int(np.searchsorted(self.nulls, one.declared[field].null))
        # A learnt prior width does not enter the signal: its place in the formula stays empty.
        labelled = {
            (() if p.label == ("all",) else p.label): places[p.name]
            for p in one.parameters
            if p.field == field and field not in one.hyper_fields
        }
        per = one.per_of(field)
        place = grouping.node_places(per, labelled, null, names, one.gated)
        if names and "channel" not in per:
            place = np.where(np.isin(names, one.channels), place, null)
        return place if names else place[:, 0]


def assemble(effects: tuple[BoundEffect, ...], grouping: Grouping) -> Assembly:
    """Return the assembly of effects on a campaign."""
    campaign = grouping.campaign
    return Assembly(
        effects=effects,
        grouping=grouping,
        layout=Layout(tuple(p for one in effects for p in one.parameters)),
        hyper_layout=Layout(tuple(p for one in effects for p in one.hyperparameters)),
        nulls=np.array(sorted({d.null for one in effects for d in one.declared.values()} | {0.0})),
        channels={k: _channels(campaign, k) for k in KINDS if any(c.kind == k for c in campaign.channels)},
        nodes=_nodes(campaign, grouping.nodes),
    )


def _channels(campaign: Campaign, kind: str) -> Channels:
    chosen = [channel for channel in campaign.channels if channel.kind == kind]
    return Channels(
        axes=np.stack([channel.axes for channel in chosen]),
        scale=np.array([channel.scale_si for channel in chosen]),
        offset=np.array([channel.offset for channel in chosen]),
        current_per_acceleration=np.array([channel.current_per_acceleration or np.inf for channel in chosen]),
    )


def _nodes(campaign: Campaign, nodes: NodeTable) -> Nodes:
    stimulus, first = nodes.stimulus, nodes.stand_node
    count, still = len(first), np.zeros(len(first))
    referenced = np.any(stimulus.reference_rate[first] != 0, axis=1)
    stands = Motion(
        base=stimulus.base[first],
        mounting=stimulus.mounting[first],
        table_angle=still,
        table_rate=still,
        table_acceleration=still,
        reference_rate=np.zeros((count, 3)),
        reference_acceleration=np.zeros((count, 3)),
        gravity=np.tile([0.0, 0.0, campaign.site.gravity], (count, 1)),
        earth_rate=np.where(referenced[:, None], 0.0, earth_rate(campaign.site.latitude)),
    )
    return Nodes(
        stands=stands,
        stand_ambient=Ambient(**{name: values[first] for name, values in stimulus.ambient.items()}),
        stand=nodes.stand,
        table_angle=stimulus.table_angle,
        table_rate=stimulus.table_rate,
        table_acceleration=stimulus.table_acceleration,
        reference_rate=stimulus.reference_rate,
        reference_acceleration=stimulus.reference_acceleration,
        ambient=Ambient(**stimulus.ambient),
        injected=nodes.injected,
        records=records_of(nodes),
    )


def _at(nodes: NodeTable, chosen: np.ndarray) -> NodeTable:
    """Return what labels need to know of chosen nodes."""
    return NodeTable(
        nodes.stimulus,
        nodes.run[chosen],
        nodes.pose[chosen],
        nodes.stand[chosen],
        nodes.stand_node,
        nodes.turns,
        nodes.row_of,
        nodes.injected[chosen],
        nodes.supplies,
    )


def _nowhere(nodes: NodeTable) -> NodeTable:
    """Return one node that belongs to no run and no pose."""
    one = _at(nodes, np.zeros(1, dtype=int))
    return replace(one, run=np.array([-1]), pose=np.array([-1]))

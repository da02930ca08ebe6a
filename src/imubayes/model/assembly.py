"""Effects and campaign assembled: what the problem and the derived quantities are built from."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np

from imubayes.effects.base import AmbientEffect, Effect, MotionEffect, RecordEffect, Stage
from imubayes.foundations.arrays import Array
from imubayes.foundations.campaign_data import KINDS, Campaign
from imubayes.foundations.signal_path_state import Ambient, Nodes
from imubayes.model import signal_path
from imubayes.model.bound_effects import BoundEffect
from imubayes.model.grouping import Grouping
from imubayes.model.nodes_and_entries import NodeTable, hand_motion, motion_at, outer_axes, records_of
from imubayes.parameters.declarations import Layout


@dataclass(frozen=True)
class Assembly:
    """What a model consists of on a campaign, before it becomes arrays.

    Attributes
    ----------
    effects : the effects and noise members.
    grouping : labels of nodes and entries.
    layout, hyper_layout : the scalars.
    nulls : null values of effects, appended to the parameters in the vector of values.
    channels : constants of the channels, per kind.
    nodes : all nodes.
    """

    effects: tuple[BoundEffect, ...]
    grouping: Grouping
    layout: Layout
    hyper_layout: Layout
    nulls: np.ndarray
    channels: dict[str, signal_path.Channels]
    nodes: Nodes

    def path(
        self,
        chosen: np.ndarray | None,
        stages: Collection[Stage],
        keep: Callable[[BoundEffect, type[Effect]], bool] = lambda effect, effect_class: True,
        injected: np.ndarray | None = None,
    ) -> tuple[signal_path.Layer, ...]:
        """Return the layers of some stages of the signal path: their effects, and the junctions that close them.

        Parameters
        ----------
        chosen : the nodes of the path, shape (n,); None for one node that belongs to no run.
        stages : the stages that the path passes.
        keep : selects among the effects of these stages, given the bound effect and its class.
        injected : shape (n,), 1 where a current is injected; nowhere by default.
        """
        if injected is None:
            injected = np.zeros(1 if chosen is None else len(chosen))
        junctions: dict[Stage, signal_path.Layer] = {
            Stage.STAND: signal_path.Broadcast(),
            Stage.TABLE: signal_path.Resolve(
                tuple((kind, len(channels.scale)) for kind, channels in self.channels.items())
            ),
            Stage.PLACE: signal_path.Project(self.channels),
            Stage.SENSOR: signal_path.Convert(self.channels, injected),
            Stage.CONVERTER: signal_path.AddOffset(self.channels),
        }
        layers: list[signal_path.Layer] = [junctions[stage] for stage in stages]
        for effect in self.effects:
            effect_class = effect.effect_class
            if not issubclass(effect_class, Effect) or not keep(effect, effect_class):
                continue
            if effect_class.stage in stages:
                layers += self._effect_layers(effect, effect_class, chosen)
        return tuple(sorted(layers, key=lambda layer: layer.sort_key()))

    def ambient_path(self, chosen: np.ndarray) -> tuple[signal_path.Layer, ...]:
        """Return the effects on the circumstances at some nodes, (n,), alone: for a path that begins at the sensors."""
        of_ambient = [
            (effect, effect.effect_class) for effect in self.effects if issubclass(effect.effect_class, AmbientEffect)
        ]
        layers = [layer for effect, known in of_ambient for layer in self._effect_layers(effect, known, chosen)]
        return tuple(sorted(layers, key=lambda layer: layer.sort_key()))

    def _effect_layers(
        self, effect: BoundEffect, effect_class: type[Effect], chosen: np.ndarray | None
    ) -> Iterator[signal_path.EffectLayer]:
        """Yield the layers of an effect, one per kind of channel.

        Effects at STAND are evaluated at all stands, effects with memory at all nodes, whatever the chosen nodes.
        """
        if effect_class.stage == Stage.STAND:
            chosen = self.grouping.nodes.stand_node
        if issubclass(effect_class, RecordEffect):
            chosen = np.arange(len(self.grouping.nodes.run))
        nodes = self.grouping.nodes
        grouping = replace(self.grouping, nodes=_without_run(nodes) if chosen is None else _at(nodes, chosen))
        kinds = ("",) if issubclass(effect_class, MotionEffect) else [kind for kind in KINDS if kind in effect.kinds]
        options = tuple(sorted(effect.spec.options.items()))
        for kind in kinds:
            names = [channel.name for channel in grouping.campaign.of_kind(kind)]
            places: dict[str, Array] = {
                field: self._places(effect, field, grouping, names) for field in effect.declared
            }
            yield signal_path.EffectLayer(effect_class, options, places, kind)

    def _places(self, effect: BoundEffect, field: str, grouping: Grouping, names: list[str]) -> np.ndarray:
        """Return the indices of one field's values: (1 or N, 1 or C), or (1 or N,) for effects on the motion."""
        null = len(self.layout) + int(np.searchsorted(self.nulls, effect.declared[field].null))
        # A learnt prior width is no parameter of the formula: its field keeps the null value.
        labelled = {
            (() if parameter.label == ("all",) else parameter.label): self.layout.index(parameter.name)
            for parameter in effect.parameters
            if parameter.field == field
        }
        per = effect.per_of(field)
        place = grouping.node_places(per, labelled, null, names, effect.gated)
        if names and "channel" not in per:
            place = np.where(np.isin(names, effect.channels), place, null)
        return place if names else place[:, 0]


def assemble(effects: tuple[BoundEffect, ...], grouping: Grouping) -> Assembly:
    """Return the assembly of effects on a campaign."""
    campaign = grouping.campaign
    return Assembly(
        effects=effects,
        grouping=grouping,
        layout=Layout(tuple(p for effect in effects for p in effect.parameters)),
        hyper_layout=Layout(tuple(p for effect in effects for p in effect.hyperparameters)),
        nulls=np.array(sorted({d.null for effect in effects for d in effect.declared.values()} | {0.0})),
        channels={k: _channels(campaign, k) for k in KINDS if any(c.kind == k for c in campaign.channels)},
        nodes=nodes_of(campaign, grouping.nodes),
    )


def _channels(campaign: Campaign, kind: str) -> signal_path.Channels:
    chosen = campaign.of_kind(kind)
    return signal_path.Channels(
        axes=np.stack([channel.axes for channel in chosen]),
        scale=np.array([channel.scale_si for channel in chosen]),
        offset=np.array([channel.offset for channel in chosen]),
        current_per_acceleration=np.array([channel.current_per_acceleration or np.inf for channel in chosen]),
    )


def nodes_of(campaign: Campaign, nodes: NodeTable) -> Nodes:
    """Return the nodes of a campaign as arrays."""
    stimulus, first = nodes.stimulus, nodes.stand_node
    still, at_rest = np.zeros(len(first)), np.zeros((len(first), 3))
    stands = replace(
        motion_at(campaign, nodes, first), table_angle=still, table_rate=still, table_acceleration=still,
        reference_rate=at_rest, reference_acceleration=at_rest, hand=None,
    )  # fmt: skip
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
        outer=outer_axes(stimulus, np.arange(len(nodes.run))),
        hand=hand_motion(stimulus, np.arange(len(nodes.run))),
    )


def _at(nodes: NodeTable, chosen: np.ndarray) -> NodeTable:
    """Return chosen nodes, with what labels depend on."""
    columns = {name: getattr(nodes, name)[chosen] for name in ("run", "pose", "stand", "injected")}
    return replace(nodes, **columns)


def _without_run(nodes: NodeTable) -> NodeTable:
    """Return one node that belongs to no run and no pose."""
    return replace(_at(nodes, np.zeros(1, dtype=int)), run=np.array([-1]), pose=np.array([-1]))

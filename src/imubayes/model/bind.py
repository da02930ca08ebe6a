"""Declaring a model on a campaign: which parameters there are, what they mean, and the problem as arrays.

This is where names end and arrays begin.  Everything that does not fit (an unknown effect, a channel of the wrong kind,
an effect that no run can show, two that do not go together) is collected and reported at once.
"""

from dataclasses import dataclass

import numpy as np

from imubayes.effects.base import Effect, MotionEffect, Stage
from imubayes.errors import InputError, Issue, closest_first
from imubayes.gather import on_device
from imubayes.model.assembly import Assembly, assemble
from imubayes.model.attitude_closure import Transitions, nominal_inverse
from imubayes.model.bound_effects import BoundEffect, NotObservableError, bind_effect
from imubayes.model.dry_run import dry_run
from imubayes.model.effect_registry import EffectClass, Registry
from imubayes.model.grouping import Grouping, colour_columns
from imubayes.model.jit_cache import clear_if_crowded
from imubayes.model.model_spec import EffectSpec, ModelSpec
from imubayes.model.nodes import (
    Entries,
    NodeTable,
    join_entries,
    join_nodes,
    nominal_rates,
    output_indices,
    reference_scales,
    servo_runs,
    time_ranks,
)
from imubayes.model.problem import NoiseLayer, Observations, Problem, Sparsity
from imubayes.model.servo_ode import bind_servos
from imubayes.model.signal_path import AddOffset, Broadcast, Convert, Layer, Project, Resolve, sorted_layers
from imubayes.noise.base import Entry, EntryNoise, Noise
from imubayes.parameters.vector import Layout, Priors
from imubayes.procedures import PROCEDURES
from imubayes.run import Campaign
from imubayes.stimulus import Ambient

# What a procedure's own unknowns need, whether or not the model file lists them.
_IMPLIED_BY_TUMBLE = ("pose_attitude", "tumble_heading", "rotation_closure")
_IMPLIED_BY_SERVO = ("servo_start",)


@dataclass(frozen=True)
class Model:
    """A model declared on a campaign.

    Attributes
    ----------
    spec, registry, campaign : what it was made of.
    layout, hyper_layout : names and priors of θ and of h, in the order of the flat vectors.
    problem : the arrays.
    nodes, entries, assembly : where they come from.
    """

    spec: ModelSpec
    registry: Registry
    campaign: Campaign
    layout: Layout
    hyper_layout: Layout
    problem: Problem
    nodes: NodeTable
    entries: Entries
    assembly: Assembly


def bind(spec: ModelSpec, campaign: Campaign, registry: Registry | None = None) -> Model:
    """Return a model declared on a campaign.

    Raises
    ------
    InputError
        with everything in the model that does not fit the campaign.
    """
    _refuse_unknown_procedures(campaign)
    first = registry is None
    registry = (registry or Registry()).with_files(spec.files)
    spec = _with_implied(spec, campaign)
    nodes, entries = join_nodes(campaign), join_entries(campaign)
    belonging = Grouping(campaign, nodes, entries)
    acting: list[BoundEffect] = []
    issues: list[Issue] = []
    for one in spec.effects:
        try:
            acting.append(bind_effect(one, belonging, registry))
        except NotObservableError as error:
            issues.extend(() if one.optional else error.issues)
        except InputError as error:
            issues.extend(error.issues)
    issues.extend(_conflicts(acting))
    if not any(_is_everywhere(one.effect_class) for one in acting):
        issues.append(
            Issue(
                "the model has no noise",
                spec.where,
                "white_noise",
                'add [[effect]] name = "white_noise": without it no residual has a size to be compared with',
            )
        )
    if issues:
        raise InputError(issues)
    if not any(one.parameters for one in acting):
        raise InputError(
            Issue(
                "the model has no parameter to fit: it lists noise and no effect that acts in these runs",
                spec.where,
                "at least one effect, such as gyro_bias or accel_bias",
                "add an [[effect]]; `imubayes effects --for CAMPAIGN` lists those that the runs could show",
            )
        )
    clear_if_crowded()  # what is compiled belongs to one structure, and each model declared may be another
    assembly = assemble(tuple(acting), belonging)
    problem = on_device(build_problem(assembly))
    if first:  # what is declared again, on simulated data say, has been tried
        dry_run(problem, acting, spec.files)
    return Model(
        spec,
        registry,
        campaign,
        assembly.layout,
        assembly.hyper_layout,
        problem,
        nodes,
        entries,
        assembly,
    )


def _refuse_unknown_procedures(campaign: Campaign) -> None:
    unknown = [run for run in campaign.runs if run.procedure not in PROCEDURES]
    if unknown:
        raise InputError(
            Issue(
                f"a run of procedure '{run.procedure}' cannot be fitted",
                f"campaign '{campaign.name}', run '{run.name}'",
                closest_first(run.procedure, PROCEDURES),
                "take the run out of campaign.toml, or give it the procedure that describes it",
            )
            for run in unknown
        )


def _with_implied(spec: ModelSpec, campaign: Campaign) -> ModelSpec:
    names = [*(_IMPLIED_BY_TUMBLE if any(run.tumble for run in campaign.runs) else ())]
    names += _IMPLIED_BY_SERVO if servo_runs(campaign) else ()
    listed = {one.name for one in spec.effects}
    implied = tuple(
        EffectSpec(name, where=f"{spec.where}: implied by the procedure") for name in names if name not in listed
    )
    return ModelSpec(spec.name, spec.effects + implied, spec.files, spec.where)


def _conflicts(acting: list[BoundEffect]) -> list[Issue]:
    """Return complaints about effects that stand twice or exclude each other on the same channel."""
    found = []
    for place, one in enumerate(acting):
        for other in acting[:place]:
            shared = set(one.channels) & set(other.channels) or (not one.channels and not other.channels)
            same = one.name == other.name
            excluded = other.name in one.effect_class.excludes or one.name in other.effect_class.excludes
            if shared and (same or excluded):
                on = f" on {', '.join(sorted(shared))}" if isinstance(shared, set) else ""
                what = (
                    f"the effect '{one.name}' stands twice{on}"
                    if same
                    else f"'{one.name}' and '{other.name}' do not go together{on}"
                )
                remedy = f"keep one of them, or give each its own 'channels' ({other.spec.where} is the other)"
                found.append(Issue(what, one.spec.where, "one effect for each cause and channel", remedy))
    return found


def _is_everywhere(member: EffectClass) -> bool:
    """Tell whether a member gives every reading a variance of its own."""
    return issubclass(member, EntryNoise) and "closure" not in member.kinds and not member.needs


def build_problem(assembly: Assembly) -> Problem:
    """Return the arrays of an assembly: layers, sparsity, observations, noise and priors."""
    acting, belonging = assembly.effects, assembly.grouping
    layout, hyper_layout, channels = assembly.layout, assembly.hyper_layout, assembly.channels
    campaign, nodes, entries = belonging.campaign, belonging.nodes, belonging.entries
    places = {p.name: i for i, p in enumerate(layout.parameters)}
    hyper_places = {p.name: i for i, p in enumerate(hyper_layout.parameters)}
    effects = [one for one in acting if issubclass(one.effect_class, Effect)]
    everywhere = np.arange(len(nodes.run))
    layers: list[Layer] = [
        Broadcast(),
        Resolve(tuple((kind, len(channels[kind].scale)) for kind in channels)),
        Project(channels),
        Convert(channels, nodes.injected),
        AddOffset(channels),
        *(layer for one in effects for layer in assembly.effect_layers(one, everywhere)),
    ]
    reach = np.zeros((len(layout), len(entries)), dtype=bool)
    for one in effects:
        for parameter in one.parameters:
            spread_channels = None if issubclass(one.effect_class, MotionEffect) else one.channels
            per = one.per_of(parameter.field)
            label = () if parameter.label == ("all",) else parameter.label
            felt = set(range(len(campaign.runs))) - one.gated
            reach[places[parameter.name]] = belonging.reach(per, label, spread_channels, felt)
    colour = colour_columns(reach)
    seeds = (colour[None, :] == np.arange(colour.max(initial=-1) + 1)[:, None]).astype(float)
    spread_of, spread_unit = _spreads(acting, layout, hyper_places)
    return Problem(
        nodes=assembly.nodes,
        channels=channels,
        layers=sorted_layers(layers),
        transitions=_transitions(assembly, effects),
        servos=bind_servos(assembly, effects),
        turns=nodes.turns,
        node_weight=nodes.stimulus.weight,
        nulls=assembly.nulls,
        priors=Priors.stack([p.prior for p in layout.parameters]),
        hyper_priors=Priors.stack([p.prior for p in hyper_layout.parameters]),
        noise=tuple(
            _noise_layer(one, belonging, hyper_places) for one in acting if issubclass(one.effect_class, Noise)
        ),
        observations=_observations(belonging),
        sparsity=Sparsity(colour, reach.T, seeds),
        spread_of=spread_of,
        spread_unit=spread_unit,
    )


def _spreads(acting, layout: Layout, hyper_places: dict[str, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return for each parameter the place of its learnt prior width in h, and its own prior's width."""
    spread_of = np.full(len(layout), len(hyper_places))
    unit = np.ones(len(layout))
    by_name = {p.name: (one, p) for one in acting for p in one.parameters}
    for place, parameter in enumerate(layout.parameters):
        one, _ = by_name[parameter.name]
        spread = one.declared[parameter.field].spread
        if spread:
            own = dict(zip(one.per_of(parameter.field), parameter.label, strict=True))
            label = ",".join(own[axis] for axis in one.per_of(spread))
            spread_of[place] = hyper_places[f"{parameter.effect}.{spread}[{label}]"]
            unit[place] = parameter.prior.sd()
    return spread_of, unit


def _observations(belonging: Grouping) -> Observations:
    entries = belonging.entries
    key = entries.run * (len(belonging.campaign.channels) + 3) + entries.channel
    _, group = np.unique(key, return_inverse=True)
    sizes = np.bincount(group)
    members = np.full((len(sizes), sizes.max(initial=1)), len(entries))
    place = np.zeros(len(sizes), dtype=int)
    for entry, one in enumerate(group.tolist()):
        members[one, place[one]] = entry
        place[one] += 1
    rank = time_ranks(belonging.campaign, entries)
    padded = np.append(rank, np.iinfo(rank.dtype).max)
    return Observations(
        value=entries.value.astype(float),
        weight=np.ones(len(entries)),
        entry=Entry(
            samples=entries.samples.astype(float),
            rate=nominal_rates(belonging.campaign, belonging.nodes, entries),
            reference=reference_scales(belonging.campaign, belonging.nodes, entries),
        ),
        readout=output_indices(belonging.campaign, belonging.nodes, entries),
        group=group,
        members=members,
        in_time=np.take_along_axis(members, np.argsort(padded[members], axis=1, kind="stable"), axis=1),
        rank=rank,
    )


def _noise_layer(one: BoundEffect, belonging: Grouping, hyper_places: dict[str, int]) -> NoiseLayer:
    """Return a noise member with places per entry, or per group for what is shared."""
    member = one.effect_class
    assert issubclass(member, Noise)
    entries, campaign = belonging.entries, belonging.campaign
    names = [channel.name for channel in campaign.channels] + [""] * 3
    shared = not issubclass(one.effect_class, EntryNoise)
    if shared:
        key = entries.run * len(names) + entries.channel
        _, first = np.unique(key, return_index=True)
    else:
        first = np.arange(len(entries))
    run, channel, closing = entries.run[first], entries.channel[first], entries.closing[first]
    acts = closing if "closure" in one.effect_class.kinds else np.isin(channel, [names.index(c) for c in one.channels])
    acts = acts & np.isin(run, list(one.runs))
    labels = {(p.field, p.label): hyper_places[p.name] for p in one.hyperparameters}
    places = {}
    for field in one.fields:
        per = one.per_of(field)
        lookup = {}
        for key_pair in set(zip(run.tolist(), channel.tolist(), strict=True)):
            r, c = key_pair
            label = tuple(names[c] if axis == "channel" else belonging.label_of_run(axis, r) or "" for axis in per)
            lookup[key_pair] = labels.get((field, label if per else ("all",)), 0)
        places[field] = np.array([lookup[pair] for pair in zip(run.tolist(), channel.tolist(), strict=True)])
    return NoiseLayer(member, places, acts.astype(float))


def _transitions(assembly: Assembly, effects: list[BoundEffect]) -> Transitions | None:
    """Return the moving parts of all free tumbles, padded to the longest transition."""
    campaign, nodes, channels = assembly.grouping.campaign, assembly.grouping.nodes, assembly.channels
    tumbles = [(index, run.tumble) for index, run in enumerate(campaign.runs) if run.tumble is not None]
    if not tumbles:
        return None
    steps = max(tumble.step.shape[1] for _, tumble in tumbles)
    node_of = {(run, pose): node for node, (run, pose) in enumerate(zip(nodes.run, nodes.pose, strict=True))}

    def padded(array: np.ndarray) -> np.ndarray:
        return np.pad(array, [(0, 0), (0, steps - array.shape[1]), *[(0, 0)] * (array.ndim - 2)])

    readings = np.concatenate([padded(tumble.readings) for _, tumble in tumbles])
    start_node = np.concatenate([[node_of[i, pose] for pose in tumble.start] for i, tumble in tumbles])
    by_kind = {}
    for kind, one in channels.items():
        columns = [index for index, channel in enumerate(campaign.channels) if channel.kind == kind]
        # Padding reads the nominal offset: a unit at rest in free fall, whose steps have no length.
        still = np.concatenate([padded(tumble.step) for _, tumble in tumbles]) == 0
        by_kind[kind] = np.where(still[..., None], one.offset, readings[..., columns]).reshape(-1, len(columns))
    node = np.repeat(start_node, steps)
    layers: list[Layer] = [
        Project(channels),
        Convert(channels, np.zeros(len(node))),
        AddOffset(channels),
        *(
            layer
            for one in effects
            if issubclass(one.effect_class, Effect) and one.effect_class.stage >= Stage.SENSOR
            for layer in assembly.effect_layers(one, node)
        ),
    ]
    return Transitions(
        start=start_node,
        stop=np.concatenate([[node_of[i, pose] for pose in tumble.stop] for i, tumble in tumbles]),
        step=np.concatenate([padded(tumble.step) for _, tumble in tumbles]),
        readings=by_kind,
        coning=np.concatenate([padded(tumble.coning) for _, tumble in tumbles]),
        ambient=Ambient(**{name: values[node] for name, values in nodes.stimulus.ambient.items()}),
        records=assembly.nodes.records.at(node),
        inverse={kind: nominal_inverse(one.axes) for kind, one in channels.items()},
        layers=sorted_layers(layers),
    )

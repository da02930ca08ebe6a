"""The arrays of a bound model: layers, sparsity, observations, noise and priors."""

import numpy as np

from imubayes.effects.base import MotionEffect, Stage
from imubayes.model.assembly import Assembly
from imubayes.model.attitude_closure import bind_transitions
from imubayes.model.bound_effects import BoundEffect
from imubayes.model.grouping import Grouping, colour_columns
from imubayes.model.hyper_prior import HyperCorrelation
from imubayes.model.nodes_and_entries import nominal_rates, output_indices, reference_scales, time_ranks
from imubayes.model.problem import NoiseLayer, Observations, Problem, Sparsity
from imubayes.model.row_times import timeline
from imubayes.model.servo_ode import bind_servos
from imubayes.noise.base import Entry, EntryNoise, Noise, SlowNoise
from imubayes.parameters.vector import Priors


def build_problem(assembly: Assembly, hyper_correlation: HyperCorrelation | None = None) -> Problem:
    """Return the arrays of an assembly, as NumPy arrays on the host."""
    nodes = assembly.grouping.nodes
    spread_of, spread_unit = _learnt_prior_widths(assembly)
    observations = _observations(assembly.grouping)
    slow = any(issubclass(effect.effect_class, SlowNoise) for effect in assembly.effects)
    return Problem(
        nodes=assembly.nodes,
        channels=assembly.channels,
        layers=assembly.path(np.arange(len(nodes.run)), tuple(Stage), injected=nodes.injected),
        transitions=bind_transitions(assembly),
        servos=bind_servos(assembly),
        turns=nodes.turns,
        node_weight=nodes.stimulus.weight,
        nulls=assembly.nulls,
        priors=Priors.stack([parameter.prior for parameter in assembly.layout.parameters]),
        hyper_priors=Priors.stack([parameter.prior for parameter in assembly.hyper_layout.parameters]),
        hyper_correlation=hyper_correlation,
        noise=tuple(
            _noise_layer(effect, assembly) for effect in assembly.effects if issubclass(effect.effect_class, Noise)
        ),
        observations=observations,
        timeline=timeline(assembly.grouping.campaign, assembly.grouping.entries, np.asarray(observations.group))
        if slow
        else None,
        sparsity=_sparsity(assembly),
        spread_of=spread_of,
        spread_unit=spread_unit,
    )


def _sparsity(assembly: Assembly) -> Sparsity:
    """Return which entries each parameter can change, and the compression of the Jacobian that follows from it."""
    grouping = assembly.grouping
    runs = set(range(len(grouping.campaign.runs)))
    reach = []
    for effect in assembly.effects:
        channels = None if issubclass(effect.effect_class, MotionEffect) else effect.channels
        for parameter in effect.parameters:
            label = () if parameter.label == ("all",) else parameter.label
            reach.append(grouping.reach(effect.per_of(parameter.field), label, channels, runs - effect.gated))
    reached = np.stack(reach) if reach else np.zeros((0, len(grouping.entries)), dtype=bool)
    colour = colour_columns(reached)
    seeds = (colour[None, :] == np.arange(colour.max(initial=-1) + 1)[:, None]).astype(float)
    return Sparsity(colour, reached.T, seeds)


def _learnt_prior_widths(assembly: Assembly) -> tuple[np.ndarray, np.ndarray]:
    """Return for each parameter the index in h of its learnt prior width, and the width of its own prior."""
    hyper = assembly.hyper_layout
    spread_of = np.full(len(assembly.layout), len(hyper))
    unit = np.ones(len(assembly.layout))
    pairs = ((effect, parameter) for effect in assembly.effects for parameter in effect.parameters)
    for index, (effect, parameter) in enumerate(pairs):
        spread = effect.declared[parameter.field].spread
        if spread:
            names = dict(zip(effect.per_of(parameter.field), parameter.label, strict=True))
            label = ",".join(names[axis] for axis in effect.per_of(spread))
            spread_of[index] = hyper.index(f"{parameter.effect}.{spread}[{label}]")
            unit[index] = parameter.prior.sd()
    return spread_of, unit


def _observations(grouping: Grouping) -> Observations:
    entries = grouping.entries
    key = entries.run * (len(grouping.campaign.channels) + 3) + entries.channel
    _, group = np.unique(key, return_inverse=True)
    sizes = np.bincount(group)
    members = np.full((len(sizes), sizes.max(initial=1)), len(entries))
    order = np.argsort(group, kind="stable")
    members[group[order], np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)] = order
    rank = time_ranks(grouping.campaign, entries)
    padded = np.append(rank, np.iinfo(rank.dtype).max)
    return Observations(
        value=entries.value.astype(float),
        weight=np.ones(len(entries)),
        entry=Entry(
            samples=entries.samples.astype(float),
            rate=nominal_rates(grouping.campaign, grouping.nodes, entries),
            reference=reference_scales(grouping.campaign, grouping.nodes, entries),
        ),
        readout=output_indices(grouping.campaign, grouping.nodes, entries),
        group=group,
        members=members,
        in_time=np.take_along_axis(members, np.argsort(padded[members], axis=1, kind="stable"), axis=1),
        rank=rank,
    )


def _noise_layer(effect: BoundEffect, assembly: Assembly) -> NoiseLayer:
    """Return a noise member with the indices of its values, per entry, or per group for what is shared."""
    member, grouping = effect.effect_class, assembly.grouping
    assert issubclass(member, Noise)
    entries = grouping.entries
    names = [channel.name for channel in grouping.campaign.channels] + [""] * 3
    first = np.arange(len(entries))
    if not issubclass(member, EntryNoise | SlowNoise):
        _, first = np.unique(entries.run * len(names) + entries.channel, return_index=True)
    run, channel, closing = entries.run[first], entries.channel[first], entries.closing[first]
    acts = closing if "closure" in member.kinds else np.isin(channel, [names.index(name) for name in effect.channels])
    acts = acts & np.isin(run, list(effect.runs))
    labels = {(p.field, p.label): assembly.hyper_layout.index(p.name) for p in effect.hyperparameters}
    pairs, group = np.unique(np.stack([run, channel]), axis=1, return_inverse=True)
    places = {}
    for field in effect.declared:
        per = effect.per_of(field)
        found = [grouping.label(per, names[c], r) or ("all",) for r, c in pairs.T.tolist()]
        places[field] = np.array([labels.get((field, label), 0) for label in found], dtype=int)[group.reshape(-1)]
    return NoiseLayer(member, places, acts.astype(float))

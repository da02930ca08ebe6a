"""Which runs show an effect: whether it changes the nominal signals, Earth rate and gravity included.

An effect acts on the nominal samples of a run with one coefficient at the largest size met in practice, all else at its
null.  A few instants of each run are enough: those where a stimulus is extreme, and some in between.  They come in
blocks of one shape, so that formulas are traced once for all campaigns; NumPy evaluates them, and nothing is compiled.
An effect on the motion responds if it changes what acts on the body.

Three kinds are taken to respond wherever the covariates they need are recorded: effects with memory, and effects on the
gyros of free tumbles and of driven tables, if the record is not the signal itself.  For those the linearised model
decides (`imubayes.responses.candidate_effects`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.compiled.in_numpy import in_numpy
from imubayes.effects.base import Effect, MotionEffect, PlaceEffect, RecordEffect, SignalEffect, Stage
from imubayes.foundations.arrays import Array
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.covariates import ambient_names
from imubayes.foundations.signal_path_state import Ambient, Experience, Motion, Sample
from imubayes.model import nodes_and_entries as listed
from imubayes.model.effect_registry import EffectClass
from imubayes.model.parameter_priors import largest_typical, unit_factors
from imubayes.model.signal_path import on_body, project
from imubayes.noise.components import Entry, EntryNoise, Noise, SlowNoise
from imubayes.parameters.declarations import declared_parameters

# A relative change of the input below this is the rounding error of the signal path.  Numerical.
_ROUNDING = 1e-12
# Instants of a run spread evenly, size of a block, and the least input that a change is measured against, SI.
_EVEN_INSTANTS, _BLOCK, _LEAST_INPUT = 4, 256, 1e-6


class Place(eqx.Module):
    """Which channel at which instant (P pairs), and its constants.

    Attributes
    ----------
    run, channel : shape (P,), index of the run and of the channel in the campaign.
    gyro, injected : shape (P,), bool: kind of the channel, and whether a current stands for the sensor.
    indirect : shape (P,), bool: gyros of free tumbles and of driven tables.
    axes, scale, equivalent : shapes (P, 3, 3), (P,) and (P,): of the channel, and the injected input in SI.
    """

    run: np.ndarray
    channel: np.ndarray
    gyro: np.ndarray
    injected: np.ndarray
    indirect: np.ndarray
    axes: np.ndarray
    scale: np.ndarray
    equivalent: np.ndarray


class Felt(eqx.Module):
    """What the channels experience.

    Attributes
    ----------
    experience, sample : along the signal path, leaves (P, …).
    signal, size : shape (P,), the input along the input axis, and its size in all directions, SI.
    """

    experience: Experience
    sample: Sample
    signal: Array
    size: Array


@dataclass(frozen=True)
class NominalSamples:
    """What the channels experience nominally at one block of instants; worked out if it is asked for.

    Attributes
    ----------
    place : run and channel of each.
    motion, ambient : along the signal path, leaves (P, …).
    """

    place: Place
    motion: Motion
    ambient: Ambient

    @cached_property
    def felt(self) -> Felt:
        """What is felt in the motion."""
        return _felt(self.place, self.motion, self.ambient)

    def turning(self, rate: float) -> "NominalSamples":
        """Return the samples of a unit that turns about all axes and whose input is as much larger."""
        place = replace(self.place, equivalent=self.place.equivalent * (1 + rate))
        motion, about = self.motion, rate * np.array([[1.0, 0.7, 0.5]])
        turned = replace(
            motion,
            table_rate=motion.table_rate + rate,
            reference_rate=motion.reference_rate + about,
            gravity=motion.gravity * (1 + (rate if rate > 1 else 0.0)),
            outer=None if motion.outer is None else replace(motion.outer, rate=motion.outer.rate + rate),
        )
        return NominalSamples(place, turned, self.ambient)

    def accelerating(self) -> "NominalSamples":
        """Return the samples of a unit whose rate about all axes changes."""
        motion, about = self.motion, np.array([[1.0, 0.7, 0.5]])
        faster = replace(
            motion,
            table_acceleration=motion.table_acceleration + 1.0,
            reference_acceleration=motion.reference_acceleration + about,
        )
        return NominalSamples(self.place, faster, self.ambient)

    def elsewhere(self, *covariates: str) -> "NominalSamples":
        """Return the samples at other values of some covariates."""
        changed = self.ambient.updated(**{name: getattr(self.ambient, name) + 10.0 for name in covariates})
        return NominalSamples(self.place, self.motion, changed)


def nominal_samples(campaign: Campaign, nodes: listed.NodeTable) -> tuple[NominalSamples, ...]:
    """Return the nominal samples of a campaign in blocks of one size, the last filled by repetition."""
    sensors = [place for place, channel in enumerate(campaign.channels) if channel.kind != "angle"]
    instants = [_instants(nodes, run) for run in range(len(campaign.runs))]
    # The first instant of every run comes first: most effects show there already.
    chosen = [own[place] for place in range(max(map(len, instants))) for own in instants if place < len(own)]
    node, channel = (part.reshape(-1) for part in np.meshgrid(np.array(chosen), sensors, indexing="ij"))
    node, channel = (np.pad(part, (0, -len(part) % _BLOCK), mode="wrap") for part in (node, channel))
    blocks = np.arange(len(node)).reshape(-1, _BLOCK)
    return tuple(_block(campaign, nodes, node[block], channel[block]) for block in blocks)


def _block(campaign: Campaign, nodes: listed.NodeTable, node: np.ndarray, channel: np.ndarray) -> NominalSamples:
    known = [campaign.channels[place] for place in channel.tolist()]
    gyro = np.array([each.kind == "gyro" for each in known])
    stimulus, run = nodes.stimulus, nodes.run[node]
    indirect = [i for i, each in enumerate(campaign.runs) if each.tumble is not None] + listed.servo_runs(campaign)
    per_current = np.array([each.current_per_acceleration or np.inf for each in known])
    place = Place(
        run=run,
        channel=channel,
        gyro=gyro,
        injected=nodes.injected[node] > 0,
        indirect=gyro & np.isin(run, indirect),
        axes=np.stack([each.axes for each in known]),
        scale=np.array([each.scale_si for each in known]),
        equivalent=stimulus.ambient["current"][node] / per_current,
    )
    return NominalSamples(
        place,
        listed.motion_at(campaign, nodes, node),
        Ambient(**{name: v[node] for name, v in stimulus.ambient.items()}),
    )


@in_numpy
def _felt(place: Place, motion: Motion, ambient: Ambient) -> Felt:
    experience = jax.vmap(on_body)(motion)
    sample = _samples(place, experience, ambient)
    size = jnp.linalg.norm(jnp.where(place.gyro[:, None], sample.rate, sample.force), axis=1)
    return Felt(experience, sample, _signal(place, sample), size)


def _instants(nodes: listed.NodeTable, run: int) -> list[int]:
    """Return nodes of a run at which its stimuli are extreme, then some spread evenly."""
    stimulus, own = nodes.stimulus, np.flatnonzero(nodes.run == run)
    if not len(own):
        return []
    moving = [stimulus.table_rate, stimulus.table_acceleration]
    moving += [*stimulus.reference_rate.T, *stimulus.reference_acceleration.T]
    columns = [np.abs(column[own]) for column in moving]
    columns += [column[own] for column in stimulus.ambient.values()]
    extreme = [int(np.argmax(column)) for column in columns if np.ptp(column) > 0]
    even = np.linspace(0, len(own) - 1, min(len(own), _EVEN_INSTANTS)).astype(int).tolist()
    return [int(own[place]) for place in dict.fromkeys((*extreme, *even))]


@dataclass(frozen=True)
class Probe:
    """An effect at the sizes at which its response is looked for.

    Attributes
    ----------
    effect, options : the class and its fixed settings.
    sizes : values of its parameters, SI: one coefficient at its largest typical size, the others at their null.
    channels : indices of the channels it acts on; none for effects on the motion.
    """

    effect: type[Effect]
    sizes: tuple[dict[str, float], ...]
    options: dict[str, Any]
    channels: list[int]


def probes(
    effect: type[Effect], options: dict[str, Any], channels: Sequence[str], campaign: Campaign
) -> tuple[Probe, ...]:
    """Return an effect at its largest typical sizes, for each kind of channel that it acts on: their units differ."""
    places = {channel.name: place for place, channel in enumerate(campaign.channels)}
    by_kind: dict[str, list[str]] = {}
    for name in channels:
        by_kind.setdefault(campaign.channels[places[name]].kind, []).append(name)
    return tuple(
        Probe(effect, _sizes(effect, campaign, names[0] if names else ""), options, [places[name] for name in names])
        for names in by_kind.values() or [[]]
    )


def _sizes(effect: type[Effect], campaign: Campaign, channel: str) -> tuple[dict[str, float], ...]:
    """Return the values at which the response to an effect is looked for, one set per coefficient and shape, in SI."""
    declared, factors = declared_parameters(effect), unit_factors(effect, campaign, channel)
    largest = largest_typical(effect, campaign, channel)
    spreads = {each.spread for each in declared.values()}
    nulls = {field: each.null for field, each in declared.items()}
    shapes = {field: each.shape for field, each in declared.items() if each.shape}
    count = max((len(shape) for shape in shapes.values()), default=1)
    grid = [
        {field: shape[min(place, len(shape) - 1)] * factors[field] for field, shape in shapes.items()}
        for place in range(count)
    ]
    coefficients = [field for field in declared if field not in shapes and field not in spreads]
    return tuple({**nulls, **shape, field: largest[field]} for field in coefficients for shape in grid)


def responding_runs(probe: Probe, blocks: Sequence[NominalSamples]) -> set[int]:
    """Return the runs in which an effect changes the nominal signal of a channel, or the motion."""
    if issubclass(probe.effect, RecordEffect):
        return {run for at in blocks for run in at.place.run[_felt_by(probe, at.place)].tolist()}
    found: set[int] = set()
    for at in blocks:
        felt = _felt_by(probe, at.place)
        if not set(at.place.run[felt].tolist()) <= found:
            found |= set(at.place.run[_responds(probe, at, felt)].tolist())
    return found


def _felt_by(probe: Probe, place: Place) -> np.ndarray:
    """Return where an effect acts, (P,) bool: on its channels, and on the sensor where no current is injected."""
    on_channels = not issubclass(probe.effect, MotionEffect)
    acts = np.isin(place.channel, probe.channels) if on_channels else np.ones(len(place.run), dtype=bool)
    return acts & ~place.injected if probe.effect.stage < Stage.CONVERTER else acts


def _responds(probe: Probe, at: NominalSamples, felt: np.ndarray) -> np.ndarray:
    """Return where an effect changes the nominal signal or motion, (P,) bool."""
    effect, place = probe.effect, at.place
    responds = felt & place.indirect & issubclass(effect, SignalEffect)
    for values in probe.sizes:
        if np.all(responds[felt]):
            break
        try:
            responds |= felt & _changes(probe, values, at)
        except (Exception, SystemExit):  # a user's class that cannot be evaluated is for the dry run to report
            return felt
    return responds


def _changes(probe: Probe, values: dict[str, float], at: NominalSamples) -> np.ndarray:
    """Return where the motion or the signal changes by more than rounding, (P,) bool."""
    acting = probe.effect(**{field: np.asarray(value) for field, value in values.items()}, **probe.options)
    if isinstance(acting, MotionEffect):
        return _moves(acting, at)
    return np.asarray(_alters(acting, at.place, at.felt, at.ambient))


def _moves(acting: MotionEffect, at: NominalSamples) -> np.ndarray:
    """Return where an effect changes what acts on the body, (P,) bool."""
    after, before = _on_bodies(_moved(acting, at.motion, at.ambient)), at.felt.experience
    changed = np.zeros(len(at.place.run), dtype=bool)
    for new, old in zip(jax.tree.leaves(after), jax.tree.leaves(before), strict=True):
        rows = np.abs(np.asarray(old)).reshape(len(changed), -1)
        with np.errstate(invalid="ignore"):
            moved = np.abs(np.asarray(new) - np.asarray(old)).reshape(len(changed), -1)
        changed |= moved.max(axis=1) > _ROUNDING * np.maximum(rows.max(axis=1), _LEAST_INPUT)
    return changed


@in_numpy
def _moved(acting: MotionEffect, before: Motion, ambient: Ambient) -> Motion:
    return jax.vmap(acting.apply)(before, ambient)


# One program for all effects.
@in_numpy
def _on_bodies(motion: Motion) -> Experience:
    return jax.vmap(on_body)(motion)


@in_numpy
def _alters(acting: Effect, place: Place, felt: Felt, ambient: Ambient) -> Array:
    """Return where an effect changes the signal, (P,) bool."""
    before, size, least = felt.signal, felt.size, jnp.asarray(_LEAST_INPUT)
    if isinstance(acting, PlaceEffect):
        after = _signal(place, _samples(place, jax.vmap(acting.apply)(felt.experience), ambient))
    else:
        assert isinstance(acting, SignalEffect)
        if acting.stage == Stage.CONVERTER:
            scale = jnp.abs(place.scale)
            before = place.scale * jnp.where(place.injected, place.equivalent, before)
            size, least = scale * jnp.maximum(size, jnp.abs(place.equivalent)), scale * least
        after = jax.vmap(acting.apply)(before, felt.sample)
    # What is not finite is a response: the fit reports it.
    return ~(jnp.abs(after - before) <= _ROUNDING * jnp.maximum(size, least))


def _samples(place: Place, experience: Experience, ambient: Ambient) -> Sample:
    return eqx.tree_at(lambda s: s.output_scale, jax.vmap(project)(place.axes, experience, ambient), place.scale)


def _signal(place: Place, sample: Sample) -> Array:
    return jnp.where(place.gyro, sample.rate[:, 0], sample.force[:, 0])


def missing_stimulus(probe: Probe, blocks: Sequence[NominalSamples]) -> tuple[str, ...]:
    """Return what the runs would need to show an effect that no run shows; empty if nothing tried brings it out."""
    first = blocks[0]
    stimuli: dict[str, Callable[[], NominalSamples]] = {
        "turning": lambda: first.turning(1.0),
        "acceleration": first.accelerating,
        **{name: lambda name=name: first.elsewhere(name) for name in probe.effect.needs if name in ambient_names()},
        "larger input": lambda: first.turning(100.0),
    }
    return next(((name,) for name, changed in stimuli.items() if responding_runs(probe, [changed()])), ())


def noisy_runs(noise: type[Noise], campaign: Campaign, nodes: listed.NodeTable, entries: listed.Entries) -> set[int]:
    """Return the runs in which a noise component has a variance at its largest typical size."""
    runs = range(len(campaign.runs))
    if issubclass(noise, SlowNoise):
        return set(runs) if listed.has_row_times(campaign) else set()
    if not issubclass(noise, EntryNoise) or "closure" in noise.kinds:
        return set(runs)
    known = [
        each(campaign, nodes, entries)
        for each in (listed.nominal_rates, listed.reference_scales, listed.encoder_slopes)
    ]
    values, found = _largest(noise, campaign), set()
    for run in runs:
        here = entries.run == run
        facts = Entry(np.asarray(1.0), *(np.asarray(each[here].max(initial=0.0)) for each in known))
        found |= {run} if float(_variance(noise(**values), facts)) > 0 else set()
    return found


@in_numpy
def _variance(noise: EntryNoise, facts: Entry) -> Array:
    return noise.variance(facts)


def is_independent(noise: type[EntryNoise], campaign: Campaign) -> bool:
    """Return whether a noise component gives every reading a variance of its own, at rest too."""
    still = Entry(*map(np.asarray, (1.0, 0.0, 0.0, 0.0)))
    return "closure" not in noise.kinds and float(_variance(noise(**_largest(noise, campaign)), still)) > 0


def _largest(member: EffectClass, campaign: Campaign) -> dict[str, Array]:
    return {field: np.asarray(size, dtype=float) for field, size in largest_typical(member, campaign).items()}

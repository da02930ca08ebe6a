"""A model bound to a campaign: which parameters there are, what they mean, and the problem as arrays.

Names end here and arrays begin: layers, sparsity, observations, noise and priors.  Everything that does not fit (an
unknown effect, a channel of the wrong kind, an effect that no run can show, two that exclude each other) is collected
and reported at once.

User-defined effects are evaluated abstractly, by shapes and types alone, before anything is fitted.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import jax.numpy as jnp
import numpy as np
import polars as pl

from imubayes.compiled.jax_settings import clear_if_crowded, prepare_jax
from imubayes.effects.base import MotionEffect, Stage
from imubayes.effects.thermometer import UncertainTemperature
from imubayes.foundations.arrays import Array, Float, Scalar
from imubayes.foundations.campaign_data import THERMOMETERS, Campaign, Tumble
from imubayes.foundations.errors import InputError, Issue, closest_first, input_error, refuse
from imubayes.foundations.quantity_names import name_of
from imubayes.model import bound_effects as binding
from imubayes.model import nodes_and_entries
from imubayes.model.assembly import Assembly, assemble
from imubayes.model.carried_motion import bind_carried
from imubayes.model.dry_run import dry_run
from imubayes.model.effect_registry import EffectClass, Registry, with_noise_priors
from imubayes.model.grouping import Grouping, colour_columns
from imubayes.model.integrated_outputs import bind_servos, bind_transitions
from imubayes.model.likelihood import log_density
from imubayes.model.model_file import EffectSpec, ModelSpec, SingleRunEffect
from imubayes.model.nominal_response import is_independent
from imubayes.model.parameter_priors import HyperCorrelation, hyper_correlation, stated_uncertainty
from imubayes.model.problem import (
    NoiseLayer,
    Observations,
    Problem,
    Sparsity,
    placed,
    predict,
    predict_with_jacobian,
)
from imubayes.model.set_aside import without
from imubayes.noise.components import Entry, EntryNoise, Noise, SlowNoise
from imubayes.parameters.declarations import Layout, Priors, declared_parameters
from imubayes.procedures import PROCEDURES


def build_problem(assembly: Assembly, hyper_correlation: HyperCorrelation | None = None) -> Problem:
    """Return the arrays of an assembly, as NumPy arrays on the host."""
    nodes = assembly.grouping.nodes
    spread_of, spread_unit = _learnt_prior_widths(assembly)
    observations, transitions = _observations(assembly.grouping), bind_transitions(assembly)
    slow = any(issubclass(effect.effect_class, SlowNoise) for effect in assembly.effects)
    return Problem(
        nodes=assembly.nodes,
        channels=assembly.channels,
        layers=assembly.path(np.arange(len(nodes.run)), tuple(Stage), injected=nodes.injected),
        transitions=transitions,
        carried=bind_carried(assembly, transitions),
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
        timeline=nodes_and_entries.timeline(
            assembly.grouping.campaign, assembly.grouping.entries, np.asarray(observations.group)
        )
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
            spread_of[index] = hyper.index(name_of(f"{parameter.effect}.{spread}", label))
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
    rank = nodes_and_entries.time_ranks(grouping.campaign, entries)
    padded = np.append(rank, np.iinfo(rank.dtype).max)
    return Observations(
        value=entries.value.astype(float),
        weight=np.ones(len(entries)),
        entry=Entry(
            samples=entries.samples.astype(float),
            rate=nodes_and_entries.nominal_rates(grouping.campaign, grouping.nodes, entries),
            reference=nodes_and_entries.reference_scales(grouping.campaign, grouping.nodes, entries),
            encoder=nodes_and_entries.encoder_slopes(grouping.campaign, grouping.nodes, entries),
        ),
        readout=nodes_and_entries.output_indices(grouping.campaign, grouping.nodes, entries),
        group=group,
        members=members,
        in_time=np.take_along_axis(members, np.argsort(padded[members], axis=1, kind="stable"), axis=1),
        rank=rank,
    )


def _noise_layer(effect: binding.BoundEffect, assembly: Assembly) -> NoiseLayer:
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


# Unknowns of the procedures themselves, added whether or not the model file lists them.
_IMPLIED_BY_POSES, _IMPLIED_BY_TURNS = ("pose_attitude",), ("tumble_heading", "rotation_closure")
_IMPLIED_BY_MOTION = ("carried_closure",)
_IMPLIED_BY_SERVO = ("servo_start",)
_IMPLIED_BY_BENCHES = ("unknown_heading", "unknown_level")


@dataclass(frozen=True)
class Model:
    """A model bound to a campaign.

    The vector z holds all parameters θ in the order of `layout`, then all hyperparameters h of noise and learnt prior
    widths in the order of `hyper_layout`: `parameter_names` lists both.  Its components are standard normal under the
    prior; `to_units` and `from_units` convert to and from the units of the parameters.

    Attributes
    ----------
    spec, registry, campaign : what was bound.
    layout, hyper_layout : names and priors of θ and of h, in the order of the flat vectors.
    problem : the arrays.
    assembly : the effects and channels they are made from.
    left_out : effects of the model that the campaign cannot determine, because it has one run of their channels.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> import imubayes
    >>> model = imubayes.load("results/accel-channel").fit.model
    >>> prior_median = jnp.zeros(len(model.parameter_names))
    >>> model.log_density(prior_median).shape
    ()
    """

    spec: ModelSpec
    registry: Registry
    campaign: Campaign
    layout: Layout
    hyper_layout: Layout
    problem: Problem
    nodes: nodes_and_entries.NodeTable
    entries: nodes_and_entries.Entries
    assembly: Assembly
    left_out: tuple[SingleRunEffect, ...] = ()

    @property
    def acting(self) -> tuple[EffectSpec, ...]:
        """Effects and noise members of `spec` that act in some run of the campaign."""
        bound = {effect.name for effect in self.assembly.effects}
        return tuple(effect for effect in self.spec.effects if effect.name in bound)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the components of z, `effect.parameter[label]`: parameters, then hyperparameters."""
        return self.layout.names + self.hyper_layout.names

    @property
    def output_names(self) -> np.ndarray:
        """Names of the outputs of `entries.channel`, (K + 3,): channels, then components of a closing rotation."""
        return np.array([*(each.name for each in self.campaign.channels), "closure_x", "closure_y", "closure_z"])

    @property
    def parameter_units(self) -> tuple[str, ...]:
        """Units of the components of z, in the order of `parameter_names`."""
        return tuple(p.unit for p in (*self.layout.parameters, *self.hyper_layout.parameters))

    @property
    def spec_of_known(self) -> ModelSpec:
        """The model without what was left out of it, for a campaign with more runs."""
        gone = {each.effect for each in self.left_out}
        kept = {effect.name: effect.channels for effect in self.assembly.effects if effect.left_out}
        known = (
            replace(each, channels=kept.get(each.name, each.channels))
            for each in self.spec.effects
            if each.name not in gone or each.name in kept
        )
        return replace(self.spec, effects=tuple(known))

    def predict(self, z: Float[Array, " D"]) -> Float[Array, " E"]:
        """Return the predicted outputs of all entries, in the order of `outputs`; closing rotations in rad.

        A pure function of z, as `log_density`.

        Parameters
        ----------
        z : shape (D,), in the order of `parameter_names`.
        """
        return predict(self.problem, z[: len(self.layout)])

    def jacobian(self, z: Float[Array, " D"]) -> Float[Array, "E P"]:
        """Return the derivatives of `predict` with respect to the parameters θ, the first P components of z.

        Parameters that affect no common entry share one derivative, so that this costs less than `jax.jacfwd`.
        """
        return predict_with_jacobian(self.problem, z[: len(self.layout)])[1]

    @property
    def outputs(self) -> pl.DataFrame:
        """Run, row (from 1), channel and observed value of every entry, a table of E rows."""
        runs = np.array([run.name for run in self.campaign.runs])
        entries = self.entries
        columns = {
            "run": runs[entries.run], "row": entries.row + 1, "channel": self.output_names[entries.channel],
            "observed": entries.value,
        }  # fmt: skip
        return pl.DataFrame(columns)

    def log_density(self, z: Float[Array, " D"]) -> Scalar:
        """Return log p(y, z), the joint log density of data and parameters; normalised in y and z.

        A pure function of z: it can be compiled, differentiated and batched (`jax.jit`, `jax.grad`, `jax.vmap`), and
        is the density that `imubayes.fit` maximises and samples.

        Parameters
        ----------
        z : shape (D,), in the order of `parameter_names`.
        """
        count = len(self.layout)
        return log_density(self.problem, z[:count], z[count:])

    def to_units(self, z: Float[Array, " D"]) -> Float[Array, " D"]:
        """Return the parameters of z, shape (D,), in their units; compiles, differentiates and batches as well."""
        count, problem = len(self.layout), self.problem
        values = jnp.concatenate([problem.priors.values(z[:count]), problem.hyper_priors.values(z[count:])])
        return values / np.concatenate([self.layout.factors(), self.hyper_layout.factors()])

    def from_units(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return z, shape (D,), of parameters in their units; ValueError if a prior excludes a value."""
        count = len(self.layout)
        return np.concatenate([self.layout.z_of(values[:count]), self.hyper_layout.z_of(values[count:])])


def bind(spec: ModelSpec, campaign: Campaign, registry: Registry | None = None, *, single_runs: bool = False) -> Model:
    """Return a model bound to a campaign.

    Parameters
    ----------
    spec, campaign : as `load_model` and `load_campaign` return them.
    registry : effects by name, user effects in it are not dry-run again; by default the package's own.
    single_runs : see `imubayes.model.bound_effects.bind_effect`.

    Raises
    ------
    InputError
        with everything in the model that does not fit the campaign.

    Examples
    --------
    >>> import imubayes
    >>> campaign = imubayes.load_campaign("data/accel-channel")
    >>> model = imubayes.bind(imubayes.load_model("accel-channel"), campaign)
    >>> model.parameter_names[0], model.parameter_units[0]
    ('mounting_error.x[pyramid]', 'arcsec')
    """
    prepare_jax()
    _refuse_unknown_procedures(campaign)
    campaign = without(campaign, spec.set_aside, spec.where)
    new_files = registry is None
    registry = (registry or Registry()).with_files(spec.files).with_classes(spec.classes)
    spec = _with_implied(with_noise_priors(spec, campaign, registry), campaign, registry)
    nodes, entries = nodes_and_entries.join_nodes(campaign), nodes_and_entries.join_entries(campaign)
    grouping = Grouping(campaign, nodes, entries)
    effects, left_out = _bind_effects(spec, grouping, registry, single_runs)
    clear_if_crowded()  # compiled code belongs to the structure of one model, and every model bound may be another
    assembly = assemble(effects, grouping)
    problem = placed(build_problem(assembly, hyper_correlation(spec.correlations, assembly.hyper_layout)))
    if new_files:
        dry_run(problem, effects, spec)
    layouts = assembly.layout, assembly.hyper_layout
    return Model(spec, registry, campaign, *layouts, problem, nodes, entries, assembly, left_out)


def _bind_effects(
    spec: ModelSpec, grouping: Grouping, registry: Registry, single_runs: bool
) -> tuple[tuple[binding.BoundEffect, ...], tuple[SingleRunEffect, ...]]:
    """Return all effects bound to the campaign, and those left out; raises InputError with all that does not fit."""
    effects: list[binding.BoundEffect] = []
    left_out: list[SingleRunEffect] = []
    issues: list[Issue] = []
    unknown: dict[tuple, list[binding.UnknownCovariateError]] = {}
    for entry in spec.effects:
        try:
            bound = binding.bind_effect(entry, grouping, registry, single_runs=single_runs)
            effects.append(bound)
            left_out += [SingleRunEffect(effect=entry.name, channels=bound.left_out)] if bound.left_out else []
        except binding.UnknownCovariateError as error:
            # An optional one too: other runs show it, and to drop it would put its part of their outputs elsewhere.
            unknown.setdefault((error.runs, error.missing), []).append(error)
        except binding.ExactEquipmentError:
            continue  # the effect is known to be absent
        except binding.SingleRunError as error:
            left_out.append(SingleRunEffect(effect=entry.name, channels=error.channels))
        except binding.NotObservableError as error:
            issues.extend(() if entry.optional else error.issues)
        except InputError as error:
            issues.extend(error.issues)
    issues.extend(
        binding.unknown_covariates_issue([each.effect for each in errors], runs, missing, errors[0].where)
        for (runs, missing), errors in unknown.items()
    )
    issues.extend(_conflicts(effects))
    _refuse_useless(effects, issues, spec, grouping)
    return tuple(effects), tuple(left_out)


def _refuse_useless(
    effects: Sequence[binding.BoundEffect], issues: Sequence[Issue], spec: ModelSpec, grouping: Grouping
) -> None:
    """Raise InputError with all issues, a model without noise among them, or for a model with nothing to fit."""
    found = list(issues)
    if not any(_is_independent_noise(effect.effect_class, grouping.campaign) for effect in effects):
        found.append(
            Issue(
                "the model has no noise",
                spec.where,
                "white_noise",
                'add [[effect]] name = "white_noise": without it residuals have no scale',
            )
        )
    refuse(found)
    if not any(effect.parameters for effect in effects):
        raise input_error(
            "the model has no parameter to fit: it lists noise and no effect that acts in these runs",
            spec.where,
            "at least one effect, such as gyro_bias or accel_bias",
            "add an [[effect]]; `imubayes effects --for CAMPAIGN` lists those that the runs could show",
        )


def _refuse_unknown_procedures(campaign: Campaign) -> None:
    refuse(
        Issue(
            f"a run of procedure '{run.procedure}' cannot be fitted",
            f"campaign '{campaign.name}', run '{run.name}'",
            closest_first(run.procedure, PROCEDURES),
            "take the run out of campaign.toml, or give it the procedure that describes it",
        )
        for run in campaign.runs
        if run.procedure not in PROCEDURES
    )


def _with_implied(spec: ModelSpec, campaign: Campaign, registry: Registry) -> ModelSpec:
    """Return the model with the unknowns of the procedures themselves, and of temperatures that are stated as such."""
    names = _by_hand([run.tumble for run in campaign.runs if run.tumble is not None])
    names += _IMPLIED_BY_SERVO if nodes_and_entries.servo_runs(campaign) else ()
    present = {channel.kind for channel in campaign.channels}
    names += [name for name in _IMPLIED_BY_BENCHES if present & set(registry.effects[name].kinds)]
    listed = {effect.name for effect in spec.effects}
    names += _temperature_errors(listed, campaign, registry)
    where = f"{spec.where}: implied by the campaign"
    implied = tuple(
        EffectSpec(name, where=where, optional=name in _IMPLIED_BY_BENCHES) for name in names if name not in listed
    )
    return replace(spec, effects=spec.effects + implied)


def _by_hand(tumbles: Sequence[Tumble]) -> list[str]:
    """Return the unknowns of runs without a table: attitudes, heading, and what the gyros wander."""
    names = list(_IMPLIED_BY_POSES) if tumbles else []
    names += _IMPLIED_BY_TURNS if any(tumble.turns and not tumble.carried for tumble in tumbles) else ()
    return [*names, *(_IMPLIED_BY_MOTION if any(tumble.carried for tumble in tumbles) else ())]


def _temperature_errors(listed: Collection[str], campaign: Campaign, registry: Registry) -> list[str]:
    """Return the effects of the temperatures that listed effects depend on and runs state with an uncertainty.

    To take such a temperature as exact would be silently wrong; to leave the uncertainty out of campaign.toml says so.
    """
    needed = {need for name in listed if name in registry.effects for need in registry.effects[name].needs}
    return [
        member.name
        for member in registry.effects.values()
        if issubclass(member, UncertainTemperature) and member.covariate in needed and _states_any(member, campaign)
    ]


def _states_any(member: type[UncertainTemperature], campaign: Campaign) -> bool:
    """Return whether the campaign states an uncertainty above 0 of an error of temperatures."""
    facts = [declared.equipment for declared in declared_parameters(member).values()]
    labels = [
        {axis: name for axis in THERMOMETERS if (name := getattr(run, axis)) is not None} | {"run": run.name}
        for run in campaign.runs
    ]
    return any(stated_uncertainty(fact, label, campaign) for fact in facts for label in labels)


def _conflicts(effects: Sequence[binding.BoundEffect]) -> Iterator[Issue]:
    """Yield complaints about effects that are listed twice or exclude each other on the same channel."""
    for other, effect in combinations(effects, 2):
        shared = sorted(set(effect.channels) & set(other.channels))
        whole_unit = not effect.channels and not other.channels
        same = effect.name == other.name
        excluded = other.name in effect.effect_class.excludes or effect.name in other.effect_class.excludes
        if (shared or whole_unit) and (same or excluded):
            pair = f"'{effect.name}' and '{other.name}' do not go together"
            what = f"the model already contains the effect '{effect.name}'" if same else pair
            on = f" on {', '.join(shared)}" if shared else ""
            remedy = f"keep one of the two, or give each its own 'channels'; the other is {other.spec.where}"
            yield Issue(what + on, effect.spec.where, "one effect for each cause and channel", remedy)


def _is_independent_noise(effect_class: EffectClass, campaign: Campaign) -> bool:
    """Return whether a member gives every reading a variance of its own."""
    return issubclass(effect_class, EntryNoise) and is_independent(effect_class, campaign)
